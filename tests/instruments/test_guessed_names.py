"""Names of columns that are guessed from the lines above the first row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planrunner.instruments.formats.guessing import guessed_format
from planrunner.instruments.formats.text import TextKeys
from tests.in_process import planrunner

SIX = "gx,gy,gz,ax,ay,az"
VALUES = "0.1,0.2,0.3,0.01,0.02,1.0"
NAMES = tuple(SIX.split(","))


def names_of(folder: Path, header: str, rows: list[str]) -> tuple[str, ...]:
    """The names that the format states; without such names, those of the header."""
    file = folder / "r.csv"
    file.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    found = guessed_format(file, "r.csv")
    if found is None:
        return tuple(header.splitlines()[0].split(","))
    assert isinstance(found.parameters, TextKeys)
    return found.parameters.names or tuple(header.splitlines()[found.parameters.skip].split(","))


@pytest.mark.parametrize("step", [1, 10])
@pytest.mark.parametrize("first", ["msec", "time", "n"])
def test_a_comma_at_the_end_of_each_row_shifts_no_name(tmp_path: Path, first: str, step: int) -> None:
    rows = [f"{step * k},{VALUES}," for k in range(20)]
    assert names_of(tmp_path, f"{first},{SIX}", rows) == (first, *NAMES, "column_8")


def test_a_further_column_without_a_name_shifts_no_name(tmp_path: Path) -> None:
    assert names_of(tmp_path, f"msec,{SIX}", [f"{10 * k},{VALUES},7" for k in range(20)]) == (
        "msec",
        *NAMES,
        "column_8",
    )


@pytest.mark.parametrize(
    ("names", "row"),
    [(SIX, "{0},{1}"), (SIX, "{2:.2f},{1}"), (f"t,{SIX}", "{0},{2:.2f},{1}"), (f"speed,{SIX}", "{0},3,{1}")],
    ids=["numbers", "times", "numbers and times", "another first name"],
)
def test_a_first_column_without_a_name_is_left_without(tmp_path: Path, names: str, row: str) -> None:
    rows = [row.format(k, VALUES, k / 100) for k in range(20)]
    assert names_of(tmp_path, names, rows) == ("row", *names.split(","))


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("t,gx,gy,gz\ns,deg/s,deg/s,deg/s", ("t [s]", "gx [deg/s]", "gy [deg/s]", "gz [deg/s]")),
        ("gx,gy,ax,ay\ndeg/s,deg/s,g,g", ("gx [deg/s]", "gy [deg/s]", "ax [g]", "ay [g]")),
        ("Operator,Anna,Table,T1\nt,x,y,x", ("t", "x", "y", "x")),
        ("Operator,Anna,Table\nt,x,y,x", ("t", "x", "y", "x")),
        ("Gyro,,Accelerometer,\nX,Y,X,Y", ("Gyro X", "Gyro Y", "Accelerometer X", "Accelerometer Y")),
        ("Gyro,Gyro,Acc,Acc\nX,Y,X,Y", ("Gyro X", "Gyro Y", "Acc X", "Acc Y")),
        ("Time,Gyro,Acc,Temp\ns,z,z,C", ("Time s", "Gyro z", "Acc z", "Temp C")),
    ],
)
def test_a_line_above_the_names(tmp_path: Path, header: str, names: tuple[str, ...]) -> None:
    assert names_of(tmp_path, header, [f"{k / 100:.2f},0.1,0.2,1.0" for k in range(20)]) == names


def test_a_column_named_by_milliseconds_and_text_in_utf_16_without_a_mark(tmp_path: Path) -> None:
    """200 rows of 10 ms; at 10 s a row, the recording would take half an hour."""
    draw = np.random.default_rng(1)
    rows = [f"{10 * k}," + ",".join(f"{v:.5f}" for v in (*draw.normal(0, 0.1, 5), 9.81)) for k in range(200)]
    text = "\n".join([f"msec,{SIX}", *rows, ""])
    file = tmp_path / "r.csv"
    file.write_bytes(text.encode("utf-16-le"))
    found = guessed_format(file, "r.csv")
    assert found is not None and found.parameters == TextKeys(separator="comma", encoding="utf-16-le")
    for encoding in ("utf-8", "utf-16-le"):
        file.write_bytes(text.encode(encoding))
        assert planrunner("new", "p", "--from-recording", "r.csv", cwd=tmp_path).returncode == 0
        assert "time: {column: msec, unit: ms}" in (tmp_path / "p.bench.yaml").read_text(encoding="utf-8")
        assert planrunner("check", "p.yaml", "--data", ".", cwd=tmp_path).returncode == 0
        for made in tmp_path.glob("p.*"):
            made.unlink()
