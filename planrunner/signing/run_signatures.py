"""Makes and reads electronic signatures of sealed runs: `signatures/<number>-<meaning>.dsse.json` in the run folder.

A signature is a DSSE envelope with an in-toto Statement v1 whose predicate is a test result
(https://in-toto.io/attestation/test-result/v0.1). The subjects of the statement are files, each with its digest: the seal, the
files with which the run began, the journal, the lists of digests of analyses, and the earlier signatures. The seal and the lists
contain the digests of all other files.

Persons sign what they have examined (`PersonMeaning`); their signatures cover all files that exist at that time. A bench uses its
own key to sign what it has made (`BenchMeaning`): the seal after it has recorded a run, and each analysis after it has evaluated a
run.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from datetime import datetime
from typing import Literal, get_args

from planrunner.archive import analyses as stored
from planrunner.archive import seal as seals
from planrunner.archive.formats import from_bytes
from planrunner.archive.journal import MOST_BYTES as MOST_OF_JOURNAL
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal import utc_now
from planrunner.archive.storage import ASIDE, Storage, digest_of
from planrunner.archive.verifying import (
    APPROVALS,
    BENCH,
    MOST_GIVEN,
    MOST_OF_APPROVALS,
    PLAN,
    RUN,
    SIGNATURES,
    Examined,
)
from planrunner.base.documents import JsonObject
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.signing.declared import declared
from planrunner.signing.envelope import (
    MOST_BYTES,
    PAYLOAD,
    STATEMENT,
    Envelope,
    EnvelopeError,
    parse_envelope,
    payload_of,
    read_statement,
    require_line,
    seal_envelope,
)
from planrunner.signing.key_ring import KeyRing, KnownKey
from planrunner.signing.keys import PublicKey, Signer, parse_public

PREDICATE = "https://in-toto.io/attestation/test-result/v0.1"

PersonMeaning = Literal["reviewed", "approved", "released"]
BenchMeaning = Literal["recorded", "evaluated"]
SignatureMeaning = Literal[PersonMeaning, BenchMeaning]
MEANINGS: tuple[PersonMeaning, ...] = get_args(PersonMeaning)
BENCH_MEANINGS: tuple[BenchMeaning, ...] = get_args(BenchMeaning)
BENCH_ROLE = "bench"
"""Role in a key ring that states that the key belongs to a bench. The owner is the name of the bench."""
TestResult = Literal["PASSED", "WARNED", "FAILED"]
SignatureStanding = Literal["valid", "unknown key", "invalid"]
_FILE = re.compile(rf"([0-9]{{4}})-({'|'.join((*MEANINGS, *BENCH_MEANINGS))})\.dsse\.json\Z")


@dataclass(frozen=True, slots=True)
class BenchSigning:
    """Contains what the files of a run state about the signatures of its bench.

    `key`: public key in the bench file; None if the bench file names none. `name`: name of the bench. `earlier_seals`: SHA-256 of
    the seals that existed before the run was opened again, according to its journal.
    """

    key: PublicKey | None = None
    name: str = ""
    earlier_seals: frozenset[str] = frozenset()


def bench_signing(bench: bytes | None, earlier_seals: Iterable[str] = ()) -> BenchSigning:
    """Reads what the files of a run state about the signatures of its bench. `bench`: text of the run's bench file.
    `earlier_seals`: the same as in `BenchSigning`."""
    stated, name = declared(bench, "signing"), declared(bench, "name")
    text = stated.get("key") if isinstance(stated, dict) else None
    try:
        key = parse_public(text) if isinstance(text, str) else None
    except ValueError:
        key = None
    return BenchSigning(key, name if isinstance(name, str) else "", frozenset(earlier_seals))


def signing_of(found: Examined) -> BenchSigning:
    """Reads what an examined run folder states about the signatures of its bench."""
    return bench_signing(found.given.get(BENCH), () if found.state is None else found.state.earlier_seals)


@dataclass(frozen=True, slots=True)
class RunSignature:
    """One signature of a run.

    `file`: name of the file in `signatures/`. `standing`: the result of the check. `standing` is `unknown key` if no key ring was
    given or if the ring lacks the key; all other values are then only claims. `why`: the reason why the signature is not valid;
    empty if it is valid. `owner`: the name of the key in the ring. `name`, `signed`, `comment`, `result`: what the signer states.
    `signed` is the time of signing, ISO 8601 in UTC. `analyses`: numbers of the analyses that the signature covers. `current`: True
    if the signature covers the present seal; False if a bench made it for a seal that the run had before it was reopened.
    """

    file: str
    standing: SignatureStanding
    why: str
    key: str
    owner: str = ""
    meaning: str = ""
    name: str = ""
    signed: str = ""
    comment: str = ""
    result: str = ""
    analyses: tuple[int, ...] = ()
    current: bool = True

    @property
    def by_bench(self) -> bool:
        return self.meaning in BENCH_MEANINGS

    def to_json(self) -> JsonObject:
        return {field.name: getattr(self, field.name) for field in fields(self)} | {"analyses": list(self.analyses)}


def statement(
    run: str, subjects: Mapping[str, str], result: TestResult, meaning: SignatureMeaning, name: str, comment: str
) -> JsonObject:
    """Returns the in-toto statement for a signature that is made now. `subjects`: maps each file in the run folder to its SHA-256."""
    given = [{"name": file, "digest": {"sha256": subjects[file]}} for file in (PLAN, BENCH)]
    return {
        "_type": STATEMENT,
        "subject": [{"name": file, "digest": {"sha256": value}} for file, value in subjects.items()],
        "predicateType": PREDICATE,
        "predicate": {
            "result": result,
            "configuration": given,
            "signature": {"run": run, "meaning": meaning, "name": name, "signed": utc_now(), "comment": comment},
        },
    }


def sign_run(
    folder: GuardedFolder,
    run: str,
    signer: Signer,
    result: TestResult,
    meaning: SignatureMeaning,
    name: str,
    comment: str = "",
    *,
    analyses: Iterable[int] | None = None,
) -> str:
    """Signs a run, which must have been verified as sealed and unchanged. Returns the name of the new file. The caller must hold
    the lock of the folder.

    `run`: name of the run. `analyses`: numbers of the analyses that the signature covers; by default, all analyses. Raises
    `InputError` if the name or the comment cannot be printed or if the key cannot sign, and `OSError` if the signature cannot be
    written.
    """
    require_line(str(folder.path), "name", name, 1)
    require_line(str(folder.path), "comment", comment)
    made = statement(run, _subjects(folder, analyses=analyses), result, meaning, name, comment)
    envelope = seal_envelope(PAYLOAD, payload_of(made), signer)
    storage = Storage()
    if folder.entry(SIGNATURES) is None:
        storage.make_folder(folder, SIGNATURES)
        storage.sync_folder(folder)
    within = folder.folder(SIGNATURES)
    number = 1 + max((int(match[1]) for match in map(_FILE.match, within.entries()) if match), default=0)
    file = f"{number:04d}-{meaning}.dsse.json"
    storage.write_whole(within, file, envelope.to_bytes())
    return file


def signatures_of(
    folder: GuardedFolder, ring: KeyRing | None = None, bench: BenchSigning | None = None
) -> tuple[RunSignature, ...]:
    """Returns all signatures of a run in the order of their numbers, each checked against the key ring and against the files as
    they are now.

    `bench`: what the run states about the signatures of its bench; by default, this is read from the run folder. Raises `OSError`
    if a file cannot be read.
    """
    bench = bench or bench_signing(folder.read(BENCH, MOST_GIVEN))
    return tuple(_examined(folder, file, ring, bench) for file in _files(folder))


def signature_faults(folder: GuardedFolder) -> Iterator[str]:
    """Reports entries of `signatures/` that are not signatures, and gaps in the numbers of the signatures. Raises `OSError` if the
    folder cannot be read."""
    numbers = []
    if folder.entry(SIGNATURES) is None:
        return
    within = folder.folder(SIGNATURES)
    for name, entry in within.entries().items():
        match = _FILE.match(name)
        if match is not None and entry.kind == "file":
            numbers.append(int(match[1]))
        elif not (name.endswith(ASIDE) and entry.kind == "file"):
            yield f"{within.path / name}: {entry.what} that is not a signature of planrunner"
    if sorted(numbers) != list(range(1, len(numbers) + 1)):
        yield f"{within.path}: the signatures are not numbered from 1 without gaps: one was removed or added"


def _files(folder: GuardedFolder) -> list[str]:
    if folder.entry(SIGNATURES) is None:
        return []
    return [name for name in folder.folder(SIGNATURES).entries() if _FILE.match(name)]


def _examined(folder: GuardedFolder, file: str, ring: KeyRing | None, bench: BenchSigning) -> RunSignature:
    try:
        envelope = parse_envelope(folder.folder(SIGNATURES).read(file, MOST_BYTES), PAYLOAD)
    except (OSError, EnvelopeError) as error:
        return RunSignature(file, "invalid", f"the file cannot be read as a signature: {error}", "")
    known = None if ring is None else ring.find(envelope.key)
    own = bench.key is not None and envelope.key == bench.key.fingerprint
    public = known.public if known is not None else bench.key if own else None
    if public is not None and not envelope.signed_by(public):
        owner = "" if known is None else known.name
        return RunSignature(file, "invalid", "the signature does not match its content", envelope.key, owner)
    try:
        found = _read(file, envelope)
    except (ValueError, KeyError, TypeError):
        why = "its content is not a statement about a run"
        return RunSignature(file, "invalid", why, envelope.key)
    subjects, claimed, run = found
    earlier = claimed.by_bench and subjects.get(seals.NAME) in bench.earlier_seals
    claimed = replace(claimed, current=not earlier)
    why = _other_signer(claimed, known, own=own) or _difference(folder, file, subjects, run, earlier=earlier)
    if why:
        return _with(claimed, "invalid", why)
    if known is None:
        if claimed.by_bench and ring is not None and _benches(ring):
            return _with(claimed, "invalid", "its key is not that of a bench in the key ring")
        why = "no key ring was given" if ring is None else "its key is not in the key ring"
        return _with(claimed, "unknown key", why)
    why = known.objection(datetime.fromisoformat(claimed.signed).date())
    return _with(claimed, "invalid" if why else "valid", why, known.name)


def _other_signer(claimed: RunSignature, known: KnownKey | None, *, own: bool) -> str:
    """Returns the reason why a key must not make a signature of this meaning; empty if the key may make it. `own`: True if the key
    is the one in the bench file."""
    bench = known is not None and BENCH_ROLE in known.roles
    if not claimed.by_bench:
        return "a person must sign it, but the key is that of a bench" if own or bench else ""
    if not own:
        return "the bench must sign it, but the key is not the one in the bench file"
    if known is not None and not bench:
        return f"the key of {known.name} does not have the role `{BENCH_ROLE}` in the key ring"
    return ""


def _benches(ring: KeyRing) -> list[KnownKey]:
    return [one for one in ring.keys.values() if BENCH_ROLE in one.roles]


def lacking_signatures(
    signatures: Iterable[RunSignature],
    bench: BenchSigning,
    made: datetime,
    analyses: Iterable[int],
    ring: KeyRing | None,
) -> Iterator[tuple[str, str]]:
    """Yields the missing signatures that the bench of a sealed run must make, each as a code and a message.

    The bench file requires signatures if it names a key. The key ring also requires them if it contains a key of the bench that is
    valid on the day of the run. The requirement therefore remains even if the bench file is changed or the key is revoked. `made`:
    time when the run began. `analyses`: numbers of the analyses of the run. A person may evaluate a run elsewhere. Therefore, a
    person's signature of an analysis can replace the signature of the bench. If a key ring is given, it must contain the person's
    key.
    """
    day = made.date()
    expected = [one for one in ([] if ring is None else _benches(ring)) if one.person == bench.name]
    expected = [one for one in expected if (one.begins or day) <= day <= (one.ends or day)]
    if expected and bench.key not in [one.public for one in expected]:
        what = "names no key of its own" if bench.key is None else "names another key"
        message = f"{BENCH}: the bench '{bench.name}' {what}, but the key ring has the key of this bench"
        yield "run-bench-unsigned", message
        return
    if bench.key is None:
        return
    good = [one for one in signatures if one.standing != "invalid"]
    if not any(one.by_bench and one.current for one in good):
        message = (
            f"{seals.NAME} is not signed by the key of its bench ({bench.key.fingerprint}): the signature was removed, or the key was "
            "not available"
        )
        yield "run-bench-unsigned", message
        return
    counts = [one for one in good if one.by_bench or ring is None or one.standing == "valid"]
    covered = {number for one in counts for number in one.analyses}
    for number in sorted(set(analyses) - covered):
        message = f"{stored.FOLDER}/{number}: the bench signs its runs, but neither the bench nor a person signed this analysis"
        yield "run-analysis-unsigned", message


def _with(claimed: RunSignature, standing: SignatureStanding, why: str, owner: str = "") -> RunSignature:
    return replace(claimed, standing=standing, why=why, owner=owner)


def _read(file: str, envelope: Envelope) -> tuple[dict[str, str], RunSignature, str]:
    """Reads the subjects, the claims and the name of the run from an envelope. Raises ValueError, KeyError or TypeError for an
    envelope of any other form."""
    value = read_statement(envelope.payload, PREDICATE)
    listed = [(one["name"], one["digest"]["sha256"]) for one in value["subject"]]
    predicate = value["predicate"]
    told = predicate["signature"]
    texts = [told[name] for name in ("run", "meaning", "name", "signed", "comment")] + [predicate["result"]]
    run, meaning, name, signed, comment, result = texts
    if not all(
        isinstance(text, str) and text.isprintable() for text in [*texts, *(text for one in listed for text in one)]
    ):
        raise ValueError
    if len(dict(listed)) != len(listed) or result not in get_args(TestResult) or f"-{meaning}." not in file:
        raise ValueError
    if datetime.fromisoformat(signed).tzinfo is None:
        raise ValueError
    subjects = dict(listed)
    listed_analyses = (one.split("/") for one in subjects if one.startswith(f"{stored.FOLDER}/"))
    numbers = tuple(sorted(int(parts[1]) for parts in listed_analyses))
    return (
        subjects,
        RunSignature(file, "invalid", "", envelope.key, "", meaning, name, signed, comment, result, numbers),
        run,
    )


def _difference(folder: GuardedFolder, file: str, subjects: Mapping[str, str], run: str, *, earlier: bool) -> str:
    """Describes in words the first difference between the signed digests and the present files; empty if there is no difference.
    Analyses and signatures that were added later are not a difference.

    `earlier`: True if the signature covers a seal that the run had before it was reopened. In this case, the present seal and
    journal may differ from the signed files, because the journal contains the digest of the earlier seal.
    """
    try:
        present = _subjects(folder, before=file)
        name = from_bytes(folder.read(RUN, MOST_GIVEN))["run"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"the signed files cannot be read: {error}"
    if name != run:
        return f"it is a signature of another run, {run}"
    for one in sorted({RUN, PLAN, BENCH, JOURNAL, seals.NAME} | set(subjects)):
        if one not in subjects:
            return f"it does not cover {one}"
        if one not in present:
            return f"{one} was signed, but is missing"
        if present[one] != subjects[one] and not (earlier and one in (JOURNAL, seals.NAME)):
            return f"{one} differs from what was signed"
    smaller = {one for one in present if one.startswith(f"{SIGNATURES}/")} - set(subjects)
    if smaller:
        return f"it does not cover {min(smaller)}, which has a smaller number"
    return ""


def _subjects(
    folder: GuardedFolder, before: str | None = None, analyses: Iterable[int] | None = None
) -> dict[str, str]:
    """Maps each file that a signature covers to its SHA-256 digest. `before`: file of a signature; this signature and all later
    signatures are omitted. `analyses`: numbers of the analyses; by default, all analyses. Raises `OSError` if a file cannot be
    read."""
    limits = {
        RUN: MOST_GIVEN,
        PLAN: MOST_GIVEN,
        BENCH: MOST_GIVEN,
        JOURNAL: MOST_OF_JOURNAL,
        seals.NAME: seals.MOST_BYTES,
    }
    if folder.entry(APPROVALS) is not None:
        limits[APPROVALS] = MOST_OF_APPROVALS
    found = {name: _digest(folder, name, limit) for name, limit in limits.items()}
    for number in stored.numbers(folder) if analyses is None else analyses:
        within = folder.folder(stored.FOLDER).folder(str(number))
        found[f"{stored.FOLDER}/{number}/{stored.DIGESTS}"] = _digest(within, stored.DIGESTS, stored.MOST_DIGESTS)
    for name in _files(folder):
        if before is None or name < before:
            found[f"{SIGNATURES}/{name}"] = _digest(folder.folder(SIGNATURES), name, MOST_BYTES)
    return found


def _digest(folder: GuardedFolder, name: str, limit: int) -> str:
    with folder.open_file(name, limit) as file:
        return digest_of(file)
