"""Recordings as they come from laboratories, played back through the command line: what is wrong is named, what is lost is told."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.cli import main

BENCH = """planrunner_bench: 1
name: played
clock: virtual
site: {{latitude: 45 deg, gravity: 9.80665 m/s^2}}
instruments:
  imu:
    driver: recording
    file: {file}
    kind: imu
    time: {{column: t, unit: s}}
    sample_rate: {rate}
    {segments}
    channels:
      gx: {{column: gx, unit: deg/s, noise: 0.1 deg/s}}
"""
PLAN = """planrunner: 1
title: Three rates
bench: bench.yaml
sensor: {{kind: imu, outputs: [gx]}}
defaults: {{orientation: {{x: up, y: north, z: west}}, dwell: {dwell}}}
segments:
  - {{label: "R{{rate}}", for_each: {{rate: "10, 20, 30 deg/s"}}}}
estimates:
  sf: {{estimator: scale_factor, segments: R*, outputs: [gx]}}
report: [summary.md]
"""
TABLE = "label,start_s,end_s\nR+10,0,10\nR+20,10,20\nR+30,20,30\n"
TIME = np.arange(3000) / 100
RATE = np.repeat([10.0, 20.0, 30.0], 1000) * 1.01 + np.random.default_rng(1).normal(0, 0.1, 3000)
Ended = tuple[int, str, str]


def text(time: np.ndarray = TIME, rate: np.ndarray = RATE, header: str = "t,gx") -> bytes:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(zip(time.tolist(), rate.tolist(), strict=True))
    return f"{header}\n{out.getvalue()}".encode()


def parquet(**columns: object) -> bytes:
    out = io.BytesIO()
    pq.write_table(pa.table({"t": TIME, "gx": RATE} | columns), out, row_group_size=500)
    return out.getvalue()


def changed(values: np.ndarray, where: slice, to: float) -> np.ndarray:
    copy = values.copy()
    copy[where] = to
    return copy


@pytest.fixture
def play(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Plays a recording back; the exit code, standard output and standard error."""

    def run(
        data: bytes | None,
        *,
        file: str = "r.csv",
        table: str | None = TABLE,
        segments: str = "segments: {table: seg.csv}",
        rate: str = "100 Hz",
        dwell: str = "recorded",
        root: str | None = "data",
    ) -> Ended:
        monkeypatch.chdir(tmp_path)
        folder = tmp_path / "data"
        folder.mkdir(exist_ok=True)
        if data is not None:
            (folder / Path(file).name).write_bytes(data)
        if table is not None:
            (folder / "seg.csv").write_text(table, encoding="utf-8")
        Path("bench.yaml").write_text(BENCH.format(file=file, segments=segments, rate=rate), encoding="utf-8")
        Path("plan.yaml").write_text(PLAN.format(dwell=dwell), encoding="utf-8")
        code = main(["run", "plan.yaml", "--quiet", *([] if root is None else ["--data", root])])
        printed = capsys.readouterr()
        assert "internal error" not in printed.err
        assert "Warning:" not in printed.err
        return code, printed.out, printed.err

    return run


@pytest.mark.parametrize(
    "data",
    [
        text(),
        b"\xef\xbb\xbf" + text(),
        text().replace(b"\n", b"\r\n"),
        text().replace(b"t,gx", b'"t","gx"'),
        text().replace(b"\n", b"\n\n"),
    ],
    ids=["plain", "BOM", "CRLF", "quoted", "blank lines"],
)
def test_csv_as_other_programs_write_it(play: Callable[..., Ended], data: bytes) -> None:
    code, out, _ = play(data)
    assert code == 0
    assert "warning" not in out
    (row,) = [line for line in out.splitlines() if line.startswith(" K_gx")]
    assert float(row.split()[1]) == pytest.approx(1.01, abs=0.002)


