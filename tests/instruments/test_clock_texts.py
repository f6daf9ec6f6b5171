"""Dates and times of day in recordings, against the times that `datetime` of the standard library gives them."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.formats.choice import open_file
from planrunner.instruments.formats.clock import DateOrder, of_arrow, of_objects, seconds_in, seconds_of
from planrunner.instruments.formats.file import TimeStamps
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.instruments.recording_segments import read_segment_table
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment

NOON = datetime(2026, 3, 4, 12, 0, 0, 5000, UTC)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-03-04T12:00:00.005Z", NOON),
        ("2026-03-04 12:00:00,005", NOON),
        ("2026-03-04T13:00:00.005+01:00", NOON),
        ("2026-03-04 04:30:00.005-0730", NOON),
        ("2026-03-04T12:00:00.005+00:00[Europe/London]", NOON),
        ("2026/03/04 12:00:00.005", NOON),
        ("04.03.2026 12:00:00.005", NOON),
        ("3/4/2026 12:00:00.005 PM", NOON),
        ("04-Mar-2026 12:00:00.005", NOON),
        ("20260304T120000.005Z", NOON),
        ("20260304_120000", NOON.replace(microsecond=0)),
        ("2026-03-04T12.00.00.005", NOON),
        ("2026-03-04T12:00", NOON.replace(microsecond=0)),
        ("3/4/2026 12:15 AM", datetime(2026, 3, 4, 0, 15, tzinfo=UTC)),
        ("13/04/2026 00:00:01", datetime(2026, 4, 13, 0, 0, 1, tzinfo=UTC)),
        ("2024-02-29 23:59:59.999999", datetime(2024, 2, 29, 23, 59, 59, 999999, UTC)),
        ("1999-12-31T23:59:59+14:00", datetime(1999, 12, 31, 23, 59, 59, tzinfo=timezone(timedelta(hours=14)))),
    ],
)
def test_a_date_with_a_time(text: str, expected: datetime) -> None:
    dates = DateOrder()
    dates.decide_for([text])
    assert seconds_of(text, "here", dates) == pytest.approx(expected.timestamp(), abs=1e-6)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("12:00:00.005", 43200.005),
        ("00:00:01", 1),
        ("23:59:59,5", 86399.5),
        ("1:00:00 pm", 46800),
        ("12:00:00:005", 43200.005),
        ("00:01.25", 1.25),
        ("59:59.9", 3599.9),
        ("60:00.5", 3600.5),
        ("125:00.0", 7500),
        ("120000.005", 43200.005),
    ],
)
def test_a_time_of_day(text: str, expected: float) -> None:
    assert seconds_of(text, "here", DateOrder()) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    "text", ["25:61:00", "noon", "2026-02-30 12:00:00", "2026-13-01 12:00:00", "1:60:00", "", "1.5"]
)
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(InstrumentError, match="here"):
        seconds_of(text, "here", DateOrder())


def test_missing_times_and_times_of_both_kinds() -> None:
    found = seconds_in(pa.array(["12:00:00", None, " ", "12:00:01"]), "here", DateOrder())
    np.testing.assert_array_equal(found, [43200, np.nan, np.nan, 43201])
    with pytest.raises(InstrumentError, match="only some"):
        seconds_in(pa.array(["12:00:00", "2026-03-04 12:00:01"]), "here", DateOrder())


def test_times_that_are_no_texts() -> None:
    stamps = np.array(["2026-03-04T12:00:00.005", "NaT"], "M8[us]")
    for found in (of_objects(stamps, "here", DateOrder()), of_arrow(pa.array(stamps), "here", DateOrder())):
        assert found[0] == pytest.approx(NOON.timestamp(), abs=1e-6) and np.isnan(found[1])
    assert of_arrow(pa.array([NOON.time()]), "here", DateOrder())[0] == pytest.approx(43200.005)


def written_as_text(folder: Path, times: list[datetime]) -> str:
    lines = [f"{time:%H:%M:%S}.{time.microsecond // 1000:03d};{k}" for k, time in enumerate(times)]
    (folder / "r.csv").write_text("Time;gx\n" + "\n".join(lines))
    return "file: r.csv\nformat: {type: text, separator: semicolon}\ntime: {column: Time, unit: time_of_day}"


def written_as_parquet(folder: Path, times: list[datetime]) -> str:
    naive = [time.replace(tzinfo=None) for time in times]
    pq.write_table(
        pa.table({"Time": pa.array(naive, pa.timestamp("ns")), "gx": range(len(times))}), folder / "r.parquet"
    )
    return "file: r.parquet\ntime: {column: Time, unit: date_time}"


def written_as_sqlite(folder: Path, times: list[datetime]) -> str:
    connection = sqlite3.connect(folder / "r.sqlite")
    connection.execute("CREATE TABLE samples (Time TEXT, gx REAL)")
    connection.executemany("INSERT INTO samples VALUES (?, ?)", [(time.isoformat(), k) for k, time in enumerate(times)])
    connection.commit()
    connection.close()
    return "file: r.sqlite\ntime: {column: Time, unit: date_time}"


@pytest.mark.parametrize("write", [written_as_text, written_as_parquet, written_as_sqlite])
def test_a_recording_across_midnight_and_its_table_of_segments(
    tmp_path: Path, write: Callable[[Path, list[datetime]], str]
) -> None:
    """20 s at 10 Hz from 23:59:50; the table of segments states 23:59:52 to 23:59:57 in the same form as the recording."""
    begin = datetime(2026, 3, 4, 23, 59, 50, tzinfo=UTC)
    keys = write(tmp_path, [begin + timedelta(milliseconds=100 * k) for k in range(200)])
    form, unit = ("%H:%M:%S", "time_of_day") if "time_of_day" in keys else ("%Y-%m-%d %H:%M:%S", "date_time")
    first, last = (f"{begin + timedelta(seconds=after):{form}}" for after in (2, 7))
    (tmp_path / "stops.csv").write_text(f"label,start_s,end_s\nstop,{first},{last}\n")
    for segments, expected in (("", range(200)), (f"segments: {{table: stops.csv, unit: {unit}}}\n", range(20, 70))):
        text = f"kind: gyro\n{keys}\nsample_rate: 10 Hz\n{segments}channels: {{gyro_x: {{column: gx, unit: deg/s}}}}"
        log = Findings()
        made = RecordOf(RecordingParameters).read(source.parse(text, "bench.yaml"), log)
        assert list(log) == []
        table = tmp_path / "stops.csv" if segments else None
        player = RecordingPlayer.open(made, [tmp_path / made.file], table, VirtualClock())
        whole = Segment(0, "stop", None, "unknown", Rest(), None)
        player.look_over([whole], log)
        assert list(log) == []
        blocks = list(player.stream(whole))
        np.testing.assert_array_equal(np.concatenate([block.channels["gyro_x"] for block in blocks]), list(expected))
        time = np.concatenate([block.time for block in blocks])
        np.testing.assert_allclose(time - time[0], np.arange(len(expected)) / 10, atol=1e-6)


def test_a_time_of_day_needs_no_wraps() -> None:
    log = Findings()
    text = "file: r.csv\nkind: gyro\nsample_rate: 10 Hz\ntime: {column: t, unit: time_of_day, wraps: 86400}\n"
    RecordOf(RecordingParameters).read(
        source.parse(f"{text}channels: {{x: {{column: x, unit: deg/s}}}}", "b.yaml"), log
    )
    assert [one.message for one in log] == ["a time in the unit time_of_day is no counter that returns to zero"]


@pytest.mark.parametrize(
    ("texts", "first"),
    [
        (["05/04/2026 23:59:59.9", "06/04/2026 00:00:00.1"], datetime(2026, 4, 5, 23, 59, 59, 900_000, UTC)),
        (["04/05/2026 23:59:59.9", "04/06/2026 00:00:00.1"], datetime(2026, 4, 5, 23, 59, 59, 900_000, UTC)),
        (["12/04/2026 23:59:59.9", "13/04/2026 00:00:00.1"], datetime(2026, 4, 12, 23, 59, 59, 900_000, UTC)),
        (["31/12/2025 23:59:59.9", "01/01/2026 00:00:00.1"], datetime(2025, 12, 31, 23, 59, 59, 900_000, UTC)),
        (["12-31-2025 23:59:59.9", "01-01-2026 00:00:00.1"], datetime(2025, 12, 31, 23, 59, 59, 900_000, UTC)),
    ],
)
def test_day_and_month_have_one_order_in_a_column(texts: list[str], first: datetime) -> None:
    """In each column, the time continues over midnight. Row by row, some of these dates would count in the other order."""
    dates = DateOrder()
    dates.decide_for(texts)
    found = seconds_in(pa.array(texts), "here", dates)
    assert found[0] == pytest.approx(first.timestamp(), abs=1e-6)
    assert found[1] - found[0] == pytest.approx(0.2, abs=1e-6)


def test_the_whole_file_decides_the_order_of_day_and_month(tmp_path: Path) -> None:
    """The first of several batches contains a single date, which exists in both orders."""
    begin = datetime(2026, 4, 12, 23, 58, 52, tzinfo=UTC)
    times = [begin + timedelta(milliseconds=k) for k in range(70_000)]
    rows = [f"{time:%d/%m/%Y %H:%M:%S.%f},{k % 7}" for k, time in enumerate(times)]
    (tmp_path / "r.csv").write_text("\n".join(["time,x", *rows]) + "\n")
    stamps = TimeStamps("time", written=True)
    file = open_file(tmp_path / "r.csv", "r.csv", stamps, {"x": "x"}, None)
    file.look()
    parts = [part for part, _ in file.rows()]
    time = np.concatenate(parts)
    assert len(parts[0]) < 68_000 and file.origin == pytest.approx(begin.timestamp())
    np.testing.assert_allclose(np.diff(time), 0.001, atol=1e-5)
    assert file.remarks == ()


def test_a_table_of_times_of_day_continues_after_midnight(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("label,start,end\na,23:59:40,23:59:50\nb,23:59:55,00:00:05\nc,00:00:10,00:00:20\n")
    columns = ("label", "start", "end")
    found = read_segment_table(tmp_path / "s.csv", "s.csv", columns, "time_of_day", 0.0, 86_370.0, DateOrder())
    spans = [(found.span(label).start, found.span(label).end) for label in "abc"]
    assert spans == [(86_380, 86_390), (86_395, 86_405), (86_410, 86_420)]
    after = read_segment_table(tmp_path / "s.csv", "s.csv", columns, "time_of_day", 0.0, 5.0, DateOrder())
    assert after.span("c").start == 10 and after.span("a").end == -10
