"""Verifies runs for an auditor who has only the run folders: shows what has been changed since the runs were written."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from planrunner.archive.finding_runs import find_runs
from planrunner.archive.formats import IntegrityError
from planrunner.archive.stamp_files import FOLDER as STAMPS
from planrunner.archive.verifying import (
    CHANGES,
    SIGNATURES,
    Change,
    Examined,
    examine,
    is_being_written,
    open_run,
)
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Finding, InputError, Mark
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.run_signatures import (
    RunSignature,
    lacking_signatures,
    signature_faults,
    signatures_of,
    signing_of,
)
from planrunner.signing.run_stamps import RunStamp, verify_stamps
from planrunner.signing.time_stamps import StampAuthority
from planrunner.tasks.amendment import in_words, stored_amendment
from planrunner.tasks.approvals import RunApproval, run_approvals
from planrunner.tasks.evaluation_approvals import EvaluationApproval, evaluation_approvals

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Verification:
    """Contains the result of the verification of a run folder.

    `changes`: each change, with the finding that describes it. `remarks`: findings that are not changes, for example that the run
    is not sealed. `amendments`: maps the number of each amended analysis to a text that states who amended which analysis, and why.
    `signatures`: all electronic signatures. `stamps`: all time stamps. `approvals`: the approvals under which the plan ran. An
    invalid signature, stamp or approval also appears in `changes`. `evaluations`: states for each analysis whether approvals cover
    its evaluation; empty if the bench requires no approvals.
    """

    found: Examined
    changes: tuple[tuple[Change, Finding], ...]
    remarks: tuple[Finding, ...]
    amendments: Mapping[int, str] = field(default_factory=dict)
    signatures: tuple[RunSignature, ...] = ()
    stamps: tuple[RunStamp, ...] = ()
    approvals: tuple[RunApproval, ...] = ()
    evaluations: tuple[EvaluationApproval, ...] = ()

    @property
    def sealed(self) -> bool:
        """Returns True if the run is finished and has a seal."""
        return self.found.seal is not None and self.found.state is not None and self.found.state.finished

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/verification.schema.json."""
        found = self.found
        parts = found.files.values()
        return {
            "planrunner_verification": FORMAT,
            "changes": [{"change": change, **finding.to_json()} for change, finding in self.changes],
            "remarks": [finding.to_json() for finding in self.remarks],
            "sealed": self.sealed,
            "sealed_at": None if found.seal is None else found.seal["sealed"],
            "seal": found.seal_digest,
            "events": None if found.scan is None else found.scan.count,
            "sample_files": len(parts),
            "sample_bytes": sum(part.bytes for part in parts),
            "analyses": [
                {
                    "number": one.number,
                    "made": one.digests["made"],
                    "digests": one.digest,
                    **({"amendment": self.amendments[one.number]} if one.number in self.amendments else {}),
                }
                for one in found.analyses
            ],
            "signatures": [one.to_json() for one in self.signatures],
            "stamps": [one.to_json() for one in self.stamps],
            "evaluations": [
                {"analysis": one.analysis, "covered": one.covered, "words": one.words} for one in self.evaluations
            ],
            "approvals": [{**one.judged.to_json(), "verified": one.verified} for one in self.approvals],
        }


def verify_run(run: Path, ring: KeyRing | None = None, authority: StampAuthority | None = None) -> Verification:
    """Verifies a run folder with all its samples, signatures and time stamps. `ring`: the user's key ring.
    `authority`: the certificates that verify time stamps. Raises `InputError` if the folder is not a run folder."""
    found = examine(open_run(run), samples="digests")
    signatures = verify_signatures(found, ring)
    stamps: tuple[RunStamp, ...] = ()
    try:
        stamps = verify_stamps(found, authority)
    except OSError as error:
        found.error("run-stamp", f"{found.folder.path / STAMPS}: {error.strerror}")
    approvals = run_approvals(found, ring)
    evaluations = verify_evaluations(found, ring)
    return replace(verification(found, signatures, approvals), stamps=stamps, evaluations=evaluations)


