"""The check standard of a bench: limits worked by hand, its states, and what the commands and a suite do with it."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from planrunner.archive.formats import to_bytes
from planrunner.archive.run_reader import RunReader
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings, InputError
from planrunner.base.workers import ALONE
from planrunner.bench.model import Bench, parse_bench, read_bench
from planrunner.night.history.check_standard import ControlStanding, ControlState, ControlTest
from planrunner.night.history.databases import INDEX
from planrunner.plan import source
from planrunner.reporting.history_tables import control_table
from planrunner.signing.envelope import PAYLOAD, parse_envelope
from planrunner.tasks import check_standard
from planrunner.tasks.check_standard import Admission, Override, admit, check_in_control, control_state
from planrunner.tasks.check_suite import check_suite
from tests.in_process import planrunner
from tests.night.history.made_runs import BEGIN, MadeRun, make_run

ROOT = Path(__file__).resolve().parents[3]
VIRTUAL = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
STANDARD = MadeRun(device="CS-01", bench="virtual", plan="standard")


@pytest.fixture(autouse=True)
def own_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(INDEX, str(tmp_path / "index.sqlite"))


def bench_with(**keys: Any) -> Bench:
    rule = {"device": "CS-01", "plan": "standard.yaml", "coefficients": {"drift.bias": {}}, "max_age": "400 d", **keys}
    text = f"{VIRTUAL}check_standard: {json.dumps(rule)}\n"
    bench, log = parse_bench(source.parse(text, "lab.yaml"))
    assert bench is not None and not log.errors, [str(item) for item in log]
    return bench


def archive_of(folder: Path, values: list[float], u: float, **made: Any) -> Path:
    """A run a day."""
    archive = folder / "runs"
    archive.mkdir(exist_ok=True)
    for day, value in enumerate(values):
        make_run(archive, replace(STANDARD, days=day, values={"bias": (value, u)}, **made), day)
    return archive


def state(bench: Bench, archive: Path, days: float = 12.0) -> ControlState:
    found = control_state(bench, archive, now=BEGIN + timedelta(days=days))
    assert found is not None
    return found


# -- limits worked by hand ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("newest", "inside"), [(1.385, True), (1.395, False), (0.615, True), (0.605, False)])
def test_limits_about_a_reference_worked_by_hand(tmp_path: Path, newest: float, inside: bool) -> None:
    """u = 0.12, u_R = 0.04 and repeatability 0.03: σ² = 0.0144 + 0.0016 + 0.0009 = 0.13², so the limits are 1 ± 0.39."""
    about = {"reference": "1.0 deg/h ± 0.04 deg/h", "repeatability": "0.03 deg/h"}
    found = state(bench_with(coefficients={"drift.bias": about}), archive_of(tmp_path, [newest], 0.12))
    (one,) = found.coefficients
    (limits,) = one.limits
    assert (limits.centre, limits.lower, limits.upper) == pytest.approx((1.0, 0.61, 1.39))
    assert found.in_control is inside
    assert one.failed == (() if inside else (ControlTest.REFERENCE,))
    assert inside or f"{newest} deg/h, outside 1 ± 0.39 (reference)" in found.words()


@pytest.mark.parametrize(("newest", "inside"), [(1.63, True), (1.64, False)])
def test_limits_from_earlier_values_worked_by_hand(tmp_path: Path, newest: float, inside: bool) -> None:
    """Ten values 1.0, 1.2, 1.0 … have the mean 1.1 and moving ranges of 0.2: σ = 0.2/1.12838 = 0.177245, so the limits are
    1.1 ± 0.531736. The newest value takes no part: with it the limits would be wider."""
    bench = bench_with(coefficients={"drift.bias": {}}, values=10)
    found = state(bench, archive_of(tmp_path, [1.0, 1.2] * 5 + [newest], 0.0))
    (one,) = found.coefficients
    (limits,) = one.limits
    assert limits.centre == pytest.approx(1.1)
    assert (limits.lower, limits.upper) == pytest.approx((1.1 - 0.531736, 1.1 + 0.531736), abs=1e-6)
    assert found.in_control is inside
    assert one.failed == (() if inside else (ControlTest.SHEWHART,))


def test_each_comparison_is_stated_with_its_own_limits(tmp_path: Path) -> None:
    """Ten values about 1.1 with σ = 0.177245 and a newest one of 1.64: outside the chart (± 0.53), but within 1.5 ± 3·0.2. The Shewhart
    limits do not contain the value, the ones about the reference do: a sentence with one pair of limits would be wrong."""
    about = {"reference": "1.5 deg/h ± 0.2 deg/h"}
    archive = archive_of(tmp_path, [1.0, 1.2] * 5 + [1.64], 0.0)
    found = state(bench_with(coefficients={"drift.bias": about}), archive)
    (one,) = found.coefficients
    assert one.failed == (ControlTest.SHEWHART,)
    half = 3 * math.hypot(0.2, 0.177245)
    assert f"is 1.64 deg/h, within 1.5 ± {half:.2g} (reference), outside 1.1 ± 0.53 (Shewhart)" in found.words()
    document = found.to_json()["coefficients"][0]
    assert [(limits["test"], limits["centre"]) for limits in document["limits"]] == [
        ("reference", pytest.approx(1.5)),
        ("Shewhart", pytest.approx(1.1)),
    ]
    rows = [(row[5], row[-1]) for row in control_table(found).rows]
    assert rows == [("reference", ""), ("Shewhart", "Shewhart")]


def test_a_small_lasting_shift_is_found_by_the_average_and_the_sums(tmp_path: Path) -> None:
    """After ten values about 1.1 with σ = 0.177, eight values of 1.37 (1.5 σ) each lie within the Shewhart limits. By hand: the sum
    grows by 1.523 − 0.5 a value and exceeds 5 with the fifth."""
    bench = bench_with(values=10)
    found = state(bench, archive_of(tmp_path, [1.0, 1.2] * 5 + [1.37] * 8, 0.0), days=18)
    (one,) = found.coefficients
    assert one.failed == (ControlTest.EWMA, ControlTest.CUSUM)
    assert "within 1.1 ± 0.53 (Shewhart), and outside the limits of EWMA and CUSUM" in found.words()
    assert one.charts is not None
    z = 0.27 / (0.2 / (2 / math.sqrt(math.pi)))
    assert np.flatnonzero(one.charts.cusum_up.alarms)[0] == 14
    before = one.charts.cusum_up.statistic[9]
    assert one.charts.cusum_up.statistic[10:15] == pytest.approx([before + (k + 1) * (z - 0.5) for k in range(5)])


# -- states ------------------------------------------------------------------------------------------------------------


def test_states(tmp_path: Path) -> None:
    bench = bench_with(coefficients={"drift.bias": {"reference": "1.0 deg/h"}}, max_age="36 h")
    assert state(bench, tmp_path / "nowhere").standing is ControlStanding.MISSING
    archive = archive_of(tmp_path, [1.1], 0.1)
    assert state(bench, archive, days=1).standing is ControlStanding.IN_CONTROL
    old = state(bench, archive, days=2)
    assert old.standing is ControlStanding.TOO_OLD
    assert old.reasons == ("its newest run is 48 h old, at most 36 h is permitted",)
    make_run(archive, replace(STANDARD, days=2, values={"other": (1.0, 0.1)}), 1)
    silent = state(bench, archive, days=2)
    assert silent.standing is ControlStanding.OUT_OF_CONTROL and "no usable value of drift.bias" in silent.words()
    make_run(archive, replace(STANDARD, days=2.5, finished=False, analysed=False), 2)
    assert state(bench, archive, days=2.6).run == silent.run  # an unfinished run says nothing
    make_run(archive, replace(STANDARD, days=3, limit=(2.0, 3.0)), 3)
    assert "a limit of its own plan failed" in state(bench, archive, days=3).words()


def test_runs_of_other_devices_benches_and_plans_do_not_count(tmp_path: Path) -> None:
    archive = tmp_path / "runs"
    archive.mkdir()
    others = [replace(STANDARD, device="CS-02"), replace(STANDARD, bench="virtual 2"), replace(STANDARD, plan="other")]
    for number, other in enumerate(others):
        make_run(archive, other, number)
    assert state(bench_with(), archive).standing is ControlStanding.MISSING


def test_too_few_values_establish_no_limits_and_a_chart_begins_anew_after_a_change(tmp_path: Path) -> None:
    archive = archive_of(tmp_path, [1.0, 1.2, 1.0, 1.2, 9.0, 9.2, 9.0, 9.2], 0.0)
    few = state(bench_with(values=10), archive)
    assert few.standing is ControlStanding.NOT_ESTABLISHED and "3 more values are needed" in few.words()
    assert state(bench_with(values=4), archive).standing is ControlStanding.OUT_OF_CONTROL
    after = f"{BEGIN + timedelta(days=4):%Y-%m-%d}"
    assert state(bench_with(values=3, since=after), archive).standing is ControlStanding.IN_CONTROL


def test_a_reference_in_another_dimension_is_said(tmp_path: Path) -> None:
    bench = bench_with(coefficients={"drift.bias": {"reference": "1.0 mg"}})
    assert "states mg, but the run gives deg/h" in state(bench, archive_of(tmp_path, [1.0], 0.1)).words()


def test_wrong_rules_are_found_at_their_place() -> None:
    rule = {
        "device": "CS-01",
        "plan": "standard.yaml",
        "coefficients": {"drift.bias": {"reference": "1 deg/h", "repeatability": "1 mg"}},
        "max_age": "1 d",
        "since": "2026-02-30",
    }
    log = parse_bench(source.parse(f"{VIRTUAL}check_standard: {json.dumps(rule)}\n", "lab.yaml"))[1]
    assert sorted(item.code for item in log) == ["meaning-date", "meaning-dimension"]
    empty = {**rule, "coefficients": {}, "since": "2026-02-03"}
    log = parse_bench(source.parse(f"{VIRTUAL}check_standard: {json.dumps(empty)}\n", "lab.yaml"))[1]
    assert [item.code for item in log] == ["meaning-check-standard"]


def test_a_repeatability_in_a_unit_with_an_offset_is_refused_where_it_stands() -> None:
    """0.01 °C read as a temperature would be τ = 273.16 K: no limit would ever be exceeded."""
    for text in ("0.01 degC", "0.01 degF", "0.01 K"):
        rule = {
            "device": "CS-01",
            "plan": "standard.yaml",
            "coefficients": {"drift.bias": {"reference": "25 degC ± 0.1 degC", "repeatability": text}},
            "max_age": "1 d",
        }
        document = json.dumps(rule, ensure_ascii=False)
        log = parse_bench(source.parse(f"{VIRTUAL}check_standard: {document}\n", "lab.yaml"))[1]
        column = len("check_standard: ") + document.index(f'"{text}"') + 1
        assert [str(item.mark) for item in log.errors] == ([] if text == "0.01 K" else [f"lab.yaml:57:{column}"])
        assert all("write it in K" in item.hint for item in log.errors)


def test_a_damaged_run_may_be_the_newest_one_and_admits_nothing(tmp_path: Path) -> None:
    """Somebody changes a byte of the newest run, which is out of control: the run before it was in control and is young enough."""
    bench = bench_with(coefficients={"drift.bias": {"reference": "1.0 deg/h"}}, action="refuse")
    archive = archive_of(tmp_path, [1.0, 5.0], 0.1)
    assert state(bench, archive, days=2).standing is ControlStanding.OUT_OF_CONTROL
    plan = archive / "0001-standard" / "plan.yaml"
    plan.write_bytes(plan.read_bytes() + b"#")
    found = state(bench, archive, days=2)
    assert found.standing is ControlStanding.NOT_DETERMINED
    assert found.reasons == ("the run 0001-standard, one of its runs, is damaged",)
    assert [fault.folder for fault in found.damaged] == ["0001-standard"]
    log = Findings()
    check_in_control(bench, found, log)
    (error,) = log.errors
    assert "restore 0001-standard from a backup" in error.hint and "unreadable" not in error.hint
    shutil.rmtree(archive / "0000-standard")
    assert state(bench, archive, days=2).standing is ControlStanding.MISSING


def test_damaged_runs_of_other_benches_plans_and_devices_do_not_matter(tmp_path: Path) -> None:
    """A byte of the samples, the plan or the results is changed. What the run was is in run.json and bench.yaml, which are as recorded."""
    bench = bench_with(coefficients={"drift.bias": {"reference": "1.0 deg/h"}})
    archive = archive_of(tmp_path, [1.0], 0.1)
    others = [replace(STANDARD, device="D-7"), replace(STANDARD, bench="virtual 2"), replace(STANDARD, plan="other")]
    for number, (other, spoilt) in enumerate(
        zip(others, ("plan.yaml", "journal.jsonl", "analyses/1/results.json"), strict=True), 5
    ):
        file = make_run(archive, replace(other, days=2), number) / spoilt
        file.write_bytes(file.read_bytes()[:-40] + file.read_bytes()[-39:])
    found = state(bench, archive, days=2)
    # The journal of the one on the other bench is torn: nothing says any more which bench it was.
    assert found.standing is ControlStanding.NOT_DETERMINED
    (reason,) = found.reasons
    assert reason == "the folder 0006-standard cannot be read, and may be one of its runs"
    log = Findings()
    check_in_control(bench, found, log)
    (error,) = log.errors
    assert "restore 0006-standard from a backup" in error.hint and "`unreadable: warn`" in error.hint
    lenient = bench_with(coefficients={"drift.bias": {"reference": "1.0 deg/h"}}, unreadable="warn")
    told = state(lenient, archive, days=2)
    assert told.in_control and [fault.folder for fault in told.left_out] == ["0006-standard"]
    log = Findings()
    check_in_control(lenient, told, log)
    assert [item.severity for item in log] == ["warning"] and "0006-standard" in str(next(iter(log)))


def test_the_name_of_the_bench_in_a_changed_file_is_not_believed(tmp_path: Path) -> None:
    """Somebody who would hide a run of the check standard by another bench or device in its files hides nothing."""
    bench = bench_with(coefficients={"drift.bias": {"reference": "1.0 deg/h"}})
    for number, (name, old, new) in enumerate(
        [("bench.yaml", b"name: virtual", b"name: another"), ("run.json", b"CS-01", b"CS-02")]
    ):
        archive = archive_of(tmp_path, [1.0, 5.0], 0.1) if not number else tmp_path / "runs"
        file = archive / "0001-standard" / name
        kept = file.read_bytes()
        assert old in kept
        file.write_bytes(kept.replace(old, new))
        assert state(bench, archive, days=2).standing is ControlStanding.NOT_DETERMINED
        file.write_bytes(kept)


# -- commands ----------------------------------------------------------------------------------------------------------

PLAN = """\
planrunner: 1
title: Drift in eight positions
bench: lab.yaml
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
record: {device_serial: required}
defaults: {temperature: 25 degC, settle: 1 s, dwell: 10 s}
segments:
  - for_each:
      orientation:
        P1: {x: up, y: north, z: west}
        P2: {x: down, y: north, z: east}
        P3: {x: north, y: up, z: east}
        P4: {x: north, y: down, z: west}
        P5: {x: east, y: south, z: down}
        P6: {x: south, y: east, z: up}
        P7: {x: west, y: south, z: up}
        P8: {x: south, y: west, z: down}
