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
from planrunner.cli import main
from planrunner.instruments.formats.choice import Format, open_file
from planrunner.instruments.formats.clock import (
    DateOrder,
    NoTimesError,
    of_arrow,
    of_objects,
    seconds_in,
    seconds_of,
    text_of,
)
from planrunner.instruments.formats.file import TimeStamps
from planrunner.instruments.formats.text import TextKeys
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.instruments.recording_segments import read_segment_table
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment


def place(index: int) -> str:
    return f"here, text {index}"


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
    found = seconds_in(pa.array(["12:00:00", None, " ", "12:00:01"]), place, DateOrder())
    np.testing.assert_array_equal(found, [43200, np.nan, np.nan, 43201])


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["12:00:00", "2026-03-04 12:00:01", "12:00:02"], "text 1: '2026-03-04 12:00:01' has a date"),
        (["2026-03-04 12:00:00", "2026-03-04 12:00:01", None, "12:00:02"], "text 3: '12:00:02' has no date"),
        (["12:00:00", None, "12:0o:01"], "text 2: '12:0o:01' is not a date with a time.*such as '12:00:00'"),
    ],
)
def test_a_time_unlike_the_others_is_named(texts: list[str | None], said: str) -> None:
    with pytest.raises(InstrumentError, match=said) as caught:
        seconds_in(pa.array(texts), place, DateOrder())
    assert not isinstance(caught.value, NoTimesError)


def test_texts_without_any_time() -> None:
    with pytest.raises(NoTimesError, match=r"text 1: 'on' is not a date.*; write times such as 2026-03-04 12"):
        seconds_in(pa.array([None, "on", "off"]), place, DateOrder())


GARBLED = {
    "2026-03-0 4T12:00:05.600": "row 57 (line 60), column 'time': '2026-03-0 4T12:00:05.600' is not a date with a time, or a time of day; "
    "write it like the other times, such as '2026-03-04T12:00:00.000000', or remove the row",
    "2026-13-04T12:00:05.600": "row 57 (line 60), column 'time': '2026-13-04T12:00:05.600' is not a date",
    "12:00:05.600": "row 57 (line 60), column 'time': '12:00:05.600' has no date, but other times have one",
    "": "row 57 (line 60): the time is missing",
    "2026-03-05T12:00:05.600": "row 58 (line 61): time does not increase: 2026-03-04 12:00:05.7 after 2026-03-05 12:00:05.6; sort the "
    "recording, or correct or remove this row or the row before it",
}


@pytest.mark.parametrize("garbled", GARBLED)
def test_one_garbled_date_is_named_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], garbled: str
) -> None:
    """A hundred rows. A comment and an empty line before row 57 are lines, but no rows. `new --from-recording` and `check` name the same
    place."""
    begin = datetime(2026, 3, 4, 12, tzinfo=UTC)
    times = [f"{begin + timedelta(milliseconds=100 * k):%Y-%m-%dT%H:%M:%S.%f}" for k in range(100)]
    noise = np.random.default_rng(1).normal([0, 0, 0, 0, 0, 9.8], 0.01, (100, 6))
    cells = [",".join(f"{value:.5f}" for value in row) for row in noise]

    def written(times: list[str]) -> None:
        rows = [f"{time},{values}" for time, values in zip(times, cells, strict=True)]
        lines = ["time,gx,gy,gz,ax,ay,az", *rows[:20], "# paused", "", *rows[20:]]
        (tmp_path / "r.csv").write_text("\n".join(lines) + "\n")

    written(times)
    assert main(["new", "--from-recording", str(tmp_path / "r.csv"), str(tmp_path / "plan.yaml")]) == 0
    written([*times[:56], garbled, *times[57:]])
    capsys.readouterr()
    for arguments in (
        ["new", "--from-recording", str(tmp_path / "r.csv"), str(tmp_path / "other.yaml")],
        ["check", str(tmp_path / "plan.yaml"), "--data", str(tmp_path)],
    ):
        assert main(arguments) == 2
        assert f"r.csv, {GARBLED[garbled]}" in capsys.readouterr().err


def test_how_messages_show_a_time() -> None:
    assert text_of(43200.005) == "12:00:00.005" and text_of(86_401.0) == "00:00:01"
    assert text_of(NOON.timestamp()) == "2026-03-04 12:00:00.005"


def test_the_line_of_a_row_below_other_lines(tmp_path: Path) -> None:
    """Three lines before the header, a value over two lines, and a line without its last cell are no rows of their own."""
    (tmp_path / "r.txt").write_text('# a\n# b\n\ntime;x;note\n12:00:00;1;"of\ntwo"\n12:00:01;2\n12:00:02;3;\nnoon;4;\n')
    keys = Format(type="text", parameters=TextKeys(separator="semicolon", skip=3))
    file = open_file(tmp_path / "r.txt", "r.txt", TimeStamps("time", written=True), {"x": "x"}, keys)
    assert file.place(1) == "row 1 (line 6)" and file.place(2) == "row 2 (line 8)"


def test_times_that_are_no_texts() -> None:
    stamps = np.array(["2026-03-04T12:00:00.005", "NaT"], "M8[us]")
    for found in (of_objects(stamps, place, DateOrder()), of_arrow(pa.array(stamps), place, DateOrder())):
        assert found[0] == pytest.approx(NOON.timestamp(), abs=1e-6) and np.isnan(found[1])
    assert of_arrow(pa.array([NOON.time()]), place, DateOrder())[0] == pytest.approx(43200.005)


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
    found = seconds_in(pa.array(texts), place, dates)
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
