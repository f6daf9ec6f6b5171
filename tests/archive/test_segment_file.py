"""Segment files: parts of bounded length, digests, columns with units, blocks that do not fit, files that were
changed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal_state import name_parts
from planrunner.archive.segment_file import Part, SegmentData, SegmentWriter, file_stem, safe_name
from planrunner.archive.storage import Storage
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.instruments.interfaces import Block, InstrumentError

UNITS = {"x": "deg/s", "y": "m/s^2"}


def read_part(run: Path, part: Part, channels: list[str] | None = None) -> Iterator[Block]:
    return SegmentData(GuardedFolder.open(run), part).blocks(channels)


def make_writer(run: Path, **options: Any) -> SegmentWriter:
    (run / "segments").mkdir(exist_ok=True)
    return SegmentWriter(GuardedFolder.open(run / "segments"), "0001-P1", UNITS, Storage("flushed"), **options)


def block(start: float, rows: int, step: float = 0.1) -> Block:
    time = start + step * np.arange(rows, dtype=float)
    return Block(time, {"y": np.cos(time), "x": np.sin(time)})


def test_what_any_parquet_reader_sees(tmp_path: Path) -> None:
    writer = make_writer(tmp_path)
    for start in range(5):
        writer.append(block(start, 10))
    (part,) = writer.close()
    path = tmp_path / "segments" / "0001-P1.parquet"
    assert part == Part(
        "segments/0001-P1.parquet", hashlib.sha256(path.read_bytes()).hexdigest(), 50, path.stat().st_size
    )
    table = pq.read_table(path)
    assert table.schema.names == ["time", "x", "y"]
    assert {str(field.type) for field in table.schema} == {"double"}
    assert [field.metadata[b"unit"].decode() for field in table.schema] == ["s", "deg/s", "m/s^2"]
    np.testing.assert_array_equal(table["x"].to_numpy(), np.sin(table["time"].to_numpy()))
    assert SegmentData(GuardedFolder.open(tmp_path), part).units == UNITS
    assert [entry.name for entry in (tmp_path / "segments").iterdir()] == ["0001-P1.parquet"]


def test_parts_end_by_size_and_by_time(tmp_path: Path) -> None:
    writer = make_writer(tmp_path, part_bytes=24 * 40, part_seconds=5.0)
    writer.append(block(0.0, 100))  # 40 rows of 24 bytes, 4 s: size ends it
    writer.append(block(10.0, 30, step=0.5))  # up to 13.0 s are 7 rows more; then 5 s are 11 rows
    parts = [*writer.take_finished(), *writer.close()]
    names = [part.file for part in parts]
    assert names[:3] == [
        "segments/0001-P1.parquet",
        "segments/0001-P1.part002.parquet",
        "segments/0001-P1.part003.parquet",
    ]
    assert [part.rows for part in parts] == [40, 40, 20 + 7, 11, 11, 1]


@settings(max_examples=60, deadline=None)
@given(sizes=st.lists(st.integers(0, 50), max_size=12), rows=st.integers(1, 60))
def test_samples_come_back_however_they_are_cut(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], rows: int
) -> None:
    run = tmp_path_factory.mktemp("cut")
    writer, start, given_time = make_writer(run, part_bytes=24 * rows), 0.0, []
    for size in sizes:
        piece = block(start, size)
        writer.append(piece)
        given_time.append(piece.time)
        start += size * 0.1
    parts = [*writer.take_finished(), *writer.close()]
    assert all(part.rows <= rows for part in parts)
    got = [piece for part in parts for piece in read_part(run, part, ["y"])]
    time = np.concatenate([*(piece.time for piece in got), np.empty(0)])
    np.testing.assert_array_equal(time, np.concatenate([*given_time, np.empty(0)]))
    np.testing.assert_array_equal(np.concatenate([*(piece.channels["y"] for piece in got), np.empty(0)]), np.cos(time))


def test_a_driver_may_fill_its_buffers_again(tmp_path: Path) -> None:
    writer, buffer = make_writer(tmp_path), np.empty(4)
    for start in range(3):
        buffer[:] = start
        writer.append(Block(np.arange(4.0) + 4 * start, {"x": buffer, "y": buffer}))
    (part,) = writer.close()
    (piece,) = read_part(tmp_path, part)
    assert piece.channels["x"].tolist() == [0.0] * 4 + [1.0] * 4 + [2.0] * 4


def test_a_segment_without_samples_is_one_empty_file(tmp_path: Path) -> None:
    (part,) = make_writer(tmp_path).close()
    assert part.rows == 0
    assert sum(len(piece.time) for piece in read_part(tmp_path, part)) == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (Block(np.array([2.0, 1.0]), {"x": np.zeros(2), "y": np.zeros(2)}), "does not increase"),
        (Block(np.array([0.5]), {"x": np.zeros(1), "y": np.zeros(1)}), "does not increase after 0.9"),
        (Block(np.array([np.nan]), {"x": np.zeros(1), "y": np.zeros(1)}), "does not increase"),
        (Block(np.array([2.0]), {"x": np.zeros(1)}), "gave the channels x but had announced x, y"),
        (Block(np.array([2.0]), {"x": np.zeros(1), "y": np.zeros(2)}), "differ in length"),
    ],
)
def test_blocks_that_do_not_fit(tmp_path: Path, wrong: Block, message: str) -> None:
    writer = make_writer(tmp_path)
    writer.append(block(0.0, 10))
    with pytest.raises(InstrumentError, match=message):
        writer.append(wrong)
    writer.abandon()


def test_a_channel_named_time_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InstrumentError, match="named 'time'"):
        SegmentWriter(GuardedFolder.open(tmp_path), "0001-a", {"time": "s"}, Storage("flushed"))


def test_an_abandoned_file_leaves_nothing(tmp_path: Path) -> None:
    writer = make_writer(tmp_path)
    writer.append(block(0.0, 70_000, step=0.001))  # a row group is written aside
    assert len(list((tmp_path / "segments").iterdir())) == 1
    writer.abandon()
    assert list((tmp_path / "segments").iterdir()) == []


def test_changed_missing_and_foreign_files_are_refused(tmp_path: Path) -> None:
    writer = make_writer(tmp_path)
    writer.append(block(0.0, 100))
    (part,) = writer.close()
    path = tmp_path / part.file
    good = path.read_bytes()
    for place in (10, len(good) // 2, len(good) - 3):
        path.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
        with pytest.raises(IntegrityError, match="differ from what was recorded"):
            list(read_part(tmp_path, part))
    path.write_bytes(b"PAR1 and so on")
    foreign = Part(part.file, hashlib.sha256(b"PAR1 and so on").hexdigest(), 1, 14)
    with pytest.raises(IntegrityError, match="not a recording"):
        list(read_part(tmp_path, foreign))
    path.unlink()
    with pytest.raises(IntegrityError, match="No such file"):
        list(read_part(tmp_path, part))


@pytest.mark.parametrize(
    "name", ["../../etc/passwd.parquet", "/segments/x.parquet", "segments/../x.parquet", "segments/x"]
)
def test_names_that_lead_elsewhere_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="not a file of samples"):
        Part.from_json({"file": name, "sha256": "0" * 64, "rows": 1, "bytes": 1})


@given(label=st.text(max_size=100), index=st.integers(0, 20_000), attempt=st.integers(1, 12))
def test_names_are_safe_and_can_be_taken_apart(label: str, index: int, attempt: int) -> None:
    stem = file_stem(index, label, attempt)
    assert all(letter.isascii() and (letter.isalnum() or letter in "+-_.") for letter in stem)
    assert len(stem) < 90
    for ending in (".parquet", ".part002.parquet"):
        assert name_parts(stem + ending) == (index, safe_name(label), attempt)
