"""Suites: the schema and the reader agree, names and dependencies are checked, and the reference is up to date."""

from __future__ import annotations

import copy
import json
import random
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from planrunner.base.findings import Findings
from planrunner.night.expansion import check_known_failures, expand_suite, known_failure
from planrunner.night.reference import suite_reference
from planrunner.night.suite import Suite, read_suite
from planrunner.plan import source
from planrunner.tasks.write_schemas import suite_schema

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "plans" / "suites").glob("*.yaml"))
VALIDATOR = Draft202012Validator(suite_schema())

FULL = {
    "planrunner_suite": 1,
    "title": "t",
    "zone": "Europe/Berlin",
    "window": {"from": "22:00", "to": "06:00", "days": ["mon"]},
    "budget": "8 h",
    "set": {"operator": "night"},
    "benches": {"a": {"bench": "virtual", "warm_up": "30 min", "stays_warm": "1 h", "window": {"from": "20:00", "to": "23:00"}}},
    "devices": {"FG-1": {"benches": ["a"], "set": {"device_serial": "FG-1"}, "seed": 3}},
    "plans": {
        "one": {"plan": "p.yaml", "matrix": {"fixture": ["x", "y"]}, "parameters": {"dwell": ["1 min", 2]},
            "retries": 2, "retry_on": ["limit"], "retry_after": "1 min"},
        "two": {"plan": "p.yaml", "after": "one", "needs": ["one"], "warm": False, "on_limit": "stop_bench", "interrupted": "retake"},
    },
    "known_failures": [{"tests": "one/*", "until": "2026-12-31", "reason": "r", "of": ["fault"]}],
    "notify": [
        {"webhook": "https://example.org/x", "secret_from": "KEY", "when": "failed"},
        {"email": ["a@example.org"], "from": "b@example.org"},
    ],
}  # fmt: skip
MANY = [str(number) for number in range(100)]
VALUES: tuple[Any, ...] = (None, True, 0, -1, 3, 2.5, "", "x", "25:00", "22:00", "5 min",
    "-5 min", "5 kg", [], ["a"], {}, {"a": 1})  # fmt: skip


def parsed(document: Any) -> tuple[Suite | None, Findings]:
    log = Findings()
    return read_suite(source.parse(json.dumps(document), "s.yaml"), log), log


def places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    entries = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for name, item in entries:
        found += places(item, (*path, name))
    return found


def mutated(draw: random.Random) -> Any:
    document = copy.deepcopy(FULL)
    for _ in range(draw.choice((1, 1, 2, 3))):
        *parents, last = draw.choice(places(document))
        node: Any = document
        for name in parents:
            node = node[name]
        match draw.randrange(3):
            case 0:
                node[last] = draw.choice(VALUES)
            case 1 if isinstance(node, dict):
                node[f"{last}x"] = node.pop(last)
            case _:
                del node[last]
    return document


def test_schema_and_reader_agree_on_mutated_suites() -> None:
    draw, verdicts = random.Random(18), []
    for _ in range(80):
        document = mutated(draw)
        _, log = parsed(document)
        form = [str(finding) for finding in log.items if finding.code.startswith("form-")]
        errors = [error.message for error in VALIDATOR.iter_errors(document)]
        assert bool(form) == bool(errors), f"reader: {form}\nschema: {errors}\n{json.dumps(document)}"
        verdicts.append(bool(errors))
    assert 15 < sum(verdicts) < 78  # of both kinds


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_shipped_suites_pass_the_schema(path: Path) -> None:
    VALIDATOR.validate(source.plain(source.load(path)))


def test_the_reference_of_keys_is_up_to_date() -> None:
    written = (ROOT / "docs" / "suite-keys.md").read_text(encoding="utf-8")
    assert written == suite_reference(), "run `python -m planrunner.night.reference docs`"


def expanded(**keys: Any) -> tuple[list[str], Findings, Any]:
    document = {
        "planrunner_suite": 1,
        "title": "t",
        "benches": {"a": {"bench": "virtual"}, "b": {"bench": "virtual"}},
        **keys,
    }
    suite, log = parsed(document)
    assert suite is not None, [str(item) for item in log]
    tests = expand_suite(suite, Path("lab"), log)
    return [test.name for test in tests], log, tests


def test_plans_devices_benches_and_matrix_are_multiplied() -> None:
    names, log, tests = expanded(
        devices={"D1": {"benches": "a"}, "D2": {}},
        plans={
            "one": {"plan": "x/one.yaml", "matrix": {"p": ["1", "2"], "q": ["u"]}},
            "two": {"plan": "two.yaml", "devices": "D1"},
        },
    )
    assert not log.errors
    assert names == [
        *("one/D1/a/p=1,q=u", "one/D1/a/p=2,q=u"),
        *("one/D2/a/p=1,q=u", "one/D2/a/p=2,q=u", "one/D2/b/p=1,q=u", "one/D2/b/p=2,q=u"),
        "two/D1/a",
    ]
    assert [test.index for test in tests] == list(range(7))
    assert tests[0].file == Path("lab/x/one.yaml")


def test_parameters_are_multiplied_with_the_matrix_and_are_no_information() -> None:
    names, log, tests = expanded(
        benches={"a": {"bench": "virtual"}},
        plans={
            "one": {
                "plan": "p.yaml",
                "matrix": {"m": ["u", "v"]},
                "parameters": {"dwell": ["1 min", "2 min"], "r": "x"},
            }
        },
    )
    assert not log.errors
    assert names == [f"one/a/m={m},dwell={dwell} min,r=x" for m in "uv" for dwell in (1, 2)]
    assert [test.information for test in tests] == [{"m": "u"}, {"m": "u"}, {"m": "v"}, {"m": "v"}]
    assert [test.values for test in tests][1] == {"m": "u", "dwell": "2 min", "r": "x"}
    assert len({test.measurement for test in tests}) == 2  # the matrix changes nothing that is checked


