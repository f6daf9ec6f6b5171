"""Stores approvals as files: next to a plan, and in the folder of a run.

    calibration.yaml
    calibration.yaml.approvals/
      20260301T081100Z-4f2a9c0d11e38b57.dsse.json     one approval or withdrawal
      20260301T081100Z-4f2a9c0d11e38b57.yaml          the plan as it was approved, for comparisons; nothing relies on it

Each approval has its own file, so that several reviewers can work in separate branches of a repository. A file is written under
another name, synced and renamed, so that it exists completely or not at all. The name of a file is made only from the time and the
digest, never from texts in the approval.

The file `approvals.json` of a run folder contains the approvals that counted when the run began, with the canonical meanings that
they cover.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from planrunner.archive.formats import FROM_BACKUP, IntegrityError, parse_json, to_bytes
from planrunner.archive.storage import Storage
from planrunner.archive.verifying import APPROVALS, MOST_GIVEN
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.review.approvals import (
    ApprovalRecord,
    DamagedApproval,
    StatedApproval,
    payload_digest,
    read_stated,
)
from planrunner.review.meaning import Meaning
from planrunner.signing.envelope import MOST_BYTES, Envelope

ENDING = ".approvals"
_ENVELOPE, _PLAN = ".dsse.json", ".yaml"
_FILE = re.compile(r"([0-9]{8}T[0-9]{6}Z-[0-9a-f]{16})\.dsse\.json\Z")
MOST = 10_000
"""Largest number of approvals of one plan."""
FORMAT = 1


def approvals_folder(plan: Path) -> Path:
    """Returns the folder with the approvals of a plan, next to the plan."""
    return plan.with_name(plan.name + ENDING)


def read_approvals(folder: Path) -> tuple[ApprovalRecord, ...]:
    """Reads all approvals and withdrawals in a folder; the result is empty if the folder does not exist. Other files in the folder
    are ignored.

    A file that cannot be read becomes a `DamagedApproval`. Raises `InputError` if the folder itself cannot be read.
    """
    try:
        opened = GuardedFolder.open(folder)
        names = [name for name in opened.entries() if _FILE.match(name)]
    except FileNotFoundError:
        return ()
    except (OSError, ValueError) as error:
        raise _unreadable(folder, error) from None
    if len(names) > MOST:
        message = f"this folder has more than {MOST} approvals"
        raise InputError.at(Mark(str(folder)), "approval-folder", message, "move old ones elsewhere")
    return tuple(_read(opened, name) for name in names)


def _read(folder: GuardedFolder, name: str) -> ApprovalRecord:
    try:
        return read_stated(name, folder.read(name, MOST_BYTES))
    except OSError as error:
        return DamagedApproval(name, f"it cannot be read: {error.strerror or error}")


def approved_text(folder: Path, approval: StatedApproval) -> bytes | None:
    """Returns the text of the plan as it was approved; None if it is not available. The caller must compare the digest of the
    text's meaning with the digest in the approval."""
    name = approval.file.removesuffix(_ENVELOPE) + _PLAN
    try:
        return GuardedFolder.open(folder).read(name, MOST_GIVEN)
    except (OSError, ValueError):
        return None


def write_envelope(
    plan: Path, envelope: Envelope, signed: str, text: bytes | None = None, storage: Storage | None = None
) -> str:
    """Writes an approval or withdrawal next to a plan; returns the name of its file. `signed`: the time of signing that the
    envelope states, ISO 8601. `text`: the plan as it was approved. Raises `InputError` if the file cannot be written."""
    storage = storage or Storage()
    folder = approvals_folder(plan)
    stem = f"{re.sub(r'[^0-9T]', '', signed[:19])}Z-{payload_digest(envelope)[:16]}"
    try:
        parent = GuardedFolder.open(plan.parent)
        if parent.entry(folder.name) is None:
            storage.make_folder(parent, folder.name)
            storage.sync_folder(parent)
        within = parent.folder(folder.name)
        if text is not None:
            storage.write_whole(within, stem + _PLAN, text)
        storage.write_whole(within, stem + _ENVELOPE, envelope.to_bytes())
    except (OSError, ValueError) as error:
        raise _unreadable(folder, error) from None
    return stem + _ENVELOPE


