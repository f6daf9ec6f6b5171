"""Keys, envelopes and signatures of runs, against published vectors and other programs."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.signing.envelope import PAYLOAD, Envelope, EnvelopeError, pae, parse_envelope, seal_envelope
from planrunner.signing.key_ring import KeyRing, KnownKey, entry_text, parse_ring, read_ring
from planrunner.signing.keys import PrivateKey, PublicKey, parse_public, read_private, write_private
from planrunner.signing.run_signatures import sign_run, signatures_of
from planrunner.signing.ssh_agent import AgentKey
from planrunner.tasks.verify import verify_run
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]
WORDS = b"correct horse"


def key_of(number: int) -> PrivateKey:
    return PrivateKey(Ed25519PrivateKey.from_private_bytes(bytes([number]) * 32))


ANNA, BEN = key_of(1), key_of(2)


def ring_of(*keys: PrivateKey, revoked: date | None = None) -> KeyRing:
    known = [KnownKey(f"key{number}", key.public, revoked=revoked) for number, key in enumerate(keys)]
    return KeyRing({one.public.fingerprint: one for one in known})


def test_a_signature_of_rfc_8032() -> None:
    """Section 7.1, test 2."""
    secret = "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb"
    public = "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c"
    signature = (
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da"
        "085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00"
    )
    key = PrivateKey(Ed25519PrivateKey.from_private_bytes(bytes.fromhex(secret)))
    assert key.public.raw.hex() == public
    assert key.sign(b"\x72").hex() == signature
    assert key.public.signed(bytes.fromhex(signature), b"\x72")
    assert not key.public.signed(bytes.fromhex(signature), b"\x73")


def test_the_encoding_that_the_specification_of_dsse_gives() -> None:
    """The example of protocol.md: the type http://example.com/HelloWorld and the payload `hello world`."""
    assert pae("http://example.com/HelloWorld", b"hello world") == (
        b"DSSEv1 29 http://example.com/HelloWorld 11 hello world"
    )


def test_an_envelope_holds_for_its_type_key_and_payload_only() -> None:
    made = seal_envelope("a/b", b"payload", ANNA)
    assert parse_envelope(made.to_bytes(), "a/b").signed_by(ANNA.public)
    assert not made.signed_by(BEN.public)
    assert not Envelope("a/bp", b"ayload", made.key, made.signature).signed_by(ANNA.public)
    assert not Envelope("a/b", b"payloae", made.key, made.signature).signed_by(ANNA.public)
    with pytest.raises(EnvelopeError, match="a type other than a/c"):
        parse_envelope(made.to_bytes(), "a/c")
    double = json.loads(made.to_bytes())
    double["signatures"] *= 2
    with pytest.raises(EnvelopeError, match="exactly one"):
        parse_envelope(json.dumps(double).encode(), "a/b")


def test_a_private_key_is_encrypted_and_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "anna.pem"
    write_private(path, ANNA, WORDS)
    if os.name != "nt":
        assert path.stat().st_mode & 0o777 == 0o600
    assert path.read_text().startswith("-----BEGIN ENCRYPTED PRIVATE KEY-----")
    assert read_private(path, WORDS).public == ANNA.public
    for wrong in (b"wrong horse", None):
        with pytest.raises(InputError):
            read_private(path, wrong)
    before = path.read_bytes()
    with pytest.raises(InputError, match="key-exists"):
        write_private(path, BEN, WORDS)
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="key-passphrase"):
        write_private(tmp_path / "short.pem", BEN, b"short")


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="needs ssh-keygen")
def test_the_fingerprint_is_that_of_openssh(tmp_path: Path) -> None:
    (tmp_path / "anna.pub").write_text(ANNA.public.line + " anna\n")
    shown = subprocess.run(
        ["ssh-keygen", "-l", "-f", tmp_path / "anna.pub"], capture_output=True, text=True, check=True
    )
    assert shown.stdout.split()[:2] == ["256", ANNA.public.fingerprint]
    assert parse_public(ANNA.public.line + " anna") == ANNA.public