REFUSED: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "r.csv cannot be read: Empty CSV file"),
    "only a header": (b"t,gx\n", "r.csv holds no samples"),
    "missing column": (text(header="t,gy"), "no column 'gx'; known here: gy, t"),
    "semicolons": (text().replace(b",", b";"), "`format: {type: text, separator: semicolon}`"),
    "tabs": (text().replace(b",", b"\t"), "`format: {type: text, separator: tab}`"),
    "not UTF-8": (
        text(header="t,gx").replace(b"gx", b"gx\xb0", 1),
        "r.csv cannot be read: its header is not UTF-8",
    ),
    "binary": (bytes(range(256)) * 100, "r.csv cannot be read"),
    "text cell": (text().replace(b"\n25.5,", b"\n25.5,abc", 1), "r.csv, line 2552: 'abc30"),
    "row of units": (text(header="t,gx\ns,deg/s"), "line 2: 's' in column 't' is not a number"),
    "repeated row": (
        text(changed(TIME, slice(50, 51), TIME[49])),
        "row 51 (line 52): time does not increase: 0.49 s after 0.49",
    ),
    "backwards": (text(TIME[::-1]), "row 2 (line 3): time does not increase"),
    "missing time": (text(changed(TIME, slice(50, 51), np.nan)), "row 51 (line 52): the time is missing"),
    "milliseconds for seconds": (text(TIME * 1000), "declared at 100 Hz, but its rows are 10 s apart (0.1 Hz)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_csv_is_refused_before_anything_is_played(play: Callable[..., Ended], tmp_path: Path, name: str) -> None:
    data, message = REFUSED[name]
    code, _, err = play(data)
    assert code == 2
    assert message in err
    assert not (tmp_path / "runs").exists()


PARQUET: dict[str, tuple[bytes, str]] = {
    "truncated": (parquet()[:-100], "r.parquet cannot be read"),
    "empty": (b"", "r.parquet cannot be read"),
    "CSV by another name": (text(), "r.parquet cannot be read"),
    "text": (parquet(gx=["x"] * 3000), "column 'gx' holds text"),
    "time of day": (
        parquet(t=(TIME * 1e6).astype("datetime64[us]")),
        "column 't' holds values of the type timestamp",
    ),
}


@pytest.mark.parametrize("name", PARQUET)
def test_parquet_is_refused(play: Callable[..., Ended], name: str) -> None:
    data, message = PARQUET[name]
    code, _, err = play(data, file="r.parquet")
    assert code == 2
    assert message in err


def test_two_columns_of_one_name(play: Callable[..., Ended]) -> None:
    out = io.BytesIO()
    pq.write_table(pa.Table.from_arrays([pa.array(TIME), pa.array(RATE), pa.array(RATE)], names=["t", "gx", "gx"]), out)
    assert "2 columns called 'gx'; rename all but one" in play(out.getvalue(), file="r.parquet")[2]


@pytest.mark.parametrize(
    ("rate", "lost"),
    [
        (changed(RATE, slice(100, 110), np.nan), "'R+10' 10/1000"),
        (changed(RATE, slice(1500, 1501), np.inf), "'R+20' 1/1000"),
        (changed(RATE, slice(1500, 1502), 1e308), "'R+20' 2/1000"),
        (changed(RATE, slice(0, 999), np.nan), "'R+10' 999/1000"),
    ],
    ids=["NaN", "inf", "too large to square", "nearly all"],
)
def test_samples_left_out_are_reported(play: Callable[..., Ended], rate: np.ndarray, lost: str) -> None:
    code, out, err = play(text(rate=rate))
    assert code == 0, err
    assert f"warning: Samples that are missing or not a number were left out: {lost}." in out


def test_a_segment_without_a_number_cannot_be_used(play: Callable[..., Ended]) -> None:
    code, _, err = play(text(rate=changed(RATE, slice(0, 1000), np.nan)))
    assert code == 1  # what was recorded is in question, not the plan
    assert "segment 'R+10' has no usable samples" in err


def test_a_gap_is_reported_and_is_no_dwell(play: Callable[..., Ended]) -> None:
    kept = np.r_[0:300, 600:3000]
    data = text(TIME[kept], RATE[kept])
    code, out, _ = play(data)
    assert code == 0
    assert "warning: Samples are missing; the longest gaps: 'R+10' 3.01 s." in out
    code, _, err = play(data, dwell="5 s")
    assert code == 2
    assert "'R+10' dwells 5 s, but r.csv holds only 3 s of it" in err


TABLES: dict[str, tuple[str | None, str]] = {
    "missing": (None, "there is no file 'seg.csv' in the data folder"),
    "no rows": ("label,start_s,end_s\n", "seg.csv contains no segments"),
    "other labels": (TABLE.replace("R+20", "R+200"), "seg.csv has no segment 'R+20'; did you mean 'R+200'?"),
    "labels without signs": (TABLE.replace("+", ""), "seg.csv has no segment 'R+10'; did you mean 'R10'?"),
    "ends before it starts": (
        TABLE.replace("R+20,10", "R+20,25"),
        "line 3: the segment 'R+20' does not end after it starts",
    ),
    "twice": (TABLE.replace("R+20", "R+10"), "line 3: the label 'R+10' appears twice"),
    "text": (TABLE.replace("R+20,10", "R+20,ten"), "line 3: 'ten' in column 'start_s' is not a number"),
    "short": (TABLE.replace("R+20,10,20", "R+20,10"), "line 3: '' in column 'end_s' is not a number"),
    "outside": (
        TABLE.replace("R+30,20,30", "R+30,200,299"),
        "'R+30' is listed from 200 s to 299 s, but r.csv holds 0 s to 30 s",
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_segments(play: Callable[..., Ended], name: str) -> None:
    table, message = TABLES[name]
    code, _, err = play(text(), table=table)
    assert code == 2
    assert message in err


def test_nothing_outside_the_data_root_is_read(play: Callable[..., Ended], tmp_path: Path) -> None:
    outside = tmp_path / "outside.csv"
    outside.write_bytes(text())
    for name in ("../outside.csv", str(outside)):
        assert "leads outside the data folder" in play(None, file=name)[2]
    (tmp_path / "data" / "link.csv").symlink_to(outside)
    assert "is a link that leads outside" in play(None, file="link.csv")[2]
    (tmp_path / "data" / "folder.csv").mkdir()
    os.mkfifo(tmp_path / "data" / "pipe.csv")
    for name, what in (("folder.csv", "a folder"), ("pipe.csv", "a pipe")):
        assert f"{name}: this is {what}" in play(None, file=name)[2]
    assert "there is no file 'absent.csv'" in play(None, file="absent.csv")[2]
    assert "add --data FOLDER" in play(text(), root=None)[2]
    assert "the data folder elsewhere does not exist" in play(text(), root="elsewhere")[2]
