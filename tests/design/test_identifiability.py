"""What planned positions can tell: the methods' own figures, and terms that must be named."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from planrunner.base.arrays import Array
from planrunner.base.said import Said
from planrunner.design.identifiability import identify, identify_block
from planrunner.error_model.flexure_gyro import static_model
from planrunner.error_model.terms import Term
from planrunner.estimators.interface import Design, DesignBlock
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import Stimulus, segment_means
from planrunner.plan.schedule import Rest, Segment

SITE = Site(math.radians(39.98))
WORDS = {"e": (1, 0, 0), "w": (-1, 0, 0), "n": (0, 1, 0), "s": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)}
OPTIMAL = ["unw", "dne", "nue", "ndw", "esd", "seu", "wsu", "swd"]
CARDINAL = [
    "".join(p)
    for p in itertools.permutations(WORDS, 3)
    if np.array_equal(np.cross(WORDS[p[0]], WORDS[p[1]]), WORDS[p[2]])
]


def block(
    positions: list[str] | np.ndarray, products: tuple[str, ...] = (), extra: tuple[Term, ...] = ()
) -> DesignBlock:
    attitudes = (
        positions
        if isinstance(positions, np.ndarray)
        else [np.array([WORDS[a] for a in p], dtype=float) for p in positions]
    )
    segments = [Segment(k, f"P{k}", a, "", Rest(), 120.0) for k, a in enumerate(attitudes)]
    model = static_model(products)
    terms = (*model.terms, *extra)
    felt = segment_means(segments, SITE)
    matrix = np.column_stack([term.column(felt) for term in terms])
    labels = tuple(s.label for s in segments)
    magnitudes = np.array([term.magnitude for term in terms])
    return DesignBlock("torquer_x", tuple(t.name for t in terms), matrix, magnitudes, np.ones(len(labels)), labels)


def test_the_eight_positions() -> None:
    (found,) = identify(Design((block(OPTIMAL),)))
    assert found.sound
    assert found.rank == found.columns == 6
    assert found.determinant == pytest.approx(706.081, abs=5e-4)
    assert found.condition == pytest.approx(2.61, abs=5e-3)
    assert found.explanation == ""
    assert np.linalg.cond(block(OPTIMAL).matrix) == pytest.approx(1.75e5, rel=0.01)  # raw SI columns mislead


def test_products_on_all_cardinal_positions_are_named() -> None:
    found = identify_block(block(CARDINAL, ("accel_x_accel_z", "accel_y_accel_z")))
    assert found.rank == 6
    assert found.unidentifiable == ("accel_x_accel_z", "accel_y_accel_z")
    assert found.explanation == "the terms accel_x_accel_z and accel_y_accel_z are zero in every position"
    assert math.isinf(found.condition)


def test_products_are_seen_with_up_along_the_corners_of_a_cube() -> None:
    rng = np.random.default_rng(0)
    attitudes = []
    for corner in itertools.product((-1, 1), repeat=3):
        up = np.array(corner) / math.sqrt(3)
        side = np.cross(up, rng.normal(size=3))
        side /= np.linalg.norm(side)
        attitudes.append(np.column_stack([side, np.cross(up, side), up]))  # columns: east, north, up in sensor axes
    assert identify_block(block(np.array(attitudes), ("accel_x_accel_z", "accel_y_accel_z"))).rank == 8


def test_squares_and_bias_cannot_be_separated() -> None:
    """a_X² + a_Y² + a_Z² is constant at 1 g: rank 9 of 10, at any attitude."""

    def squared(axis: int) -> Callable[[Stimulus], Array]:
        return lambda felt: felt.specific_force[:, axis] ** 2

    squares = tuple(
        Term(f"accel_{name}_squared", Said(""), 9.80665**2, "(m/s^2)^2", squared(k), 2) for k, name in enumerate("xyz")
    )
    attitudes = np.array([np.linalg.qr(np.random.default_rng(k).normal(size=(3, 3)))[0] for k in range(30)])
    found = identify_block(block(attitudes, extra=squares))
    assert found.rank == found.columns - 1
    assert set(found.unidentifiable) == {"bias", "accel_x_squared", "accel_y_squared", "accel_z_squared"}
    assert "cannot be separated" in found.explanation


def test_too_few_positions_are_said_to_be() -> None:
    found = identify_block(block(OPTIMAL[:5]))
    assert found.rank == 5
    assert found.explanation.startswith("5 segments cannot determine 6 coefficients")
    empty = block(OPTIMAL)
    none = DesignBlock(empty.output, empty.terms, np.empty((0, 6)), empty.magnitudes, np.empty(0), ())
    assert identify_block(none).explanation == "no segments are chosen"


def test_one_axis_always_level() -> None:
    found = identify_block(block(["nwu", "nue", "ned", "ndw", "swd", "seu"]))
    assert "accel_x" in found.unidentifiable
    assert "accel_x is zero in every position" in found.explanation
