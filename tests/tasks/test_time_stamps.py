"""Time stamps of journals and seals, given by `openssl ts`: what was cut, back-dated or removed shows; an outage spoils nothing."""

from __future__ import annotations

import hashlib
import json
import pickle
import shutil
import subprocess
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from jsonschema import Draft202012Validator

from planrunner.base.guarded_folder import GuardedFolder
from planrunner.cli import main
from planrunner.signing.stamping import Stamper
from planrunner.signing.time_stamps import StampAuthority, StampError, parse_authority, request_stamp
from planrunner.tasks.stamp import stamp_run, stamp_seal
from planrunner.tasks.verify import verify_run
from tests.forging import flip, rechain, reseal, rewrite, with_digest, write_run
from tests.in_process import planrunner
from tests.stamp_authority import LocalAuthority

ROOT = Path(__file__).resolve().parents[2]
BENCH = (ROOT / "plans" / "benches" / "virtual.yaml").read_bytes()
pytestmark = pytest.mark.skipif(not shutil.which("openssl"), reason="the local authority needs openssl")


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalAuthority]:
    found = LocalAuthority(tmp_path_factory.mktemp("authority"))
    yield found
    found.close()


def trusted(authority: LocalAuthority) -> StampAuthority:
    return parse_authority(authority.ca.read_bytes())


def bench_of(authority: LocalAuthority) -> bytes:
    return BENCH + b"\n" + authority.bench_key().encode()


def stamped_run(root: Path, authority: LocalAuthority) -> Path:
    """A sealed run of three segments, with a stamp of every journal head that was free when the last one arrived, and of the seal."""
    stamper = Stamper(authority.url, trusted(authority), every=0.0)
    run = write_run(root, analyses=0, bench=bench_of(authority), witness=stamper)
    if not authority.down:
        stamp_seal(GuardedFolder.open(run), authority.url, trusted(authority))
    return run


@pytest.fixture(scope="module")
def made(authority: LocalAuthority, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stamped_run(tmp_path_factory.mktemp("stamped"), authority)


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / made.name))


def kinds(run: Path, authority: LocalAuthority) -> set[tuple[str, str]]:
    return {(change, one.code) for change, one in verify_run(run, None, trusted(authority)).changes}


def stamps(run: Path) -> list[Path]:
    return sorted((run / "stamps").iterdir())


def events(run: Path) -> list[dict]:
    return [json.loads(line) for line in (run / "journal.jsonl").read_bytes().splitlines()]


def test_an_untouched_run_has_valid_stamps(run: Path, authority: LocalAuthority) -> None:
    found = verify_run(run, None, trusted(authority))
    assert (found.changes, found.remarks) == ((), ())
    assert {one.standing for one in found.stamps} == {"valid"} and found.stamps[-1].events is None
    told = [one for one in events(run) if one["event"] == "stamped"]
    assert told and told[-1]["seq"] == len(events(run)) - 1
    without = verify_run(run)
    assert {one.standing for one in without.stamps} == {"unknown authority"} and not without.changes
    assert {one.code for one in without.remarks} == {"run-stamp-unverified"}


def test_openssl_verifies_each_stamp(run: Path, authority: LocalAuthority) -> None:
    lines = (run / "journal.jsonl").read_bytes().splitlines()
    seal = hashlib.sha256((run / "seal.json").read_bytes()).hexdigest()
    for path in stamps(run):
        place = path.name.split("-")[2].removesuffix(".tsr")
        digest = seal if "-seal-" in path.name else hashlib.sha256(lines[int(place) - 1]).hexdigest()
        command = ["openssl", "ts", "-verify", "-digest", digest, "-in", str(path), "-CAfile", str(authority.ca)]
        assert "Verification: OK" in subprocess.run(command, capture_output=True, text=True).stdout


def without_tail(run: Path) -> None:
    """The last segment is cut off, and the run sealed again, without a new stamp."""

    def cut(found: list[dict]) -> None:
        last = max(number for number, one in enumerate(found) if one["event"] == "begun")
        found[last:-1] = []

    for name in ("0003-P3.parquet",):
        (run / "segments" / name).unlink()
    rewrite(run, cut)
    seal = json.loads((run / "seal.json").read_bytes())
    seal["files"].pop("segments/0003-P3.parquet")
    (run / "seal.json").write_bytes(with_digest(seal))


def without_tail_and_stamps(run: Path) -> None:
    without_tail(run)
    left = {one["file"] for one in events(run) if one["event"] == "stamped"}
    for path in stamps(run):
        if path.name not in left:
            path.unlink()


