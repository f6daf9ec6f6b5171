"""The flexure gyro's relations against formulas written apart, the published determinant, and numerical differentiation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from planrunner.error_model import flexure_gyro
from planrunner.physics.earth import Site
from planrunner.uncertainty.derivatives import jacobian
from tests.directions import WORDS

LATITUDE = math.radians(39.98)
OPTIMAL = (
    "up north west",
    "down north east",
    "north up east",
    "north down west",
    "east south down",
    "south east up",
    "west south up",
    "south west down",
)
TRADITIONAL = (
    "north west up",
    "west south up",
    "south east up",
    "east north up",
    "west up north",
    "up east north",
    "east down north",
    "down west north",
)


def rows(positions: tuple[str, ...]) -> np.ndarray:
    """[1, ω_Y, ω_X, a_X, a_Y, a_Z] in Earth-rate units and g, written from the words alone."""
    table = []
    for position in positions:
        x, y, z = (WORDS[word] for word in position.split())
        rate = [axis[1] * math.cos(LATITUDE) + axis[2] * math.sin(LATITUDE) for axis in (x, y)]
        table.append([1.0, rate[1], rate[0], x[2], y[2], z[2]])
    return np.array(table, dtype=float)


def test_published_determinants_and_conditions() -> None:
    best = rows(OPTIMAL)
    assert np.linalg.det(best.T @ best) == pytest.approx(706.081, abs=5e-4)
    assert np.trace(np.linalg.inv(best.T @ best)) == pytest.approx(2.57809, abs=5e-6)
    assert np.linalg.cond(best) == pytest.approx(2.61, abs=5e-3)
    traditional = rows(TRADITIONAL)
    assert np.linalg.det(traditional.T @ traditional) == pytest.approx(88.26, abs=5e-3)
    assert np.linalg.cond(traditional) == pytest.approx(3.83, abs=5e-3)


@pytest.mark.parametrize("wrong", ["up east north", "up west south"])
def test_other_repairs_of_position_one_give_less(wrong: str) -> None:
    matrix = rows((wrong, *OPTIMAL[1:]))
    assert np.linalg.det(matrix.T @ matrix) == pytest.approx(419.236, abs=5e-4)


def test_no_eight_of_the_cardinal_orientations_do_better() -> None:
    """All 735 471 choices of 8 of 24, as the methods file states."""
    cardinal = [
        f"{x} {y} {z}"
        for x, y, z in itertools.permutations(WORDS, 3)
        if np.array_equal(np.cross(WORDS[x], WORDS[y]), WORDS[z])
    ]
    assert len(cardinal) == 24
    matrix = rows(tuple(cardinal))
    outer = np.einsum("ni,nj->nij", matrix, matrix).reshape(24, 36)
    largest, count = 0.0, 0
    chosen = itertools.combinations(range(24), 8)
    while batch := list(itertools.islice(chosen, 50_000)):
        masks = np.zeros((len(batch), 24))
        masks[np.arange(len(batch))[:, None], np.array(batch)] = 1.0
        largest = max(largest, float(np.linalg.det((masks @ outer).reshape(-1, 6, 6)).max()))
        count += len(batch)
    assert count == 735_471
    assert largest == pytest.approx(706.081, abs=5e-4)


def hand_worked_pulses(position: str, truth: dict[str, float], site: Site) -> tuple[float, float]:
    """Both outputs [pulse/s] from the physical coefficients, written out from the source in deg/h and g."""
    x, y, z = (WORDS[word] for word in position.split())
    earth = 15.041067
    w_x, w_y = (earth * (axis[1] * math.cos(site.latitude) + axis[2] * math.sin(site.latitude)) for axis in (x, y))
    a_x, a_y, a_z = (axis[2] * site.gravity / 9.80665 for axis in (x, y, z))
    seen_y = w_y + truth["D_X_F"] + truth["D_X_X"] * a_x + truth["D_X_Y"] * a_y + truth["D_X_Z"] * a_z
    seen_x = w_x + truth["D_Y_F"] + truth["D_Y_X"] * a_x + truth["D_Y_Y"] * a_y + truth["D_Y_Z"] * a_z
    e, s = math.radians(truth["epsilon"] / 60), math.radians(truth["xi"] / 60)
    i_x = (math.cos(e + s) * seen_y + math.sin(e + s) * seen_x) / (truth["SF_Y"] * math.cos(s))
    i_y = (-math.sin(e) * seen_y + math.cos(e) * seen_x) / (truth["SF_X"] * math.cos(s))
    return i_x, i_y


def random_physical(rng: np.random.Generator, count: int = 12) -> np.ndarray:
    geometry = [*rng.uniform(1e-6, 1e-3, 2) * rng.choice([-1, 1], 2), *rng.uniform(-0.6, 0.6, 2)]
    return np.array([*geometry, *rng.normal(0, 1e-5, count - 4)])


@pytest.mark.parametrize("count", [12, 16])
def test_inverse_undoes_forward(count: int) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        truth = random_physical(rng, count)
        back = flexure_gyro.physical_coefficients(flexure_gyro.output_coefficients(truth))
        assert back == pytest.approx(truth, rel=1e-9, abs=1e-20)


def test_forward_has_the_signs_of_the_source() -> None:
    """One case worked by hand: ε = 30°, ξ = 15°, SF_X = 2, SF_Y = 3."""
    truth = np.array([2.0, 3.0, math.pi / 6, math.pi / 12, 1.0, 0, 0, 0, 0, 0, 0, 1.0])
    (u, v) = flexure_gyro.output_coefficients(truth)
    cos_xi = 0.9659258262890683
    assert u[1] == pytest.approx(math.sqrt(0.5) / (3 * cos_xi))
    assert u[2] == pytest.approx(math.sqrt(0.5) / (3 * cos_xi))
    assert v[1] == pytest.approx(-0.5 / (2 * cos_xi))
    assert v[2] == pytest.approx(math.sqrt(0.75) / (2 * cos_xi))
    assert (u[0], v[0]) == pytest.approx((u[1], v[1]))  # D_X_F = 1 acts like one unit of ω_Y
    assert (u[5], v[5]) == pytest.approx((u[2], v[2]))  # D_Y_Z = 1 acts like one unit of ω_X
    assert np.all(u[3:5] == 0)


@pytest.mark.parametrize("count", [12, 16])
def test_jacobian_matches_central_differences(count: int) -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        outputs = flexure_gyro.output_coefficients(random_physical(rng, count))
        analytic = jacobian(
            lambda flat: flexure_gyro.physical_coefficients(flat.reshape(2, count // 2, -1)), outputs.ravel()
        )
        flat = outputs.ravel()
        for k in range(flat.size):
            step = 1e-5 * np.abs(outputs).max(axis=1)[k // outputs.shape[1]]
            step = max(step * (1e-3 if k % outputs.shape[1] in (0, *range(3, outputs.shape[1])) else 1e-1), 1e-12)
            up, down = flat.copy(), flat.copy()
            up[k] += step
            down[k] -= step
            difference = flexure_gyro.physical_coefficients(
                up.reshape(outputs.shape)
            ) - flexure_gyro.physical_coefficients(down.reshape(outputs.shape))
            numeric = difference / (2 * step)
            assert analytic[:, k] == pytest.approx(numeric, rel=2e-5, abs=1e-7 * np.abs(analytic[:, k]).max() + 1e-18)


def test_compensation_returns_the_true_rates() -> None:
    truth = np.array([1e-5, -2e-5, 0.01, -0.02, *np.random.default_rng(1).normal(0, 1e-5, 8)])
    outputs = flexure_gyro.output_coefficients(truth)
    rng = np.random.default_rng(2)
    omega, force = rng.normal(0, 7e-5, (5, 3)), rng.normal(0, 9.8, (5, 3))
    design = np.column_stack([np.ones(5), omega[:, 1], omega[:, 0], force])
    recovered = flexure_gyro.compensated_rates(outputs, design @ outputs.T, force)
    assert recovered == pytest.approx(omega[:, [1, 0]], rel=1e-9)


def test_dead_output_is_explained() -> None:
    with pytest.raises(ValueError, match="do not respond to rate"):
        flexure_gyro.physical_coefficients(np.zeros((2, 6)))


def test_static_model_agrees_with_the_pulses_worked_by_hand() -> None:
    from planrunner.physics.stimulus import segment_means
    from planrunner.plan.schedule import Rest, Segment

    site = Site(LATITUDE, 9.8015)
    truth = {"SF_X": 0.031, "SF_Y": 0.029, "epsilon": 7.0, "xi": -4.0}
    truth |= {f"D_{a}_{k}": 0.1 * n - 0.3 for n, (a, k) in enumerate(itertools.product("XY", "FXYZ"))}
    deg_h = math.radians(1 / 3600)
    si = np.array(
        [truth["SF_X"] * deg_h, truth["SF_Y"] * deg_h, math.radians(7 / 60), math.radians(-4 / 60)]
        + [truth[f"D_{a}_{k}"] * deg_h / (1.0 if k == "F" else 9.80665) for a in "XY" for k in "FXYZ"]
    )
    segments = [
        Segment(k, position, np.array([WORDS[w] for w in position.split()], dtype=float), position, Rest(), 120.0)
        for k, position in enumerate(OPTIMAL)
    ]
    predicted = (
        flexure_gyro.static_model().columns(segment_means(segments, site)) @ flexure_gyro.output_coefficients(si).T
    )
    expected = np.array([hand_worked_pulses(position, truth, site) for position in OPTIMAL])
    assert predicted == pytest.approx(expected, rel=1e-12)
