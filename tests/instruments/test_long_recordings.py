"""Recordings with one reading per row: time, name and value."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from test_recording_formats import RATE, ROWS, TIME, columns, described, read, refusal

from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats import json_samples, long

Reading = tuple[float, str, float]
NAMES = ("x", "y", "z")


def sorted_by_time() -> list[Reading]:
    return [
        (float(t), name, float(v))
        for t, row in zip(TIME, RATE, strict=True)
        for name, v in zip(NAMES, row, strict=True)
    ]


def in_blocks() -> list[Reading]:
    return [
        (float(t), name, float(v))
        for name, col in zip(NAMES, RATE.T, strict=True)
        for t, v in zip(TIME, col, strict=True)
    ]


def write_text(folder: Path, table: Sequence[Reading]) -> str:
    lines = ["t,name,value", *(f"{t!r},{name},{value!r}" for t, name, value in table)]
    (folder / "r.csv").write_text("\n".join(lines), encoding="utf-8")
    return "file: r.csv\nformat: {type: text, readings: {name: name}}\n"


def write_parquet(folder: Path, table: Sequence[Reading]) -> str:
    time, names, values = zip(*table, strict=True)
    stored = pa.table({"t": time, "name": pa.array(names).dictionary_encode(), "v": values})
    pq.write_table(stored, folder / "r.parquet", row_group_size=500)
    return "file: r.parquet\nformat: {type: parquet, readings: {name: name, values: v}}\n"


def write_sqlite(folder: Path, table: Sequence[Reading]) -> str:
    with sqlite3.connect(folder / "r.db") as base:
        base.execute("CREATE TABLE readings (t REAL, name TEXT, value REAL)")
        base.executemany("INSERT INTO readings VALUES (?, ?, ?)", table)
    base.close()
    return "file: r.db\nformat: {type: sqlite, readings: {name: name}}\n"


def write_json(folder: Path, table: Sequence[Reading]) -> str:
    lines = [f'{{"t": {t!r}, "name": "{name}", "value": {value!r}}}' for t, name, value in table]
    (folder / "r.jsonl").write_text("\n".join(lines), encoding="utf-8")
    return "file: r.jsonl\nformat: {type: json, readings: {name: name}}\n"


@pytest.mark.parametrize("batch", [65_536, 7])
@pytest.mark.parametrize("table", [sorted_by_time, in_blocks])
@pytest.mark.parametrize("write", [write_text, write_parquet, write_sqlite, write_json])
def test_readings_become_the_numbers_that_were_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    write: Callable[[Path, Sequence[Reading]], str],
    table: Callable[[], list[Reading]],
    batch: int,
) -> None:
    """Batches of 7 rows divide the samples of 3 readings."""
    monkeypatch.setattr(format_file, "BATCH", batch)
    monkeypatch.setattr(json_samples, "ROWS", batch)
    keys = write(tmp_path, table()) + "time: {column: t}\n" + columns({"x": "x", "z": "z"})
    time, channels = read(tmp_path, keys)
    np.testing.assert_allclose(time, TIME - TIME[0], rtol=0, atol=2e-9)
    np.testing.assert_array_equal(channels["x"], RATE[:, 0])
    np.testing.assert_array_equal(channels["z"], RATE[:, 2])


def test_a_reading_with_several_values_and_other_sensors_between(tmp_path: Path) -> None:
    """The compass has its own times, which make no samples of the gyro."""
    lines = ["us|sensor|x|y|z"]
    for k, (t, row) in enumerate(zip(TIME.tolist(), RATE.tolist(), strict=True)):
        lines.append(f"{1e6 * t:.0f}|gyro|{row[0]!r}|{row[1]!r}|{row[2]!r}")
        lines += [f"{1e6 * t + 2000:.0f}|compass|1|2|3"] * (k % 7 == 0)
    (tmp_path / "r.txt").write_text("\n".join(lines), encoding="utf-8")
    keys = (
        "file: r.txt\nformat: {type: text, separator: bar, readings: {name: sensor, values: [x, y, z]}}\n"
        "time: {column: us, unit: us}\n"
    )
    time, channels = read(tmp_path, keys + columns({"x": "gyro.x", "z": "gyro.z"}))
    assert len(time) == ROWS
    np.testing.assert_array_equal(channels["z"], RATE[:, 2])


def test_readings_that_are_a_short_time_apart(tmp_path: Path) -> None:
    """Each channel is read 0.2 ms after the one before it. The sample has the time of its first reading."""
    delay = {"x": 0.0, "y": 2e-4, "z": 4e-4}
    table = [(t + delay[name], name, value) for t, name, value in sorted_by_time()]
    keys = write_text(tmp_path, table) + "time: {column: t}\n" + columns({"x": "x", "z": "z"})
    said = refusal(tmp_path, keys)
    assert "'x' and 'z' have no readings at the same time" in said and "such as `within: 2 ms`" in said
    for within, names in (("0.3 ms", "xyz"), ("0.5 ms", "xz")):
        keys = write_text(tmp_path, table).replace("name: name", f"name: name, within: {within}")
        time, channels = read(tmp_path, keys + "time: {column: t}\n" + columns({name: name for name in names}))
        np.testing.assert_allclose(time, TIME - TIME[0], atol=1e-8)
        np.testing.assert_array_equal(channels["z"], RATE[:, 2])
    said = refusal(tmp_path, keys.replace("0.5 ms", "10 ms") + "time: {column: t}\n" + columns({"x": "x", "z": "z"}))
    assert "'x' has two readings in the sample at" in said and "state a shorter time `within`" in said


def test_a_channel_that_lacks_readings_lacks_numbers(tmp_path: Path) -> None:
    table = [one for k, one in enumerate(sorted_by_time()) if k != 301]
    _, channels = read(tmp_path, write_text(tmp_path, table) + "time: {column: t}\n" + columns({"x": "x", "y": "y"}))
    assert len(channels["x"]) == ROWS
    assert np.flatnonzero(np.isnan(channels["y"])).tolist() == [100]


def change(index: int, *cells: object) -> Callable[[Path], str]:
    """Writes the text with other cells in one reading."""

    def write(folder: Path) -> str:
        table: list[tuple[object, ...]] = [*sorted_by_time()]
        table[index : index + 1] = [cells] if cells else [table[index], table[index]]
        return write_text(folder, table)  # type: ignore[arg-type]

    return write


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (change(300), "r.csv, row 302 (line 303): the time of 'x' does not increase: 6 s after 6 s; correct or remove"),
        (change(302, 5.5, "z", 1.0), "row 303 (line 304): the time of 'z' does not increase: 5.5 s after 5.99 s"),
        (change(302, float("nan"), "z", 1.0), "row 303 (line 304): the time is missing or not a number"),
        (lambda folder: change(0)(folder).replace("name: name", "name: nam"), "no column 'nam'; did you mean 'name'?"),
        (lambda folder: change(0)(folder).replace("name: name", "name: name, values: v"), "r.csv has no column 'v'"),
        (lambda folder: change(0)(folder).replace("name: name", "name: t"), "more than 1000 different names"),
    ],
)
def test_a_fault_is_named_with_its_place(tmp_path: Path, write: Callable[[Path], str], said: str) -> None:
    if "different names" in said:
        table = [(k, f"n{k}", 1.0) for k in range(1200)]
        keys = write_text(tmp_path, table)
    else:
        keys = write(tmp_path)
    assert said in refusal(tmp_path, keys + "time: {column: t}\n" + columns({"x": "x", "z": "z"}))


def test_a_name_that_is_not_in_the_table(tmp_path: Path) -> None:
    keys = write_text(tmp_path, sorted_by_time())
    said = refusal(tmp_path, keys + "time: {column: t}\n" + columns({"x": "X"}))
    assert "has no column 'X'; did you mean 'x'? The column 'name' contains the names" in said
    assert "needs a column of the time" in refusal(tmp_path, keys + "time: sample_count\n" + columns({"x": "x"}))


def test_an_unsorted_table_is_held_only_up_to_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "MAX_HELD", 2000)
    rest = "time: {column: t}\n" + columns({"x": "x"})
    read(tmp_path, write_text(tmp_path, sorted_by_time()) + rest)
    said = refusal(tmp_path, write_text(tmp_path, in_blocks()) + rest)
    assert "it is not sorted by time, and contains more than 0.002 million numbers; sort its rows by time" in said


def test_a_wrong_number_is_named_with_its_line(tmp_path: Path) -> None:
    keys = write_text(tmp_path, sorted_by_time())
    text = (tmp_path / "r.csv").read_text(encoding="utf-8").splitlines()
    text[41] = f"{text[41].rpartition(',')[0]},off"
    (tmp_path / "r.csv").write_text("\n".join(text), encoding="utf-8")
    said = refusal(tmp_path, keys + "time: {column: t}\n" + columns({"x": "x"}))
    assert "r.csv, line 42: 'off' in column 'value' is not a number" in said


def test_the_keys_are_checked() -> None:
    _, faults = described("file: r.csv\nformat: {type: text, readings: {values: v}}\n" + columns({"x": "x"}))
    assert faults == ["the key 'name' is missing"]
