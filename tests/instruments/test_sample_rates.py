"""Where the sample rate of a recording changes, against recordings that were made with known changes."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planrunner.instruments.sample_rates import SampleRates


def parts(times: np.ndarray, batch: int = 65536) -> list[list[Any]]:
    """The parts of `times` that have one rate: first row, row after the last, period. `batch`: rows that are given at once."""
    divider: SampleRates[np.int_] = SampleRates()
    found: list[list[Any]] = []
    taken = [
        part
        for begin in range(0, len(times), batch)
        for part in divider.take(times[begin : begin + batch], np.arange(begin, min(begin + batch, len(times))))
    ]
    for part in [*taken, *divider.rest()]:
        np.testing.assert_array_equal(part.time, times[part.data])
        if part.changed or not found:
            found.append([part.data[0], part.data[0], part.period])
        assert part.data[0] == found[-1][1]
        found[-1][1] = part.data[-1] + 1
    return found


@pytest.mark.parametrize("batch", [1, 100, 1050, 65536])
@pytest.mark.parametrize("changes", [(1000,), (300, 1100), (129, 700, 2000)])
def test_the_parts_meet_where_the_rate_changes(changes: tuple[int, ...], batch: int) -> None:
    """The period is 10, 5, 10, 5 ms between the changes; the jitter of each time is 2 % of a period."""
    period = np.zeros(3000)
    for number, (begin, end) in enumerate(pairwise((0, *changes, 3000))):
        period[begin:end] = 0.01 if number % 2 == 0 else 0.005
    times = np.cumsum(period) + np.random.default_rng(1).normal(0, 1e-4, 3000)
    found = parts(times, batch)
    assert [begin for begin, *_ in found] == [0, *[pytest.approx(change, abs=1) for change in changes]]
    assert [end for _, end, _ in found] == [*[begin for begin, *_ in found[1:]], 3000]
    assert [one for *_, one in found] == [pytest.approx(period[begin + 5], rel=0.05) for begin, *_ in found]


@pytest.mark.parametrize("lost", [0.0, 0.02, 0.2])
def test_lost_rows_and_pauses_are_no_change(lost: float) -> None:
    draw = np.random.default_rng(2)
    times = 0.01 * np.arange(5000)
    times[2500:] += 300
    times = times[draw.random(5000) >= lost]
    assert parts(times) == [[0, len(times), pytest.approx(0.01)]]


@pytest.mark.parametrize(("rate", "jitter"), [(400, 2e-4), (2000 / 3, 2e-4), (800, 5e-4), (2000 / 7, 5e-4)])
def test_times_in_whole_milliseconds_show_no_change(rate: float, jitter: float) -> None:
    draw = np.random.default_rng(3)
    count = int(120 * rate)
    times = np.unique(np.round(1000 * (np.arange(count) / rate + draw.normal(0, jitter, count))) / 1000)
    assert [part[:2] for part in parts(times)] == [[0, len(times)]]


def test_few_rows() -> None:
    assert parts(np.array([0.0, 1.0, 2.0])) == [[0, 3, 1.0]]
    assert parts(np.array([5.0])) == [[0, 1, pytest.approx(math.nan, nan_ok=True)]]
