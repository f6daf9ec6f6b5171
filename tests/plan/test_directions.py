"""A direction of the site is declared once: everything knows a new word, and no design changes by it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from planrunner.plan.directions import CARDINAL, DIRECTIONS
from planrunner.plan.rewriting import cardinal_orientations, orientation_text

ROOT = Path(__file__).resolve().parents[2]
WORD, DIRECTION = "south-east", (0.7071067811865476, -0.7071067811865476, 0.0)
SEEN_WITH_A_NEW_WORD = f"""
import json
from planrunner.plan import directions

directions.DIRECTIONS[{WORD!r}] = {DIRECTION!r}

import numpy as np
from planrunner.gap.answer.gap_description import _words
from planrunner.instruments.table_keys import AxisSpec
from planrunner.base.findings import Findings
from planrunner.plan.kinds import Schema
from planrunner.plan.orientation import OrientationKind, in_words
from planrunner.plan.reference import type_words
from planrunner.plan.rewriting import cardinal_orientations, orientation_text
from planrunner.plan.segments import MotionSpec
from planrunner.plan.source import parse
from planrunner.reporting import words

def read(text):
    log = Findings()
    found = OrientationKind().read(parse(text, "plan.yaml"), log)
    return (None if found is None else found.text), [(one.code, one.message, one.hint) for one in log]

def choices(record, name):
    return next(item.metadata["kind"] for item in record.__dataclass_fields__.values() if item.name == name).schema()["enum"]

axes = np.array([{DIRECTION!r}, (0.0, 0.0, 1.0), np.cross({DIRECTION!r}, (0.0, 0.0, 1.0))])
print(json.dumps({{
    "orientation": OrientationKind().schema()["anyOf"][1]["properties"]["x"]["enum"],
    "about": choices(MotionSpec, "about"),
    "axis": choices(AxisSpec, "direction"),
    "read": read("{{x: south-east, y: up}}"),
    "misspelt": read("{{x: south-eest, y: up}}"),
    "aslant": read("{{x: south-east, y: east}}"),
    "handed": read("{{x: south-east, y: up, z: north}}"),
    "in words": in_words(axes),
    "spin": words.direction({DIRECTION!r}),
    "level": _words(axes),
    "reference": type_words(next(i.metadata["kind"] for i in MotionSpec.__dataclass_fields__.values() if i.name == "about")),
    "cardinal": [one.tolist() for one in cardinal_orientations()],
    "written": orientation_text(axes),
}}))
"""


def test_everything_knows_a_new_word_and_designs_stay() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SEEN_WITH_A_NEW_WORD], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    for name in ("orientation", "about", "axis"):
        assert seen[name] == [*DIRECTIONS, WORD], name
    assert WORD in seen["reference"]
    text, findings = seen["read"]
    assert not findings and text.startswith(f"x {WORD}, y up, z ")
    assert any(WORD in hint for _, _, hint in seen["misspelt"][1])
    ((code, message, _),) = seen["aslant"][1]
    assert code == "meaning-orientation" and WORD in message
    assert seen["handed"][1]
    assert seen["in words"].startswith(f"x {WORD}, y up")
    assert seen["spin"] == WORD
    # Designs and proposals search among the same 24 attitudes, in the same order.
    assert np.array_equal(seen["cardinal"], cardinal_orientations())
    assert WORD not in seen["written"] and "rotate" in seen["written"]


def test_the_cardinal_directions_are_six_unit_vectors_in_opposite_pairs() -> None:
    vectors = np.array(list(CARDINAL.values()))
    assert np.array_equal(np.sort(vectors @ vectors.T, axis=1), np.tile([-1.0, 0.0, 0.0, 0.0, 0.0, 1.0], (6, 1)))
    assert len({orientation_text(one) for one in cardinal_orientations()}) == 24


def test_every_word_is_a_unit_vector_and_stands_in_the_findings() -> None:
    row = next(
        line
        for line in (ROOT / "docs" / "findings.md").read_text(encoding="utf-8").splitlines()
        if "`form-direction`" in line
    )
    for word, vector in DIRECTIONS.items():
        assert abs(np.linalg.norm(vector) - 1) < 1e-12
        assert word in row
    assert set(CARDINAL) <= set(DIRECTIONS)
