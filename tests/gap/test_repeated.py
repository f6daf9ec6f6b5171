"""Stuck stretches: found where noise would not leave a count for so long, and nowhere else. The recordings are drawn here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.base.arrays import Array
from planrunner.error_model.added import LASTING
from planrunner.error_model.effects.held import sticking
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.apart import repeated, repeated_parameters
from planrunner.gap.answer.comparison import compare
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.plan.schedule import Rock
from tests.gap.turntable import record

SIGMA = 0.01


@pytest.fixture(scope="module")
def still() -> Observed:
    return record(seed=3)


def _with(still: Observed, values: Array) -> Observed:
    return replace(still, values=np.column_stack([values] * len(still.channels)))


def _noise(still: Observed, draw: np.random.Generator, smoothing: float = 0.0) -> Array:
    """Noise of SIGMA whose neighbours correlate by `smoothing`."""
    from scipy.signal import lfilter

    white = draw.standard_normal(len(still.time))
    return np.asarray(SIGMA * np.sqrt(1 - smoothing**2) * lfilter([1.0], [1.0, -smoothing], white))


@pytest.mark.parametrize("count", [0.0, 0.001, 0.01, 0.03, 0.1])
@pytest.mark.parametrize("smoothing", [0.0, 0.8])
def test_noise_is_never_stuck(still: Observed, count: float, smoothing: float) -> None:
    values = _noise(still, np.random.default_rng(1), smoothing)
    if count:
        values = np.round(values / count) * count
    found = repeated(_with(still, values))
    assert found.log_bayes <= 0 and not found.stretches
    if count <= SIGMA / 10:
        assert found.log_bayes < 0, "the channels were used; those with coarse counts may be left out"


def test_samples_that_come_twice_are_a_slower_sensor(still: Observed) -> None:
    values = np.repeat(_noise(still, np.random.default_rng(2)), 2)[: len(still.time)]
    assert not repeated(_with(still, values)).stretches


def test_a_stretch_is_found_with_its_first_sample_and_its_length(still: Observed) -> None:
    part = still.segments()[4]
    values = np.round(_noise(still, np.random.default_rng(3)) / 1e-3) * 1e-3
    values[part.start + 100 : part.start + 130] = values[part.start + 99]
    observed = _with(still, np.zeros(len(values)))
    observed.values[:, 1] = values
    found = repeated(observed)
    assert found.log_bayes > 20
    (one,) = found.stretches
    assert (one.channel, one.first) == (1, part.start + 100) and 30 <= one.count <= 31
    assert found.held.sum() == one.count


def test_the_errors_of_time_and_duration_of_a_stretch_are_those_stated(still: Observed) -> None:
    """Stretches that begin and end anywhere between samples, held in all outputs by the simulation."""
    draw, away = np.random.default_rng(4), []
    part, step = still.segments()[4], 1 / still.sample_rate
    for _ in range(60):
        begin = float(still.time[part.start]) + draw.uniform(2, 8)
        lasting = draw.uniform(2, 8)
        observed = _with(still, _noise(still, draw))
        values = sticking(still.time, observed.values[:, 0], begin, lasting, 0.0)
        found = repeated(_with(still, values))
        when, duration = repeated_parameters(observed, "samples_stuck", found)
        assert (when.name, duration.name) == ("time", LASTING)
        away.append([(when.value - begin) / step, (duration.value - lasting) / step])
        stated = [when.standard_uncertainty / step, duration.standard_uncertainty / step]
    assert np.sqrt(np.mean(np.square(away), axis=0)) == pytest.approx(stated, rel=0.25)


def _held(observed: Observed, segment: int, channel: int, share: float) -> Observed:
    """The recording, in which a channel keeps one value for a share of a segment."""
    values, part = observed.values.copy(), observed.segments()[segment]
    first = part.start + (part.stop - part.start) // 10
    values[first : first + int(share * (part.stop - part.start)), channel] = values[first, channel]
    return replace(observed, values=values)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_the_rest_of_a_segment_with_stuck_samples_is_no_other_cause(share: float) -> None:
    """Few samples determine the coefficients of the segment poorly, and samples without noise do not make the others a burst."""
    few = DiagnosisOptions(effects=("samples_stuck", "accel_bias_step", "mount_shift"))
    found = diagnose(_held(record(seed=1), 4, 3, share), few)
    assert found.verdict.effects == ("samples_stuck",)
    assert not found.verdict.something_else
    assert found.posterior.probability["samples_stuck"] > 0.5


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_stuck_samples_are_left_out_of_simulations_as_well(share: float) -> None:
    """Gyro z sticks while the table turns about z."""
    few = DiagnosisOptions(effects=("samples_stuck", "accel_bias_step"))
    turning = next(k for k, motion in enumerate(record(seed=1).motions) if isinstance(motion, Rock))
    weighing = diagnose(_held(record(seed=1), turning, 2, share), few).grounds.weighing
    nominal = DiagnosisOptions().nominal
    made = compare(weighing, nominal, record(seed=2), _held(record(seed=3), turning, 2, share))
    assert max(one.before_sigma for one in made.channels.values()) < 1.5
    assert max(one.after_sigma for one in made.channels.values()) < 1.5
    assert (weighing.observed.labels[turning] in made.labels) == (share < 1 / 3)
