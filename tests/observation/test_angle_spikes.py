"""Spikes in recorded angles: they are found whatever the motion, and motion, counts and standing encoders give no find."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.archive.recording import Find, FindKind
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import SensorModel
from planrunner.observation.screening import watch_of
from planrunner.plan.schedule import Rest, Segment

Array = NDArray[np.float64]
ARCSEC = 1 / 3600
RATE, ROWS = 10.0, 6000
T = np.arange(ROWS) / RATE


def rocking(phase: float = 1.0) -> Array:
    """3 deg at 0.2 Hz, fading out within 5 s after 480 s."""
    return np.asarray(3 * np.clip((485 - T) / 5, 0, 1) * np.sin(2 * np.pi * 0.2 * T + phase))


def resting(phase: float = 1.0) -> Array:
    return np.full(ROWS, 100 * phase)


def turning(phase: float = 1.0) -> Array:
    """At 7 deg/s, read within one turn."""
    return np.mod(100 * phase + 7 * T, 360)


def indexing(phase: float = 1.0) -> Array:
    """90 deg in 9 s, and stops, over and over; the turns begin and end suddenly."""
    return np.asarray(90 * np.floor(T / 30) + np.clip(np.mod(T, 30) - 20 - phase, 0, 9) * 10)


def found(values: Array, rows: int = 997, unit: str = "deg") -> tuple[Find, ...]:
    segment = Segment(0, "S", np.eye(3), "", Rest(), None)
    watcher = watch_of(SensorModel("platform", (), RATE))(segment, {"ring": unit}, len(values))
    for low in range(0, len(values), rows):
        watcher.add(Block(50 + T[low : low + rows], {"ring": values[low : low + rows]}))
    return watcher.finds()


MOTIONS = [rocking, resting, turning, indexing]


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize(("noise", "count"), [(1.0, 0.0), (0.3, 3.6), (0.1, 18.0), (0.0, 0.0)])
def test_motion_noise_and_counts_alone_give_no_find(
    motion: Callable[[float], Array], noise: float, count: float
) -> None:
    """noise, count: arcsec. Whether counts change now and then depends on the phase."""
    draw = np.random.default_rng(7)
    for phase in draw.uniform(0, 1, 12):
        values = motion(phase) + noise * ARCSEC * draw.standard_normal(ROWS)
        if count:
            values = count * ARCSEC * np.round(values / (count * ARCSEC))
        assert found(values) == ()


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_spike_is_found_where_it_is_and_replaced_by_the_course(motion: Callable[[float], Array]) -> None:
    """400 arcsec with noise of 1 arcsec: near both ends, at the boundaries of blocks and of pieces."""
    draw = np.random.default_rng(8)
    true = motion(0.0)
    values = true + ARCSEC * draw.standard_normal(ROWS)
    for row in (1, 2, 3, 996, 997, 998, 3000, ROWS - 4, ROWS - 3, ROWS - 2):
        spoilt = values.copy()
        spoilt[row] += 400 * ARCSEC
        (one,) = found(spoilt)
        assert (one.kind, one.channel, one.first, one.rows, one.bad) == (FindKind.SPIKE, "ring", row, 1, True)
        assert one.time == pytest.approx(50 + T[row])
        assert one.size == pytest.approx(400 * ARCSEC, abs=40 * ARCSEC)
        assert one.before == one.after == pytest.approx(true[row], abs=40 * ARCSEC)


def test_the_finds_depend_neither_on_blocks_nor_on_the_unit() -> None:
    draw = np.random.default_rng(9)
    values = rocking() + ARCSEC * draw.standard_normal(ROWS)
    values[[40, 1500, 5990]] += 0.2
    first = [one.first for one in found(values)]
    assert first == [40, 1500, 5990]
    assert [one.first for one in found(values, rows=64)] == first
    assert [one.first for one in found(3600 * values, unit="arcsec")] == first


def test_spikes_in_a_long_record_with_missing_numbers() -> None:
    """Rows are those of the record."""
    draw = np.random.default_rng(10)
    n = 60_000
    values = 3 * np.sin(2 * np.pi * 0.02 * np.arange(n) / RATE) + ARCSEC * draw.standard_normal(n)
    values[100:110] = np.nan
    rows = [5000, 16_500, 16_640, 33_000, 59_998]
    values[rows] -= 0.1
    segment = Segment(0, "S", np.eye(3), "", Rest(), None)
    watcher = watch_of(SensorModel("platform", (), RATE))(segment, {"ring": "deg"}, n)
    for low in range(0, n, 4096):
        part = slice(low, low + 4096)
        watcher.add(Block(np.arange(n)[part] / RATE, {"ring": values[part]}))
    assert [one.first for one in watcher.finds() if one.kind is FindKind.SPIKE] == rows


@pytest.mark.parametrize(("rows", "screened"), [(16, False), (19, False), (20, True), (24, True)])
def test_spikes_are_found_in_every_segment_of_twenty_samples_and_in_no_shorter_one(rows: int, screened: bool) -> None:
    draw = np.random.default_rng(12)
    for row in range(3, rows - 3):
        values = resting()[:rows] + ARCSEC * draw.standard_normal(rows)
        values[row] += 400 * ARCSEC
        assert [one.first for one in found(values)] == ([row] if screened else [])


def test_a_step_is_no_spike() -> None:
    values = resting() + ARCSEC * np.random.default_rng(11).standard_normal(ROWS)
    values[3000:] += 0.2
    assert found(values) == ()


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("size", [179.9999, 180.0, -180.0, 180.0001, 200.0, 270.0, 540.0])
def test_a_spike_of_half_a_turn_or_more_shifts_no_other_sample(motion: Callable[[float], Array], size: float) -> None:
    """With noise, the way to such a sample and the way back may seem to go in the same direction. The value that replaces the sample
    is near its neighbours, not a turn away from them."""
    draw = np.random.default_rng(11)
    for row in (2, 450, 997, 3100, ROWS - 3):
        values = motion(0.0) + ARCSEC * draw.standard_normal(ROWS)
        true = values[row]
        values[row] += size
        (one,) = found(values)
        assert (one.kind, one.first, one.rows) == (FindKind.SPIKE, row, 1)
        assert one.before == one.after == pytest.approx(true, abs=40 * ARCSEC)
        assert one.size == pytest.approx(size, abs=40 * ARCSEC)


def test_a_spike_of_half_a_turn_while_the_reading_starts_again_at_zero() -> None:
    values = turning(0.0) + ARCSEC * np.random.default_rng(12).standard_normal(ROWS)
    values[3000] += 180.0
    (one,) = found(np.mod(values, 360))
    assert one.first == 3000


def test_a_fast_rotation_has_no_spike() -> None:
    """100 and 170 deg from sample to sample: no sample is alone."""
    for step in (100.0, 170.0):
        assert (
            found(np.mod(step * np.arange(ROWS), 360) + ARCSEC * np.random.default_rng(13).standard_normal(ROWS)) == ()
        )
