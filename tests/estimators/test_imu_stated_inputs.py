"""What is stated of site and table moves the coefficients of an IMU as a refit with changed inputs says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import simulated_imu as imu
from recorded import from_means
from test_imu_multi_position import BOTH, calibrate

from planrunner.estimators.interface import Estimate, Setup
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.influences import InputQuantity, Inputs


def stated(name: str, unit: str, u: float) -> Setup:
    return Setup(inputs=Inputs({name: InputQuantity(name, 0.0, unit, u)}))


@pytest.mark.parametrize("misalignment", ["full", "lower_triangular"])
@pytest.mark.parametrize(("name", "step"), [("latitude", 1e-4), ("gravity", 1e-3)])
def test_sensitivities_are_those_of_a_refit(name: str, step: float, misalignment: str) -> None:
    recorded = imu.recorded(imu.plan(), imu.drawn_truth(np.random.default_rng(2)))
    keys: dict[str, Any] = {**BOTH, "misalignment": misalignment}
    found = calibrate(recorded, stated(name, "rad", step), **keys)
    up, down = (
        calibrate(recorded, site=replace(imu.SITE, **{name: getattr(imu.SITE, name) + s}), **keys)
        for s in (step, -step)
    )
    refit = np.array(
        [(a.value - b.value) / (2 * step) for a, b in zip(up.coefficients, down.coefficients, strict=True)]
    )
    assert np.sum([item.sensitivities for item in found.influences], axis=0)[:, 0] == pytest.approx(
        refit, rel=1e-3, abs=1e-5 * np.abs(refit).max()
    )


UNBALANCED = tuple(imu.POSITIONS[k] for k in (0, 2, 3, 4, 5, 7, 8, 11))
# So little that the weights are those of the noise, 10⁻¹² rad/s: a larger one would let positions that feel it count less.
BY_AZIMUTH = Setup(inputs=Inputs({"azimuth": InputQuantity("azimuth", 0.0, "rad", 1e-12)}))
BY_POSITION = Setup(inputs=Inputs({"table position": InputQuantity("table position", 0.0, "rad", 1e-4)}))


def azimuth_of(found: Estimate) -> np.ndarray:
    return np.sum([one.sensitivities[:, 0] for one in found.influences if one.quantity.name == "azimuth"], axis=0)


def test_azimuth_against_a_turned_table() -> None:
    """What a table turned by 10⁻⁴ rad does to the recording, estimated as if it had stood right. Balanced positions do not feel it."""
    truth, angle = imu.drawn_truth(np.random.default_rng(2)), 1e-4
    segments = imu.plan(positions=UNBALANCED)
    turn = np.array([[1, angle, 0], [-angle, 1, 0], [0, 0, 1.0]])  # axes turned counter-clockwise, seen from above
    wrong = []
    for segment in segments:
        rate, force = imu.felt(segment, tilt=turn)
        gyros, accelerometers = (
            truth["A_g"] @ rate + truth["b_g"] + truth["G"] @ force,
            truth["A_a"] @ force + truth["b_a"],
        )
        means = dict(zip((*imu.GYROS, *imu.ACCELS), (*gyros, *accelerometers), strict=True))
        one = from_means(segment, means, "rad/s", 1e-12)
        one.units.update(dict.fromkeys(imu.ACCELS, "m/s^2"))
        wrong.append(one)
    right, moved = calibrate(imu.recorded(segments, truth), BY_AZIMUTH), calibrate(tuple(wrong))
    change = [(b.value - a.value) / angle for a, b in zip(right.coefficients, moved.coefficients, strict=True)]
    expected = azimuth_of(right)
    assert np.abs(expected).max() > 0.1
    assert change == pytest.approx(expected, rel=2e-3, abs=1e-3 * np.abs(expected).max())
    assert np.abs(azimuth_of(calibrate(imu.recorded(imu.plan(), truth), BY_AZIMUTH))).max() < 1e-9


@pytest.mark.slow
def test_positions_against_tilted_tables() -> None:
    """Independent tilts of every orientation: the spread of many recordings is what the influence says, with the noise beside it."""
    truth, draw, segments = imu.drawn_truth(np.random.default_rng(2)), np.random.default_rng(4), imu.plan()
    quiet = (1e-8, 1e-5)
    keys = BOTH | {"uncertainty": "within_segment"}
    spread = [
        [
            item.value
            for item in calibrate(
                imu.recorded(segments, truth, draw, quiet, tilt=1e-4), BY_POSITION, **keys
            ).coefficients
        ]
        for _ in range(150)
    ]
    together = calibrate(imu.recorded(segments, truth, draw, quiet), BY_POSITION, **keys)
    expected = np.sqrt(np.diag(together.covariance + sum(one.covariance for one in merged(together.influences))))
    seen = np.std(spread, axis=0, ddof=1)
    # Where tilts act in second order alone, noise and rounding rule.
    whole = np.array([{"1": 1, "mrad": 1000, "mg": 1000}.get(item.unit, 15) for item in together.coefficients])
    real = expected > 1e-5 * whole
    assert real.sum() >= 12 and (seen[~real] < 1e-4 * whole[~real]).all()
    assert (seen / expected)[real].mean() == pytest.approx(1, abs=0.06)
    assert (seen / expected)[real] == pytest.approx(np.ones(real.sum()), abs=0.3)
    for basis, shown in (("within_segment", False), ("residual", True)):
        found = calibrate(imu.recorded(segments, truth, draw, quiet), BY_POSITION, **BOTH, uncertainty=basis)
        acting = [item.in_scatter for item in found.influences if item.quantity.name == "table position"]
        assert acting == [shown, shown]  # gyros, accelerometers


def test_a_table_that_is_too_fast_makes_the_scale_factor_too_large() -> None:
    truth = imu.drawn_truth(np.random.default_rng(2))
    # So little that the weights are those of the noise; else what the Earth turns at rest, of which no error is stated, would rule.
    found = calibrate(imu.recorded(imu.plan(), truth), stated("table rate", "1", 1e-14))
    index = [item.name for item in found.coefficients].index("gyro_scale_x")
    # A table whose rates are all stated too fast by δ makes the scale factor too small by δ; either sense of rotation does half of it.
    (influence,) = found.influences
    assert len(influence.parts) == influence.sensitivities.shape[1] == 2
    assert influence.sensitivities[index].sum() == pytest.approx(-found["gyro_scale_x"].value, rel=1e-3)
    assert influence.sensitivities[index, 0] == pytest.approx(influence.sensitivities[index, 1], rel=1e-2)
