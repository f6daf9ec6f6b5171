"""Keys, key rings and approvals for tests."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from planrunner.bench.signatures import ApprovalRule
from planrunner.review.approvals import (
    DECLARED,
    ApprovalRequest,
    Approved,
    ApprovedBench,
    StatedApproval,
    StatedWithdrawal,
    approval_envelope,
    read_stated,
    withdrawal_envelope,
)
from planrunner.signing.key_ring import KeyRing, KnownKey
from planrunner.signing.keys import PrivateKey

PLAN, BENCH, OTHER = ("1" * 64, "2" * 64, "3" * 64)
DAY = date(2026, 5, 10)
NOON = datetime(2026, 5, 10, 12, tzinfo=UTC)
ASKED = ApprovalRequest(PLAN, BENCH, ("carla",), NOON, DAY)
WHAT = Approved(PLAN, "a plan", ("carla",), (ApprovedBench("lab", BENCH),))


def key_of(number: int) -> PrivateKey:
    return PrivateKey(Ed25519PrivateKey.from_private_bytes(bytes([number]) * 32))


ANNA, BEN, CARLA, EVE, TOKEN = (key_of(number) for number in range(1, 6))
RING = KeyRing(
    {
        one.public.fingerprint: one
        for one in (
            KnownKey("anna", ANNA.public, ("reviewer",)),
            KnownKey("ben", BEN.public, ("reviewer", "head")),
            KnownKey("carla", CARLA.public, ("author",)),
            KnownKey("anna-token", TOKEN.public, ("reviewer",), owner="anna"),
        )
    }
)
RULE = ApprovalRule(keys="lab-keys.yaml")


def ring_with(
    key: PrivateKey, begins: date | None = None, ends: date | None = None, revoked: date | None = None
) -> KeyRing:
    """The ring with these dates in the entry of a key."""
    known = RING.find(key.public.fingerprint)
    assert known is not None
    return KeyRing({**RING.keys, key.public.fingerprint: replace(known, begins=begins, ends=ends, revoked=revoked)})


def file_of(number: int = 1) -> str:
    return f"20260501T120000Z-{number:016x}.dsse.json"


def signed(
    key: PrivateKey = ANNA, what: Approved = WHAT, at: str = "2026-05-01T12:00:00.000000+00:00", name: str = "A"
) -> bytes:
    return approval_envelope(what, name, DECLARED, key, at).to_bytes()


def approval(
    key: PrivateKey = ANNA, what: Approved = WHAT, at: str = "2026-05-01T12:00:00.000000+00:00", name: str = "A"
) -> StatedApproval:
    found = read_stated(file_of(), signed(key, what, at, name))
    assert isinstance(found, StatedApproval)
    return found


def withdrawal(key: PrivateKey, *approvals: StatedApproval) -> StatedWithdrawal:
    gone = {one.file: one.digest for one in approvals}
    made = withdrawal_envelope(gone, "A", "a mistake", key, "2026-05-02T12:00:00.000000+00:00")
    found = read_stated(file_of(2), made.to_bytes())
    assert isinstance(found, StatedWithdrawal)
    return found
