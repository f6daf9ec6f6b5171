"""Where the sample rate of a recording changes, against recordings that were made with known changes."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from planrunner.instruments.sample_rates import constant_rates


def parts(times: np.ndarray, period: float = math.nan) -> list[tuple[int, int, object]]:
    return [(rows.start, rows.stop, found) for rows, found in constant_rates(times, period)]


@pytest.mark.parametrize("changes", [(1000,), (300, 1100), (129, 700, 2000)])
def test_the_parts_meet_where_the_rate_changes(changes: tuple[int, ...]) -> None:
    """The period is 10, 5, 10, 5 ms between the changes; the jitter of each time is 2 % of a period."""
    period = np.zeros(3000)
    for number, (begin, end) in enumerate(pairwise((0, *changes, 3000))):
        period[begin:end] = 0.01 if number % 2 == 0 else 0.005
    times = np.cumsum(period) + np.random.default_rng(1).normal(0, 1e-4, 3000)
    found = parts(times)
    assert [begin for begin, *_ in found] == [0, *[pytest.approx(change, abs=1) for change in changes]]
    assert [end for _, end, _ in found] == [*[begin for begin, *_ in found[1:]], 3000]
    assert [one for *_, one in found] == [pytest.approx(period[begin + 5], rel=0.05) for begin, *_ in found]


@pytest.mark.parametrize("lost", [0.0, 0.02, 0.2])
def test_lost_rows_and_pauses_are_no_change(lost: float) -> None:
    draw = np.random.default_rng(2)
    times = 0.01 * np.arange(5000)
    times[2500:] += 300
    times = times[draw.random(5000) >= lost]
    assert parts(times) == [(0, len(times), pytest.approx(0.01))]


def test_a_change_between_two_batches() -> None:
    assert parts(0.005 * np.arange(500), period=0.01) == [(0, 500, pytest.approx(0.005))]


def test_few_rows_have_the_rate_before_them() -> None:
    assert parts(np.array([0.0, 1.0]), period=0.01) == [(0, 2, 0.01)]
    assert parts(np.array([0.0, 1.0, 2.0])) == [(0, 3, 1.0)]