estimates:
  drift: {estimator: flexure_gyro_static, segments: P*}
"""


def lab(folder: Path, reference: str = "1.83 deg/h ± 0.1 deg/h", **keys: Any) -> None:
    """A bench with a check standard, the plan that measures it, and another plan."""
    rule = {
        "device": "CS-01",
        "plan": "standard.yaml",
        "coefficients": {"drift.D_X_F": {"reference": reference}},
        "max_age": "1 d",
        "may_override": ["anna"],
        **keys,
    }
    (folder / "lab.yaml").write_text(f"{VIRTUAL}check_standard: {json.dumps(rule)}\n", encoding="utf-8")
    for name in ("standard", "work"):
        (folder / f"{name}.yaml").write_text(PLAN, encoding="utf-8")


def run_json(folder: Path) -> dict[str, Any]:
    newest = max((folder / "runs").glob("2*-work-*"))
    data: dict[str, Any] = json.loads((newest / "run.json").read_text(encoding="utf-8"))
    Draft202012Validator(json.loads((ROOT / "schemas" / "run.schema.json").read_bytes())).validate(data)
    return data


def test_a_bench_whose_check_standard_is_in_control_works_and_the_run_says_so(tmp_path: Path) -> None:
    lab(tmp_path)
    missing = planrunner("check", "work.yaml", cwd=tmp_path)
    assert missing.returncode == 2
    assert "lab.yaml:57:17: error[bench-check-standard]" in missing.stderr
    assert planrunner("check", "standard.yaml", cwd=tmp_path).returncode == 0  # this plan may always run
    refused = planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path)
    assert refused.returncode == 2 and "is missing" in refused.stderr and "may override this" in refused.stderr
    assert not list(tmp_path.glob("runs/2*"))
    # The plan of the check standard with another device measures no check standard.
    other = planrunner("run", "standard.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path)
    assert other.returncode == 2
    measured = planrunner("run", "standard.yaml", "--set", "device_serial=CS-01", "--quiet", cwd=tmp_path)
    assert measured.returncode == 0 and "is in control" in measured.stderr
    assert planrunner("check", "work.yaml", cwd=tmp_path).returncode == 0
    worked = planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path)
    assert worked.returncode == 0, worked.stderr
    kept = run_json(tmp_path)["check_standard"]
    assert kept["standing"] == "in control" and kept["device"] == "CS-01" and "-standard-" in kept["run"]
    assert planrunner("verify", "runs", "--all", cwd=tmp_path).returncode == 0
    shown = planrunner("bench", "check-standard", "lab.yaml", "--json", cwd=tmp_path)
    assert shown.returncode == 0
    schema = json.loads((ROOT / "schemas" / "check-standard.schema.json").read_bytes())
    Draft202012Validator(schema).validate(json.loads(shown.stdout))
    assert "1.83" in planrunner("bench", "check-standard", "lab.yaml", cwd=tmp_path).stdout


def test_a_bench_whose_check_standard_is_out_of_control_refuses_and_an_override_is_kept(tmp_path: Path) -> None:
    lab(tmp_path, "2.9 deg/h ± 0.1 deg/h")  # the gyro has 1.83 deg/h
    measured = planrunner("run", "standard.yaml", "--set", "device_serial=CS-01", "--json", "--quiet", cwd=tmp_path)
    assert measured.returncode == 1 and "out of control" in measured.stderr
    assert json.loads(measured.stdout)["check_standard"]["standing"] == "out of control"
    words = ("run", "work.yaml", "--set", "device_serial=D1", "--quiet")
    refused = planrunner(*words, cwd=tmp_path)
    assert refused.returncode == 2
    assert (
        "lab.yaml:57:17" in refused.stderr
        and "drift.D_X_F is 1." in refused.stderr
        and "outside 2.9 ±" in refused.stderr
    )
    stranger = planrunner(*words, "--override-check-standard", "x", "--override-by", "bob", cwd=tmp_path)
    assert stranger.returncode == 2 and "bench-check-override" in stranger.stderr
    half = planrunner(*words, "--override-check-standard", "x", cwd=tmp_path)
    assert half.returncode == 2 and "belong together" in half.stderr
    let = planrunner(*words, "--override-check-standard", "levelled again", "--override-by", "anna", cwd=tmp_path)
    assert let.returncode == 0 and "anna (name not authenticated) let this run begin: levelled again" in let.stderr
    assert run_json(tmp_path)["check_standard"]["override"] == {"by": "anna", "why": "levelled again"}


def test_a_damaged_run_is_named_and_refuses_plans(tmp_path: Path) -> None:
    lab(tmp_path)
    measured = planrunner("run", "standard.yaml", "--set", "device_serial=CS-01", "--quiet", cwd=tmp_path)
    assert measured.returncode == 0
    (tmp_path / "other").mkdir()
    damaged = make_run(tmp_path / "other", MadeRun()).rename(tmp_path / "runs" / "damaged")
    (damaged / "bench.yaml").write_text("planrunner_bench: 1\nname: another\n", encoding="utf-8")
    shown = planrunner("bench", "check-standard", "lab.yaml", "--json", cwd=tmp_path)
    assert shown.returncode == 4 and "not in the index: damaged: " in shown.stderr
    document = json.loads(shown.stdout)
    schema = json.loads((ROOT / "schemas" / "check-standard.schema.json").read_bytes())
    Draft202012Validator(schema).validate(document)
    assert document["standing"] == "not determined" and [one["folder"] for one in document["damaged"]] == ["damaged"]
    refused = planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path)
    assert refused.returncode == 2 and "the folder damaged cannot be read, and may be one of its runs" in refused.stderr


def test_a_run_whose_index_cannot_be_used_still_gives_its_results(tmp_path: Path) -> None:
    lab(tmp_path)
    (tmp_path / "index").mkdir()
    words = ("run", "standard.yaml", "--set", "device_serial=CS-01", "--json", "--quiet")
    measured = planrunner(*words, cwd=tmp_path, **{INDEX: str(tmp_path / "index")})
    assert measured.returncode == 1
    assert "the state of the check standard cannot be determined" in measured.stderr
    document = json.loads(measured.stdout)
    assert document["check_standard"] is None and document["estimates"]


def test_a_bench_may_only_warn(tmp_path: Path) -> None:
    lab(tmp_path, action="warn")
    done = planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path)
    assert done.returncode == 0 and "warning[bench-check-standard]" in done.stderr
    assert run_json(tmp_path)["check_standard"]["standing"] == "missing"


def test_a_run_is_continued_only_while_the_check_standard_is_in_control(tmp_path: Path) -> None:
    """A run began while the check standard was in control. When a segment of it is to be repeated, its runs are gone."""
    lab(tmp_path)
    words = ("run", "standard.yaml", "--set", "device_serial=CS-01", "--quiet")
    assert planrunner(*words, cwd=tmp_path).returncode == 0
    assert planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path).returncode == 0
    (run,) = (tmp_path / "runs").glob("2*-work-*")
    again = ("resume", run, "--retake", "P1", "--reason", "door", "--quiet")
    standard = next((tmp_path / "runs").glob("2*-standard-*"))
    shutil.move(standard, tmp_path / "aside")
    refused = planrunner(*again, cwd=tmp_path)
    assert refused.returncode == 2 and "is missing" in refused.stderr and "may override" in refused.stderr
    before = (run / "journal.jsonl").read_bytes()
    stranger = planrunner(*again, "--override-check-standard", "x", "--override-by", "bob", cwd=tmp_path)
    assert stranger.returncode == 2 and (run / "journal.jsonl").read_bytes() == before
    let = planrunner(*again, "--override-check-standard", "levelled", "--override-by", "anna", cwd=tmp_path)
    assert let.returncode == 0, let.stderr
    assert "anna (name not authenticated) let this run begin: levelled" in let.stderr
    events = [json.loads(line) for line in (run / "journal.jsonl").read_text(encoding="utf-8").splitlines()]
    (reopened,) = [event for event in events if event["event"] == "reopened"]
    assert (
        reopened["check_standard"]["standing"] == "missing" and reopened["check_standard"]["override"]["by"] == "anna"
    )
    assert planrunner("verify", run, cwd=tmp_path).returncode == 0


def test_an_override_on_a_bench_with_a_key_ring_counts_only_signed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    secret = {"PLANRUNNER_PASSPHRASE": "correct horse battery"}
    for name in ("anna", "bob"):
        assert planrunner("key", "new", f"{name}.pem", cwd=tmp_path, **secret).returncode == 0
        added = planrunner("key", "add", "keys.yaml", name, f"{name}.pem.pub", "--role", "reviewer", cwd=tmp_path)
        assert added.returncode == 0, added.stderr
    lab(tmp_path, may_override=["anna", "carla"])
    file, signed = tmp_path / "lab.yaml", tmp_path / "lab.override.json"
    file.write_text(file.read_text("utf-8") + "approvals: {keys: keys.yaml}\n", encoding="utf-8")
    given = Override("anna", "levelled")

    def admitted() -> Admission:
        return admit(read_bench("lab.yaml", tmp_path)[0], "work", {"device_serial": "D1"}, tmp_path / "runs", given)

    def override(*words: str) -> str:
        done = planrunner("bench", "override", "lab.yaml", *words, cwd=tmp_path, **secret)
        assert done.returncode == 0 or "bench-check-override" in done.stderr, done.stderr
        return done.stderr

    with pytest.raises(InputError, match=r"must be signed by anna, in .*lab\.override\.json: there is none"):
        admitted()
    key = ("--by", "anna.pem", "--until", "2999-12-31")
    assert "may not override" in override("--name", "bob", "--reason", "levelled", *key)
    assert "signed by anna, not by carla" in override("--name", "carla", "--reason", "levelled", *key)
    assert "given until 2020-01-01" in override(
        "--name", "anna", "--reason", "x", "--by", "anna.pem", "--until", "2020-01-01"
    )
    assert not signed.exists()
    assert not override("--name", "anna", "--reason", "levelled", *key)
    found = admitted()
    assert found.record is not None and found.record["override"]["signature"] == json.loads(signed.read_bytes())
    assert "anna let this run begin: levelled" in str(found.findings[0])
    given = Override("anna", "another reason")
    with pytest.raises(InputError, match="it states a different reason: levelled"):
        admitted()
    given = Override("anna", "levelled")
    kept = file.read_text("utf-8")
    file.write_text(kept.replace("1.83 deg/h", "1.93 deg/h"), encoding="utf-8")
    with pytest.raises(InputError, match="for this bench before a change"):
        admitted()
    file.write_text(kept, encoding="utf-8")
    envelope = parse_envelope(signed.read_bytes(), PAYLOAD)
    payload = envelope.payload.replace(b"2999-12-31", b"2999-12-30")
    assert payload != envelope.payload
    signed.write_bytes(replace(envelope, payload=payload).to_bytes())
    with pytest.raises(InputError, match="the signature does not match"):
        admitted()
    signed.write_bytes(b"{}")
    with pytest.raises(InputError, match="it is damaged"):
        admitted()


def test_a_run_keeps_a_signed_override_that_verify_and_resume_examine_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The override of one run is as signed. That of another is changed after it was admitted: its signature does not match."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PLANRUNNER_PASSPHRASE", "correct horse battery")
    own = ("--by", "anna.pem", "--name", "anna")
    lab(tmp_path)
    file = tmp_path / "lab.yaml"
    rule = "approvals: {keys: keys.yaml, author_may_approve: true}\n"
    file.write_text(file.read_text("utf-8") + rule, encoding="utf-8")
    for words in (
        ("key", "new", "anna.pem"),
        ("key", "add", "keys.yaml", "anna", "anna.pem.pub", "--role", "reviewer"),
        ("approve", "work.yaml", *own, "--yes", "--no-predictions"),
        ("bench", "override", "lab.yaml", *own, "--reason", "levelled", "--until", "2999-12-31"),
    ):
        assert planrunner(*words, cwd=tmp_path).returncode == 0
    override = ("--override-by", "anna", "--override-check-standard", "levelled")

    def ran(archive: str) -> Path:
        words = ("run", "work.yaml", "--set", "device_serial=D1", "--quiet", "--runs", archive, *override)
        done = planrunner(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        (run,) = (tmp_path / archive).glob("2*")
        return run

    good = ran("good")
    for further in (
        (),
        override,
    ):  # a night gives the override again; without --bench, the key ring is not sought in the run folder
        again = planrunner("resume", good, "--retake", "P1", "--reason", "door", "--quiet", *further, cwd=tmp_path)
        assert again.returncode == 0, again.stderr
        assert "anna let this run begin: levelled" in again.stderr
    other = ("--override-by", "anna", "--override-check-standard", "another reason")
    refused = planrunner("resume", good, "--retake", "P1", "--reason", "door", "--quiet", *other, cwd=tmp_path)
    assert refused.returncode == 2 and "name the file of the bench with --bench" in refused.stderr
    assert planrunner("verify", good, "--keys", "keys.yaml", cwd=tmp_path).returncode == 0

    true = check_standard.signature_of

    def changed(bench: Bench, given: Override) -> JsonObject | None:
        signed = true(bench, given)
        assert signed is not None
        envelope = parse_envelope(to_bytes(signed), PAYLOAD)
        payload = envelope.payload.replace(b"2999-12-31", b"2999-12-30")
        made: JsonObject = json.loads(replace(envelope, payload=payload).to_bytes())
        return made

    monkeypatch.setattr(check_standard, "signature_of", changed)
    bad = ran("bad")
    monkeypatch.setattr(check_standard, "signature_of", true)
    verified = planrunner("verify", bad, "--keys", "keys.yaml", cwd=tmp_path)
    assert verified.returncode == 4 and "the signature does not match" in verified.stdout + verified.stderr
    refused = planrunner("resume", bad, "--retake", "P1", "--reason", "door", "--quiet", cwd=tmp_path)
    assert refused.returncode == 2 and "the signature does not match" in refused.stderr


def test_a_signature_that_no_key_ring_verifies_is_a_change_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bench has no key ring. A signature would make reports leave out that the name is not authenticated."""
    monkeypatch.setattr(check_standard, "signature_of", lambda *_: {})
    lab(tmp_path)
    override = ("--override-by", "anna", "--override-check-standard", "levelled")
    done = planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", *override, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs").glob("2*-work-*")
    verified = planrunner("verify", run, cwd=tmp_path)
    assert verified.returncode == 4 and "names no key ring" in verified.stdout + verified.stderr


