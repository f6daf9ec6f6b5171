"""Approvals from the reviewer to the auditor: what a bench refuses, what keeps an approval, and what a run folder proves afterwards."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from datetime import date, timedelta
from io import FileIO
from pathlib import Path
from typing import NoReturn

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from jsonschema import Draft202012Validator

from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.storage import Storage
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.bench.model import read_bench
from planrunner.execution.stopping import StopRequest
from planrunner.review.approval_files import KeptApprovals, approvals_folder, kept_approvals, read_approvals
from planrunner.review.approvals import (
    DamagedApproval,
    StatedApproval,
    StatedWithdrawal,
    approval_envelope,
    read_stated,
)
from planrunner.signing.key_ring import entry_text, read_ring
from planrunner.signing.keys import PrivateKey, write_private
from planrunner.tasks import run as running
from planrunner.tasks.approve import approve, prepare, withdraw
from planrunner.tasks.check import Checked, Document, check_plan
from planrunner.tasks.estimate import analyse_run
from planrunner.tasks.simulate import simulation
from planrunner.tasks.verify import verify_run
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]
HERE = Path()
WORDS = "correct horse battery"
PLAN = """\
planrunner: 1
title: Two rates
author: carla
bench: lab.yaml
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
record: {device_serial: optional}
defaults: {settle: 1 s, dwell: 5 s}
segments:
  - for_each:
      orientation:
        P1: {x: up, y: north}
        P2: {x: down, y: north}
