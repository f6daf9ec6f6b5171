"""Transients that all segments have in common: named, because neither residuals nor repeats show them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from recorded import from_samples, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import analyse
from planrunner.estimators.interface import Estimate
from planrunner.estimators.scale_factor import ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import Spin

SITE = Site(math.radians(47.0), 9.807, earth_rate=0.0)
RATES = (1.0, -1.0, 5.0, -5.0, 20.0, -20.0, 60.0, -60.0)
Array = np.ndarray
Change = Callable[[Array, Array], Array]


def estimated(
    change: Change, seed: int = 1, drift: float = 0.0, about: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> Estimate:
    """A gyro of 200 (pulse/s)/(deg/s), 30 s at each rate with noise of 0.5 pulse/s. `change`: of the outputs without noise, as a
    function of the outputs and of the time since the beginning of the segment, s. drift: pulse/s². about: axis of the turns."""
    draw = np.random.default_rng(seed)
    recording: list[RecordedSegment] = []
    for number, rate in enumerate(RATES):
        time = np.arange(3000) / 100
        values = change(np.full(3000, 200.0 * rate + 3.0), time) + 0.5 * draw.standard_normal(3000)
        values += drift * (40.0 * number + time)
        planned = segment(f"R{number}", np.eye(3), Spin(math.radians(rate), about), 30.0)
        recording.append(from_samples(planned, 40.0 * number + time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    spec = EstimateSpec(estimator="scale_factor", parameters=ScaleFactorParameters(outputs=("gyro_z",)))
    results = analyse({"k": spec}, (), recording, SITE, sensor("gyro_z"))
    assert not results.failures
    return results.estimates["k"]


def named(found: Estimate) -> list[str]:
    return [text for text in found.warnings if "in a way that all segments have in common" in text]


SPOILT: list[tuple[str, Change, str]] = [
    ("spin-up of 3 s", lambda x, t: x * np.clip(t / 3, 0, 1), "beginnings"),
    ("settling in 0.3 s", lambda x, t: x * (1 - np.exp(-t / 0.3)), "beginnings"),
    ("switched on for each segment", lambda x, t: x + np.exp(-t / 3), "beginnings"),
    ("stopping for 2 s", lambda x, t: x * np.clip((30 - t) / 2, 0, 1), "ends"),
]


@pytest.mark.parametrize(("change", "place"), [one[1:] for one in SPOILT], ids=[one[0] for one in SPOILT])
def test_a_transient_of_all_segments_is_named(change: Change, place: str) -> None:
    """The coefficients are far from the true values, and the residuals do not show it."""
    found = estimated(change)
    off = [
        abs(found[name].value - true) / found[name].standard_uncertainty
        for name, true in (("K_gyro_z", 200.0), ("F0_gyro_z", 3.0))
    ]
    assert max(off) > 30
    [text] = named(found)
    assert f"the {place} of the segments" in text


def test_noise_drift_and_vibration_are_no_transient() -> None:
    for seed in range(2, 12):
        assert not named(estimated(lambda x, t: x, seed))
        assert not named(estimated(lambda x, t: x, seed, drift=0.1))
        assert not named(estimated(lambda x, t: x + 20 * np.sin(2 * np.pi * 0.37 * t), seed))


def test_a_transient_of_one_segment_is_not_called_common() -> None:
    def once(x: Array, t: Array) -> Array:
        return x * np.clip(t / 3, 0, 1) if x[0] > 200 * 30 else x

    assert not named(estimated(once))


def test_outputs_across_the_axis_of_the_turns_are_not_tested() -> None:
    """They follow the Earth rate and gravity, with the same course in every segment that makes one turn from the same angle."""
    tilt = math.radians(30)
    assert not named(estimated(SPOILT[0][1], about=(math.sin(tilt), 0.0, math.cos(tilt))))
