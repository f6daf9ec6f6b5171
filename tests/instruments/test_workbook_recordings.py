"""Recordings in Excel workbooks: the cells that messages name, and workbooks that would fill the memory."""

from __future__ import annotations

import contextlib
import datetime
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from planrunner.instruments.formats import workbook
from planrunner.instruments.formats.choice import ENDINGS, Format, open_file
from planrunner.instruments.formats.file import AnyFile, TimeStamps
from planrunner.instruments.formats.workbook import WorkbookKeys
from planrunner.instruments.interfaces import InstrumentError

Rows = Sequence[Sequence[object]]
GOOD: Rows = [["t", "x"], [1, 0.5], [2, None], [None, None], [3, "1.5"], [4, "#N/A"], [5, True]]


def opened(
    folder: Path, sheets: dict[str, Rows], keys: WorkbookKeys | None = None, *, written: bool = False
) -> AnyFile:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(list(row))
    book.save(folder / "r.xlsx")
    return reopened(folder, keys, written=written)


def reopened(folder: Path, keys: WorkbookKeys | None = None, *, written: bool = False) -> AnyFile:
    given = None if keys is None else Format(type="excel", parameters=keys)
    return open_file(folder / "r.xlsx", "r.xlsx", TimeStamps("t", written=written), {"x": "x"}, given)


def refusal(file: AnyFile) -> str:
    with pytest.raises(InstrumentError) as caught:
        file.look()
    assert len(str(caught.value)) < 600
    return str(caught.value)


def test_empty_cells_empty_rows_and_numbers_as_text(tmp_path: Path) -> None:
    file = opened(tmp_path, {"a": GOOD})
    file.look()
    ((time, values),) = file.rows()
    assert time.tolist() == [1, 2, 3, 4, 5]
    assert values["x"].tolist() == pytest.approx([0.5, float("nan"), 1.5, float("nan"), 1.0], nan_ok=True)
    assert file.about == 7  # rows of the sheet


def test_dates_and_times_of_day(tmp_path: Path) -> None:
    day = datetime.datetime(2026, 3, 4, 12, 0, 0)
    stamps = [day + datetime.timedelta(milliseconds=20 * k) for k in range(4)]
    file = opened(tmp_path, {"a": [["t", "x"], *([one, 1.0] for one in stamps)]}, written=True)
    file.look()
    assert file.interval == pytest.approx(0.02, abs=1e-6)
    assert "write `time: {column: t, unit: date_time}`" in refusal(reopened(tmp_path))
    file = opened(tmp_path, {"a": [["t", "x"], *([one.time(), 1.0] for one in stamps)]}, written=True)
    file.look()
    assert file.origin == pytest.approx(12 * 3600)


@pytest.mark.parametrize(
    ("sheets", "keys", "said"),
    [
        (
            {"a": [*GOOD, [6, "off"]]},
            None,
            "r.xlsx, row 8 of the sheet: 'off' in column 'x' is not a number; correct it, or leave",
        ),
        ({"a": [*GOOD, [5, 1.0]]}, None, "r.xlsx, row 8 of the sheet: time does not increase: 5 s after 5 s"),
        ({"a": [*GOOD, [None, 1.0], [7, 1]]}, None, "r.xlsx, row 8 of the sheet: the time is missing"),
        ({"a": GOOD, "b": GOOD}, None, "has the sheets a, b; name one: `format: {type: excel, sheet: a}`"),
        ({"a": GOOD, "b": GOOD}, WorkbookKeys(sheet="c"), "has no sheet 'c'"),
        ({"a": GOOD}, WorkbookKeys(skip=1), "its first row contains numbers. Name its columns in the bench file"),
        ({"a": [["t", "x"]]}, None, "r.xlsx holds no samples"),
        ({"a": [["t", "y"], [1, 2]]}, None, "r.xlsx has no column 'x'"),
        ({"a": [[f"c{k}" for k in range(1200)]]}, None, "it has more than 1000 columns"),
    ],
)
def test_a_fault_is_named_with_its_cell(
    tmp_path: Path, sheets: dict[str, Rows], keys: WorkbookKeys | None, said: str
) -> None:
    assert said in refusal(opened(tmp_path, sheets, keys))