@pytest.mark.parametrize(
    "line", ["", "ssh-rsa AAAA", "ssh-ed25519 !!!!", "ssh-ed25519 AAAA", ANNA.public.line.replace("C3Nz", "C3Ny")]
)
def test_what_is_no_public_key_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match="public key"):
        parse_public(line)


def test_the_key_ring_is_read_back(tmp_path: Path) -> None:
    text = "planrunner_keys: 1\nkeys:\n" + entry_text("anna", ANNA.public, ("reviewer", "head"), "2028-12-31")
    (tmp_path / "keys.yaml").write_text(text + entry_text("ben", BEN.public, (), None))
    anna, ben = read_ring(tmp_path / "keys.yaml").keys.values()
    assert anna == KnownKey("anna", ANNA.public, ("reviewer", "head"), ends=date(2028, 12, 31))
    assert ben == KnownKey("ben", BEN.public)
    with pytest.raises(InputError, match="key-twice"):
        parse_ring(text + entry_text("ben", ANNA.public, (), None), "keys.yaml")
    with pytest.raises(InputError, match="meaning-date"):
        parse_ring(text.replace("12-31", "02-30"), "keys.yaml")


@pytest.mark.parametrize(
    ("key", "day", "objection"),
    [
        (KnownKey("a", ANNA.public), date(2026, 5, 1), ""),
        (KnownKey("a", ANNA.public, begins=date(2026, 5, 2)), date(2026, 5, 1), "valid from 2026-05-02"),
        (KnownKey("a", ANNA.public, begins=date(2026, 5, 1), ends=date(2026, 5, 1)), date(2026, 5, 1), ""),
        (KnownKey("a", ANNA.public, ends=date(2026, 4, 30)), date(2026, 5, 1), "valid until 2026-04-30"),
        (KnownKey("a", ANNA.public, revoked=date(2027, 1, 1)), date(2026, 5, 1), "revoked on 2027-01-01"),
    ],
    ids=["always", "early", "on the day", "late", "revoked"],
)
def test_when_a_key_counts(key: KnownKey, day: date, objection: str) -> None:
    assert (objection in key.objection(day)) if objection else key.objection(day) == ""


# -- a run -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    given = ("--set", "device_serial=F", "--set", "operator=t", "--flushed", "--quiet")
    done = planrunner("run", ROOT / "plans" / "flexure_gyro_eight_position.yaml", *given, cwd=folder)
    assert done.returncode == 0, done.stderr
    (run,) = (folder / "runs").iterdir()
    return run


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "run"))


def sign(run: Path, key: PrivateKey = ANNA) -> str:
    name = json.loads((run / "run.json").read_text())["run"]
    return sign_run(GuardedFolder.open(run), name, key, "PASSED", "reviewed", "Anna Example")


def test_commands_sign_and_verify(run: Path, tmp_path: Path) -> None:
    write_private(tmp_path / "anna.pem", ANNA, WORDS)
    (tmp_path / "anna.pub").write_text(ANNA.public.line)
    known = {"PLANRUNNER_PASSPHRASE": WORDS.decode()}
    for arguments in (
        ["key", "add", "keys.yaml", "anna", "anna.pub"],
        ["sign", run, "--as", "approved", "--by", "anna.pem", "--name", "Anna <b>"],
        ["verify", run, "--keys", "keys.yaml", "--json"],
    ):
        done = planrunner(*arguments, cwd=tmp_path, **known)
        assert done.returncode == 0, done.stderr
    (one,) = json.loads(done.stdout)[0]["signatures"]
    assert (one["standing"], one["owner"], one["meaning"], one["name"]) == ("valid", "anna", "approved", "Anna <b>")
    results = json.loads((run / "analyses" / "1" / "results.json").read_text())
    met = {limit["verdict"] for limit in results["limits"]} == {"pass"}
    assert one["result"] in (("PASSED", "WARNED") if met else ("FAILED",))


