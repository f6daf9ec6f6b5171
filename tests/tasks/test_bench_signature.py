"""Signatures that a bench makes by itself: every run and analysis is signed, a missing key spoils nothing, and no forgery passes."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from jsonschema import Draft202012Validator

from planrunner.base.guarded_folder import GuardedFolder
from planrunner.signing.bench_key import BenchKeyError, bench_signer
from planrunner.signing.key_ring import KeyRing, KnownKey, entry_text
from planrunner.signing.keys import PrivateKey, PublicKey, parse_public, read_public, write_unencrypted
from planrunner.signing.run_signatures import sign_run
from planrunner.tasks.verify import verify_run
from tests.forging import rechain, reseal, rewrite, with_digest
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]
PLAN = """\
planrunner: 1
title: Two rates
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


def key_of(number: int) -> PrivateKey:
    return PrivateKey(Ed25519PrivateKey.from_private_bytes(bytes([number]) * 32))


BENCH, ANNA, EVE = (key_of(number) for number in range(11, 14))


def store(key: PrivateKey, state: Path, name: str = "lab") -> Path:
    """The key in the folder of signing keys of a state folder."""
    folder = state / "signing-keys"
    folder.mkdir(parents=True, exist_ok=True)
    state.chmod(0o700)
    write_unencrypted(folder / f"{name}.pem", key)
    (folder / f"{name}.pem.pub").write_text(f"{key.public.line} {name}\n")
    return folder


def ring(*entries: KnownKey) -> KeyRing:
    known = entries or (KnownKey("virtual", BENCH.public, ("bench",)), KnownKey("anna", ANNA.public, ("reviewer",)))
    return KeyRing({one.public.fingerprint: one for one in known})


