"""Influences of stated conditions against derivatives by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from planrunner.uncertainty.conditions import StatedCondition, influences_on
from planrunner.uncertainty.influences import InputQuantity


@dataclass(frozen=True)
class Fall:
    gravity: float
    tilts: tuple[float, float]


WHERE = Fall(9.81, (0.3, -0.2))


def felt(where: Fall) -> np.ndarray:
    """g·sin a and g·cos b."""
    a, b = where.tilts
    return np.array([where.gravity * math.sin(a), where.gravity * math.cos(b)])


def conditions() -> list[StatedCondition[Fall]]:
    a, b = WHERE.tilts
    return [
        StatedCondition.single(
            InputQuantity("gravity", 9.81, "m/s^2", 1e-3), lambda by: replace(WHERE, gravity=WHERE.gravity + by)
        ),
        StatedCondition(
            InputQuantity("tilt", 0.0, "rad", 1e-4),
            {
                "a": lambda by: replace(WHERE, tilts=(a + by, b)),
                "b": lambda by: replace(WHERE, tilts=(a, b + by)),
            },
            in_scatter=True,
        ),
    ]


def test_sensitivities_are_the_derivatives() -> None:
    gravity, tilt = influences_on(felt, conditions())
    assert gravity.sensitivities[:, 0] == pytest.approx([math.sin(0.3), math.cos(-0.2)], rel=1e-12)
    assert tilt.sensitivities == pytest.approx(np.diag([9.81 * math.cos(0.3), -9.81 * math.sin(-0.2)]), rel=1e-8)
    assert (gravity.parts, gravity.in_scatter) == ((), False)
    assert (tilt.parts, tilt.in_scatter) == (("a", "b"), True)


def test_a_tiny_uncertainty_contributes_no_more_than_rounding() -> None:
    tiny = InputQuantity("gravity", 9.81, "m/s^2", 1e-20)
    (found,) = influences_on(
        felt, [StatedCondition.single(tiny, lambda by: replace(WHERE, gravity=WHERE.gravity + by))]
    )
    assert np.sqrt(np.diag(found.covariance)).max() < 1e-15


def test_a_formula_may_see_the_conditions_in_its_own_way() -> None:
    in_g = [one.seen_by(lambda where: where.gravity / 9.80665) for one in conditions()]
    gravity, tilt = influences_on(lambda ratio: np.array([ratio**2]), in_g)
    assert gravity.sensitivities[0, 0] == pytest.approx(2 * 9.81 / 9.80665**2, rel=1e-9)
    assert not tilt.sensitivities.any()
