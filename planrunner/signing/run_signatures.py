"""Electronic signatures of sealed runs: `signatures/<number>-<meaning>.dsse.json` in the run folder.

A signature is a DSSE envelope with an in-toto Statement v1 whose predicate is a test result
(https://in-toto.io/attestation/test-result/v0.1). Its subjects are the digests of the seal, the files that the run was given, the journal,
the lists of digests of all analyses, and the signatures before it. The seal and these lists contain the digests of everything else.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Literal, get_args

from planrunner.archive import analyses as stored
from planrunner.archive import seal as seals
from planrunner.archive.formats import from_bytes
from planrunner.archive.journal import MOST_BYTES as MOST_OF_JOURNAL
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.journal import utc_now
from planrunner.archive.storage import ASIDE, Storage, digest_of
from planrunner.archive.verifying import BENCH, MOST_GIVEN, PLAN, RUN, SIGNATURES
from planrunner.base.documents import JsonObject
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.signing.envelope import Envelope, EnvelopeError, parse_envelope, seal_envelope
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.keys import Signer
from planrunner.signing.statement import MOST_BYTES, PAYLOAD, STATEMENT, payload_of, read_statement, require_line

PREDICATE = "https://in-toto.io/attestation/test-result/v0.1"

SignatureMeaning = Literal["reviewed", "approved", "released"]
MEANINGS: tuple[SignatureMeaning, ...] = get_args(SignatureMeaning)
TestResult = Literal["PASSED", "WARNED", "FAILED"]
SignatureStanding = Literal["valid", "unknown key", "invalid"]
_FILE = re.compile(r"([0-9]{4})-(reviewed|approved|released)\.dsse\.json\Z")


@dataclass(frozen=True, slots=True)
class RunSignature:
    """One signature of a run.

    file: its name in `signatures/`. standing: `unknown key` if no key ring was given or the key is not in it; then the other values are
    only claimed. why: the reason if it is not valid. owner: the name of the key in the ring. name, signed, comment, result: as stated by
    the signer; signed is UTC, ISO 8601. analyses: number of analyses that the signature covers.
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
    analyses: int = 0

    def to_json(self) -> JsonObject:
        return {name: getattr(self, name) for name in self.__slots__}


def statement(
    run: str, subjects: Mapping[str, str], result: TestResult, meaning: SignatureMeaning, name: str, comment: str
) -> JsonObject:
    """The in-toto statement of a signature made now. subjects: file in the run folder → SHA-256."""
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
) -> str:
    """Signs a run that was verified as sealed and unchanged; returns the name of the new file.

    run: its name. Raises `InputError` for a name or comment that cannot be printed, and `OSError`.
    """
    require_line(str(folder.path), "name", name, 1)
    require_line(str(folder.path), "comment", comment)
    made = statement(run, _subjects(folder), result, meaning, name, comment)
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


def signatures_of(folder: GuardedFolder, ring: KeyRing | None = None) -> tuple[RunSignature, ...]:
    """All signatures of a run in the order of their numbers, each checked against the key ring and the present files. Raises `OSError`."""
    return tuple(_examined(folder, file, ring) for file in _files(folder))


def signature_faults(folder: GuardedFolder) -> Iterator[str]:
    """Entries of `signatures/` that are no signatures, and gaps in their numbers. Raises `OSError`."""
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


def _examined(folder: GuardedFolder, file: str, ring: KeyRing | None) -> RunSignature:
    try:
        envelope = parse_envelope(folder.folder(SIGNATURES).read(file, MOST_BYTES), PAYLOAD)
    except (OSError, EnvelopeError) as error:
        return RunSignature(file, "invalid", f"the file cannot be read as a signature: {error}", "")
    known = None if ring is None else ring.find(envelope.key)
    if known is not None and not envelope.signed_by(known.public):
        return RunSignature(file, "invalid", "the signature does not match its content", envelope.key, known.name)
    try:
        found = _read(file, envelope)
    except (ValueError, KeyError, TypeError):
        why = "its content is not a statement about a run"
        return RunSignature(file, "invalid", why, envelope.key)
    subjects, claimed, run = found
    why = _difference(folder, file, subjects, run)
    if why:
        return _with(claimed, "invalid", why)
    if known is None:
        why = "no key ring was given" if ring is None else "its key is not in the key ring"
        return _with(claimed, "unknown key", why)
    why = known.objection(datetime.fromisoformat(claimed.signed).date())
    return _with(claimed, "invalid" if why else "valid", why, known.name)


def _with(claimed: RunSignature, standing: SignatureStanding, why: str, owner: str = "") -> RunSignature:
    return replace(claimed, standing=standing, why=why, owner=owner)


def _read(file: str, envelope: Envelope) -> tuple[dict[str, str], RunSignature, str]:
    """Subjects, claims and name of the run of an envelope. Raises ValueError, KeyError or TypeError for any other form."""
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
    count = sum(one.startswith(f"{stored.FOLDER}/") for one in subjects)
    return (
        subjects,
        RunSignature(file, "invalid", "", envelope.key, "", meaning, name, signed, comment, result, count),
        run,
    )


def _difference(folder: GuardedFolder, file: str, subjects: Mapping[str, str], run: str) -> str:
    """What differs between the signed digests and the present files; empty if nothing does. Later analyses and signatures may exist."""
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
        if present[one] != subjects[one]:
            return f"{one} differs from what was signed"
    earlier = {one for one in present if one.startswith(f"{SIGNATURES}/")} - set(subjects)
    if earlier:
        return f"it does not cover {min(earlier)}, which has a smaller number"
    return ""


def _subjects(folder: GuardedFolder, before: str | None = None) -> dict[str, str]:
    """File → SHA-256 of everything that a signature covers. before: leave out this signature and those after it. Raises `OSError`."""
    limits = {
        RUN: MOST_GIVEN,
        PLAN: MOST_GIVEN,
        BENCH: MOST_GIVEN,
        JOURNAL: MOST_OF_JOURNAL,
        seals.NAME: seals.MOST_BYTES,
    }
    found = {name: _digest(folder, name, limit) for name, limit in limits.items()}
    for number in stored.numbers(folder):
        within = folder.folder(stored.FOLDER).folder(str(number))
        found[f"{stored.FOLDER}/{number}/{stored.DIGESTS}"] = _digest(within, stored.DIGESTS, stored.MOST_DIGESTS)
    for name in _files(folder):
        if before is None or name < before:
            found[f"{SIGNATURES}/{name}"] = _digest(folder.folder(SIGNATURES), name, MOST_BYTES)
    return found


def _digest(folder: GuardedFolder, name: str, limit: int) -> str:
    with folder.open_file(name, limit) as file:
        return digest_of(file)
