"""Which approvals count: every reason against one, forgeries, clocks, and any mixture of persons."""

from __future__ import annotations

import base64
import json
import random
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime, time, timedelta

import pytest
from approved import (
    ANNA,
    ASKED,
    BEN,
    BENCH,
    CARLA,
    DAY,
    EVE,
    NOON,
    OTHER,
    PLAN,
    RING,
    RULE,
    TOKEN,
    WHAT,
    approval,
    file_of,
    ring_with,
    signed,
    withdrawal,
)
from hypothesis import given
from hypothesis import strategies as st
from respelling import STYLES, with_keys_shuffled, with_other_units
from test_mutants import MUTATIONS, bases, copied

from planrunner.base.findings import InputError
from planrunner.bench.signatures import ApprovalRule
from planrunner.plan.model import parse_plan
from planrunner.review.approvals import (
    APPROVAL,
    DECLARED,
    ApprovalRecord,
    ApprovalRequest,
    Approved,
    ApprovedBench,
    DamagedApproval,
    StatedApproval,
    judged,
    read_stated,
)
from planrunner.review.meaning import meaning_of_plan, procedure_of
from planrunner.signing.envelope import PAYLOAD, STATEMENT, Envelope, pae, payload_of, seal_envelope
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.keys import PrivateKey, PublicKey
from planrunner.signing.run_signatures import PREDICATE

BY_CARLA = ("carla",)


def standing(
    stated: ApprovalRecord, rule: ApprovalRule = RULE, ring: KeyRing = RING, asked: ApprovalRequest = ASKED
) -> str:
    (one,), met = judged([stated], rule, ring, asked)
    assert met == (one.standing == "counts")
    assert (one.why == "") == (one.standing == "counts")
    return one.standing


def rule(**changes: object) -> ApprovalRule:
    made: ApprovalRule = replace(RULE, **changes)  # type: ignore[arg-type]
    return made


CASES: dict[str, Callable[[], str]] = {
    "counts": lambda: standing(approval()),
    "unknown key": lambda: standing(approval(EVE)),
    "revoked": lambda: standing(approval(), ring=ring_with(ANNA, revoked=date(2026, 5, 9))),
    "key dates": lambda: standing(approval(), ring=ring_with(ANNA, ends=date(2026, 5, 9))),
    "future": lambda: standing(approval(at="2026-05-10T14:00:00.000000+00:00")),
    "expired": lambda: standing(approval(what=replace(WHAT, until=date(2026, 5, 9)))),
    "another plan": lambda: standing(approval(what=replace(WHAT, plan=OTHER))),
    "another bench": lambda: standing(approval(what=replace(WHAT, benches=(ApprovedBench("lab", OTHER),)))),
    "another author": lambda: standing(approval(what=replace(WHAT, author=("ben",)))),
    "not named": lambda: standing(approval(), rule(by=("ben",))),
    "role": lambda: standing(approval(), rule(roles=("head",))),
    "author": lambda: standing(approval(CARLA)),
    "damaged": lambda: standing(DamagedApproval("x", "it is not JSON")),
}


@pytest.mark.parametrize("name", CASES)
def test_every_reason_against_an_approval(name: str) -> None:
    assert CASES[name]() == name


@pytest.mark.parametrize(
    ("stated", "changes"),
    [
        (approval(what=replace(WHAT, until=DAY)), {}),
        (approval(BEN), {"roles": ("reviewer", "other")}),
        (approval(TOKEN), {"by": ("anna",)}),
        (approval(TOKEN), {"by": ("anna-token",)}),
        (approval(CARLA), {"author_may_approve": True}),
        (approval(what=replace(WHAT, benches=(ApprovedBench("x", OTHER), ApprovedBench("lab", BENCH)))), {}),
    ],
    ids=["on the last day", "one of the roles", "second key", "second key by name", "author", "one of the benches"],
)
def test_what_counts(stated: StatedApproval, changes: dict[str, object]) -> None:
    assert standing(stated, rule(**changes)) == "counts"


def test_one_person_counts_once() -> None:
    twice = [approval(), approval(TOKEN, at="2026-05-02T12:00:00.000000+00:00")]
    found, met = judged(twice, rule(required=2), RING, ASKED)
    assert ([one.standing for one in found], met) == (["counts", "same person"], False)
    found, met = judged([*twice, approval(BEN)], rule(required=2), RING, ASKED)
    assert met
    assert judged([twice[0]] * 5, rule(required=2), RING, ASKED)[1] is False


@pytest.mark.parametrize("author", [(), ("dora",), ("carla", "dora")], ids=["none", "unknown", "one unknown"])
def test_an_author_who_cannot_be_determined_may_be_the_reviewer(author: tuple[str, ...]) -> None:
    asked, made = replace(ASKED, author=author), approval(what=replace(WHAT, author=author))
    assert judged([made], RULE, RING, asked)[1] is False
    assert judged([made], rule(author_may_approve=True), RING, asked)[1] is True


