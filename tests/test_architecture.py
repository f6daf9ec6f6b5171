"""The walls of the house: who may import whom, and what `check` may cost."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "planrunner"

ROW = re.compile(r"^\| `(\w+)` \| .* \| (.*) \|$", re.MULTILINE)


def allowed() -> dict[str, set[str]]:
    """Folder → what it may import beside itself, as the table in CONTRIBUTING.md says; `cli` may import everything."""
    rows = ROW.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    return {folder: set(re.findall(r"`([\w.]+)`", words.split(";")[0])) for folder, words in rows if folder != "cli"}


def imported(path: Path) -> set[str]:
    """What a file imports of ours, such as `plan.units`; of a package itself, its name alone. `dataclass` is for all."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        found.update(".".join(name.split(".")[1:3]) for name in names if name.startswith("planrunner."))
    return {name for name in found if name.split(".")[0] not in ("__version__", "dataclass")}


def test_the_table_names_every_folder() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert set(allowed()) == folders - {"cli"}


@pytest.mark.parametrize("folder", sorted(allowed()))
def test_imports_point_one_way(folder: str) -> None:
    may = {folder} | allowed()[folder]
    for path in (PACKAGE / folder).rglob("*.py"):
        crossing = {name for name in imported(path) if name not in may and name.split(".")[0] not in may}
        if path == PACKAGE / "plan" / "schema.py":
            crossing -= {"bench.model"}  # writes the schema of bench files too
        assert not crossing, f"{path.relative_to(ROOT)} imports {sorted(crossing)}"


def test_nothing_but_the_entry_point_imports_the_command_line() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path.parent.name != "cli" and path.name != "__main__.py":
            assert not {name for name in imported(path) if name.split(".")[0] == "cli"}, path


def test_simulator_and_estimators_share_no_formula() -> None:
    for path in (PACKAGE / "instruments").rglob("*.py"):
        assert "flexure_gyro import" not in path.read_text(encoding="utf-8").replace(
            "virtual.flexure_gyro import", ""
        ), path


REAL = ("wire", "sensors", "tables", "chambers")


def test_simulated_instruments_and_drivers_share_no_code() -> None:
    """Each is written from the protocols alone, so that a shared misunderstanding cannot hide."""
    drivers = [path for name in REAL for path in (PACKAGE / "instruments" / name).rglob("*.py")]
    simulators = list((PACKAGE / "simulators").rglob("*.py"))
    assert drivers and simulators
    for path in drivers:
        assert "planrunner.simulators" not in path.read_text(encoding="utf-8"), path
    for path in simulators:
        assert not {name for name in imported(path) if name in {f"instruments.{folder}" for folder in REAL}}, path


HEAVY = (
    "GTC",
    "babel",
    "jinja2",
    "jsonschema",
    "markupsafe",
    "matplotlib",
    "numba",
    "numpy.random",
    "pint",
    "pyarrow",
    "pyvisa",
    "rich",
    "scipy",
    "serial",
)


def test_check_of_the_shipped_plans_imports_nothing_heavy() -> None:
    code = (
        "import sys; from planrunner.cli import main;"
        "[main(['check', plan]) or print('HELD', plan, sorted({*HEAVY} & set(sys.modules))) for plan in sys.argv[1:]]"
    ).replace("HEAVY", repr(HEAVY))
    plans = sorted(str(path) for path in (ROOT / "plans").glob("*.yaml"))
    run = subprocess.run([sys.executable, "-c", code, *plans], capture_output=True, text=True, check=True)
    held = [line for line in run.stdout.splitlines() if line.startswith("HELD ")]
    assert held == [f"HELD {plan} []" for plan in plans]


OPENERS = {
    "regular_files.py": "every file that somebody else named",
    "guarded_folder.py": "everything in a run folder",
    "exclusive.py": "locks",
    "bench/lock.py": "the folder of locks",
    "cli/__init__.py": "the null device, when standard output went away",
    "cli/new.py": "shipped plans, copied",
    "cli/simulate_bench.py": "the file that says where everything listens, made new",
    "archive/formats.py": "shipped schemas",
    "reporting/language.py": "shipped catalogues",
    "diagnosing.py": "shipped benches",
    "validation.py": "its own reference data",
}
"""Modules that open files by the means of Python, and what they open."""


def test_files_that_somebody_named_are_opened_in_one_place() -> None:
    """A pipe as a plan would hang the program, and a device would fill its memory, where a file is simply opened."""
    reading = {"read_text", "read_bytes", "memory_map", "read_table", "OSFile"}
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            whole = ast.unparse(node.func)
            by_path = isinstance(node.func, ast.Attribute) and node.func.attr in reading
            ours = whole.startswith(("source.", "resource.", "self.resource."))  # the one place, and a port
            opened = whole in ("open", "io.open", "os.open", "FileIO", "os.fdopen") or (
                isinstance(node.func, ast.Attribute) and node.func.attr == "open" and bool(node.args)
                and isinstance(node.args[0], ast.Constant)
            )  # fmt: skip
            if opened or (by_path and not ours):
                found.add(path.relative_to(PACKAGE).as_posix())
    assert found == set(OPENERS)