report: [summary.md]
"""
RULE = "approvals: {keys: lab-keys.yaml, required: 2, roles: [reviewer]}\n"


def key_of(number: int) -> PrivateKey:
    return PrivateKey(Ed25519PrivateKey.from_private_bytes(bytes([number]) * 32))


ANNA, BEN, CARLA, EVE = (key_of(number) for number in range(1, 5))


def write_ring(folder: Path, **lines: str) -> None:
    """The key ring, with more lines in the entries of these names."""
    text = "planrunner_keys: 1\nkeys:\n"
    for name, key, roles in (("anna", ANNA, ("reviewer",)), ("ben", BEN, ("reviewer",)), ("carla", CARLA, ())):
        text += entry_text(name, key.public, roles, None) + lines.get(name, "")
    (folder / "lab-keys.yaml").write_text(text)


def write_lab(folder: Path) -> Path:
    """A plan, its bench, and the key ring that the bench names."""
    folder.mkdir(exist_ok=True)
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    (folder / "lab.yaml").write_text(bench + RULE)
    write_ring(folder)
    (folder / "plan.yaml").write_text(PLAN)
    return folder / "plan.yaml"


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return write_lab(tmp_path / "lab")


def approved(plan: Path, *keys: PrivateKey, until: date | None = None) -> Path:
    for key in keys or (ANNA, BEN):
        approve(prepare(plan, until=until, foresee=False), key, {ANNA: "Anna", BEN: "Ben"}[key])
    return plan


def codes(checked: Checked) -> set[str]:
    return {finding.code for finding in checked.findings if finding.code.startswith("approval")}


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def ran(plan: Path, runs: Path) -> Path:
    run, outcome = running.start(check_plan(plan).sound(), info={}, runs=runs, stop=StopRequest(), durability="flushed")
    assert outcome.ok
    return run


# -- before a run ----------------------------------------------------------------------------------------------------


def test_the_bench_refuses_a_plan_until_two_reviewers_approved_it(plan: Path) -> None:
    lines = (plan.parent / "lab.yaml").read_text().splitlines()
    for keys, message in (((), "there is none"), ((ANNA,), "only the approval by anna counts")):
        if keys:
            approved(plan, *keys)
        checked = check_plan(plan)
        (error,) = checked.findings.errors
        assert (error.code, error.mark.file, error.mark.line) == (
            "approval-missing",
            str(plan.parent / "lab.yaml"),
            1 + lines.index(RULE.strip()),
        )
        assert message in error.message
        assert not checked.ok
        with pytest.raises(InputError, match="approval-missing"):
            checked.sound()
    approved(plan, BEN)
    assert check_plan(plan).ok
    kept = check_plan(plan).sound().approvals
    assert kept is not None and [one.name for one in kept.approvals] == ["Anna", "Ben"]


def _days(number: int) -> date:
    return date.today() + timedelta(days=number)


def _listed_by_the_bench(plan: Path) -> None:
    replaced(plan.parent / "lab.yaml", "roles: [reviewer]", f"roles: [reviewer], withdrawn: [{newest(plan).digest}]")


def newest(plan: Path) -> StatedApproval:
    found = [one for one in read_approvals(approvals_folder(plan)) if isinstance(one, StatedApproval)]
    return max(found, key=lambda one: one.signed)


def _flip(plan: Path) -> None:
    path = approvals_folder(plan) / newest(plan).file
    data = path.read_bytes()
    path.write_bytes(
        data.replace(b'"sig": "A', b'"sig": "B') if b'"sig": "A' in data else data.replace(b'"sig": "', b'"sig": "A')
    )


CHANGES: dict[str, Callable[[Path], object]] = {
    "approval-other-plan": lambda plan: replaced(plan, "dwell: 5 s", "dwell: 6 s"),
    "approval-other-bench": lambda plan: replaced(plan.parent / "lab.yaml", "seed: ", "seed: 1"),
    "approval-other-author": lambda plan: replaced(plan, "author: carla", "author: anna"),
    "approval-key-revoked": lambda plan: write_ring(plan.parent, anna='    revoked: "2026-01-01"\n'),
    "approval-key-dates": lambda plan: write_ring(plan.parent, anna='    until: "2026-01-01"\n'),
    "approval-unknown-key": lambda plan: replaced(plan.parent / "lab-keys.yaml", ANNA.public.line, EVE.public.line),
    "approval-role": lambda plan: replaced(plan.parent / "lab.yaml", "roles: [reviewer]", "roles: [head]"),
    "approval-not-named": lambda plan: replaced(plan.parent / "lab.yaml", "roles:", "by: [anna, carla], roles:"),
    "approval-withdrawn": lambda plan: withdraw(plan, ANNA, "Anna", "a mistake"),
    "approval-by-author": lambda plan: replaced(
        plan.parent / "lab-keys.yaml", "  carla:\n", "  carla:\n    person: ben\n"
    ),
    "approval-same-person": lambda plan: replaced(
        plan.parent / "lab-keys.yaml", "  ben:\n", "  ben:\n    person: anna\n"
    ),
    "approval-damaged": _flip,
}


@pytest.mark.parametrize("code", CHANGES)
def test_every_reason_is_a_finding(plan: Path, code: str) -> None:
    approved(plan)
    assert check_plan(plan).ok
    CHANGES[code](plan)
    checked = check_plan(plan)
    assert not checked.ok
    assert codes(checked) == {"approval-missing", code}


def test_an_approval_that_the_bench_withdrew(plan: Path) -> None:
    _listed_by_the_bench(approved(plan))
    assert codes(check_plan(plan)) == {"approval-missing", "approval-withdrawn"}


def test_an_approval_expires(plan: Path) -> None:
    approved(plan, until=_days(3))
    assert check_plan(plan, today=_days(3)).ok
    assert codes(check_plan(plan, today=_days(4))) == {"approval-missing", "approval-expired"}
    assert codes(check_plan(plan, today=_days(-2))) == {"approval-missing", "approval-future"}
    with pytest.raises(InputError, match="approval-until"):
        prepare(plan, until=_days(-1))


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("author: carla\n", "", "approval-author-unknown"),
        ("author: carla\n", "author: dora\n", "approval-author-unknown"),
    ],
)
def test_an_author_who_cannot_be_determined(plan: Path, old: str, new: str, code: str) -> None:
    replaced(plan, old, new)
    approved(plan)
    assert code in codes(check_plan(plan))
    assert not check_plan(plan).ok


def test_a_ring_that_cannot_be_read_refuses_everything(plan: Path) -> None:
    approved(plan)
    replaced(plan.parent / "lab.yaml", "roles: [reviewer]", "by: [anna, bne]")
    assert codes(check_plan(plan)) == {"approval-person"}
    (plan.parent / "lab-keys.yaml").write_text("planrunner_keys: 1\nkeys: {anna: {}}\n")
    assert codes(check_plan(plan)) == {"approval-ring"}
    (plan.parent / "lab-keys.yaml").unlink()
    assert codes(check_plan(plan)) == {"approval-ring"}


@pytest.mark.parametrize("keys", ["../lab-keys.yaml", "/etc/lab-keys.yaml", "a/../../k.yaml", ".keys", "a//k", "C:k"])
def test_a_bench_names_no_key_ring_outside_its_folder(plan: Path, keys: str) -> None:
    replaced(plan.parent / "lab.yaml", "keys: lab-keys.yaml", f"keys: '{keys}'")
    assert not check_plan(plan).ok
    assert check_plan(plan).bench is None


def test_the_message_says_what_differs(plan: Path) -> None:
    approved(plan)
    replaced(plan, "dwell: 5 s", "dwell: 6 s")
    notes = [item.message for item in check_plan(plan).findings if item.code == "approval-other-plan"]
    assert len(notes) == 2
    assert all("2 segments changed" in note for note in notes)
    for path in approvals_folder(plan).glob("*.yaml"):  # another plan in place of the approved one proves nothing
        path.write_text(PLAN.replace("5 s", "7 s"))
    notes = [item.message for item in check_plan(plan).findings if item.code == "approval-other-plan"]
    assert all("cannot be restored" in note for note in notes)


def test_a_rule_may_change_without_a_new_approval(plan: Path) -> None:
    approved(plan, ANNA)
    replaced(plan.parent / "lab.yaml", "required: 2", "required: 1")
    assert check_plan(plan).ok


def test_run_information_is_not_part_of_the_meaning_and_cannot_change_it(plan: Path) -> None:
    write_private(plan.parent / "anna.pem", ANNA, WORDS.encode())
    write_private(plan.parent / "ben.pem", BEN, WORDS.encode())
    for name in ("anna", "ben"):
        asked = ["approve", "plan.yaml", "--by", f"{name}.pem", "--name", name, "--yes", "--json"]
        done = planrunner(*asked, cwd=plan.parent, PLANRUNNER_PASSPHRASE=WORDS)
        assert done.returncode == 0, done.stderr
        schema = json.loads((ROOT / "schemas" / "approval.schema.json").read_text())
        Draft202012Validator(schema).validate(json.loads(done.stdout))
    quiet = ("--flushed", "--quiet")
    assert planrunner("run", "plan.yaml", "--set", "device_serial=X", *quiet, cwd=plan.parent).returncode == 0
    other = planrunner("run", "plan.yaml", "--set", "dwell=9 s", *quiet, cwd=plan.parent)
    assert other.returncode == 2 and "run-info-unknown" in other.stderr
    elsewhere = planrunner("run", "plan.yaml", "--bench", "lab.yaml", *quiet, cwd=plan.parent)
    assert elsewhere.returncode == 0
    replaced(plan.parent / "lab.yaml", "seed: ", "seed: 1")
    elsewhere = planrunner("run", "plan.yaml", "--bench", "lab.yaml", *quiet, cwd=plan.parent)
    assert elsewhere.returncode == 2 and "approval-other-bench" in elsewhere.stderr
    assert len(list((plan.parent / "runs").iterdir())) == 2


# -- by meaning --------------------------------------------------------------------------------------------------------

SPELLINGS = [
    ("dwell: 5 s", "dwell: 5000 ms"),
    ("title: Two rates\n", "# a comment\ntitle: 'Another title'\ndescription: words\n"),
    ("{settle: 1 s, dwell: 5 s}", "\n  dwell: 5.0 s\n  settle: 1 s"),
    ("{x: up, y: north}", "{y: north, z: west}"),
    (
        "  - for_each:\n      orientation:\n        P1: {x: up, y: north}\n        P2: {x: down, y: north}\n",
        "  - {label: P1, orientation: {x: up, y: north}}\n  - {label: P2, orientation: {x: down, y: north}}\n",
    ),
    ("report: [summary.md]", "report:\n- summary.md"),
]


@pytest.mark.parametrize(("old", "new"), SPELLINGS)
def test_another_spelling_keeps_the_approval(plan: Path, old: str, new: str) -> None:
    replaced(approved(plan), old, new)
    assert check_plan(plan).ok, [str(item) for item in check_plan(plan).findings]


MUTATIONS = [
    ("settle: 1 s", "settle: 2 s"),
    ("dwell: 5 s", "dwell: 5.001 s"),
    ("x: up", "x: down"),
    ("P1", "P3"),
    ("report: [summary.md]", "report: [report.html]"),
    ("device_serial: optional", "device_serial: required"),
    ("[torquer_x, torquer_y]", "[torquer_y, torquer_x]"),
    ("        P2: {x: down, y: north}\n", ""),
    ("report:", "diagnosis: {nominal: [gyro_bias]}\nreport:"),
    ("report:", "estimates: {s: {estimator: allan_deviation, segments: P1}}\nreport:"),
]


@pytest.mark.parametrize(("old", "new"), MUTATIONS)
def test_any_change_of_meaning_loses_it(plan: Path, old: str, new: str) -> None:
    approved(plan)
    replaced(plan, old, new)
    checked = check_plan(plan)
    assert not checked.ok
    assert "approval-other-plan" in codes(checked) or checked.findings.errors[0].code.startswith(("physics", "meaning"))


# -- running -----------------------------------------------------------------------------------------------------------


def test_every_run_is_refused_however_its_plan_was_checked(plan: Path) -> None:
    approved(plan)
    sound = check_plan(Document(plan.read_bytes(), str(plan))).sound()
    with pytest.raises(InputError, match="approval-missing"):
        running.start(sound, info={}, runs=plan.parent / "runs", stop=StopRequest())
    assert not (plan.parent / "runs").exists()


def test_a_simulation_with_effects_is_not_what_was_approved(plan: Path) -> None:
    bench = (ROOT / "plans" / "benches" / "virtual_mems.yaml").read_text(encoding="utf-8")
    (plan.parent / "imu.yaml").write_text(bench + RULE)
    imu = Path(shutil.copy(ROOT / "plans" / "imu_multi_position.yaml", plan.parent / "imu-plan.yaml"))
    replaced(imu, "title:", "author: carla\ntitle:")
    with pytest.raises(InputError, match="approval-missing"):
        simulation(imu, str(plan.parent / "imu.yaml"), ["gyro_warm_up"])
    for key in (ANNA, BEN):
        approve(prepare(imu, [str(plan.parent / "imu.yaml")], foresee=False), key, "R")
    assert simulation(imu, str(plan.parent / "imu.yaml"), []).sound.approvals is not None
    with pytest.raises(InputError, match="approval-other-bench"):
        simulation(imu, str(plan.parent / "imu.yaml"), ["gyro_warm_up"])


def interrupted(plan: Path) -> Path:
    """A run that stops after its first segment."""
    stop = StopRequest()
    stop.request()
    run, outcome = running.start(check_plan(plan).sound(), info={}, runs=plan.parent / "runs", stop=stop)
    assert not outcome.ok
    return run


def test_a_run_goes_on_under_the_approvals_with_which_it_began(plan: Path) -> None:
    run = interrupted(approved(plan))
    assert running.resume(run, stop=StopRequest()).ok
    assert not verify_run(run, read_ring(plan.parent / "lab-keys.yaml")).changes


STOPS: dict[str, Callable[[Path], object]] = {
    "approval-key-revoked": CHANGES["approval-key-revoked"],
    "approval-unknown-key": CHANGES["approval-unknown-key"],
    "approval-withdrawn": CHANGES["approval-withdrawn"],
    "approval-ring": lambda plan: (plan.parent / "lab-keys.yaml").unlink(),
}


@pytest.mark.parametrize("code", STOPS)
def test_a_run_does_not_go_on_when_an_approval_counts_no_more(plan: Path, code: str) -> None:
    run = interrupted(approved(plan))
    STOPS[code](plan)
    with pytest.raises(InputError) as refused:
        running.resume(run, stop=StopRequest())
    assert code in {finding.code for finding in refused.value.findings}
    assert len(RunReader.open(run).acknowledged()) < 2


def test_a_run_goes_on_under_further_approvals(plan: Path) -> None:
    run = interrupted(approved(plan))
    ring = plan.parent / "lab-keys.yaml"
    write_ring(plan.parent, anna='    revoked: "2026-01-01"\n')
    with pytest.raises(InputError) as refused:
        running.resume(run, stop=StopRequest())
    assert "--approvals PLAN" in refused.value.findings[0].hint
    ring.write_text(ring.read_text() + entry_text("eve", EVE.public, ("reviewer",), None))
    with pytest.raises(InputError, match="approval-key-revoked"):
        running.resume(run, stop=StopRequest(), approvals=plan)
    approve(prepare(plan, foresee=False), EVE, "Eve")
    with pytest.raises(InputError, match="approval-missing"):
        running.resume(run, stop=StopRequest())
    words = ("resume", run, "--approvals", plan, "--quiet")
    assert planrunner(*words, cwd=plan.parent).returncode == 0
    found = verify_run(run, read_ring(ring))
    assert not found.changes
    assert [(one.judged.standing, one.judged.person) for one in found.approvals] == [
        ("revoked", "anna"),
        ("counts", "ben"),
        ("counts", "eve"),
    ]
    assert "Eve" in (run / "analyses" / "1" / "summary.md").read_text()
    write_ring(plan.parent)  # without Eve
    codes_found = {finding.code for _, finding in verify_run(run, read_ring(ring)).changes}
    assert codes_found == {"run-approval"}


def test_further_approvals_of_another_plan_or_by_nobody_known_do_not_count(plan: Path) -> None:
    run = interrupted(approved(plan))
    withdraw(plan, ANNA, "Anna", "a mistake")
    other = Path(shutil.copy(plan, plan.with_name("other.yaml")))
    replaced(other, "dwell: 5 s", "dwell: 6 s")
    approved(other)
    with pytest.raises(InputError, match="approval-other-plan"):
        running.resume(run, stop=StopRequest(), approvals=other)
    approve(prepare(plan, foresee=False), EVE, "Eve")
    with pytest.raises(InputError, match="approval-unknown-key"):
        running.resume(run, stop=StopRequest(), approvals=plan)


def test_the_run_folder_names_no_folder_of_the_computer(plan: Path) -> None:
    run = interrupted(approved(plan))
    text = (run / "approvals.json").read_text()
    assert json.loads(text)["found_in"] == {"keys": "../lab-keys.yaml", "approvals": "../plan.yaml.approvals"}
    assert str(plan.parent) not in text
    plan.parent.rename(plan.parent.with_name("moved"))
    moved = plan.parent.with_name("moved")
    assert running.resume(moved / "runs" / run.name, stop=StopRequest()).ok


# -- afterwards --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run under two approvals, one of them by a person with a hostile name."""
    plan = write_lab(tmp_path_factory.mktemp("lab"))
    approve(prepare(plan, foresee=False), ANNA, "<script>alert(1)</script>")
    approve(prepare(plan, until=_days(30), foresee=False), BEN, "../../Ben {{ 7*7 }} |x| `y`")
    run = ran(plan, plan.parent / "runs")
    analyse_run(run)
    return plan.parent