def test_an_author_with_a_second_key_is_known() -> None:
    asked, made = replace(ASKED, author=("anna",)), approval(TOKEN, what=replace(WHAT, author=("anna",)))
    assert standing(made, asked=asked) == "author"


def test_a_withdrawal_counts_for_the_key_that_approved_only() -> None:
    first, second = approval(), approval(at="2026-05-03T12:00:00.000000+00:00")
    by_other, met = judged([first, withdrawal(BEN, first)], RULE, RING, ASKED)
    assert (by_other[0].standing, met) == ("counts", True)
    (one,), met = judged([first, withdrawal(ANNA, first)], RULE, RING, ASKED)
    assert (one.standing, met) == ("withdrawn", False)
    found, met = judged([first, withdrawal(ANNA, first), second], RULE, RING, ASKED)
    assert ([item.standing for item in found], met) == (["withdrawn", "counts"], True)
    assert standing(first, rule(withdrawn=(first.digest,))) == "withdrawn"


# -- forgeries ---------------------------------------------------------------------------------------------------------


def forged(change: Callable[[dict[str, object]], None], key: PrivateKey = ANNA) -> bytes:
    """An envelope that the key really signed, with another content."""
    value = json.loads(base64.b64decode(json.loads(signed(key))["payload"]))
    change(value)
    return seal_envelope(PAYLOAD, payload_of(value), key).to_bytes()


def stolen(key: PrivateKey = EVE) -> bytes:
    """The payload of Anna, signed by another key under her fingerprint."""
    payload = base64.b64decode(json.loads(signed())["payload"])
    return Envelope(PAYLOAD, payload, ANNA.public.fingerprint, key.sign(pae(PAYLOAD, payload))).to_bytes()


def with_signature(change: Callable[[bytes], bytes]) -> bytes:
    value = json.loads(signed())
    signature = change(base64.b64decode(value["signatures"][0]["sig"]))
    payload = base64.b64decode(value["payload"])
    return Envelope(PAYLOAD, payload, ANNA.public.fingerprint, signature).to_bytes()


L = 2**252 + 27742317777372353535851937790883648493
"""Order of the base point (RFC 8032, 5.1)."""


def plus_order(signature: bytes) -> bytes:
    """S + L in place of S, which satisfies the equation too (RFC 8032, 5.1.7 requires S < L)."""
    return signature[:32] + (int.from_bytes(signature[32:], "little") + L).to_bytes(32, "little")


def other_type() -> bytes:
    payload = base64.b64decode(json.loads(signed())["payload"])
    return seal_envelope("text/plain", payload, ANNA).to_bytes()


def type_renamed() -> bytes:
    """An envelope of another type whose type is rewritten: the signature covers the type."""
    payload = base64.b64decode(json.loads(signed())["payload"])
    made = seal_envelope("text/plain", payload, ANNA)
    return Envelope(PAYLOAD, payload, made.key, made.signature).to_bytes()


def run_signature() -> bytes:
    """What `planrunner sign` makes: the same payload type, another predicate."""
    predicate = {"result": "PASSED", "configuration": [], "signature": {"meaning": "approved", "name": "Anna"}}
    subject = [{"name": "plan.yaml", "digest": {"sha256": PLAN}}]
    value = {"_type": STATEMENT, "subject": subject, "predicateType": PREDICATE, "predicate": predicate}
    return seal_envelope(PAYLOAD, payload_of(value), ANNA).to_bytes()


def two_signatures() -> bytes:
    value = json.loads(signed())
    value["signatures"] += json.loads(signed(BEN))["signatures"]
    return json.dumps(value).encode()


def with_subject(name: str, digest: str) -> bytes:
    def change(value: dict[str, object]) -> None:
        value["subject"] = [{"name": name, "digest": {"sha256": digest}}]

    return forged(change)


def with_predicate(**entries: object) -> bytes:
    def change(value: dict[str, object]) -> None:
        predicate = value["predicate"]
        assert isinstance(predicate, dict)
        predicate.update(entries)

    return forged(change)


