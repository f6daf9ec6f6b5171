"""Results that plans of one process share: they must be those of a process for each plan. Predictions are made when they are needed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planrunner.base import plugins
from planrunner.error_model.terms import Term
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic
from planrunner.physics.stimulus import Stimulus
from planrunner.tasks.check import check_plan
from tests.conftest import FLAGSHIP, ROOT

Write = Callable[..., Path]

_EACH = """
import json, sys
from pathlib import Path
from planrunner.tasks.check import check_plan

def shown(path):
    checked = check_plan(Path(path))
    return {
        "findings": list(map(str, checked.findings)),
        "judged": {name: list(map(str, judged)) for name, judged in checked.judged.items()},
        "notes": {name: design.all_notes for name, design in checked.designs.items()},
        "predicted": {
            name: [[item.name, item.value, item.standard_uncertainty] for item in design.predicted]
            for name, design in checked.designs.items()
        },
    }

print(json.dumps([shown(path) for path in sys.argv[1:]]))
"""


def _checked(*paths: Path) -> list[object]:
    """What a process finds that checks these plans one after the other."""
    command = [sys.executable, "-c", _EACH, *map(str, paths)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    found: list[object] = json.loads(done.stdout)
    return found


def test_plans_checked_one_after_the_other_are_as_checked_alone(plan_file: Write, tmp_path: Path) -> None:
    """The other plan has another temperature and dwell, another position, and another basis of uncertainty."""
    other = tmp_path / "other.yaml"
    text = plan_file(
        ("temperature: 25 degC", "temperature: 40 degC"),
        ("dwell: 2 min", "dwell: 77 s"),
        ("P8: {x: south, y: west, z: down}", "P8: {from: {x: south, y: west}, rotate: [x 30 deg, z 20 deg]}"),
        ("segments: P*, uncertainty: residual", "segments: P*, uncertainty: within_segment"),
    ).read_text(encoding="utf-8")
    other.write_text(text, encoding="utf-8")
    first, between, again = _checked(FLAGSHIP, other, FLAGSHIP)
    (alone,) = _checked(other)
    assert again == first != between
    assert between == alone


def test_a_prediction_is_made_once_and_only_if_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    formula = FlexureGyroStatic.quantities

    def counted(self: FlexureGyroStatic, request: object) -> object:
        made.append(request.name)  # type: ignore[attr-defined]
        return formula(self, request)  # type: ignore[arg-type]

    monkeypatch.setattr(FlexureGyroStatic, "quantities", counted)
    checked = check_plan(FLAGSHIP)
    assert made == ["drift"]  # limits need it
    assert checked.designs["drift"].predicted and checked.designs["traditional"].predicted
    assert checked.designs["traditional"].known and checked.designs["traditional"].foreseen
    assert made == ["drift", "traditional"]


@pytest.mark.parametrize("name", plugins.names(plugins.TERMS))
def test_a_term_of_the_motion_depends_on_nothing_else(name: str) -> None:
    term: Term = plugins.load(plugins.TERMS, name)
    rng = np.random.default_rng(1)
    omega, force = rng.normal(size=(2, 5, 3))
    still = np.zeros(5, dtype=bool)
    first, again = [
        term.of(
            Stimulus(omega, force, 300 + rng.normal(size=5), rng.normal(size=5), np.zeros(5), rng.normal(size=5), still)
        )
        for _ in range(2)
    ]
    assert term.of_motion == np.array_equal(first, again)
