"""The log of an archive: removed, added and replaced runs show, as does a log that was cut or rewritten; killed writers leave no false
alarm."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_log import ENTRIES, FOLDER, HEAD, RunLog
from planrunner.archive.storage import Storage
from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.plan.schedule import Rest, Segment
from planrunner.signing.keys import write_private
from planrunner.tasks.run_log import append_run, logged_run, verify_log
from planrunner.tasks.sign import sign_later
from planrunner.tasks.verify import runs_in, verify_run
from tests.forging import flip, rewrite, with_digest, write_run
from tests.in_process import planrunner
from tests.signing.test_signatures import ANNA, BEN, WORDS

ROOT = Path(__file__).resolve().parents[2]
KILLS = os.environ.get("PLANRUNNER_KILLS", "7")
"""A writer is killed at every operation of this number; 1 for all of them."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive with a log and three runs, and the tree head after the second one beside it."""
    folder = tmp_path_factory.mktemp("logged")
    archive = folder / "runs"
    RunLog.create(archive)
    for _ in range(2):
        write_run(archive, analyses=1)
    (folder / "kept.json").write_bytes((archive / FOLDER / HEAD).read_bytes())
    write_run(archive, analyses=0)
    return archive


@pytest.fixture
def archive(made: Path, tmp_path: Path) -> Path:
    shutil.copy(made.parent / "kept.json", tmp_path)
    return Path(shutil.copytree(made, tmp_path / "runs"))


def runs(archive: Path) -> list[Path]:
    """In the order in which they were made."""
    return sorted(runs_in(archive), key=lambda run: json.loads((run / "run.json").read_bytes())["created"])


def found(archive: Path) -> set[tuple[str, str]]:
    """Change and code of everything that `verify --all` reports about the runs and the log."""
    verified = [verify_run(run) for run in runs(archive)]
    log = RunLog.of(archive)
    assert log is not None
    of_log = verify_log(log, [logged_run(one.found) for one in verified])
    return {(change, one.code) for all_ in (*(v.changes for v in verified), of_log.changes) for change, one in all_}


def entries(archive: Path, change: Callable[[list[bytes]], object]) -> None:
    path = archive / FOLDER / ENTRIES
    lines = path.read_bytes().splitlines(keepends=True)
    change(lines)
    path.write_bytes(b"".join(lines))


def plain_root(leaves: list[bytes]) -> bytes:
    """MTH as RFC 9162 defines it."""
    if len(leaves) == 1:
        return hashlib.sha256(b"\0" + leaves[0]).digest()
    k = max(2**i for i in range(20) if 2**i < len(leaves))
    return hashlib.sha256(b"\1" + plain_root(leaves[:k]) + plain_root(leaves[k:])).digest()


def new_head(archive: Path) -> None:
    """A tree head for the entries as they are now, as anybody can write it."""
    leaves = (archive / FOLDER / ENTRIES).read_bytes().splitlines()
    head = json.loads((archive / FOLDER / HEAD).read_bytes())
    head |= {"size": len(leaves), "root": plain_root(leaves).hex()}
    (archive / FOLDER / HEAD).write_bytes(with_digest(head))


def test_an_untouched_archive_has_no_changes(archive: Path) -> None:
    assert found(archive) == set()
    log = RunLog.of(archive)
    assert log is not None
    content = log.read()
    assert [entry.event for entry in content.entries] == ["created", *["begun", "sealed"] * 3]
    leaves = (archive / FOLDER / ENTRIES).read_bytes().splitlines()
    assert content.stored is not None
    assert (content.stored.size, content.stored.root) == (7, plain_root(leaves).hex())


def remove_run(archive: Path) -> None:
    shutil.rmtree(runs(archive)[1])


def copy_run(archive: Path) -> None:
    shutil.copytree(runs(archive)[0], archive / "again")


def add_run(archive: Path) -> None:
    shutil.move(write_run(archive.parent / "elsewhere"), archive)


def replace_run(archive: Path) -> None:
    """Another run under the name of an old one, consistent in itself."""
    old = runs(archive)[1]
    other = write_run(archive.parent / "elsewhere", analyses=0)
    shutil.rmtree(old)
    rewrite(other, lambda events: events[0].update(run=old.name))
    shutil.move(other, old)


def rewrite_run(archive: Path) -> None:
    rewrite(runs(archive)[2], lambda events: events[4].update(clock=5.5))


def seal_again(archive: Path) -> None:
    seal = json.loads((runs(archive)[2] / "seal.json").read_bytes())
    seal["sealed"] = seal["sealed"][:19] + ".000001+00:00"
    (runs(archive)[2] / "seal.json").write_bytes(with_digest(seal))


