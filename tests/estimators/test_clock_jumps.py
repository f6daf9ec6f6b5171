"""A jump of the recording's clock: with wrong times, no drift explains the residuals. The place of the jump is named."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

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

RATES = (60.0, -60.0, 20.0, -20.0, 5.0, -5.0, 1.0, -1.0)
Array = np.ndarray


def estimate(
    clock: Callable[[int, Array], Array],
    drift: float = 0.01,
    seed: int = 1,
    step: float = 0.0,
    places: Sequence[int] = range(len(RATES)),
) -> Estimate:
    """A gyro of 200 (pulse/s)/(deg/s), 30 s at each rate, with a drift in pulse/s². `clock`: the recorded times of the segment at this
    place in time, from its true times. `step`: change of the output before the fifth segment. `places`: places in time of the segments."""
    draw = np.random.default_rng(seed)
    recording = []
    for number, (rate, place) in enumerate(zip(RATES, places, strict=True)):
        time = 40.0 * place + np.arange(3000) / 100
        values = 200.0 * rate + 3.0 + drift * time + step * (number > 3) + 0.5 * draw.standard_normal(3000)
        planned = segment(f"R{number}", np.eye(3), Spin(math.radians(rate), (0.0, 0.0, 1.0)), 30.0)
        recording.append(from_samples(planned, clock(place, time), {"gyro_z": values}, {"gyro_z": "pulse/s"}))
    return analysed(recording)


def analysed(recording: Sequence[RecordedSegment]) -> Estimate:
    spec = EstimateSpec(estimator="scale_factor", parameters=ScaleFactorParameters(outputs=("gyro_z",)))
    results = analyse({"k": spec}, (), recording, Site(0.8, 9.8, earth_rate=0.0), sensor("gyro_z"))
    assert not results.failures
    return results.estimates["k"]


def between(jump: float) -> Callable[[int, Array], Array]:
    return lambda number, time: time + jump * (number > 3)


def within(jump: float) -> Callable[[int, Array], Array]:
    return lambda number, time: time + jump * ((number > 3) | ((number == 3) & (np.arange(len(time)) >= 1800)))


def named(found: Estimate) -> list[str]:
    return [text for text in found.warnings if "clock of the recording jumped" in text]


@pytest.mark.parametrize("jump", [100.0, 1e3, 1e5, -1e3])
def test_a_jump_between_segments_is_named(jump: float) -> None:
    """The uncertainty is a hundred times as large as with the true times."""
    found, true = estimate(between(jump)), estimate(between(0.0))
    assert found["K_gyro_z"].standard_uncertainty > 50 * true["K_gyro_z"].standard_uncertainty
    [text] = named(found)
    assert "before segment 'R4'" in text
    assert f"by {jump:.3g} s" in text
    assert not named(true)


@pytest.mark.parametrize("jump", [100.0, 1e4])
def test_a_jump_within_a_segment_is_named(jump: float) -> None:
    [text] = named(estimate(within(jump)))
    assert f"in segment 'R3' contain a gap of {jump:.3g} s" in text


@pytest.mark.parametrize("seed", range(6))
def test_a_pause_is_no_jump(seed: int) -> None:
    """A drift that really continued during a long pause; no drift; a step that no time explains."""

    def paused(number: int, time: Array) -> Array:
        return time + 500.0 * (number > 3)

    assert not named(estimate(paused, drift=0.0, seed=seed))
    assert not named(estimate(paused, drift=0.0, seed=seed, step=2.0 * (-1) ** seed))
    assert not named(estimate(paused, drift=0.01, seed=seed, step=0.01 * 500.0))


@pytest.mark.parametrize("jump", [100.0, 1e3])
def test_a_jump_is_named_if_a_segment_was_recorded_again(jump: float) -> None:
    """R1 was recorded again at the end, so that the plan does not have the order of the times."""
    [text] = named(estimate(between(jump), places=(0, 7, 1, 2, 3, 4, 5, 6)))
    assert "before segment 'R5'" in text
    assert f"by {jump:.3g} s" in text


def walking(count: int, walk: float, seed: int) -> Estimate:
    """Segments whose output has a random walk, in pulse/s/√s, with a real pause of 300 s."""
    draw, recording, offset, begin = np.random.default_rng(seed), [], 0.0, 0.0
    for number, rate in enumerate(RATES[:count]):
        if number == count // 2:
            begin += 300.0
            offset += walk * math.sqrt(300.0) * draw.standard_normal()
        course = np.cumsum(walk * 0.1 * draw.standard_normal(3000))
        values = 200.0 * rate + 3.0 + offset + course + 0.5 * draw.standard_normal(3000)
        planned = segment(f"R{number}", np.eye(3), Spin(math.radians(rate), (0.0, 0.0, 1.0)), 30.0)
        time = begin + np.arange(3000) / 100
        recording.append(from_samples(planned, time, {"gyro_z": values}, {"gyro_z": "pulse/s"}))
        offset += course[-1] + walk * math.sqrt(10.0) * draw.standard_normal()
        begin += 40.0
    return analysed(recording)


@pytest.mark.parametrize(("count", "walk"), [(5, 0.01), (7, 0.003), (7, 0.005)])
def test_a_random_walk_with_a_pause_is_no_jump(count: int, walk: float) -> None:
    """Such a walk has residuals that a drift without the pause explains by chance in a tenth of the tests."""
    assert sum(bool(named(walking(count, walk, seed))) for seed in range(40)) <= 1