def move(days: int) -> Callable[[Path], object]:
    """All times of a run moved, with everything that needs no key computed anew."""

    def moved(run: Path) -> None:
        data = json.loads((run / "run.json").read_bytes())
        data["created"] = later(data["created"], days)
        (run / "run.json").write_bytes((json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode())
        digest = hashlib.sha256((run / "run.json").read_bytes()).hexdigest()

        def change(found: list[dict]) -> None:
            found[0]["files"]["run.json"] = digest
            for one in found:
                one["at"] = later(one["at"], days)

        rechain(run, change)
        seal = json.loads((run / "seal.json").read_bytes())
        seal["files"]["run.json"] = digest
        (run / "seal.json").write_bytes(with_digest(seal))
        reseal(run, sealed=later(seal["sealed"], days))

    return moved


def later(text: str, days: int) -> str:
    return (datetime.fromisoformat(text) + timedelta(days=days)).isoformat(timespec="microseconds")


def stamps_anew(change: Callable[[Path], object], authority: LocalAuthority) -> Callable[[Path], object]:
    """After a change, the forger obtains new stamps from the same authority for the changed journal and seal."""

    def changed(run: Path) -> None:
        change(run)
        for path in stamps(run):
            path.unlink()
        lines: list[bytes] = []
        head = "0" * 64
        for one in events(run):
            if one["event"] == "stamped":
                index = one["events"] - 1
                token, at = request_stamp(
                    authority.url, lines[index], hashlib.sha256(lines[index]).hexdigest(), trusted(authority)
                )
                (run / "stamps" / one["file"]).write_bytes(token)
                one |= {"sha256": hashlib.sha256(token).hexdigest(), "time": at.isoformat()}
            one["previous"] = head
            lines.append(json.dumps(one, separators=(",", ":"), ensure_ascii=False).encode())
            head = hashlib.sha256(lines[-1]).hexdigest()
        (run / "journal.jsonl").write_bytes(b"".join(line + b"\n" for line in lines))
        reseal(run)
        stamp_seal(GuardedFolder.open(run), authority.url, trusted(authority))

    return changed


FORGERIES: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "the tail was cut": (without_tail, "cut", "run-cut-short"),
    "the tail was cut with its stamps": (without_tail_and_stamps, "removed", "run-stamp-missing"),
    "a stamp was removed": (lambda run: stamps(run)[0].unlink(), "removed", "run-stamp-missing"),
    "all stamps were removed": (lambda run: shutil.rmtree(run / "stamps"), "removed", "run-stamp-missing"),
    "the stamp of the seal was changed": (lambda run: flip(stamps(run)[-1], 500, 1), "altered", "run-stamp"),
    "stamps were exchanged": (
        lambda run: stamps(run)[0].write_bytes(stamps(run)[1].read_bytes()),
        "altered",
        "run-stamp",
    ),
    "an event was changed": (lambda run: rewrite(run, lambda all_: all_[3].update(clock=7.5)), "altered", "run-stamp"),
    "a note was added": (lambda run: (run / "stamps" / "note.txt").write_bytes(b""), "added", "run-unknown-file"),
    "the seal was renewed": (lambda run: reseal(run, sealed=later(events(run)[-1]["at"], 0)), "altered", "run-stamp"),
    "moved into the past": (move(-400), "altered", "run-stamp"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forgery_is_found_and_named(run: Path, authority: LocalAuthority, name: str) -> None:
    forge, change, code = FORGERIES[name]
    forge(run)
    assert (change, code) in kinds(run, authority)


@pytest.mark.parametrize("days", [-400, -1])
def test_a_forger_with_access_to_the_authority_cannot_date_back(
    run: Path, authority: LocalAuthority, days: int
) -> None:
    stamps_anew(move(days), authority)(run)
    assert kinds(run, authority) == {("back-dated", "run-back-dated")}


def test_stamps_of_another_authority_are_not_valid(run: Path, authority: LocalAuthority, tmp_path: Path) -> None:
    other = LocalAuthority(tmp_path / "other")
    try:
        assert ("altered", "run-stamp") in kinds(run, other)
        with pytest.raises(StampError, match="certificate of the authority"):
            request_stamp(other.url, b"x", hashlib.sha256(b"x").hexdigest(), trusted(authority))
    finally:
        other.close()


def test_an_outage_spoils_nothing_and_the_seal_is_stamped_later(authority: LocalAuthority, tmp_path: Path) -> None:
    authority.down = True
    try:
        run = stamped_run(tmp_path, authority)
        found = verify_run(run, None, trusted(authority))
        assert not found.changes and found.sealed
        assert {one.code for one in found.remarks} == {"run-unstamped", "run-seal-unstamped"}
        assert main(["stamp", str(run), "--url", authority.url]) == 2
    finally:
        authority.down = False
    assert stamp_run(run, authority.url)
    assert stamp_run(run, authority.url) == ""
    found = verify_run(run, None, trusted(authority))
    assert not found.changes and {one.code for one in found.remarks} == {"run-unstamped"}


def test_a_seal_that_was_stamped_late_is_a_remark(authority: LocalAuthority, tmp_path: Path) -> None:
    authority.down = True
    run = stamped_run(tmp_path, authority)
    authority.down = False
    move(-2)(run)
    assert stamp_run(run, authority.url)
    found = verify_run(run, None, trusted(authority))
    assert not found.changes and "run-stamped-late" in {one.code for one in found.remarks}


@pytest.mark.slow
def test_flips_all_over_the_stamps(run: Path, authority: LocalAuthority) -> None:
    for path in stamps(run):
        before = path.read_bytes()
        for place in range(0, len(before), 7):
            flip(path, place, 1 << (place % 8))
            assert kinds(run, authority), (path.name, place)
            path.write_bytes(before)
    assert not kinds(run, authority)


def test_a_run_on_a_bench_with_an_authority(authority: LocalAuthority, tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_bytes(BENCH + b"\n" + authority.bench_key("1 s").encode())
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_bytes()
    (tmp_path / "plan.yaml").write_bytes(plan)
    given = ("--set", "device_serial=F", "--set", "operator=a", "--quiet", "--flushed")
    done = planrunner("run", "plan.yaml", "--bench", "bench.yaml", *given, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    check = planrunner("verify", run, "--authority", authority.ca, cwd=tmp_path)
    assert check.returncode == 0 and "time stamps" in check.stdout and ": valid" in check.stdout
    (entry,) = json.loads(planrunner("verify", run, "--authority", authority.ca, "--json", cwd=tmp_path).stdout)
    Draft202012Validator(json.loads((ROOT / "schemas" / "verification.schema.json").read_bytes())).validate(entry)
    assert entry["stamps"][-1]["events"] is None
    assert datetime.fromisoformat(entry["stamps"][-1]["time"]) <= datetime.now(UTC) + timedelta(minutes=1)


def test_a_wrong_certificate_is_found_before_anything_moves(tmp_path: Path) -> None:
    key = b"\ntime_stamps:\n  url: http://127.0.0.1:9/\n  certificate: nothing\n"
    (tmp_path / "bench.yaml").write_bytes(BENCH + key)
    (tmp_path / "plan.yaml").write_bytes((ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_bytes())
    done = planrunner("check", "plan.yaml", "--bench", "bench.yaml", cwd=tmp_path)
    assert done.returncode == 2 and "bench-stamp-certificate" in done.stdout + done.stderr


# -- revoked authorities -------------------------------------------------------------------------------------------------

BEFORE, AFTER = datetime.now(UTC) - timedelta(days=1), datetime.now(UTC) + timedelta(days=1)


@pytest.mark.parametrize(
    ("at", "reason", "valid"),
    [
        (AFTER, x509.ReasonFlags.superseded, True),
        (AFTER, x509.ReasonFlags.cessation_of_operation, True),
        (BEFORE, x509.ReasonFlags.superseded, False),
        (AFTER, x509.ReasonFlags.key_compromise, False),
        (AFTER, None, False),
    ],
    ids=["superseded later", "ceased later", "superseded before", "compromised", "no reason"],
)
def test_stamps_of_a_revoked_authority(
    run: Path, authority: LocalAuthority, tmp_path: Path, at: datetime, reason: x509.ReasonFlags | None, valid: bool
) -> None:
    """RFC 3161, section 4."""
    (tmp_path / "crl").write_bytes(authority.revocations(at, reason, der=reason is None))
    words = ("verify", run, "--authority", authority.ca, "--revoked", tmp_path / "crl", "--json")
    done = planrunner(*words, cwd=tmp_path)
    assert done.returncode == (0 if valid else 4), done.stderr
    (found,) = json.loads(done.stdout)
    assert {one["standing"] for one in found["stamps"]} == {"valid" if valid else "invalid"}
    assert valid or all("was revoked on" in one["why"] for one in found["stamps"])
    assert kinds(run, authority) == set()


def test_a_list_of_revoked_certificates_must_be_signed_by_the_authority(
    run: Path, authority: LocalAuthority, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = LocalAuthority(tmp_path_factory.mktemp("other"))
    other.close()
    for data in (other.revocations(BEFORE, None), b"not a list"):
        (tmp_path / "crl").write_bytes(data)
        words = ("verify", run, "--authority", authority.ca, "--revoked", tmp_path / "crl")
        assert planrunner(*words, cwd=tmp_path).returncode == 2


def test_an_authority_can_be_sent_to_another_process(authority: LocalAuthority) -> None:
    found = parse_authority(authority.ca.read_bytes(), authority.revocations(BEFORE, None))
    assert pickle.loads(pickle.dumps(found)) == found