@pytest.mark.parametrize("file", ["seal.json", "plan.yaml", "journal.jsonl", "analyses/1/digests.json"])
def test_a_signature_does_not_hold_for_other_files(run: Path, file: str) -> None:
    sign(run)
    with (run / file).open("ab") as opened:
        opened.write(b" ")
    (one,) = signatures_of(GuardedFolder.open(run), ring_of(ANNA))
    assert (one.standing, one.why) == ("invalid", f"{file} differs from what was signed")


def _flip(run: Path, file: str) -> None:
    path = run / "signatures" / file
    data = bytearray(path.read_bytes())
    data[200] = ord("B") if data[200] == ord("A") else ord("A")
    path.write_bytes(data)


def _stolen(run: Path, file: str) -> None:
    """The payload, signed by another key under the name of the first."""
    path = run / "signatures" / file
    value = json.loads(path.read_bytes())
    payload = base64.b64decode(value["payload"])
    forged = Envelope(PAYLOAD, payload, ANNA.public.fingerprint, BEN.sign(pae(PAYLOAD, payload)))
    path.write_bytes(forged.to_bytes())


def _other_run(run: Path, file: str) -> None:
    name = "20260101T000000Z-other-000000"
    (run / "signatures" / file).unlink()
    sign_run(GuardedFolder.open(run), name, ANNA, "PASSED", "reviewed", "Anna Example")


def _removed(run: Path, file: str) -> None:
    sign(run, BEN)
    (run / "signatures" / file).unlink()


def _renamed(run: Path, file: str) -> None:
    (run / "signatures" / file).rename(run / "signatures" / file.replace("reviewed", "released"))


def _stray(run: Path, file: str) -> None:
    (run / "signatures" / "notes.txt").write_text("hello")


@pytest.mark.parametrize("change", [_flip, _stolen, _other_run, _removed, _renamed, _stray])
def test_changes_of_signatures_are_found(run: Path, change: Callable[[Path, str], None]) -> None:
    file = sign(run)
    assert [one.standing for one in verify_run(run, ring_of(ANNA, BEN)).signatures] == ["valid"]
    assert verify_run(run, ring_of(ANNA, BEN)).changes == ()
    change(run, file)
    codes = {finding.code for _, finding in verify_run(run, ring_of(ANNA, BEN)).changes}
    assert codes == {"run-signature"}


def test_an_unknown_key_is_not_valid(run: Path) -> None:
    sign(run)
    for ring in (None, ring_of(BEN)):
        found = verify_run(run, ring)
        assert [one.standing for one in found.signatures] == ["unknown key"]
        assert found.changes == ()
    (revoked,) = verify_run(run, ring_of(ANNA, revoked=date(2099, 1, 1))).signatures
    assert (revoked.standing, revoked.why) == ("invalid", "the key was revoked on 2099-01-01")


def test_an_unsealed_or_changed_run_is_not_signed(run: Path, tmp_path: Path) -> None:
    write_private(tmp_path / "anna.pem", ANNA, WORDS)
    asked = ["sign", run, "--as", "reviewed", "--by", "anna.pem", "--name", "Anna"]
    with (run / "plan.yaml").open("ab") as opened:
        opened.write(b" ")
    done = planrunner(*asked, cwd=tmp_path, PLANRUNNER_PASSPHRASE=WORDS.decode())
    assert done.returncode == 4
    assert not (run / "signatures").exists()


@pytest.mark.slow
def test_every_changed_byte_of_a_signature_is_found(run: Path) -> None:
    path = run / "signatures" / sign(run)
    folder, ring, whole = GuardedFolder.open(run), ring_of(ANNA), path.read_bytes()
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert [one.standing for one in signatures_of(folder, ring)] != ["valid"], place
    path.write_bytes(whole)
    assert [one.standing for one in signatures_of(folder, ring)] == ["valid"]


