"""The walls of the house: who may import whom, and what `check` may cost."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "planrunner"

FORBIDDEN = {
    "physics": {"archive", "bench", "cli", "design", "estimators", "execution", "instruments", "reporting", "uncertainty"},
    "plan": {"archive", "bench", "cli", "design", "estimators", "execution", "instruments", "reporting", "uncertainty", "physics"},
    "instruments": {"archive", "bench", "cli", "design", "estimators", "execution", "reporting", "uncertainty"},
    "bench": {"archive", "cli", "design", "estimators", "reporting", "uncertainty"},
    "archive": {"cli", "design", "estimators", "execution", "reporting", "uncertainty"},
    "execution": {"bench", "cli", "design", "estimators", "reporting", "uncertainty"},
    "estimators": {"bench", "cli", "execution", "reporting"},
    "design": {"bench", "cli", "execution", "reporting", "archive"},
    "uncertainty": {"bench", "cli", "execution", "reporting", "archive", "instruments"},
    "reporting": {"cli", "execution"},
}


def imported(path: Path) -> set[str]:
    """Second parts of all `planrunner.X…` imports of a file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        found.update(name.split(".")[1] for name in names if name.startswith("planrunner.") and name.count("."))
    return found


@pytest.mark.parametrize("folder", sorted(FORBIDDEN))
def test_imports_point_one_way(folder: str) -> None:
    for path in (PACKAGE / folder).rglob("*.py"):
        crossing = imported(path) & FORBIDDEN[folder]
        if folder == "plan" and path.name == "schema.py":
            crossing -= {"bench"}  # writes the schema of bench files too
        assert not crossing, f"{path.relative_to(ROOT)} imports {sorted(crossing)}"


def test_nothing_but_the_entry_point_imports_the_command_line() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path.parent.name != "cli" and path.name != "__main__.py":
            assert "cli" not in imported(path), path


def test_simulator_and_estimators_share_no_formula() -> None:
    for path in (PACKAGE / "instruments").rglob("*.py"):
        assert "flexure_gyro import" not in path.read_text(encoding="utf-8").replace("virtual.flexure_gyro import", ""), path


def test_check_imports_nothing_heavy() -> None:
    code = (
        "import sys; from planrunner.cli import main; main(['check', sys.argv[1]]);"
        "print(sorted({'scipy', 'pyarrow', 'matplotlib', 'pint', 'rich', 'jinja2', 'jsonschema', 'numba'} & set(sys.modules)))"
    )
    plan = ROOT / "plans" / "flexure_gyro_eight_position.yaml"
    run = subprocess.run([sys.executable, "-c", code, str(plan)], capture_output=True, text=True, check=True)
    assert run.stdout.strip().splitlines()[-1] == "[]"
