"""Spikes in a gyro whose axis turns from stop to stop, in recordings of the independent generator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import firwin

from planrunner.archive.recording import Find
from planrunner.observation.screening import screened
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import known, recorded, segment_of
from tests.worlds.faults import WORLDS, Recorded

CAMPAIGN = CAMPAIGNS["strapdown_navigation from stop to stop"]
GYRO = list(CAMPAIGN.channels).index("gyro_z")


def _bad(made: Recorded) -> list[Find]:
    sound = known(CAMPAIGN, WORLDS["white noise"])
    segments = {segment.label: segment for segment in sound.schedule.segments}
    items = [segment_of(segments[step.label], made, k, CAMPAIGN) for k, step in enumerate(CAMPAIGN.steps)]
    return [find for item in screened(items, sound.sensor) for find in item.finds or () if find.bad]


@pytest.fixture(scope="module")
def made() -> Recorded:
    return recorded(CAMPAIGN, WORLDS["white noise"], np.random.default_rng(12))[1]


def _first_turn(made: Recorded) -> tuple[int, int]:
    """Row of the first sample of the first turn, and of the first sample after it."""
    turning = np.abs(made.values[:, GYRO]) > 1
    first = int(np.argmax(turning))
    return first, first + int(np.argmin(turning[first:]))


@pytest.mark.parametrize("seconds", [-20.0, -1.0, -0.4, -0.3, 0.2, 0.5, 1.0, 5.0])
def test_a_spike_that_is_small_beside_a_turn_is_found(made: Recorded, seconds: float) -> None:
    """A hundredth of the rate of the turns; before the first turn, during it and after it. It is replaced by the rate there, even three
    samples before the turn."""
    begin, end = _first_turn(made)
    for edge in (begin, end):
        values, row = made.values.copy(), edge + round(seconds * made.sampling)
        values[row, GYRO] += 0.1
        (find,) = _bad(replace(made, values=values))
        assert (find.channel, find.rows) == ("gyro_z", 1)
        assert find.size == pytest.approx(0.1, rel=0.01)
        assert (find.before + find.after) / 2 == pytest.approx(made.values[row, GYRO], abs=1e-3)


def test_a_table_that_swings_after_each_turn_has_no_spikes(made: Recorded) -> None:
    """Swings of 0.3 deg/s at 1.5 Hz that decay within half a second after each change of the rate."""
    assert not _bad(made)
    values = made.values.copy()
    edges = np.flatnonzero(np.abs(np.diff(values[:, GYRO])) > 1) + 1
    time = np.arange(30) / made.sampling
    for edge in edges:
        rows = slice(edge, edge + 30)
        count = len(values[rows])
        values[rows, GYRO] += (0.3 * np.exp(-time / 0.5) * np.sin(2 * np.pi * 1.5 * time))[:count]
    assert not _bad(replace(made, values=values))


@pytest.mark.parametrize(("taps", "width"), [(81, 0.8), (401, 0.9)])
def test_the_ripple_of_a_filter_beside_each_turn_is_no_spike(made: Recorded, taps: int, width: float) -> None:
    """A decimating filter of linear phase answers a turn with ripples of up to 9 % before it and after it. taps: of the filter, at ten
    times the rate of the recording; width: of its pass band, as a share of the band of the recording."""
    turning = np.where(np.abs(made.values[:, GYRO]) > 1, made.values[:, GYRO], 0.0).round(1)
    kernel, half, noise = firwin(taps, width / 10), taps // 2, np.random.default_rng(3)
    for shift in (0, 3, 6):
        fine = np.pad(np.repeat(turning, 10), (half + shift, half - shift), mode="edge")
        rate = np.convolve(fine, kernel, mode="valid")[5::10]
        assert np.ptp(rate[np.abs(rate) < 2]) > 0.1
        values = made.values.copy()
        values[:, GYRO] = rate + 1e-4 * noise.standard_normal(len(rate))
        assert not _bad(replace(made, values=values))
