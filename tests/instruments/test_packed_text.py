"""Text files that are packed with gzip: the same numbers, damaged files, and files that unpack to more than the limit."""

from __future__ import annotations

import gzip
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.instruments.formats import file as format_file
from planrunner.instruments.formats import packed
from planrunner.instruments.formats.choice import Format, open_file
from planrunner.instruments.formats.file import AnyFile, TimeStamps
from planrunner.instruments.formats.text import TextKeys
from planrunner.instruments.interfaces import InstrumentError

ROWS = 20_000
TABLE = np.column_stack([np.arange(ROWS) / 100, np.random.default_rng(1).normal(size=ROWS).round(9)])
LAYOUTS = {
    "r.csv.gz": TextKeys(),
    "r.tsv.gz": TextKeys(separator="tab"),
    "r.txt.GZ": TextKeys(separator="blanks", skip=1),
    "r.csv": TextKeys(encoding="utf-16"),
}


def text(keys: TextKeys) -> bytes:
    sign = {"tab": "\t", "blanks": "   "}.get(keys.separator, ",")
    lines = [*["remark"] * keys.skip, f"t{sign}x", *(f"{t:.2f}{sign}{x:.9f}" for t, x in TABLE.tolist()), ""]
    return "\n".join(lines).encode(keys.encoding)


def opened(folder: Path, content: bytes, name: str = "r.csv.gz", keys: TextKeys | None = None) -> AnyFile:
    (folder / name).write_bytes(content)
    given = None if keys is None or keys == TextKeys() else Format(type="text", parameters=keys)
    return open_file(folder / name, name, TimeStamps("t"), {"x": "x"}, given)


def rows_of(file: AnyFile) -> list[tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]]:
    file.look()
    return list(file.rows())


def refusal(file: AnyFile) -> str:
    with pytest.raises(InstrumentError) as caught:
        rows_of(file)
    return str(caught.value)


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("members", [1, 3])
def test_packed_text_gives_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, members: int
) -> None:
    monkeypatch.setattr(format_file, "BATCH", 777)
    whole = text(LAYOUTS[name])
    size = -(-len(whole) // members)
    content = b"".join(gzip.compress(whole[at : at + size]) for at in range(0, len(whole), size))
    file = opened(tmp_path, content, name, LAYOUTS[name])
    parts = rows_of(file)
    np.testing.assert_array_equal(np.concatenate([time for time, _ in parts]), TABLE[:, 0])
    np.testing.assert_array_equal(np.concatenate([values["x"] for _, values in parts]), TABLE[:, 1])
    if members == 1:
        assert file.rows_about() == pytest.approx(ROWS, rel=0.1)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.3, 0.9, 0.9999])
def test_a_packed_file_that_is_cut_is_refused(tmp_path: Path, share: float) -> None:
    whole = gzip.compress(text(TextKeys()))
    said = refusal(opened(tmp_path, whole[: int(share * len(whole))]))
    assert "r.csv.gz cannot be unpacked: it ends too early; pack it again, or unpack it first" in said


def test_a_packed_file_that_is_damaged_is_refused(tmp_path: Path) -> None:
    whole = bytearray(gzip.compress(text(TextKeys())))
    draw = np.random.default_rng(2)
    for _ in range(30):
        content = whole.copy()
        content[draw.integers(2, len(whole))] ^= int(draw.integers(1, 256))
        (tmp_path / "r.csv.gz").write_bytes(bytes(content))
        file = opened(tmp_path, bytes(content))
        try:
            parts = [values["x"] for _, values in rows_of(file)]
        except InstrumentError:
            continue
        np.testing.assert_array_equal(np.concatenate(parts), TABLE[:, 1])  # a byte of the header of gzip


def test_wrong_cells_and_times_are_named_by_line(tmp_path: Path) -> None:
    lines = text(TextKeys()).splitlines()
    wrong = [*lines[:40], b"0.40,ERR", *lines[41:]]
    assert "r.csv.gz, line 41: 'ERR' in column 'x' is not a number" in refusal(
        opened(tmp_path, gzip.compress(b"\n".join(wrong)))
    )
    wrong = [*lines[:40], lines[39], *lines[40:]]
    assert "r.csv.gz, row 40 (line 41): time does not increase" in refusal(
        opened(tmp_path, gzip.compress(b"\n".join(wrong)))
    )


def test_a_file_that_unpacks_to_more_than_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packed, "MAX_UNPACKED_TEXT", 300_000)
    said = refusal(opened(tmp_path, gzip.compress(text(TextKeys()))))
    assert "r.csv.gz: it has more than 0.0003 GB after unpacking; unpack it first" in said


def test_a_small_file_that_unpacks_to_one_endless_line(tmp_path: Path) -> None:
    content = gzip.compress(b"t,x\n" + bytes(200_000_000))
    tracemalloc.start()
    assert refusal(opened(tmp_path, content)).startswith("r.csv.gz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(content) < 300_000 and peak < 50_000_000


def test_other_formats_are_not_unpacked(tmp_path: Path) -> None:
    (tmp_path / "r.json.gz").write_bytes(gzip.compress(b'{"t": 0, "x": 1}\n'))
    with pytest.raises(InstrumentError, match=r"the extension of 'r.json.gz' is not one of"):
        open_file(tmp_path / "r.json.gz", "r.json.gz", TimeStamps("t"), {"x": "x"}, None)
