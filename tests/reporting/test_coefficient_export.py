"""Coefficients as files: read back by other readers in full precision; nothing in a name breaks out."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reporting_example as example
import yaml

from planrunner.base.said import Said
from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.plan import source
from planrunner.reporting.export import FORMS, ExportError, export, identifiers, yaml_float

PROVENANCE = {"run": "runs/20260302T081109Z-x-1a2b", "seal": "sha256:00ff"}
AWKWARD = (0.1, 1 / 3, -1.5e-310, 6.02214076e23, 1e22, 5e-324, 1.7976931348623157e308, -0.0, 2.0)
HOSTILE = "*/ int x; /* ??/\n\r\u2028'; system('id'); % {\"a\": [}] # \\"


def awkward() -> Estimate:
    names = [f"c{i}" for i in range(len(AWKWARD))]
    return Estimate(
        "odd numbers", "test", tuple(Coefficient(n, v, "deg/h", abs(v) / 3) for n, v in zip(names, AWKWARD, strict=True)),
        np.diag(np.array(AWKWARD[:9]) * 0 + 1.25),
    )  # fmt: skip


def hostile() -> Estimate:
    items = (Coefficient(HOSTILE, 1.5, HOSTILE, 0.25, 2.0, Said(HOSTILE)), Coefficient("=cmd()", 2.5, "1", 0.5))
    return Estimate(HOSTILE, HOSTILE, items, np.eye(2))


def read_csv(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO("".join(x for x in text.splitlines(True) if not x.startswith("#")))))


@pytest.mark.parametrize("estimate", [example.estimate(), awkward()])
def test_csv_reads_back(estimate: Estimate) -> None:
    rows = read_csv(export(estimate, "csv", PROVENANCE))
    assert [row["name"] for row in rows] == [item.name for item in estimate.coefficients]
    for row, item in zip(rows, estimate.coefficients, strict=True):
        assert float(row["value"]) == item.value
        assert float(row["standard_uncertainty"]) == item.standard_uncertainty
        assert float(row["degrees_of_freedom"]) == item.degrees_of_freedom
        assert row["unit"] == item.unit


@pytest.mark.parametrize("estimate", [example.estimate(), awkward()])
def test_yaml_reads_back_by_either_version_of_yaml(estimate: Estimate) -> None:
    text = export(estimate, "yaml", PROVENANCE)
    for data in (yaml.safe_load(text), source.plain(source.parse(text, "x.yaml"))):
        assert data["provenance"] == PROVENANCE
        assert list(data["coefficients"]) == [item.name for item in estimate.coefficients]
        for item in estimate.coefficients:
            read = data["coefficients"][item.name]
            assert read["value"] == item.value
            assert isinstance(read["value"], float)
            assert read["standard_uncertainty"] == item.standard_uncertainty
            assert read["degrees_of_freedom"] == item.degrees_of_freedom
        np.testing.assert_array_equal(data["covariance"], estimate.covariance)


@pytest.mark.parametrize("value", [*AWKWARD, math.inf, -math.inf])
def test_yaml_numbers(value: float) -> None:
    assert yaml.safe_load(yaml_float(value)) == value
    assert math.isnan(yaml.safe_load(yaml_float(math.nan)))


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler here")
@pytest.mark.parametrize("estimate", [example.estimate(), awkward(), hostile()], ids=["example", "awkward", "hostile"])
def test_c_header_compiles_and_holds_the_numbers(estimate: Estimate, tmp_path: Path) -> None:
    header = export(estimate, "c", PROVENANCE)
    names = re.findall(r"^#define (\w+) \(", header, re.MULTILINE)
    prints = "".join(f'printf("%.17g\\n", {name});' for name in names)
    (tmp_path / "made.h").write_text(header, encoding="utf-8")
    (tmp_path / "main.c").write_text(
        f'#include <stdio.h>\n#include "made.h"\nint main(void) {{ {prints} return 0; }}\n'
    )
    program = tmp_path / "program"
    command = ["gcc", "-std=c99", "-trigraphs", "-Wall", "-Werror", "-o", str(program), str(tmp_path / "main.c")]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    shown = subprocess.run([str(program)], check=True, capture_output=True, text=True, timeout=60).stdout.split()
    expected = [x for item in estimate.coefficients for x in (item.value, item.standard_uncertainty)]
    assert [float(text) for text in shown] == expected


def matlab_code(text: str) -> list[str]:
    """The statements without comments and with strings emptied, by MATLAB's rules for quotes."""
    code = []
    for line in text.splitlines():
        kept = re.sub(r"'(?:[^']|'')*'", "''", line)
        assert "'" not in kept.replace("''", "").split("%")[0]
        code.append(kept.split("%")[0].strip())
    return [line for line in code if line]


