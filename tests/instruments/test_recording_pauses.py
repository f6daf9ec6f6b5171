"""Recordings whose segments are parted by pauses, and columns of raw counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_file import HeldRecording
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.instruments.recording_segments import stretches
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment
from planrunner.plan.span import EVERYTHING, Span

BURSTS = np.concatenate([start + np.arange(5) / 10 for start in (3.0, 60.0, 120.0)])


def player(folder: Path, **changes: str) -> RecordingPlayer:
    pq.write_table(pa.table({"t": BURSTS, "x": np.arange(15.0) * 256 + 59136}), folder / "r.parquet")
    keys = {
        "file": "r.parquet",
        "kind": "imu",
        "time": "{column: t}",
        "sample_rate": "10 Hz",
        "pauses": "5 s",
        "channels": "{x: {column: x, unit: degC, zero: 59136, per_unit: 256}}",
        **changes,
    }
    log = Findings()
    made = RecordOf(RecordingParameters).read(source.parse("\n".join(f"{k}: {v}" for k, v in keys.items()), "b"), log)
    assert list(log) == []
    return RecordingPlayer.open(
        made, (folder / "r.parquet",), folder / "s.csv" if "segments" in keys else None, VirtualClock()
    )


def segment(index: int) -> Segment:
    return Segment(index, f"B{index + 1}", np.eye(3), "as given", Rest(), None)


def test_each_burst_is_the_segment_of_its_place(tmp_path):
    played = player(tmp_path)
    played.foresee([segment(n) for n in range(3)])
    for n in (2, 0, 1):
        (block,) = played.stream(segment(n))
        assert block.time + 3.0 == pytest.approx(BURSTS[5 * n : 5 * n + 5])
        assert block.channels["x"] == pytest.approx(np.arange(5) + 5.0 * n)  # counts become degC


def test_another_number_of_segments_is_an_error(tmp_path):
    with pytest.raises(InstrumentError, match="holds 3 stretches, separated by pauses, but the plan has 2 segments"):
        player(tmp_path).foresee([segment(0), segment(1)])


def test_a_table_beside_pauses_is_an_error(tmp_path):
    (tmp_path / "s.csv").write_text("label,start_s,end_s\nB1,3,4\n", encoding="utf-8")
    with pytest.raises(InstrumentError, match="keep one of them"):
        player(tmp_path, segments="{table: s.csv}")


@pytest.mark.parametrize("batch", [2, 5, 7, 100])
def test_pauses_are_found_whatever_the_batches(batch):
    class Batches(HeldRecording):
        def rows(self, span=EVERYTHING):
            for low in range(0, len(self.time), batch):
                yield self.time[low : low + batch], {}

    found = stretches(Batches(3.0, 0.1, BURSTS, {}), 5.0)
    assert found == (Span(3.0, 3.5), Span(60.0, 60.5), Span(120.0, 120.5))


def test_a_column_that_never_grows_is_refused():
    log = Findings()
    text = "file: r.csv\nkind: imu\ntime: {column: t}\nsample_rate: 1 Hz\nchannels: {x: {column: x, unit: deg/s, per_unit: 0}}"
    RecordOf(RecordingParameters).read(source.parse(text, "b"), log)
    assert [finding.code for finding in log] == ["meaning-range"]
