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
from planrunner.estimators.transients import transient_words
from planrunner.instruments.models import NoiseModel
from planrunner.observation.screening import screened
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


def from_the_residuals(found: Estimate) -> dict[str, float]:
    """The standard uncertainties of a straight line with equal weights, from its residuals alone."""
    rates, residuals = (np.array([row[k] for row in found.tables[0].rows], dtype=float) for k in (1, 3))
    scatter = float(np.sqrt(residuals @ residuals / (len(rates) - 2)))
    square = float(np.sum((rates - rates.mean()) ** 2))
    return {
        "K_gyro_z": scatter / math.sqrt(square),
        "F0_gyro_z": scatter * math.sqrt(1 / len(rates) + rates.mean() ** 2 / square),
    }


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
    """The coefficients are far from the true values, and the residuals do not show it. The transients also look like noise within
    the segments, which can be the larger of the two."""
    found = estimated(change)
    by_residuals = from_the_residuals(found)
    true = {"K_gyro_z": 200.0, "F0_gyro_z": 3.0}
    assert max(abs(found[name].value - value) / by_residuals[name] for name, value in true.items()) > 30
    assert max(abs(found[name].value - value) / found[name].standard_uncertainty for name, value in true.items()) > 4
    [text] = named(found)
    assert f"the {place} of the segments" in text


def test_noise_drift_and_vibration_are_no_transient() -> None:
    for seed in range(2, 12):
        assert not named(estimated(lambda x, t: x, seed))
        assert not named(estimated(lambda x, t: x, seed, drift=0.1))
        assert not named(estimated(lambda x, t: x + 20 * np.sin(2 * np.pi * 0.37 * t), seed))


def test_a_barometer_that_follows_the_weather_is_not_tested() -> None:
    model, recording = sensor("pressure", unit="hPa"), []
    for number in range(8):
        time = 100.0 * number + np.arange(3000) / 100
        values = {"pressure": 1010 + np.where(time % 100 < 3, 1.0, 0.0) + 0.01 * np.sin(time)}
        recording.append(from_samples(segment(f"R{number}", np.eye(3)), time, values, {"pressure": "hPa"}))
    screened_ones = screened(recording, model)
    assert all("pressure" in one.parts for one in screened_ones)
    assert transient_words(screened_ones, (), model) == ()


def test_a_transient_of_one_segment_is_not_called_common() -> None:
    def once(x: Array, t: Array) -> Array:
        return x * np.clip(t / 3, 0, 1) if x[0] > 200 * 30 else x

    assert not named(estimated(once))


def test_outputs_across_the_axis_of_the_turns_are_not_tested() -> None:
    """They follow the Earth rate and gravity, with the same course in every segment that makes one turn from the same angle."""
    tilt = math.radians(30)
    assert not named(estimated(SPOILT[0][1], about=(math.sin(tilt), 0.0, math.cos(tilt))))


def filtered(width: float, left_out: float, seed: int = 1) -> Estimate:
    """The same gyro turned at rates that rise without pauses, with a moving average of `width` s in its output. The rates last 18 s
    to 11 s, of which `left_out` s are not used at the beginning."""
    draw = np.random.default_rng(seed)
    lengths = np.array([18.0, 18.0, 18.0, 18.0, 18.0, 14.0, 11.0])
    rates = np.array([60.0, 120.0, 180.0, 240.0, 360.0, 540.0, 720.0])
    rows = np.repeat(np.arange(7), (100 * lengths).astype(int))
    values = 200 * rates[rows] + 3.0 + 500 * draw.standard_normal(len(rows))
    count = max(1, round(100 * width))
    values[count - 1 :] = np.convolve(values, np.full(count, 1 / count), "valid")
    recording, times = [], np.arange(len(rows)) / 100
    for k, rate in enumerate(rates):
        place = np.flatnonzero(rows == k)[round(100 * left_out) :]
        planned = segment(f"R{k}", np.eye(3), Spin(math.radians(rate), (0.0, 0.0, 1.0)), len(place) / 100)
        recording.append(from_samples(planned, times[place], {"gyro_z": values[place]}, {"gyro_z": "pulse/s"}))
    spec = EstimateSpec(
        estimator="scale_factor", parameters=ScaleFactorParameters(outputs=("gyro_z",), weights="equal")
    )
    results = analyse({"k": spec}, (), recording, SITE, sensor("gyro_z"))
    assert not results.failures
    return results.estimates["k"]


def several(found: Estimate) -> list[str]:
    return [text for text in found.warnings if "segments differ from the rest" in text]


def test_the_transients_of_a_filter_are_named() -> None:
    """They follow the steps of the rate and end after 3 s, so they are not the same function of the rate in all segments. The scale
    factor is 12 standard uncertainties away. The transients also look like noise within the segments, but the residuals are not
    significantly smaller than this noise (probability 2.6 %, decision 109), so they stay the basis of the uncertainties."""
    found = filtered(3.0, left_out=2.0)
    assert abs(found["K_gyro_z"].value - 200.0) > 10 * from_the_residuals(found)["K_gyro_z"]
    assert found["K_gyro_z"].degrees_of_freedom == 5
    [text] = several(found)
    assert "the beginnings of" in text and "of 7 segments" in text


def test_a_filter_without_transients_is_not_named() -> None:
    for seed in range(2, 8):
        assert not several(filtered(0.0, 2.0, seed))
        assert not several(filtered(3.0, 3.0, seed))


def in_counts(change: Callable[[int, Array], Array], noise: float, seed: int = 1, step: float = 100.0) -> list[str]:
    """The warnings about an output in whole deg/s. `change`: counts, of the number of the segment and the time, s. noise:
    counts. step: of the level from segment to segment, counts."""
    draw, recording = np.random.default_rng(seed), []
    model = sensor("gyro_z", unit="deg/s", noise=NoiseModel(resolution=1.0))
    for number in range(8):
        time = np.arange(3000) / 100
        values = np.round(step * number + 0.2 + change(number, time) + noise * draw.standard_normal(3000))
        planned = segment(f"R{number}", np.eye(3))
        recording.append(from_samples(planned, 40.0 * number + time, {"gyro_z": values}, {"gyro_z": "deg/s"}))
    return [str(one) for one in transient_words(screened(recording, model), (), model)]


@pytest.mark.parametrize("step", [0.0, 100.0])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize(
    "sizes", [(6.0,), (6.0, -5.0, 7.0, -6.0, -5.0, 6.0, 5.0, -7.0)], ids=["equal", "of both signs"]
)
def test_a_transient_of_several_counts_is_named_although_the_counts_hide_the_noise(
    noise: float, sizes: tuple[float, ...], step: float
) -> None:
    (text,) = in_counts(lambda number, t: sizes[number % len(sizes)] * (t < 3), noise, step=step)
    assert "the beginnings of" in text


def test_steps_of_one_count_are_no_transient() -> None:
    """A drift of less than a count per segment changes a reading once in a segment, at any time."""
    for seed in range(10):
        begins = np.random.default_rng(100 + seed).uniform(-0.5, 0.5, 8)
        for noise in (0.0, 0.05, 0.3):
            assert in_counts(lambda number, t, b=begins: b[number] + 0.02 * t, noise, seed) == []  # type: ignore[misc]