# -- ssh-agent ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def agent(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """A real ssh-agent; its socket is in a short path."""
    if sys.platform == "win32" or not all(map(shutil.which, ("ssh-agent", "ssh-add", "ssh-keygen"))):
        pytest.skip("needs OpenSSH")
    folder = tmp_path_factory.mktemp("a")
    place = str(folder / "s")
    with subprocess.Popen(
        ["ssh-agent", "-D", "-a", place], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline()  # printed when the socket exists
            yield {**os.environ, "SSH_AUTH_SOCK": place, "FOLDER": str(folder)}
        finally:
            process.terminate()


def test_a_key_in_ssh_agent_signs(agent: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    file = Path(agent["FOLDER"], "id_ed25519")
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", file], check=True)
    subprocess.run(["ssh-add", "-q", file], env=agent, check=True)
    monkeypatch.setenv("SSH_AUTH_SOCK", agent["SSH_AUTH_SOCK"])
    public: PublicKey = parse_public(file.with_suffix(".pub").read_text())
    made = seal_envelope(PAYLOAD, b"payload", AgentKey(public))
    assert parse_envelope(made.to_bytes(), PAYLOAD).signed_by(public)
    with pytest.raises(InputError, match="did not sign"):
        AgentKey(ANNA.public).sign(b"message")
    monkeypatch.delenv("SSH_AUTH_SOCK")
    with pytest.raises(InputError, match="no ssh-agent"):
        AgentKey(public).sign(b"message")


# -- weak keys ---------------------------------------------------------------------------------------------------------

P = 2**255 - 19
D = -121665 * pow(121666, -1, P) % P


def decoded(raw: bytes) -> tuple[int, int] | None:
    """A point of edwards25519 (RFC 8032, 5.1.3), y taken modulo p; None if there is none."""
    number = int.from_bytes(raw, "little")
    y, sign = (number & (2**255 - 1)) % P, number >> 255
    square = (y * y - 1) * pow(D * y * y + 1, -1, P) % P
    x = pow(square, (P + 3) // 8, P)
    if x * x % P != square:
        x = x * pow(2, (P - 1) // 4, P) % P
    if x * x % P != square:
        return None
    return (P - x if x % 2 != sign else x) % P, y


def doubled(point: tuple[int, int]) -> tuple[int, int]:
    """RFC 8032, 5.1.4, in affine coordinates, for a point added to itself."""
    x, y = point
    t = D * x * x * y * y
    return 2 * x * y * pow(1 + t, -1, P) % P, (y * y + x * x) * pow(1 - t, -1, P) % P


def of_small_order(raw: bytes) -> bool:
    point = decoded(raw)
    return point is not None and doubled(doubled(doubled(point))) == (0, 1)


def test_keys_of_small_order_are_refused() -> None:
    """All encodings of the points of order 1, 2, 4 and 8, found by the curve's own formulas: y = 0, 1, −1 and the two of order 8, each
    with both signs, and those that exceed the modulus."""
    order_8 = int.from_bytes(
        bytes.fromhex("26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05"), "little"
    )
    coordinates = [0, 1, P - 1, P, P + 1, order_8, P - order_8]
    found = 0
    for y in coordinates:
        for sign in (0, 1):
            raw = (y | sign << 255).to_bytes(32, "little")
            if of_small_order(raw):
                found += 1
                with pytest.raises(ValueError, match="weak"):
                    parse_public(PublicKey(raw).line)
    assert found == 14
    assert not of_small_order(ANNA.public.raw)
    assert parse_public(ANNA.public.line) == ANNA.public


def test_a_ring_with_a_weak_key_or_another_algorithm_is_refused() -> None:
    weak = PublicKey(b"\x01" + bytes(31))
    for line in (weak.line, "ssh-rsa AAAAB3NzaC1yc2EAAAADAQABAAAAgQDf", "ssh-ed25519 AAAAB3NzaC1yc2EAAAADAQABAAAAgQDf"):
        with pytest.raises(InputError):
            parse_ring(f"planrunner_keys: 1\nkeys:\n  eve:\n    public: {line}\n", "keys.yaml")