def _unreadable(folder: Path, error: Exception) -> InputError:
    why = (error.strerror if isinstance(error, OSError) else None) or str(error)
    message = f"the folder of the approvals cannot be read or written: {why}"
    return InputError.at(Mark(str(folder)), "approval-folder", message, "check its permissions")


# -- in a run folder ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class KeptApprovals:
    """The approval data in a run folder.

    `plan`, `bench`: canonical JSON of the meanings that the approvals cover. `ring`: text of the key ring at the beginning of the
    run. `day`: date on which the run began. `approvals`: the approvals that counted. `keys`: path of the key ring. `folder`: path
    of the folder with the approvals.
    """

    plan: str
    bench: str
    ring: str
    day: date
    approvals: tuple[StatedApproval, ...]
    keys: str
    folder: str

    @property
    def plan_digest(self) -> str:
        return hashlib.sha256(self.plan.encode()).hexdigest()

    @property
    def bench_digest(self) -> str:
        return hashlib.sha256(self.bench.encode()).hexdigest()

    def to_bytes(self, runs: Path) -> bytes:
        """Returns the content of `approvals.json`. `runs`: the folder that contains the run folders. Paths in `approvals.json` are
        relative to this folder, so that they do not contain the names of folders above the lowest common folder of the runs and the
        approvals."""
        given = [entry_of(one) for one in self.approvals]
        return to_bytes(
            {
                "planrunner_approvals": FORMAT,
                "day": self.day.isoformat(),
                "plan": self.plan,
                "bench": self.bench,
                "ring": self.ring,
                "approvals": given,
                "found_in": {"keys": _relative(self.keys, runs), "approvals": _relative(self.folder, runs)},
            }
        )


def _relative(path: str, runs: Path) -> str:
    """Returns a path relative to the folder of the runs. If the path and this folder are on different drives, the result is only
    the file name."""
    try:
        found = os.path.relpath(os.path.realpath(path), os.path.realpath(runs))
    except ValueError:
        found = Path(path).name
    return Path(found).as_posix()


def entry_of(approval: StatedApproval) -> JsonObject:
    """Returns an approval in the form in which the files of a run contain it."""
    return {"file": approval.file, "envelope": approval.envelope.to_bytes().decode()}


def entries_of(given: Iterable[Mapping[str, Json]]) -> tuple[tuple[StatedApproval, ...], tuple[DamagedApproval, ...]]:
    """Reads entries of approvals from the files of a run. Returns the approvals and, as a second value, the entries that are not
    approvals."""
    read = [read_stated(str(one["file"]), str(one["envelope"]).encode()) for one in given]
    good = tuple(one for one in read if isinstance(one, StatedApproval))
    bad = tuple(
        one if isinstance(one, DamagedApproval) else DamagedApproval(one.file, "it is not an approval")
        for one in read
        if not isinstance(one, StatedApproval)
    )
    return good, bad


def keep(
    plan: Meaning, bench: Meaning, ring: str, day: date, counted: Iterable[StatedApproval], keys: Path, folder: Path
) -> KeptApprovals:
    """Collects the approval data that the run folder will contain."""
    texts = plan.canonical().decode(), bench.canonical().decode()
    return KeptApprovals(*texts, ring, day, tuple(counted), str(keys.absolute()), str(folder.absolute()))


def kept_approvals(data: bytes, run: Path) -> tuple[KeptApprovals, tuple[DamagedApproval, ...]]:
    """Reads `approvals.json` of a run folder. Returns its content and, as a second value, the entries that are not approvals.
    Raises `IntegrityError` for a file that does not have the form of `approvals.json`."""
    value = parse_json(data, run / APPROVALS, "approvals", "planrunner_approvals", FORMAT)
    good, bad = entries_of(value["approvals"])
    try:
        day = date.fromisoformat(value["day"])
    except ValueError:
        raise IntegrityError(f"{run / APPROVALS}: its day is not a calendar date; {FROM_BACKUP}") from None
    keys, folder = (str(run.resolve().parent / value["found_in"][name]) for name in ("keys", "approvals"))
    texts = value["plan"], value["bench"], value["ring"]
    return KeptApprovals(*texts, day, good, keys, folder), bad
