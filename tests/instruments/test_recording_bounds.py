"""What a recording's file may ask of the computer that reads it: nothing beyond its batches, whatever the file holds."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats import parquet
from planrunner.instruments.formats.file import TimeStamps
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording_file import RecordedFile, beneath, open_recording

TIME = np.arange(1000) / 100


def total(path: Path) -> float:
    """Sum of the channel, after reading all of the file."""
    file = open_recording([RecordedFile(path, path.name)], TimeStamps("time"), {"rate": "gx"})
    return float(sum(columns["rate"].sum() for _, columns in file.rows()))


def refusal(path: Path) -> str:
    with pytest.raises(InstrumentError) as caught:
        total(path)
    message = str(caught.value)
    assert message.startswith(path.name)
    assert len(message) < 500
    return message


@pytest.fixture
def allocated() -> Iterator[pa.MemoryPool]:
    """A pool that counts what Arrow allocates during a test."""
    usual = pa.default_memory_pool()
    counted = pa.proxy_memory_pool(usual)
    pa.set_memory_pool(counted)
    yield counted
    pa.set_memory_pool(usual)


def written(path: Path, columns: Mapping[str, object], **options: object) -> Path:
    pq.write_table(pa.table({"time": TIME, **columns}), path, **options)
    return path


def test_text_in_a_parquet_file_is_refused_before_it_is_unpacked(tmp_path: Path, allocated: pa.MemoryPool) -> None:
    """Thousand cells of 100 kB each pack into a few kilobytes and unpack to 100 MB."""
    path = written(tmp_path / "wide.parquet", {"gx": pa.array(["0" * 100_000] * 1000)})
    assert path.stat().st_size < 100_000
    before = allocated.max_memory()
    assert "column 'gx' holds text" in refusal(path)
    assert allocated.max_memory() - before < 5_000_000


@pytest.mark.parametrize(
    "values",
    [
        pa.array([b"0"] * 1000),
        pa.array([[0.0]] * 1000),
        pa.array([{"a": 0.0}] * 1000),
        pa.array([0] * 1000, pa.timestamp("ns")),
        pa.array(["0"] * 1000).dictionary_encode(),
    ],
    ids=["bytes", "lists", "records", "dates", "dictionary"],
)
def test_other_columns_that_are_no_numbers_are_refused(tmp_path: Path, values: pa.Array) -> None:
    assert "column 'gx' holds values of the type" in refusal(written(tmp_path / "a.parquet", {"gx": values}))


@pytest.mark.parametrize("kind", [pa.int16(), pa.uint64(), pa.float32(), pa.float64(), pa.decimal128(21, 2)])
def test_numbers_of_every_kind_are_read_beside_columns_of_text(tmp_path: Path, kind: pa.DataType) -> None:
    values = pa.array([2] * 1000, pa.int64()).cast(kind)
    path = written(tmp_path / "a.parquet", {"gx": values, "note": pa.array(["x" * 1000] * 1000)})
    assert total(path) == 2000


def test_too_many_columns_are_refused(tmp_path: Path) -> None:
    names = [f"c{index}" for index in range(200_000)]
    wide = tmp_path / "wide.csv"
    wide.write_text(f"time,gx,{','.join(names)}\n0,1{',0' * len(names)}\n")
    assert "more than 1000 columns" in refusal(wide)
    some = written(tmp_path / "a.parquet", {"gx": TIME} | dict.fromkeys(names[:1000], TIME), compression="none")
    assert "more than 1000 columns" in refusal(some)
    most = tmp_path / "most.csv"
    most.write_text(f"time,gx,{','.join(names[:998])}\n0,1{',0' * 998}\n1,1{',0' * 998}\n")
    assert total(most) == 2


@pytest.mark.parametrize("before", ["", "\ufeff", "\n\n\r\n"], ids=["plain", "mark", "empty-lines"])
def test_a_header_without_end_is_refused(tmp_path: Path, before: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{before}time,gx,{'a' * 5_000_000}\n0,1,2\n", encoding="utf-8")
    assert "header is longer" in refusal(path)
    path.write_text(f"{before}time,gx,{'a' * 60_000}\n0,1,2\n1,1,2\n", encoding="utf-8")
    assert total(path) == 2


@pytest.mark.parametrize("width", [200_000, 9_000_000])
def test_a_cell_without_end_is_named_by_its_line(tmp_path: Path, width: int) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"time,gx\n0,1\n1,1\n2,{'x' * width}\n3,1\n")
    assert "line 4: a cell is wider" in refusal(path)


def test_row_groups_and_directories_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a.parquet", {"gx": TIME, "other": np.arange(1000)}, use_dictionary=False)
    assert total(path) == pytest.approx(TIME.sum())
    monkeypatch.setattr(parquet, "MAX_CHUNK", 7_000)
    assert "in row group 1" in refusal(path)
    monkeypatch.undo()
    monkeypatch.setattr(parquet, "MAX_DIRECTORY", 100)
    assert "its directory" in refusal(path)


@pytest.mark.skipif(os.name == "nt", reason="pipes as files are of POSIX systems")
@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_a_pipe_as_a_recording_is_refused_without_waiting(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    assert "pipe" in refusal(beneath(tmp_path, name))


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_a_recording_beyond_its_bound_is_refused_by_its_size(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(format_file, "MAX_BYTES", 1_000_000)
    with (tmp_path / name).open("wb") as file:
        file.truncate(1_000_001)
    assert "larger than 1 MB" in refusal(tmp_path / name)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1PAR1", b"PAR1" + b"\xff" * 4 + b"PAR1", b"x" * 100])
def test_what_is_no_parquet_file_is_said(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.parquet").write_bytes(content)
    assert "cannot be read" in refusal(tmp_path / "a.parquet")