FORGERIES: dict[str, Callable[[], bytes]] = {
    "stolen name": stolen,
    "S + L": lambda: with_signature(plus_order),
    "signature of zeros": lambda: with_signature(lambda _: bytes(64)),
    "short signature": lambda: with_signature(lambda signature: signature[:63]),
    "long signature": lambda: with_signature(lambda signature: signature + b"\0"),
    "no signature": lambda: with_signature(lambda _: b""),
    "other type": other_type,
    "type renamed": type_renamed,
    "signature of a run": run_signature,
    "two signatures": two_signatures,
    "another subject": lambda: with_subject("bench", PLAN),
    "short digest": lambda: with_subject("plan", PLAN[:40]),
    "digest in capitals": lambda: with_subject("plan", PLAN[:-1] + "A"),
    "no benches": lambda: with_predicate(benches=[]),
    "one more entry": lambda: with_predicate(role="head"),
    "until is no date": lambda: with_predicate(until="2099-02-30"),
    "until in another form": lambda: with_predicate(until="20990228"),
    "local time": lambda: with_predicate(signed="2026-05-01T12:00:00+02:00"),
    "no time zone": lambda: with_predicate(signed="2026-05-01T12:00:00"),
    "escape sequence in the name": lambda: with_predicate(name="Anna\x1b[2J"),
    "reversed name": lambda: with_predicate(name="\u202eannA"),
    "name with two lines": lambda: with_predicate(name="Anna\nBen"),
    "number as a name": lambda: with_predicate(name=1),
    "empty file": lambda: b"",
    "not JSON": lambda: b"\xff\xfe",
    "deep": lambda: b"[" * 100_000,
}


@pytest.mark.parametrize("name", FORGERIES)
def test_no_forgery_counts(name: str) -> None:
    assert standing(read_stated(file_of(), FORGERIES[name]())) == "damaged"


def test_the_unchanged_original_counts() -> None:
    """So that the forgeries fail for the change that they make."""
    assert standing(read_stated(file_of(), forged(lambda value: None))) == "counts"
    assert standing(read_stated(file_of(), with_signature(bytes))) == "counts"


def test_every_truncation_is_damaged() -> None:
    whole = signed()
    for size in range(len(whole)):
        assert standing(read_stated(file_of(), whole[:size])) == "damaged", size
    assert standing(read_stated(file_of(), whole)) == "counts"


@given(place=st.integers(0, len(signed()) - 1), bit=st.integers(0, 7))
def test_no_flipped_bit_counts(place: int, bit: int) -> None:
    data = bytearray(signed())
    data[place] ^= 1 << bit
    assert standing(read_stated(file_of(), bytes(data))) in ("damaged", "unknown key")


@pytest.mark.slow
def test_no_flipped_bit_of_any_byte_counts() -> None:
    whole = signed()
    for place in range(len(whole)):
        for bit in range(8):
            data = bytearray(whole)
            data[place] ^= 1 << bit
            found, met = judged([read_stated(file_of(), bytes(data))], RULE, RING, ASKED)
            assert not met and found[0].standing in ("damaged", "unknown key"), (place, bit)


def test_key_confusion_does_not_count() -> None:
    """The fingerprint of one known key with the signature of another known key, and the keys of two persons exchanged in the ring."""
    assert standing(read_stated(file_of(), stolen(BEN))) == "damaged"
    anna, ben = RING.keys[ANNA.public.fingerprint], RING.keys[BEN.public.fingerprint]
    exchanged = {ANNA.public.fingerprint: ben, BEN.public.fingerprint: anna}
    assert standing(approval(), ring=KeyRing(exchanged)) == "damaged"


def test_a_replayed_approval_counts_for_its_plan_and_bench_only() -> None:
    once = approval()
    for asked in (replace(ASKED, plan=OTHER), replace(ASKED, bench=OTHER), replace(ASKED, plan=BENCH, bench=PLAN)):
        assert standing(once, asked=asked) in ("another plan", "another bench")


# -- clocks ------------------------------------------------------------------------------------------------------------

DAYS = st.dates(date(2026, 1, 1), date(2026, 1, 12))


@given(run=DAYS, made=DAYS, until=st.none() | DAYS, begins=st.none() | DAYS, ends=st.none() | DAYS)
def test_dates_count_as_a_calendar_says(
    run: date, made: date, until: date | None, begins: date | None, ends: date | None
) -> None:
    """Written again with ordinals of days: an approval counts from its day to its last day, within the days of the key."""
    asked = replace(ASKED, moment=datetime.combine(run, time(12), UTC), day=run)
    found = standing(
        approval(what=replace(WHAT, until=until), at=f"{made}T12:00:00.000000+00:00"),
        ring=ring_with(ANNA, begins, ends),
        asked=asked,
    )
    first, last = 0, 10**7
    key = range(begins.toordinal() if begins else first, (ends.toordinal() if ends else last) + 1)
    allowed = range(made.toordinal(), (until.toordinal() if until else last) + 1)
    assert (found == "counts") == (run.toordinal() in key and made.toordinal() in key and run.toordinal() in allowed)