def write_lab(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    (folder / "lab.yaml").write_text(f"{bench}signing: {{key: {BENCH.public.line}}}\n")
    (folder / "plan.yaml").write_text(PLAN)
    return folder / "plan.yaml"


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    monkeypatch.setenv("PLANRUNNER_STATE", str(tmp_path / "state"))
    return tmp_path / "state"


def ran(plan: Path, code: int = 0, **environment: str) -> Path:
    done = planrunner("run", plan.name, "--flushed", "--quiet", "--json", cwd=plan.parent, **environment)
    assert done.returncode == code, done.stderr
    document = json.loads(done.stdout)
    assert ("unsigned" in document) == (code == 3)
    return plan.parent / Path(document["analysis"]).parents[1]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A state folder with the key, and a run that was signed."""
    folder = tmp_path_factory.mktemp("signed")
    store(BENCH, folder / "state")
    ran(write_lab(folder / "lab"), PLANRUNNER_STATE=str(folder / "state"), SSH_AUTH_SOCK="")
    return folder


@pytest.fixture
def run(made: Path, state: Path) -> Path:
    shutil.copytree(made / "state", state)
    (source,) = (made / "lab" / "runs").iterdir()
    return Path(shutil.copytree(source, state.parent / source.name))


def codes(run: Path, known: KeyRing | None = None) -> set[str]:
    return {one.code for _, one in verify_run(run, known).changes}


def test_a_run_is_signed_without_being_asked(run: Path) -> None:
    found = verify_run(run, ring())
    assert found.changes == ()
    assert [(one.meaning, one.standing, one.owner, one.analyses) for one in found.signatures] == [
        ("recorded", "valid", "virtual", ()),
        ("evaluated", "valid", "virtual", (1,)),
    ]
    assert [one.standing for one in verify_run(run).signatures] == ["unknown key"] * 2
    schema = json.loads((ROOT / "schemas" / "verification.schema.json").read_text())
    Draft202012Validator(schema).validate({"run": "x", "exit_code": 0, **found.to_json()})


def test_every_further_analysis_is_signed(run: Path) -> None:
    for words in (["estimate", run], ["amend", run, "--why", "again", "--by", "anna"], ["report", run]):
        assert planrunner(*words, cwd=run.parent).returncode == 0
    found = verify_run(run, ring())
    assert found.changes == ()
    numbers = [one.analyses for one in found.signatures]
    assert numbers == [(), *((one.number,) for one in found.found.analyses)]


def test_what_a_cluster_computed_is_signed_after_it_was_recomputed(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed(work: Callable[[Path], object], items: Sequence[Path], *_: object) -> Iterator[object]:
        yield from map(work, items)

    monkeypatch.setattr("planrunner.base.cluster.computed_on_cluster", computed)
    done = planrunner("estimate", run, "--json", "--scheduler", "tcp://127.0.0.1:1", cwd=run.parent)
    assert done.returncode == 0 and "another computer made it" in json.loads(done.stdout)[0]["unsigned"][0]
    assert f"`planrunner sign {run} --as recorded`" in done.stderr
    assert [one.analyses for one in verify_run(run, ring()).signatures] == [(), (1,)]
    assert planrunner("sign", run, "--as", "recorded", cwd=run.parent).returncode == 0
    found = verify_run(run, ring())
    assert found.changes == () and [one.analyses for one in found.signatures] == [(), (1,), (2,)]


def test_a_missing_key_is_announced_and_loses_nothing(state: Path, tmp_path: Path) -> None:
    plan = write_lab(tmp_path / "lab")
    done = planrunner("check", plan, cwd=tmp_path)
    assert done.returncode == 0
    assert "warning[bench-signing-key-missing]" in done.stderr
    run = ran(plan, code=3)
    assert (run / "seal.json").exists() and (run / "analyses" / "1").exists()
    assert codes(run) == {"run-bench-unsigned"}
    done = planrunner("sign", run, "--as", "recorded", cwd=tmp_path)
    assert done.returncode == 2
    assert not (run / "signatures").exists()
    store(BENCH, state)
    assert "bench-signing-key-missing" not in planrunner("check", plan, cwd=tmp_path).stderr
    done = planrunner("sign", run, "--as", "recorded", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert codes(run, ring()) == set()
    assert "nothing to sign" in planrunner("sign", run, "--as", "recorded", cwd=tmp_path).stdout


def test_results_that_the_samples_do_not_give_are_not_signed(state: Path, tmp_path: Path) -> None:
    run = ran(write_lab(tmp_path / "lab"), code=3)
    path = run / "analyses" / "1"
    results = (path / "results.json").read_bytes().replace(b'"origin": "simulated"', b'"origin": "measured"')
    (path / "results.json").write_bytes(results)
    import hashlib

    digests = json.loads((path / "digests.json").read_bytes())
    digests["files"]["results.json"] = hashlib.sha256(results).hexdigest()
    (path / "digests.json").write_bytes(with_digest(digests))
    assert codes(run) == {"run-bench-unsigned"}
    store(BENCH, state)
    done = planrunner("sign", run, "--as", "recorded", cwd=tmp_path)
    assert done.returncode == 2
    assert "sign-not-reproduced" in done.stderr
    assert not (run / "signatures").exists()


@pytest.mark.skipif(
    sys.platform == "win32" or not all(map(shutil.which, ("ssh-agent", "ssh-add", "ssh-keygen"))),
    reason="needs OpenSSH",
)
def test_a_key_in_ssh_agent_signs_until_the_agent_is_gone(
    state: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("a")
    place, plan = str(folder / "s"), write_lab(tmp_path / "lab")
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / "key"], check=True)
    public = parse_public((folder / "key.pub").read_text())
    bench = plan.with_name("lab.yaml")
    bench.write_text(bench.read_text().replace(BENCH.public.line, public.line))
    with subprocess.Popen(["ssh-agent", "-D", "-a", place], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline()
            environment = {**os.environ, "SSH_AUTH_SOCK": place}
            assert "no running ssh-agent holds it" in (bench_signer_fails(public, place) or "")
            subprocess.run(["ssh-add", "-q", folder / "key"], env=environment, check=True)
            assert bench_signer_fails(public, place) is None
            known = ring(KnownKey("virtual", public, ("bench",)))
            assert codes(ran(plan, SSH_AUTH_SOCK=place), known) == set()
        finally:
            process.terminate()
    assert codes(ran(plan, code=3, SSH_AUTH_SOCK=place)) == {"run-bench-unsigned"}


def bench_signer_fails(key: PublicKey, place: str) -> str | None:
    """Why the key is not found with the agent at this socket; None if it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SSH_AUTH_SOCK", place)
        try:
            bench_signer(key)
        except BenchKeyError as error:
            return str(error)
    return None


def test_key_files_that_others_may_read_or_that_do_not_match_are_refused(state: Path) -> None:
    folder = store(BENCH, state)
    assert bench_signer_fails(BENCH.public, "") is None
    if sys.platform != "win32":
        (folder / "lab.pem").chmod(0o640)
        assert "other users may read" in (bench_signer_fails(BENCH.public, "") or "")
        (folder / "lab.pem").chmod(0o600)
    (folder / "lab.pem").unlink()
    write_unencrypted(folder / "lab.pem", EVE)
    assert "another public key" in (bench_signer_fails(BENCH.public, "") or "")
    (folder / "lab.pem").unlink()
    assert "lab.pem" in (bench_signer_fails(BENCH.public, "") or "")
    assert EVE.public.fingerprint != BENCH.public.fingerprint


def test_a_key_for_the_bench_is_made_where_runs_find_it(state: Path, tmp_path: Path) -> None:
    done = planrunner("key", "new", "lab", "--for-bench", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    public = next(line for line in done.stdout.splitlines() if line.startswith("ssh-ed25519"))
    assert bench_signer(parse_public(public)).public.line == public
    if sys.platform != "win32":
        assert (state / "signing-keys" / "lab.pem").stat().st_mode & 0o777 == 0o600
    assert planrunner("key", "new", "../lab", "--for-bench", cwd=tmp_path).returncode == 2


def test_a_key_that_cannot_be_made_whole_leaves_nothing(state: Path, tmp_path: Path) -> None:
    folder = store(BENCH, state)
    (folder / "lab.pem").unlink()
    done = planrunner("key", "new", "lab", "--for-bench", cwd=tmp_path)
    assert done.returncode == 2 and "lab.pem.pub" in done.stderr and "key-exists" in done.stderr
    if sys.platform != "win32":
        (folder / "other.pem.pub").symlink_to("nowhere")
        assert planrunner("key", "new", "other", "--for-bench", cwd=tmp_path).returncode == 2
    assert sorted(path.name for path in folder.glob("*.pem")) == []
    done = planrunner("key", "new", "third", "--for-bench", "--passphrase-fd", "0", cwd=tmp_path)
    assert done.returncode == 2 and "has no passphrase" in done.stderr
    assert sorted(path.name for path in folder.glob("*.pem")) == []


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="needs ssh-keygen")
def test_keys_of_openssh_sign_with_and_without_a_passphrase(state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PLANRUNNER_PASSPHRASE", raising=False)
    folder = state / "signing-keys"
    folder.mkdir(parents=True)
    state.chmod(0o700)
    for name, words in (("plain", ""), ("secret", "correct horse")):
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", words, "-f", str(folder / f"{name}.pem")]
        subprocess.run(command, check=True)
    plain, secret = (read_public(folder / f"{name}.pem.pub") for name in ("plain", "secret"))
    assert bench_signer(plain).public == plain
    assert "has a passphrase" in (bench_signer_fails(secret, "") or "")
    monkeypatch.setenv("PLANRUNNER_PASSPHRASE", "correct horse")
    assert bench_signer(plain).public == plain
    if importlib.util.find_spec("bcrypt") is None:
        assert "bcrypt" in (bench_signer_fails(secret, "") or "")
    else:
        assert bench_signer(secret).public == secret


def test_a_bench_with_an_unreadable_key_is_refused(state: Path, tmp_path: Path) -> None:
    plan = write_lab(tmp_path / "lab")
    bench = plan.with_name("lab.yaml")
    bench.write_text(bench.read_text().replace(BENCH.public.line, "ssh-ed25519 " + "A" * 40))
    done = planrunner("check", plan, cwd=tmp_path)
    assert done.returncode == 2
    assert "error[bench-signing-key]" in done.stderr


def test_reports_and_the_review_page_print_signatures_and_whether_they_hold(run: Path, tmp_path: Path) -> None:
    write_unencrypted(tmp_path / "anna.pem", ANNA)
    ring_file = "planrunner_keys: 1\nkeys:\n" + entry_text("anna", ANNA.public, (), None)
    (tmp_path / "ring.yaml").write_text(ring_file + entry_text("virtual", BENCH.public, ("bench",), None))
    words = ["sign", run, "--as", "released", "--by", "anna.pem", "--name", "Anna Example"]
    assert planrunner(*words, cwd=tmp_path).returncode == 0
    signed = max((run / "signatures").iterdir())

    def printed() -> tuple[str, str]:
        done = planrunner("report", run, "summary.md", "--keys", "ring.yaml", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        text = Path(tmp_path, done.stdout.split()[-1]).read_text()
        planrunner("review", run, "--keys", "ring.yaml", "--html", "review.html", cwd=tmp_path)
        line = next(line for line in text.splitlines() if "Anna Example" in line)
        return line, (tmp_path / "review.html").read_text()

    line, page = printed()
    assert (
        "| released | Anna Example |" in line and "| valid, key of anna |" in line and ANNA.public.fingerprint in line
    )
    assert "Anna Example" in page and "key of anna" in page and ">invalid<" not in page
    signed.write_bytes(signed.read_bytes().replace(b'"sig": "', b'"sig": "AAAA', 1))
    planrunner("review", run, "--keys", "ring.yaml", "--html", "review.html", cwd=tmp_path)
    page = (tmp_path / "review.html").read_text()
    assert ">invalid<" in page and "Not to be released" in page


# -- a run that continues ----------------------------------------------------------------------------------------------


def test_signatures_of_a_run_that_is_opened_again_stay_valid(run: Path) -> None:
    words = ("resume", run, "--retake", "P1", "--reason", "a knock", "--quiet")
    done = planrunner(*words, cwd=run.parent)
    assert done.returncode == 0, done.stderr
    found = verify_run(run, ring())
    assert found.changes == ()
    assert [(one.meaning, one.standing, one.current) for one in found.signatures] == [
        ("recorded", "valid", False),
        ("evaluated", "valid", False),
        ("recorded", "valid", True),
        ("evaluated", "valid", True),
    ]
    newest = sorted((run / "signatures").iterdir())[2:]
    for path in newest:
        path.unlink()
    assert codes(run, ring()) == {"run-bench-unsigned"}


def test_an_analysis_elsewhere_needs_the_signature_of_a_person(run: Path, state: Path) -> None:
    shutil.rmtree(state)
    done = planrunner("estimate", run, cwd=run.parent)
    assert done.returncode == 0
    assert "warning[run-analysis-unsigned]" in done.stderr
    assert codes(run, ring()) == {"run-analysis-unsigned"}
    sign_run(GuardedFolder.open(run), run.name, ANNA, "WARNED", "reviewed", "Anna")
    assert codes(run, ring()) == set()


def test_the_bench_does_not_sign_analyses_of_a_seal_that_it_did_not_sign(run: Path) -> None:
    shutil.rmtree(run / "signatures")
    done = planrunner("estimate", run, cwd=run.parent)
    assert "run-analysis-unsigned" in done.stderr
    assert not (run / "signatures").exists()


def test_a_run_of_others_is_not_signed_later(run: Path) -> None:
    shutil.rmtree(run / "signatures")
    (run / ".origin").unlink()
    done = planrunner("sign", run, "--as", "recorded", cwd=run.parent)
    assert done.returncode == 2
    assert "you did not make this run folder" in done.stderr


# -- forgeries without the key -----------------------------------------------------------------------------------------


def _without(run: Path) -> None:
    shutil.rmtree(run / "signatures")


def _results(run: Path) -> None:
    """Other results in a new last analysis, without the signature of the first."""
    import hashlib

    (run / "signatures" / "0002-evaluated.dsse.json").unlink()
    path = run / "analyses" / "1"
    (path / "summary.md").write_text("# better\n")
    digests = json.loads((path / "digests.json").read_bytes())
    digests["files"]["summary.md"] = hashlib.sha256(b"# better\n").hexdigest()
    (path / "digests.json").write_bytes(with_digest(digests))


def _signed_by_a_stranger(run: Path) -> None:
    """The forged analysis, signed with a key that nobody knows."""
    _results(run)
    sign_run(GuardedFolder.open(run), run.name, EVE, "PASSED", "reviewed", "Anna")


def _journal(run: Path) -> None:
    def warmer(events: list[dict]) -> None:
        events[-1]["finished"] = events[-1]["at"]
        events[1]["at"] = events[0]["at"]

    rewrite(run, warmer)
    shutil.rmtree(run / "analyses")


def _journal_and_signatures(run: Path) -> None:
    _journal(run)
    shutil.rmtree(run / "signatures")


def _bench_file(run: Path, old: str, new: str) -> None:
    """Another bench file, with all digests computed again; the analyses and signatures are removed."""
    import hashlib

    data = (run / "bench.yaml").read_text().replace(old, new).encode()
    (run / "bench.yaml").write_bytes(data)

    def changed(events: list[dict]) -> None:
        events[0]["files"]["bench.yaml"] = hashlib.sha256(data).hexdigest()

    rechain(run, changed)
    files = json.loads((run / "seal.json").read_bytes())["files"] | {"bench.yaml": hashlib.sha256(data).hexdigest()}
    files["journal.jsonl"] = hashlib.sha256((run / "journal.jsonl").read_bytes()).hexdigest()
    reseal(run, files=files)
    shutil.rmtree(run / "analyses")
    shutil.rmtree(run / "signatures")


def _own_key(run: Path) -> None:
    """The forger's key in the bench file, which then signs."""
    _bench_file(run, BENCH.public.line, EVE.public.line)
    sign_run(GuardedFolder.open(run), run.name, EVE, "PASSED", "recorded", "virtual")


def _reviewers_key(run: Path) -> None:
    """A known person signs as the bench."""
    _bench_file(run, BENCH.public.line, ANNA.public.line)
    sign_run(GuardedFolder.open(run), run.name, ANNA, "PASSED", "recorded", "virtual")


def _no_requirement(run: Path) -> None:
    _bench_file(run, f"signing: {{key: {BENCH.public.line}}}\n", "")


def _person_as_bench(run: Path) -> None:
    sign_run(GuardedFolder.open(run), run.name, ANNA, "PASSED", "evaluated", "virtual")


def _bench_as_person(run: Path) -> None:
    sign_run(GuardedFolder.open(run), run.name, BENCH, "PASSED", "released", "Anna")


def _renamed(run: Path) -> None:
    folder = run / "signatures"
    (folder / "0002-evaluated.dsse.json").rename(folder / "0002-recorded.dsse.json")


ANY_RING: dict[Callable[[Path], None], set[str]] = {
    _without: {"run-bench-unsigned"},
    _results: {"run-analysis-unsigned"},
    _journal: {"run-signature", "run-bench-unsigned"},
    _journal_and_signatures: {"run-bench-unsigned"},
    _person_as_bench: {"run-signature"},
    _bench_as_person: {"run-signature"},
    _renamed: {"run-signature", "run-analysis-unsigned"},
}
WITH_RING: dict[Callable[[Path], None], set[str]] = {
    _signed_by_a_stranger: {"run-analysis-unsigned"},
    _own_key: {"run-bench-unsigned", "run-signature"},
    _reviewers_key: {"run-bench-unsigned", "run-signature"},
    _no_requirement: {"run-bench-unsigned"},
}


@pytest.mark.parametrize("forge", ANY_RING, ids=lambda one: one.__name__)
def test_a_forgery_without_the_key_is_found(run: Path, forge: Callable[[Path], None]) -> None:
    forge(run)
    assert codes(run) == codes(run, ring()) == ANY_RING[forge]


@pytest.mark.parametrize("forge", WITH_RING, ids=lambda one: one.__name__)
def test_a_forgery_of_the_bench_file_is_found_with_the_key_ring(run: Path, forge: Callable[[Path], None]) -> None:
    forge(run)
    assert codes(run) == set()
    assert codes(run, ring()) == WITH_RING[forge]


def test_a_revoked_key_still_requires_signatures(run: Path) -> None:
    """After a rotation of the key, an old run does not become free of the requirement."""
    today, later = date.today(), date.today() + timedelta(days=30)
    old = KnownKey("virtual", BENCH.public, ("bench",), revoked=today)
    new = KnownKey("virtual-2", key_of(14).public, ("bench",), begins=later, owner="virtual")
    _no_requirement(run)
    assert codes(run, ring(old, new)) == codes(run, ring(old)) == {"run-bench-unsigned"}
    ended = replace(old, ends=today - timedelta(days=30))
    assert codes(run, ring(ended)) == set()  # the bench no longer signs since then


def test_a_signature_of_another_run_is_found(run: Path, state: Path, tmp_path: Path) -> None:
    other = ran(write_lab(tmp_path / "lab"))
    shutil.rmtree(run / "signatures")
    shutil.copytree(other / "signatures", run / "signatures")
    assert codes(run, ring()) == {"run-signature", "run-bench-unsigned"}