def test_an_override_under_which_a_run_is_continued_is_in_its_report(tmp_path: Path) -> None:
    lab(tmp_path, action="warn")
    assert planrunner("run", "work.yaml", "--set", "device_serial=D1", "--quiet", cwd=tmp_path).returncode == 0
    (run,) = (tmp_path / "runs").glob("2*-work-*")
    assert not [text for text in RunReader.open(run).warnings() if "check standard" in text]
    override = ("--override-by", "anna", "--override-check-standard", "levelled")
    again = planrunner("resume", run, "--retake", "P1", "--reason", "door", "--quiet", *override, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    (text,) = [text for text in RunReader.open(run).warnings() if "check standard" in text]
    assert text.endswith("anna (name not authenticated) let the run continue: levelled.")


# -- nights ------------------------------------------------------------------------------------------------------------


def suite(folder: Path, bench: str) -> Path:
    file = folder / "night.yaml"
    file.write_text(
        "planrunner_suite: 1\ntitle: Night\n"
        f"benches: {{a: {bench}, b: {{bench: virtual}}}}\n"
        "devices:\n"
        "  D1: {benches: a, set: {device_serial: D1}}\n"
        "  D2: {benches: b, set: {device_serial: D2}}\n"
        "plans: {work: {plan: work.yaml}}\n",
        encoding="utf-8",
    )
    return file


@pytest.mark.slow
def test_a_night_measures_the_check_standard_first(tmp_path: Path) -> None:
    """With real runs. What happens if it is not in control: `tests/night/test_night.py`."""
    lab(tmp_path)
    suite(tmp_path, "{bench: ./lab.yaml, check_standard_first: true}")
    checked = planrunner("check", "night.yaml", cwd=tmp_path)
    assert checked.returncode == 0 and "check standard/CS-01/a" in checked.stdout
    done = planrunner("night", "night.yaml", "--flushed", "--json", "--quiet", cwd=tmp_path)
    record = json.loads(done.stdout)
    Draft202012Validator(json.loads((ROOT / "schemas" / "night.schema.json").read_bytes())).validate(record)
    states = {test["test"]: test["state"] for test in record["tests"]}
    assert states == {"check standard/CS-01/a": "passed", "work/D1/a": "passed", "work/D2/b": "passed"}
    (standard,) = record["check_standards"]
    assert standard["state"]["standing"] == "in control"
    (summary,) = (tmp_path / "runs" / "nights").glob("2*/summary.md")
    assert "| a | CS-01 | in control |" in summary.read_text(encoding="utf-8")


def test_a_suite_on_a_bench_that_is_not_in_control_is_refused_unless_it_is_overridden(tmp_path: Path) -> None:
    lab(tmp_path)
    archive = tmp_path / "runs"
    found = check_suite(suite(tmp_path, "{bench: ./lab.yaml}"), workers=ALONE, archive=archive).findings
    assert [item.code for item in found] == ["bench-check-standard"] and found.errors
    override = "{bench: ./lab.yaml, override_check_standard: {by: anna, why: levelled}}"
    assert check_suite(suite(tmp_path, override), workers=ALONE, archive=archive).ok
    wrong = check_suite(suite(tmp_path, override.replace("anna", "ann")), workers=ALONE, archive=archive).findings
    assert [item.code for item in wrong if item.severity == "error"] == ["bench-check-override"]
    none = check_suite(suite(tmp_path, "{bench: virtual, check_standard_first: true}"), workers=ALONE).findings
    assert "suite-check-standard" in [item.code for item in none]


def test_now_is_the_time_of_the_computer(tmp_path: Path) -> None:
    """Runs of 2024 are old today."""
    found = control_state(bench_with(), archive_of(tmp_path, [1.0], 0.1))
    assert found is not None and found.standing is ControlStanding.TOO_OLD