def reopened_by_hand(archive: Path) -> None:
    """The run is rewritten, and claims that it had the logged seal before it was reopened."""
    run = runs(archive)[2]
    logged = hashlib.sha256((run / "seal.json").read_bytes()).hexdigest()

    def change(events: list[dict]) -> None:
        events[4]["clock"] = 5.5
        again = {"event": "reopened", "at": events[-1]["at"], "repaired_bytes": 0, "reason": "x", "seal": logged}
        events.insert(len(events), again)
        events.append(dict(events[-2]))

    rewrite(run, change)


def remove_entries(archive: Path) -> None:
    entries(archive, lambda lines: lines.__delitem__(slice(-2, None)))


CHANGES: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "a run was removed": (remove_run, "removed", "log-run-removed"),
    "a run was copied": (copy_run, "added", "log-run-added"),
    "a run was added": (add_run, "added", "log-run-added"),
    "a run was replaced": (replace_run, "replaced", "log-run-replaced"),
    "a run was rewritten": (rewrite_run, "replaced", "log-run-replaced"),
    "a run was sealed again": (seal_again, "added", "log-run-added"),
    "a run claims to have been reopened": (reopened_by_hand, "replaced", "log-run-replaced"),
    "the last entries were removed": (remove_entries, "cut", "log-cut"),
    "all entries were removed": (lambda archive: entries(archive, list.clear), "cut", "log-cut"),
    "an entry was removed": (lambda archive: entries(archive, lambda lines: lines.pop(2)), "altered", "log-changed"),
    "entries were exchanged": (
        lambda archive: entries(archive, lambda lines: lines.insert(2, lines.pop(3))),
        "altered",
        "log-changed",
    ),
    "the head was removed": (lambda archive: (archive / FOLDER / HEAD).unlink(), "cut", "log-cut"),
    "the entries were removed": (lambda archive: (archive / FOLDER / ENTRIES).unlink(), "cut", "log-cut"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_of_the_archive_is_found_and_named(archive: Path, name: str) -> None:
    change, kind, code = CHANGES[name]
    change(archive)
    assert (kind, code) in found(archive)


def test_a_log_that_was_cut_with_its_run_shows_in_later_runs_and_kept_heads(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second run is removed with all its entries, and everything that needs no key is computed anew."""
    gone = runs(archive)[1]
    shutil.rmtree(gone)

    def without(lines: list[bytes]) -> None:
        kept = [json.loads(line) for line in lines if json.loads(line)["run"] != gone.name]
        compact = [json.dumps({**one, "seq": n}, separators=(",", ":")) for n, one in enumerate(kept, 1)]
        lines[:] = [f"{one}\n".encode() for one in compact]

    entries(archive, without)
    new_head(archive)
    assert ("altered", "log-changed") in found(archive)  # run.json of the third run
    shutil.rmtree(runs(archive)[1])
    entries(archive, lambda lines: lines.__delitem__(slice(3, None)))
    new_head(archive)
    assert found(archive) == set()  # nothing in the archive knows more; a kept head does
    assert main(["verify", str(archive), "--all", "--head", str(archive.parent / "kept.json")]) == 4
    assert "the log was cut" in capsys.readouterr().out
    shutil.rmtree(archive / FOLDER)
    assert main(["verify", str(archive), "--all", "--head", str(archive.parent / "kept.json")]) == 4
    assert main(["verify", str(archive), "--all"]) == 0
    assert "removed runs cannot be detected" in capsys.readouterr().out


@pytest.mark.slow
def test_flips_all_over_the_log(archive: Path) -> None:
    for path in (archive / FOLDER / ENTRIES, archive / FOLDER / HEAD):
        before = path.read_bytes()
        for place in range(0, len(before), 1 if len(before) < 300 else 5):
            flip(path, place, 1 << (place % 8))
            log = RunLog.of(archive)
            assert log is not None and verify_log(log).changes, (path.name, place)
            path.write_bytes(before)


def test_a_retaken_run_is_sealed_and_logged_again(archive: Path) -> None:
    with RunWriter.reopen(runs(archive)[2], reason="again") as writer:
        writer.finish()
    assert found(archive) == set()
    log = RunLog.of(archive)
    assert log is not None and [entry.event for entry in log.read().entries][-2:] == ["sealed", "sealed"]


def test_a_run_that_was_moved_on_purpose_is_a_remark(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gone = runs(archive)[0]
    shutil.rmtree(gone)
    assert main(["verify", str(archive), "--all"]) == 4
    assert f"removed: {gone.name}" in capsys.readouterr().out
    assert main(["log", "retire", str(archive), gone.name, "--why", "moved to tape 7"]) == 0
    assert main(["verify", str(archive), "--all"]) == 0
    assert "moved to tape 7" in capsys.readouterr().out


def test_runs_from_elsewhere_are_added_with_the_present_date(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    add_run(archive)
    (added,) = set(runs(archive)) - {path for path in runs(archive) if verify_run(path).found.run.get("log")}
    assert main(["log", "append", str(added)]) == 0
    assert main(["log", "append", str(added)]) == 0
    assert "already in the log" in capsys.readouterr().out
    assert found(archive) == set()
    rewrite(added, lambda events: events[4].update(clock=5.5))
    shutil.rmtree(added / "analyses")
    log = RunLog.of(archive)
    assert log is not None
    with pytest.raises(IntegrityError, match="not the run in the log"):
        append_run(log, added)


def test_a_log_begins_with_the_runs_that_are_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path)
    assert main(["log", "new", str(tmp_path)]) == 0
    assert "2 entries, root " in capsys.readouterr().out
    assert found(tmp_path) == set()
    assert main(["log", "new", str(tmp_path)]) == 2
    write_run(tmp_path)
    assert found(tmp_path) == set()


def test_no_run_begins_under_a_damaged_log(archive: Path) -> None:
    remove_entries(archive)
    before = sorted(archive.iterdir())
    with pytest.raises(IntegrityError, match="the log was cut"):
        RunWriter.create(archive, "p", b"", b"", {}, "flushed")
    assert sorted(archive.iterdir()) == before


def test_proofs_hold_without_the_log(archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = runs(archive)[1]
    schema = Draft202012Validator(json.loads((ROOT / "schemas" / "log-proof.schema.json").read_bytes()))
    proof, head, grown = tmp_path / "proof.json", tmp_path / "head.json", tmp_path / "grown.json"
    assert main(["log", "prove", str(archive), run.name, "--output", str(proof)]) == 0
    assert main(["log", "prove", str(archive), "--from", str(tmp_path / "kept.json"), "--output", str(grown)]) == 0
    capsys.readouterr()
    assert main(["log", "head", str(archive)]) == 0
    head.write_text(capsys.readouterr().out)
    for file in (proof, grown):
        schema.validate(json.loads(file.read_bytes()))
        assert main(["log", "check", "--proof", str(file), "--head", str(head)]) == 0
    assert main(["log", "check", "--proof", str(proof), "--head", str(head), "--run", str(run)]) == 0
    assert main(["log", "check", "--proof", str(proof), "--run", str(runs(archive)[0])]) == 4
    assert main(["log", "check", "--proof", str(proof), "--head", str(tmp_path / "kept.json")]) == 4
    value = json.loads(proof.read_bytes())
    value["entry"]["run"] = "other"
    proof.write_text(json.dumps(value))
    assert main(["log", "check", "--proof", str(proof), "--head", str(head)]) == 4
    assert "the proof does not hold" in capsys.readouterr().err


def test_signed_heads(archive: Path, tmp_path: Path) -> None:
    for name, key in (("anna", ANNA), ("ben", BEN)):
        write_private(tmp_path / f"{name}.pem", key, WORDS)
        (tmp_path / f"{name}.pub").write_text(key.public.line)
    planrunner("key", "add", "ring.yaml", "anna", "anna.pub", cwd=tmp_path)
    planrunner("key", "add", "other.yaml", "ben", "ben.pub", cwd=tmp_path)
    secret = {"PLANRUNNER_PASSPHRASE": WORDS.decode()}
    signed = planrunner("log", "head", "runs", "--by", "anna.pem", cwd=tmp_path, **secret)
    assert signed.returncode == 0
    (tmp_path / "signed.json").write_text(signed.stdout)
    check = ("verify", "runs", "--all", "--keys", "ring.yaml")
    assert "valid, key of anna" in planrunner(*check, cwd=tmp_path).stdout
    assert "NOT VERIFIED" in planrunner("verify", "runs", "--all", "--keys", "other.yaml", cwd=tmp_path).stdout
    write_run(archive)
    assert planrunner(*check, "--head", "signed.json", cwd=tmp_path).returncode == 0
    path = archive / FOLDER / "head.dsse.json"
    envelope = json.loads(path.read_bytes())
    forged = planrunner("log", "head", "runs", "--by", "ben.pem", cwd=tmp_path, **secret)
    other = json.loads(forged.stdout) | {"signatures": envelope["signatures"]}
    path.write_text(json.dumps(other, indent=1) + "\n")
    done = planrunner(*check, cwd=tmp_path)
    assert done.returncode == 4 and "does not match its content" in done.stdout
    path.write_bytes(signed.stdout.encode())
    remove_run(archive)
    entries(archive, lambda lines: lines.__delitem__(slice(5, None)))
    new_head(archive)
    assert "its signed tree head records 7 entries" in planrunner(*check, cwd=tmp_path).stdout


def test_the_json_of_the_log_matches_its_schema(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    remove_run(archive)
    assert main(["verify", str(archive), "--all", "--json"]) == 4
    *_, log = json.loads(capsys.readouterr().out)
    schema = Draft202012Validator(json.loads((ROOT / "schemas" / "log-verification.schema.json").read_bytes()))
    schema.validate(log)
    assert [one["change"] for one in log["changes"]] == ["removed"] and log["entries"] == 7
    assert main(["log", "check", str(archive), "--json"]) == 0
    schema.validate(json.loads(capsys.readouterr().out))


def test_wrong_use_is_explained(tmp_path: Path, archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (
        ["head", str(tmp_path)],
        ["prove", str(archive)],
        ["prove", str(archive), "nothing"],
        ["retire", str(archive), "nothing", "--why", "x"],
        ["retire", str(archive), runs(archive)[0].name, "--why", "\x1b[2J"],
        ["check"],
        ["append", str(archive)],
    ):
        assert main(["log", *words]) == 2, words
        assert "Traceback" not in capsys.readouterr().err
    with pytest.raises(InputError):
        RunLog.create(archive)


# -- several writers, and killed ones ------------------------------------------------------------------------------------


def test_several_writers_wait_for_one_another(tmp_path: Path) -> None:
    """Threads with a log of their own each: the lock belongs to the opened file, not to the process."""
    RunLog.create(tmp_path)

    def append_some(name: str) -> None:
        log = RunLog.of(tmp_path, Storage("flushed"))
        assert log is not None
        for number in range(10):
            log.append("retired", f"{name}-{number}", why="x")

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(append_some, "abc"))
    log = RunLog.of(tmp_path)
    assert log is not None and not verify_log(log).changes
    assert len(log.read().entries) == 31


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_writer_killed_at_any_write_leaves_no_false_alarm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANRUNNER_STATE", str(tmp_path / "state"))
    command = [
        sys.executable,
        "-m",
        "tests.archive.killed_writers",
        str(tmp_path / "archives"),
        KILLS,
        str(tmp_path / "state"),
    ]
    subprocess.run(command, cwd=ROOT, check=True)
    archives = sorted((tmp_path / "archives").iterdir())
    assert len(archives) * int(KILLS) > 80
    torn = 0
    for archive in archives:
        assert found(archive) <= {("removed", "run-seal-missing"), ("removed", "run-bench-unsigned")}, archive
        log = RunLog.of(archive)
        assert log is not None
        torn += bool(log.read().torn)
        for run in runs(archive):
            if not verify_run(run).sealed:
                with RunWriter.reopen(run) as writer:
                    writer.finish()
            sign_later(run)
            assert [one.meaning for one in verify_run(run).signatures] == ["recorded"]
        log.append("retired", "x", why="x")
        assert found(archive) == set(), archive
        assert not log.read().torn
    assert torn or KILLS != "1"


def test_unfinished_runs_are_entered_when_a_log_begins(tmp_path: Path) -> None:
    archive = tmp_path / "runs"
    finished = write_run(archive, analyses=0)
    with RunWriter.create(archive, "later", b"title: plan\n", b"name: bench\n", {}, "flushed") as writer:
        writer.begin(Segment(0, "P1", None, "unknown", Rest(), dwell=1.0), 0.0, {})
    assert planrunner("log", "new", archive, cwd=tmp_path).returncode == 0
    log = RunLog.of(archive)
    assert log is not None
    assert [(one.event, one.run) for one in log.read().entries[1:]] == [
        ("sealed", finished.name) if run == finished else ("begun", run.name) for run in sorted(runs_in(archive))
    ]
    assert found(archive) == set()
    with RunWriter.reopen(writer.path) as again:
        again.finish()
    assert found(archive) == set()
    rewrite(writer.path, lambda events: events[0]["files"].update({"plan.yaml": "0" * 64}))
    assert ("replaced", "log-run-replaced") in found(archive)