@pytest.mark.parametrize(("minutes", "expected"), [(-1, "counts"), (0, "counts"), (59, "counts"), (61, "future")])
def test_clocks_may_differ_by_an_hour(minutes: int, expected: str) -> None:
    at = (NOON + timedelta(minutes=minutes)).isoformat(timespec="microseconds")
    assert standing(approval(at=at)) == expected


# -- any mixture -------------------------------------------------------------------------------------------------------

KEYS = {"anna": ANNA, "ben": BEN, "carla": CARLA, "anna-token": TOKEN, "eve": EVE}
PERSONS = {"anna": "anna", "ben": "ben", "carla": "carla", "anna-token": "anna"}


@given(
    given_by=st.lists(st.tuples(st.sampled_from(sorted(KEYS)), st.booleans(), st.booleans()), max_size=8),
    required=st.integers(1, 3),
)
def test_persons_are_counted_whatever_else_is_there(given_by: list[tuple[str, bool, bool]], required: int) -> None:
    """Each entry: the key, whether it is for this plan, whether it was withdrawn."""
    stated: list[ApprovalRecord] = []
    persons = set()
    for number, (name, this, gone) in enumerate(given_by):
        what = WHAT if this else replace(WHAT, plan=OTHER)
        one = approval(KEYS[name], what, f"2026-05-01T12:00:{number:02}.000000+00:00")
        stated += [one, withdrawal(KEYS[name], one)] if gone else [one]
        if name != "eve" and this and not gone:
            persons.add(PERSONS[name])
    found, met = judged(stated, rule(required=required, author_may_approve=True), RING, ASKED)
    assert {one.person for one in found if one.standing == "counts"} == persons
    assert sum(one.standing == "counts" for one in found) == len(persons)
    assert met == (len(persons) >= required)


def test_the_statement_is_what_the_docs_say() -> None:
    """Canonical JSON, with the digest of the plan as its only subject."""
    envelope = json.loads(signed(what=Approved(PLAN, "t", BY_CARLA, (ApprovedBench("lab", BENCH),), DAY), name="Anna"))
    assert envelope["payloadType"] == "application/vnd.in-toto+json"
    assert json.loads(base64.b64decode(envelope["payload"])) == {
        "_type": "https://in-toto.io/Statement/v1",
        "subject": [{"name": "plan", "digest": {"sha256": PLAN}}],
        "predicateType": APPROVAL,
        "predicate": {
            "title": "t",
            "author": ["carla"],
            "benches": [{"name": "lab", "sha256": BENCH}],
            "until": "2026-05-10",
            "name": "Anna",
            "statement": DECLARED,
            "signed": "2026-05-01T12:00:00.000000+00:00",
            "planrunner": json.loads(base64.b64decode(envelope["payload"]))["predicate"]["planrunner"],
        },
    }


# -- meaning -----------------------------------------------------------------------------------------------------------


def digest(data: object, rng: random.Random) -> str | None:
    """The digest that an approval of this plan is bound to, in any spelling; None if the plan is not sound."""
    spelt = rng.choice(STYLES)(with_keys_shuffled(with_other_units(data, rng), rng), rng)
    plan, log = parse_plan(spelt, "plan")
    try:
        return None if plan is None or log.errors else procedure_of(plan).digest()
    except InputError:
        return None


@pytest.mark.slow
def test_spellings_keep_and_mutants_lose_an_approval() -> None:
    """With the mutations and spellings by which `diff` is tested. A change of the bench alone is not one of the plan: an approval names its
    benches by themselves."""
    rng = random.Random(40)
    kept = lost = 0
    while lost < 400:
        base = bases()[rng.randrange(len(bases()))]
        data = copied(base)
        rng.choice(MUTATIONS)(data, rng)
        before, again, after = digest(base, rng), digest(base, rng), digest(data, rng)
        assert before is not None and before == again
        kept += 1
        if after is None or {**data, "bench": ""} == {**base, "bench": ""} or _same_meaning(base, data):
            assert after in (None, before)
            continue
        assert after != before, data
        lost += 1
    assert kept >= lost


def _same_meaning(base: object, data: object) -> bool:
    """Whether the canonical documents apart from the bench are equal, computed from the whole meanings."""
    found = []
    for item in (base, data):
        plan, log = parse_plan(json.dumps(item, ensure_ascii=False), "plan")
        assert plan is not None and not log.errors
        document = meaning_of_plan(plan).document()["plan"]
        found.append({name: part for name, part in document.items() if name != "bench"})
    return found[0] == found[1]


def test_a_key_under_which_any_signature_holds_is_not_known() -> None:
    """With the neutral element as public key, R = S·B for any S is a signature of any message; see also `tests/signing`."""
    neutral = PublicKey(b"\x01" + bytes(31))
    assert neutral.signed(b"\x01" + bytes(63), b"anything")