def run_of(lab: Path, folder: Path) -> Path:
    (run,) = (lab / "runs").iterdir()
    return Path(shutil.copytree(run, folder / run.name))


def test_a_run_keeps_its_approvals_and_they_are_verified(lab: Path, tmp_path: Path) -> None:
    run = run_of(lab, tmp_path)
    found = verify_run(run, read_ring(lab / "lab-keys.yaml"))
    assert found.changes == ()
    assert [(one.judged.standing, one.judged.person, one.verified) for one in found.approvals] == [
        ("counts", "anna", True),
        ("counts", "ben", True),
    ]
    assert [one.verified for one in verify_run(run).approvals] == [False, False]
    seal = json.loads((run / "seal.json").read_text())
    assert "approvals.json" in seal["files"]
    schema = json.loads((ROOT / "schemas" / "approvals.schema.json").read_text())
    Draft202012Validator(schema).validate(json.loads((run / "approvals.json").read_text()))
    schema = json.loads((ROOT / "schemas" / "verification.schema.json").read_text())
    Draft202012Validator(schema).validate({"run": "r", "exit_code": 0, **found.to_json()})


def test_reports_print_the_approvals_and_hostile_names_as_text(lab: Path, tmp_path: Path) -> None:
    run = run_of(lab, tmp_path)
    for command in (["report", run, "report.html", "summary.md"], ["review", run, "--html", "r.html"]):
        done = planrunner(*command, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    pages = [tmp_path / "r.html", *sorted((run / "analyses" / "2").glob("report.html"))]
    assert len(pages) == 2
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert "Plan approved by" in text and ANNA.public.fingerprint in text
        assert "<script>alert" not in text and "&lt;script&gt;alert(1)" in text
        assert "{{ 7*7 }}" in text
    summary = (run / "analyses" / "2" / "summary.md").read_text(encoding="utf-8")
    assert "Ben" in summary and "<script>" not in summary
    done = planrunner("verify", run, "--keys", lab / "lab-keys.yaml", cwd=tmp_path)
    assert done.returncode == 0 and "key of ben" in done.stdout
    names = {path.name for path in approvals_folder(lab / "plan.yaml").iterdir()}
    assert all(re.fullmatch(r"[0-9]{8}T[0-9]{6}Z-[0-9a-f]{16}(\.dsse\.json|\.yaml)", name) for name in names)


@pytest.mark.parametrize("name", ["", "  ", "Anna\x1b[31m", "Anna\nBen", "\u202eannA", "A" * 201, "\ud800"])
def test_a_name_that_cannot_be_printed_is_not_signed(plan: Path, name: str) -> None:
    with pytest.raises(InputError, match="sign-text"):
        approve(prepare(plan, foresee=False), ANNA, name)
    assert not approvals_folder(plan).exists()


def test_a_key_that_is_revoked_or_unknown_later_is_reported(lab: Path, tmp_path: Path) -> None:
    run = run_of(lab, tmp_path)
    for line, old, new in (('    revoked: "2099-01-01"\n', "", ""), ("", ANNA.public.line, EVE.public.line)):
        write_ring(tmp_path, anna=line)
        replaced(tmp_path / "lab-keys.yaml", old, new) if old else None
        found = verify_run(run, read_ring(tmp_path / "lab-keys.yaml"))
        assert [(change, finding.code) for change, finding in found.changes] == [("altered", "run-approval")]


def amended(run: Path, plan: Path, folder: Path) -> str:
    """An amendment of the run by a plan; returns its text report."""
    words = ("amend", run, "--plan", plan, "--why", "a new drawing", "--by", "Q")
    done = planrunner(*words, cwd=folder)
    assert done.returncode == 0, done.stderr
    newest = max((run / "analyses").iterdir(), key=lambda path: int(path.name))
    return (newest / "summary.md").read_text()


def test_an_amendment_says_whether_its_evaluation_was_approved(lab: Path, tmp_path: Path) -> None:
    run = run_of(lab, tmp_path)
    shutil.copy(lab / "lab.yaml", tmp_path)
    ring = read_ring(Path(shutil.copy(lab / "lab-keys.yaml", tmp_path)))
    other = tmp_path / "other.yaml"
    other.write_text(
        (run / "plan.yaml").read_text().replace("report: [summary.md]", "report: [summary.md, report.html]")
    )
    assert "its plan was NOT approved" in amended(run, other, tmp_path)
    approved(other, ANNA)
    assert "its plan was NOT approved" in amended(run, other, tmp_path)  # one of two persons
    approved(other, BEN)
    assert "its plan was approved" in amended(run, other, tmp_path)
    assert planrunner("estimate", run, cwd=tmp_path).returncode == 0
    found = verify_run(run, ring)
    assert not found.changes
    covered = [(one.analysis, one.covered) for one in found.evaluations]
    assert covered == [(1, True), (2, False), (3, False), (4, True), (5, True)]
    assert [one.code for one in found.remarks].count("run-evaluation-unapproved") == 2
    done = planrunner("review", run, "--analysis", "2", "--json", cwd=tmp_path)
    deviations = json.loads(done.stdout)["deviations"]
    assert [one["grave"] for one in deviations if one["kind"] == "not approved"] == [True]
    write_ring(tmp_path, ben='    revoked: "2026-01-01"\n')
    changes = verify_run(run, read_ring(tmp_path / "lab-keys.yaml")).changes
    assert any("analyses/4" in finding.message for _, finding in changes)


def made_up(
    lab: Path, folder: Path, change: Callable[[KeptApprovals], bytes | None], plan: bytes | None = None
) -> Path:
    """A run folder that was written anew with other approvals, so that all digests and chains in it are right."""
    run = run_of(lab, folder)
    kept, _ = kept_approvals((run / "approvals.json").read_bytes(), run)
    given = plan or (run / "plan.yaml").read_bytes(), (run / "bench.yaml").read_bytes()
    with RunWriter.create(folder / "forged", "p", *given, {}, "flushed", approvals=change(kept)) as writer:
        writer.finish()
    return writer.path


def _by_eve(kept: KeptApprovals) -> bytes:
    """Approvals by a stranger, with a key ring in which the stranger is everybody."""
    text = "planrunner_keys: 1\nkeys:\n"
    forged = []
    for number, name in enumerate(("anna", "ben")):
        key = key_of(50 + number)
        text += entry_text(name, key.public, ("reviewer",), None)
        made = approval_envelope(
            kept.approvals[number].what, name, "yes", key, kept.approvals[number].signed.isoformat()
        )
        stated = read_stated(kept.approvals[number].file, made.to_bytes())
        assert isinstance(stated, StatedApproval)
        forged.append(stated)
    text += entry_text("carla", CARLA.public, (), None)
    return replace(kept, ring=text, approvals=tuple(forged)).to_bytes(HERE)


FORGERIES: dict[str, Callable[[KeptApprovals], bytes | None]] = {
    "none": lambda kept: None,
    "one less": lambda kept: replace(kept, approvals=kept.approvals[:1]).to_bytes(HERE),
    "one twice": lambda kept: replace(kept, approvals=kept.approvals[:1] * 2).to_bytes(HERE),
    "by a stranger": _by_eve,
    "another day": lambda kept: replace(kept, day=kept.day + timedelta(days=40)).to_bytes(HERE),
    "another meaning": lambda kept: replace(kept, plan=kept.plan.replace("P1", "P7")).to_bytes(HERE),
    "another bench": lambda kept: replace(kept, bench=kept.bench.replace("virtual", "other")).to_bytes(HERE),
    "not a date": lambda kept: kept.to_bytes(HERE).replace(kept.day.isoformat().encode(), b"2026-02-31"),
    "no ring": lambda kept: replace(kept, ring="").to_bytes(HERE),
    "not JSON": lambda kept: b"{",
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_run_that_was_written_anew_is_found(lab: Path, tmp_path: Path, name: str) -> None:
    """Even if every digest in it is right: the auditor has the key ring of the laboratory."""
    forged = made_up(lab, tmp_path, FORGERIES[name])
    ring = read_ring(lab / "lab-keys.yaml")
    found = verify_run(forged, ring)
    if name == "no ring":  # only its own copy is missing; that of the auditor is used
        assert not found.changes
        found = verify_run(forged)
    assert {finding.code for _, finding in found.changes} == {"run-approval"}, found.changes


def test_the_approvals_of_another_plan_are_found(lab: Path, tmp_path: Path) -> None:
    ring = read_ring(lab / "lab-keys.yaml")
    whole = made_up(lab, tmp_path, lambda kept: kept.to_bytes(HERE))
    assert verify_run(whole, ring).changes == ()
    (tmp_path / "other").mkdir()
    forged = made_up(lab, tmp_path / "other", lambda kept: kept.to_bytes(HERE), PLAN.replace("5 s", "50 s").encode())
    assert {finding.code for _, finding in verify_run(forged, ring).changes} == {"run-approval"}


def test_a_changed_or_removed_file_of_approvals_is_found(lab: Path, tmp_path: Path) -> None:
    run = run_of(lab, tmp_path)
    data = (run / "approvals.json").read_bytes()
    (run / "approvals.json").write_bytes(data.replace(b"A", b"B", 1))
    assert {finding.code for _, finding in verify_run(run).changes} >= {"run-changed"}
    (run / "approvals.json").unlink()
    assert "run-file-missing" in {finding.code for _, finding in verify_run(run).changes}


def test_approvals_in_a_run_that_needed_none_are_found(lab: Path, tmp_path: Path) -> None:
    with RunWriter.create(tmp_path, "p", PLAN.encode(), b"planrunner_bench: 1\n", {}, "flushed") as writer:
        writer.finish()
    shutil.copy(run_of(lab, tmp_path / "x") / "approvals.json", writer.path)
    assert {finding.code for _, finding in verify_run(writer.path).changes} == {"run-unknown-file"}


def test_a_certificate_prints_the_approvals(lab: Path, tmp_path: Path) -> None:
    from planrunner.tasks.certify import facts
    from planrunner.tasks.estimate import sound_run

    reader = RunReader.open(run_of(lab, tmp_path))
    shown = facts(reader, sound_run(reader), (), {})
    assert len(shown.approvals) == 2 and BEN.public.fingerprint in shown.approvals[1]


# -- crashes -----------------------------------------------------------------------------------------------------------

OPERATIONS = ("make_folder", "open_new", "write", "sync", "sync_folder", "replace")


class Killed(Storage):
    """Kills the process at the n-th operation; a write then leaves half of its data."""

    def __init__(self, number: int):
        super().__init__("durable")
        self.number = number

    def _count(self) -> bool:
        self.number -= 1
        return self.number < 0

    def make_folder(self, folder: GuardedFolder, name: str) -> GuardedFolder:
        return self._killed() if self._count() else super().make_folder(folder, name)

    def open_new(self, folder: GuardedFolder, name: str) -> FileIO:
        return self._killed() if self._count() else super().open_new(folder, name)

    def write(self, file: FileIO, data: bytes | memoryview) -> None:
        if self._count():
            super().write(file, data[: len(data) // 2])
            self._killed()
        super().write(file, data)

    def sync(self, file: FileIO) -> None:
        self._killed() if self._count() else super().sync(file)

    def sync_folder(self, folder: GuardedFolder) -> None:
        self._killed() if self._count() else super().sync_folder(folder)

    def replace(self, folder: GuardedFolder, source: str, target: str) -> None:
        self._killed() if self._count() else super().replace(folder, source, target)

    def _killed(self) -> NoReturn:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("what", ["approval", "withdrawal"])
def test_a_kill_between_any_two_writes_leaves_nothing_damaged(plan: Path, what: str) -> None:
    """A process is killed (SIGKILL) at each operation on the disk in turn, with the approvals of the kills before it beside it."""
    approved(plan, ANNA)
    prepared = prepare(plan, foresee=False)

    def act(storage: Storage) -> None:
        if what == "approval":
            approve(prepared, BEN, "Ben", storage=storage)
        else:
            withdraw(plan, ANNA, "Anna", "a mistake", storage)

    killed = 0
    while True:
        before = read_approvals(approvals_folder(plan))
        child = os.fork()
        if child == 0:
            try:
                act(Killed(killed))
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        after = read_approvals(approvals_folder(plan))
        assert not any(isinstance(one, DamagedApproval) for one in after)
        assert len(after) - len(before) in (0, 1)
        assert set(before) <= set(after)
        if not os.WIFSIGNALED(status):
            assert len(after) == len(before) + 1
            break
        killed += 1
        if what == "withdrawal" and len(after) > len(
            before
        ):  # it was complete: the next one would have nothing to withdraw
            withdrawn = [one for one in after if isinstance(one, StatedWithdrawal)]
            for one in withdrawn:
                (approvals_folder(plan) / one.file).unlink()
    assert killed >= (8 if what == "approval" else 4)


def test_a_full_disk_leaves_nothing(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Storage, file: FileIO, data: bytes | memoryview) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Storage, "write", full)
    with pytest.raises(InputError, match="approval-folder"):
        approve(prepare(plan, foresee=False), ANNA, "Anna")
    assert list(approvals_folder(plan).iterdir()) == []


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_shows_what_is_approved_and_asks(plan: Path) -> None:
    folder = plan.parent
    write_private(folder / "anna.pem", ANNA, WORDS.encode())
    asked = ["approve", "plan.yaml", "--by", "anna.pem", "--name", "Anna Example"]
    done = planrunner(*asked, cwd=folder, PLANRUNNER_PASSPHRASE=WORDS)
    assert done.returncode == 2 and "approval-unconfirmed" in done.stderr
    assert "Two rates" in done.stderr and "No earlier approved version" in done.stderr
    assert not approvals_folder(plan).exists()
    done = planrunner(*asked, "--yes", cwd=folder, PLANRUNNER_PASSPHRASE=WORDS)
    assert "this approval counts; the plan has 1 of 2 required approvals, so it cannot run" in done.stdout
    replaced(plan, "dwell: 5 s", "dwell: 7 s")
    done = planrunner(*asked, "--yes", cwd=folder, PLANRUNNER_PASSPHRASE=WORDS)
    assert "Since the version that Anna Example approved" in done.stderr and "2 segments changed" in done.stderr
    listed = json.loads(planrunner("approve", "plan.yaml", "--list", "--json", cwd=folder).stdout)
    assert [one["standing"] for one in listed[0]["approvals"]] == ["another plan", "counts"]
    assert listed[0]["met"] is False
    gone = ["approve", "plan.yaml", "--withdraw", "--by", "anna.pem", "--name", "Anna", "--statement", "a mistake"]
    assert "2 approvals withdrawn" in planrunner(*gone, cwd=folder, PLANRUNNER_PASSPHRASE=WORDS).stdout
    assert "approval-none" in planrunner(*gone, cwd=folder, PLANRUNNER_PASSPHRASE=WORDS).stderr
    assert "it was withdrawn" in planrunner("approve", "plan.yaml", "--list", cwd=folder).stdout


def test_a_plan_with_errors_is_not_approved(plan: Path) -> None:
    replaced(plan, "x: up", "x: upp")
    with pytest.raises(InputError):
        prepare(plan)
    assert not approvals_folder(plan).exists()


def test_an_approval_for_several_benches(plan: Path) -> None:
    second = plan.parent / "second.yaml"
    shutil.copy(plan.parent / "lab.yaml", second)
    replaced(second, "name: virtual", "name: second")
    for key in (ANNA, BEN):
        approve(prepare(plan, [str(plan.parent / "lab.yaml"), str(second)], foresee=False), key, "R")
    assert check_plan(plan).ok
    assert check_plan(plan, second).ok
    assert read_bench(str(second))[0].name == "second"
