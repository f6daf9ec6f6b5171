"""The plans of recordings with sealed effects, against the tables of segments that come with the recordings."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from planrunner.plan.schedule import Rest, Rock, Spin
from planrunner.tasks.check import check_plan
from tests.directions import WORDS

ROOT = Path(__file__).parents[2]
SETS = ROOT.parent / "shared" / "blind"
TABLES = {
    "round-1/segments.csv": "imu_recorded_over_temperature.yaml",
    "round-2/segments-C.csv": "imu_recorded_hot.yaml",
    "round-2/segments-D.csv": "imu_recorded_cold_and_hot.yaml",
}


@pytest.mark.skipif(not SETS.is_dir(), reason="the sealed sets are not beside this checkout")
@pytest.mark.parametrize("name", TABLES)
def test_a_plan_states_what_the_table_says(name: str) -> None:
    checked = check_plan(ROOT / "plans" / TABLES[name]).sound()
    with open(SETS / name, encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    assert [one.label for one in checked.schedule.segments] == [row["label"] for row in rows]
    for one, row in zip(checked.schedule.segments, rows, strict=True):
        assert one.attitude is not None and np.array_equal(
            one.attitude, [WORDS[row[f"{axis}_axis"]] for axis in "xyz"]
        ), one.label
        assert one.dwell == pytest.approx(float(row["end_s"]) - float(row["start_s"])), one.label
        chamber = one.ramp_to if row["ramp"] == "1" else one.temperature
        assert chamber == pytest.approx(float(row["chamber_degC"]) + 273.15), one.label
        match one.motion:
            case Rest():
                assert row["kind"] == "static", one.label
            case Spin(rate=rate):
                assert row["kind"] == "rate" and np.degrees(rate) == pytest.approx(
                    float(row["table_rate_deg_per_s"])
                ), one.label
            case Rock(amplitude=amplitude, frequency=frequency):
                assert row["kind"] == "rock" and np.degrees(amplitude) == pytest.approx(
                    float(row["rock_amplitude_deg"])
                ), one.label
                assert frequency == pytest.approx(float(row["rock_frequency_hz"])), one.label
            case _:
                raise AssertionError(one.label)
