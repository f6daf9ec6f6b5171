"""The two-round test on a few cases; `python -m tests.blind.two_rounds` is the whole of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind import two_rounds
from tests.blind.device import SENSORS, clean_output, ideal, limit
from tests.blind.motion import Fault, Schedule
from tests.blind.plans import PLANS, X_UP, Segment
from tests.blind.two_rounds import Outcome, _kept, _repeats, outcomes, summary


def test_the_device_keeps_its_limit_under_a_faster_plan() -> None:
    rows, sensor = PLANS["poor"], SENSORS["mems"]
    faster = Segment("fast", "rate", X_UP, 10.0, rate=200.0, start=rows[-1].end + 60)
    first, whole = Schedule(rows, sensor.sampling), Schedule((*rows, faster), sensor.sampling)
    fault = Fault("gyro_saturation", np.array([0.4]))
    kept = _kept(fault, first, whole, sensor, ideal(sensor), np.random.default_rng(1))
    stops = [
        limit(clean_output(schedule, sensor, ideal(sensor), {})[:, :3], float(one.theta[0]))
        for schedule, one in ((first, fault), (whole, kept))
    ]
    assert stops[0] == pytest.approx(stops[1])
    assert stops[0] < 61


def test_repeating_goes_on_after_the_plan() -> None:
    rows = PLANS["poor"]
    further, looks = _repeats(rows, False)
    starts = np.array([row.start for row in (*rows, *further)])
    assert (np.diff(starts) > 0).all() and further[0].start - rows[-1].end == two_rounds.LATER
    assert looks[-1] == len(further)
    assert [replace(row, start=0, label="") for row in further[: len(rows)]] == [
        replace(row, start=0, label="") for row in rows
    ]
    warm = PLANS["tumble"]  # ends at another temperature than it begins at
    assert _repeats(warm, False)[0][0].start - warm[-1].end == two_rounds.SOAK
    afresh = _repeats(warm, True)[0]
    assert afresh[0].start - warm[-1].end == two_rounds.SOAK + two_rounds.MOVE
    assert afresh[len(warm)].start - afresh[len(warm) - 1].end == two_rounds.SOAK


def test_the_summary_counts_what_was_enough() -> None:
    one = Outcome("c", "poor", "mems", "e", 20.0, 0.5, ("e", "none"), 0.97, 0.2, 0.99, 0.1, 0.96, 0.5)
    found = summary([one, replace(one, proposed=0.6, proposed_hours=0.2)])
    assert found["proposed_enough"] == 0.5
    assert found["ratio_median"] == pytest.approx(0.2)


@pytest.mark.slow
def test_a_proposal_brings_what_it_promises(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten cases under the poorest plan: where questions are left open, the proposed segments answer most of them."""
    monkeypatch.setattr(two_rounds, "SETUPS", (("poor", "mems"),))
    found = [one for _, one in outcomes(11, range(10)) if isinstance(one, Outcome)]
    assert found, "no case is left open"
    figures = summary(found)
    assert figures["proposed"] > figures["first"] + 0.1
    assert figures["proposed_enough"] >= 0.5
