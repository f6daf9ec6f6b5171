"""A key of a segment is declared once: schema, reading, defaults, sweeps, labels and the reference of keys know a new one."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from planrunner.plan.segments import STATE_KEYS, STATE_TRAITS, StateTraits

ROOT = Path(__file__).resolve().parents[2]
DECLARED = """    pressure: Quantity | None = key(
        QuantityOf("pressure", "positive"),
        "Pressure about the sensor.",
        "101.3 kPa",
        default=None,
        traits=StateTraits(swept=True),
    )
"""
PLAN = """planrunner: 1
title: t
sensor: {kind: k, outputs: [o]}
defaults: {pressure: 80 kPa}
segments:
  - {label: plain}
  - label: own
    pressure: 90 kPa
    steps: [{label: a}, {label: b, pressure: 95 kPa}]
  - for_each: {pressure: "100, 110 kPa"}
"""
SEEN_WITH_A_NEW_KEY = f"""
import importlib.util, json, sys

name = "planrunner.plan.segments"
spec = importlib.util.find_spec(name)
source = spec.loader.get_source(name)
place = "    mode: str | None = optional("
assert source.count(place) == 1
module = importlib.util.module_from_spec(spec)
sys.modules[name] = module
exec(compile(source.replace(place, {DECLARED!r} + place), spec.origin, "exec"), module.__dict__)

from planrunner.plan.expand import expand
from planrunner.plan.model import parse_plan
from planrunner.plan.reference import keys_reference
from planrunner.tasks.write_schemas import plan_schema

plan, log = parse_plan({PLAN!r}, "plan.yaml")
segments = expand(plan, log)
wrong = parse_plan({PLAN.replace("pressure: 80", "presure: 80")!r}, "plan.yaml")[1]
print(json.dumps({{
    "findings": [str(one) for one in log],
    "stated": [(one.label, str(one.state.pressure)) for one in segments],
    "misspelt": [one.hint for one in wrong],
    "schema": json.dumps(plan_schema()),
    "reference": keys_reference(),
}}))
"""


def test_everything_knows_a_new_key_of_a_segment() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SEEN_WITH_A_NEW_KEY], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert not seen["findings"]
    assert seen["stated"] == [
        ["plain", "80 kPa"],
        ["own/a", "90 kPa"],
        ["own/b", "95 kPa"],
        ["100kPa", "100 kPa"],
        ["110kPa", "110 kPa"],
    ]
    assert any("pressure" in hint for hint in seen["misspelt"])
    properties = json.loads(seen["schema"])["$defs"]["segment"]["properties"]
    assert "pressure" in properties
    assert "Values of pressure" in seen["schema"]
    assert "| `pressure` |" in seen["reference"]
    assert any("any of" in line and "pressure" in line for line in seen["reference"].splitlines())


def test_keys_that_replace_each_other_say_so_of_each_other() -> None:
    assert tuple(STATE_TRAITS) == STATE_KEYS
    for name, traits in STATE_TRAITS.items():
        assert isinstance(traits, StateTraits)
        if traits.replaces is not None:
            assert STATE_TRAITS[traits.replaces].replaces == name