@pytest.mark.parametrize("estimate", [example.estimate(), awkward(), hostile()], ids=["example", "awkward", "hostile"])
def test_matlab_is_a_list_of_assignments(estimate: Estimate) -> None:
    text = export(estimate, "matlab", PROVENANCE)
    code = " ".join(matlab_code(text)).replace("...", "")
    statements = [part.strip() for part in re.split(r";(?![^\[]*\])", code) if part.strip()]
    number = r"-?(?:[0-9.]+(?:e[-+]?[0-9]+)?|Inf)"
    shape = rf"[A-Za-z]\w*(?:\.[A-Za-z]\w*)*\s*=\s*(?:{number}|''|\{{[', ]*\}}|\[[-0-9.e+; ]*\])"
    for statement in statements:
        assert re.fullmatch(shape, statement), statement
    values = re.findall(rf"\.value = ({number});", text)
    assert [float(value) for value in values] == [item.value for item in estimate.coefficients]
    assert len(statements) == 4 * len(estimate.coefficients) + 2


def test_nothing_breaks_out_of_comments_cells_or_strings() -> None:
    rows = read_csv(export(hostile(), "csv", {HOSTILE: HOSTILE}))
    assert len(rows) == 2
    assert rows[1]["name"] == "'=cmd()"
    data = yaml.safe_load(export(hostile(), "yaml", {HOSTILE: HOSTILE}))
    assert data["coefficients"][HOSTILE]["unit"] == HOSTILE
    for form in FORMS:
        for line in export(hostile(), form, {HOSTILE: HOSTILE}).splitlines():
            assert "\u2028" not in line or form == "yaml"
            assert not line.startswith(("system", "int x"))


def test_names_become_distinct_identifiers() -> None:
    assert identifiers(["D(X)_F", "D X F", "1st", "ε", "d_x_f", "end"], frozenset({"end"})) == [
        "D_X_F", "D_X_F_2", "c_1st", "coefficient", "d_x_f_3", "c_end",
    ]  # fmt: skip
    long = identifiers(["a" * 500, "a" * 501])
    assert len(set(long)) == 2
    assert all(len(name) <= 55 for name in long)


def test_what_cannot_be_written_is_said() -> None:
    with pytest.raises(ExportError, match="known: csv, matlab, yaml, c"):
        export(example.estimate(), "xlsx")
    broken = replace(example.estimate(), coefficients=(Coefficient("K", math.nan, "1", 1.0),), covariance=np.eye(1))
    with pytest.raises(ExportError, match="K is not a finite number"):
        export(broken, "c")


def test_provenance_stands_in_the_opening_comment() -> None:
    for form, mark in (("csv", "# "), ("matlab", "% "), ("yaml", "# "), ("c", "/* ")):
        opening = export(example.estimate(), form, PROVENANCE).splitlines()[:3]
        assert all(line.startswith(mark) for line in opening)
        assert "sha256:00ff" in opening[2]


def test_the_period_of_a_circular_quantity_is_written_and_of_no_other() -> None:
    items = (Coefficient("heading", 359.9, "deg", 0.1, period=360.0), Coefficient("bias", 2.0, "deg/h", 0.5))
    estimate = Estimate("free", "strapdown_navigation", items, np.eye(2))
    assert [row["period"] for row in read_csv(export(estimate, "csv"))] == ["360.0", ""]
    found = yaml.safe_load(export(estimate, "yaml"))["coefficients"]
    assert found["heading"]["period"] == 360.0
    assert "period" not in found["bias"]
    matlab, header = export(estimate, "matlab"), export(estimate, "c")
    assert re.findall(r"^free\.(\w+)\.period = (\S+);", matlab, re.M) == [("heading", "360.0")]
    assert re.findall(r"^#define (\w+_PERIOD) \((\S+)\)", header, re.M) == [("FREE_heading_PERIOD".upper(), "360.0")]