def test_information_of_the_matrix_wins_over_plan_device_and_suite() -> None:
    _, _, (test,) = expanded(
        set={"w": "suite", "x": "suite", "y": "suite", "z": "suite"},
        devices={"D": {"benches": "a", "set": {"x": "device", "y": "device", "z": "device"}}},
        plans={"one": {"plan": "p", "set": {"y": "plan", "z": "plan"}, "matrix": {"z": ["matrix"]}}},
    )
    assert test.information == {"w": "suite", "x": "device", "y": "plan", "z": "matrix"}


def test_a_test_waits_for_the_same_device_on_the_same_bench_where_there_is_one() -> None:
    names, _, tests = expanded(
        devices={"D1": {}, "D2": {"benches": "b"}},
        plans={
            "cal": {"plan": "p"},
            "verify": {"plan": "p", "needs": "cal"},
            "only_b": {"plan": "p", "benches": "b", "devices": "D1"},
            "on_a": {"plan": "p", "benches": "a", "devices": "D1", "after": "only_b"},
            "last": {"plan": "p", "devices": "D2", "after": ["on_a", "cal"]},
        },
    )
    waits = {test.name: {names[other] for other in test.after} for test in tests}
    assert waits["verify/D1/a"] == {"cal/D1/a"}
    assert waits["verify/D1/b"] == {"cal/D1/b"}
    assert waits["on_a/D1/a"] == {"only_b/D1/b"}
    assert waits["last/D2/b"] == {"on_a/D1/a", "cal/D2/b"}
    assert all(set(test.needs) <= set(test.after) for test in tests)


@pytest.mark.parametrize(
    ("keys", "code", "words"),
    [
        ({"plans": {"x": {"plan": "p", "after": "y"}}}, "suite-unknown-plan", "no plan 'y'"),
        ({"plans": {"x": {"plan": "p", "benches": "c"}}}, "suite-unknown-bench", "no bench 'c'"),
        ({"plans": {"x": {"plan": "p", "devices": "D"}}}, "suite-unknown-device", "no device 'D'"),
        ({"plans": {"x": {"plan": "p", "after": "x"}}}, "suite-cycle", "x → x"),
        ({"plans": {"x": {"plan": "p", "matrix": {"m": MANY, "n": MANY[:11]}}}}, "suite-size", "'x' has 1100 combinations"),
        ({"plans": {"x": {"plan": "p", "matrix": {"m": MANY[:40]}, "parameters": {"n": MANY[:30]}}}}, "suite-size", "1200 combinations"),
        ({"plans": {"x": {"plan": "p", "parameters": {f"p{n}": MANY for n in range(30)}}}}, "suite-size", f"{100**30} combinations"),
        ({"plans": {"x": {"plan": "p", "matrix": {"m": ["v", "w", "v"]}}}}, "suite-duplicate", "'v' of 'm' is given twice"),
        ({"plans": {"x": {"plan": "p", "parameters": {"m": ["v", "w", "v"]}}}}, "suite-duplicate", "'v' of 'm' is given twice"),
        ({"plans": {"x": {"plan": "p", "matrix": {"m": ["v"]}, "parameters": {"m": "w"}}}}, "suite-duplicate", "both in `matrix` and"),
        ({"benches": {}, "plans": {"x": {"plan": "p"}}}, "suite-no-bench", "no bench"),
        (
            {"devices": {"D": {"benches": "a"}}, "plans": {"x": {"plan": "p", "benches": "b"}}},
            "suite-no-test",
            "none of its devices",
        ),
        (
            {"plans": {"x": {"plan": "p", "after": "y"}, "y": {"plan": "p", "needs": "z"}, "z": {"plan": "p", "after": ["x"]}}},
            "suite-cycle",
            "x → y → z → x",
        ),
    ],
)  # fmt: skip
def test_wrong_names_and_cycles_are_found(keys: dict[str, Any], code: str, words: str) -> None:
    _, log, _ = expanded(**keys)
    assert words in next(str(item) for item in log.errors if item.code == code)
    assert [item.code for item in log.errors] == [code]


def test_a_long_chain_and_a_diamond_are_no_cycles() -> None:
    chain = {f"p{number}": {"plan": "p", "after": [f"p{number - 1}"] if number else []} for number in range(400)}
    assert not expanded(plans=chain)[1].errors
    diamond = {
        "a": {"plan": "p", "after": ["b", "c"]},
        "b": {"plan": "p", "after": "d"},
        "c": {"plan": "p", "after": "d"},
        "d": {"plan": "p"},
    }
    assert not expanded(plans=diamond)[1].errors


def test_known_failures_have_a_kind_and_a_last_day() -> None:
    suite, log = parsed(
        {**FULL, "known_failures": [{"tests": ["one/FG-1/*", "none/*"], "until": "2026-02-28", "reason": "r"}]}
    )
    assert suite is not None
    entries = suite.known_failures
    assert known_failure("one/FG-1/a/fixture=x", entries, "limit", date(2026, 2, 28)) is entries[0]
    assert known_failure("one/FG-1/a/fixture=x", entries, "limit", date(2026, 3, 1)) is None
    assert known_failure("one/FG-1/a/fixture=x", entries, "fault", date(2026, 2, 28)) is None
    assert known_failure("two/FG-1/a", entries, "limit", date(2026, 2, 28)) is None
    tests = expand_suite(suite, Path(), log)
    check_known_failures(suite, tests, date(2026, 3, 1), log)
    assert sorted(item.code for item in log) == ["suite-expired", "suite-unknown-test"]