def test_names_from_the_bench(tmp_path: Path) -> None:
    file = opened(tmp_path, {"a": GOOD[1:]}, WorkbookKeys(names=("t", "x")))
    file.look()
    assert sum(len(time) for time, _ in file.rows()) == 5


def rewritten(folder: Path, part: str, change: Callable[[bytes], bytes]) -> None:
    """Changes a part of the workbook."""
    with zipfile.ZipFile(folder / "r.xlsx") as packed:
        parts = {name: packed.read(name) for name in packed.namelist()}
    parts[part] = change(parts[part])
    with zipfile.ZipFile(folder / "r.xlsx", "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in parts.items():
            packed.writestr(name, content)


SHEET = "xl/worksheets/sheet1.xml"


def test_parts_that_unpack_to_more_than_the_limit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workbook, "MAX_PART", 100_000)
    monkeypatch.setattr(workbook, "MAX_SHEET", 200_000)
    opened(tmp_path, {"a": GOOD}).look()
    rewritten(tmp_path, SHEET, lambda text: text + b" " * 1_000_000)
    assert (tmp_path / "r.xlsx").stat().st_size < 20_000
    assert "its part xl/worksheets/sheet1.xml has 1 MB, more than 0.2 MB; save the sheet as a CSV" in refusal(
        reopened(tmp_path)
    )
    opened(tmp_path, {"a": GOOD})
    rewritten(tmp_path, "xl/styles.xml", lambda text: text + b" " * 150_000)
    assert "its part xl/styles.xml has 0 MB, more than 0.1 MB" in refusal(reopened(tmp_path))


@pytest.mark.parametrize("part", [SHEET, "xl/workbook.xml"])
def test_entities_are_not_expanded(tmp_path: Path, part: str) -> None:
    opened(tmp_path, {"a": GOOD})
    bomb = b'<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c SYSTEM "file:///etc/passwd">]>'

    def change(text: bytes) -> bytes:
        start, end = text.rsplit(b"</", 1)
        head, xml, rest = start.rpartition(b"?>")
        return head + xml + bomb + rest + b"<x>&b;&c;</x></" + end

    rewritten(tmp_path, part, change)
    file = reopened(tmp_path)
    if part == SHEET:
        assert "cannot be read as an Excel workbook" in refusal(file)
    with contextlib.suppress(InstrumentError):
        file.look()
        assert file.columns() == ["t", "x"]
        assert all(np.nanmax(values["x"]) == 1.5 for _, values in file.rows())


def test_a_row_number_beyond_the_sheet_is_refused(tmp_path: Path) -> None:
    """The reader fills rows that are absent, so a wrong number would keep it busy for ever."""
    opened(tmp_path, {"a": [["t", "x"], [1, 1], [2, 2]]})
    rewritten(tmp_path, SHEET, lambda text: text.replace(b'r="3"', b'r="99999999999"'))
    file = reopened(tmp_path)
    assert "the sheet has more than 1048576 rows" in refusal(file)


def test_a_file_that_is_cut_is_refused(tmp_path: Path) -> None:
    opened(tmp_path, {"a": GOOD})
    whole = (tmp_path / "r.xlsx").read_bytes()
    for size in range(0, len(whole), 97):
        (tmp_path / "r.xlsx").write_bytes(whole[:size])
        assert "r.xlsx cannot be read as an Excel workbook: " in refusal(reopened(tmp_path))


def test_the_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened(tmp_path, {"a": GOOD})
    monkeypatch.setitem(sys.modules, "defusedxml", None)
    assert "install them with: pip install 'planrunner[recordings]'" in refusal(reopened(tmp_path))
    assert ENDINGS[".xlsm"] == "excel"
