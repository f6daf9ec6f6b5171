"""A drift that the gyros of an IMU show is also fitted to its accelerometers, and the other way round."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.estimators.interface import Estimate
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded
from tests.worlds.faults import WORLDS

IMU = CAMPAIGNS["imu_multi_position"]


def made(sizes: np.ndarray, key: str = "", run: int = 0, squares: np.ndarray | None = None) -> Estimate:
    """A linear drift of the six channels, in standard deviations of the noise of a segment mean.

    squares: the same for the square of each output, relative to its largest value.
    """
    _, seen = recorded(IMU, WORLDS["white noise"], np.random.default_rng([31, run]))
    course = (seen.time - seen.time.mean()) / np.ptp(seen.time)
    drifting = replace(seen, values=seen.values + course[:, None] * sizes * seen.mean)
    if squares is not None:
        shape = (seen.values / np.abs(seen.values).max(axis=0)) ** 2
        drifting = replace(drifting, values=drifting.values + shape * squares * seen.mean)
    asked = replace(IMU, plan=IMU.plan.replace("imu_multi_position,", f"imu_multi_position, {key}"))
    found = estimated(asked, known(asked, WORLDS["white noise"]), drifting)
    assert isinstance(found, Estimate), found
    return found


def test_a_drift_of_the_gyros_widens_the_intervals_of_the_accelerometers() -> None:
    """A drift of 1.5 times the noise of a mean cannot be seen in the accelerometers alone. Their uncertainties are those of a fit with
    the drift that the gyros show."""
    gyros, both = np.array([8.0, 8.0, 8.0, 0, 0, 0]), np.array([8.0, 8.0, 8.0, 1.5, 1.5, 1.5])
    for sizes in (gyros, both):
        found = made(sizes)
        [text] = [text for text in found.warnings if "accel_x" in text and "seem to drift" in text]
        form = "quadratic" if "quadratic" in text else "linear"
        planned = made(sizes, f"drift: {form}, ")
        for item in found.coefficients:
            if item.name.startswith("accel"):
                assert item.value == planned[item.name].value
                assert item.standard_uncertainty == planned[item.name].standard_uncertainty


def test_without_a_drift_both_triads_are_fitted_as_alone() -> None:
    found, none = made(np.zeros(6)), made(np.zeros(6), "drift: none, ")
    assert not [text for text in found.warnings if "seem to drift" in text]
    assert [item.value for item in found.coefficients] == [item.value for item in none.coefficients]


@pytest.mark.parametrize("square", [0.0, 10.0])
def test_a_nonlinearity_of_the_other_triad_is_named_beside_the_drift(square: float) -> None:
    """The gyros drift. The accelerometers do not, but their output contains its square. A fit of the drift hides a part of it."""
    bends = np.array([0, 0, 0, square, square, square])
    for run in range(3):
        found = made(np.array([8.0, 8.0, 8.0, 0, 0, 0]), run=run, squares=bends)
        assert [text for text in found.warnings if "accel_x" in text and "seem to drift" in text]
        bent = [text for text in found.warnings if "A nonlinearity of these outputs also explains" in text]
        assert len(bent) == (square > 0)
        assert all("accel_x" in text and "gyro_x" not in text for text in bent)