def verify_evaluations(found: Examined, ring: KeyRing | None) -> tuple[EvaluationApproval, ...]:
    """Determines whether approvals cover the evaluation of each analysis. Adds faults to the findings of `found`."""
    evaluations = tuple(evaluation_approvals(found, ring))
    for one in evaluations:
        if one.fault:
            found.error("run-approval", one.fault, hint="")
        elif not one.covered:
            message = f"the evaluation of analysis {one.analysis} is {one.words}"
            hint = "ask reviewers to approve the plan of the amendment, and amend the run again"
            found.findings.warning("run-evaluation-unapproved", Mark(str(found.folder.path)), message, hint)
    return evaluations


def verify_signatures(found: Examined, ring: KeyRing | None) -> tuple[RunSignature, ...]:
    """Verifies the signatures of a run and returns them. Adds faults to the findings of `found`."""
    path = found.folder.path / SIGNATURES
    try:
        for fault in signature_faults(found.folder):
            found.error("run-signature", fault)
        signing = signing_of(found)
        signatures = signatures_of(found.folder, ring, signing)
    except OSError as error:
        found.error("run-signature", f"{path}: {error.strerror}")
        return ()
    for one in signatures:
        if one.standing == "invalid":
            found.error("run-signature", f"{path / one.file}: this signature is not valid: {one.why}")
    if found.seal is not None and found.state is not None and found.state.finished and not is_being_written(found):
        made = datetime.fromisoformat(str(found.run["created"])) if found.run else datetime.now(UTC)
        numbers = [one.number for one in found.analyses]
        for code, message in lacking_signatures(signatures, signing, made, numbers, ring):
            hint = f"if planrunner could not sign, `planrunner sign {found.folder.path} --as recorded` on the computer of the bench"
            found.error(code, f"{found.folder.path}: {message}", hint)
    return signatures


def verification(
    found: Examined, signatures: tuple[RunSignature, ...] = (), approvals: tuple[RunApproval, ...] = ()
) -> Verification:
    """Derives the result of the verification of a run from the examination of its folder. A finding whose code is in `CHANGES`
    counts as a change of the kind that is stated there. Any other error counts as a change of the kind `altered`. Other findings
    are remarks, and so is an unknown file in a folder that is not sealed."""
    changes, remarks = [], []
    for finding in found.findings:
        change = CHANGES.get(finding.code, "altered" if finding.severity == "error" else None)
        unsealed = finding.code == "run-unknown-file" and finding.severity != "error"
        if change is None or unsealed:
            remarks.append(finding)
        else:
            changes.append((change, finding))
    amendments = {}
    for analysis in found.analyses:
        with contextlib.suppress(IntegrityError):  # already among the changes
            amendment = stored_amendment(analysis)
            if amendment is not None:
                amendments[analysis.number] = in_words(amendment)
    return Verification(found, tuple(changes), tuple(remarks), amendments, signatures, approvals=approvals)


def runs_beneath(archive: Path) -> list[Path]:
    """Finds all run folders in a folder and its subfolders, sorted by name. Links are not followed. Raises `InputError` if there is
    no run folder."""
    found = runs_in(archive)
    if not found:
        message, hint = "there is no run folder in this folder", "give the folder that contains the runs, such as runs/"
        raise InputError.at(Mark(str(archive)), "verify-no-runs", message, hint)
    return found


def runs_in(archive: Path) -> list[Path]:
    """Does the same as `runs_beneath`, but returns an empty list if the folder contains no run or does not exist. Raises
    `InputError` if a folder cannot be read."""
    if not archive.exists():
        return []
    try:
        found = list(find_runs(archive))
    except OSError as error:
        raise _unreadable(archive, f"it cannot be read: {error.strerror}") from None
    for one in found:
        if one.fault:
            raise _unreadable(one.path, one.fault)
    return sorted(one.path for one in found)


def _unreadable(folder: Path, fault: str) -> InputError:
    message = f"this folder cannot be searched: {fault}"
    return InputError.at(Mark(str(folder)), "verify-no-runs", message, "check its name and permissions")
