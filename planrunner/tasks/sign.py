"""Signing a sealed run: the run is verified, its result read from the newest analysis, and the signature written into its folder."""

from __future__ import annotations

from pathlib import Path

from planrunner.archive.formats import IntegrityError
from planrunner.archive.lock import FolderLock
from planrunner.archive.verifying import examine, open_run
from planrunner.base.findings import InputError, Mark
from planrunner.estimators.limits import VerdictKind, verdict_kind
from planrunner.signing.keys import Signer
from planrunner.signing.run_signatures import (
    RunSignature,
    SignatureMeaning,
    TestResult,
    sign_run,
    signature_faults,
    signatures_of,
)
from planrunner.tasks.approvals import run_approvals
from planrunner.tasks.run import stored_results

_RESULTS: dict[VerdictKind, TestResult] = {"pass": "PASSED", "warned": "WARNED", "fail": "FAILED", "none": "WARNED"}
"""Verdict → result of the statement, which has no word for a plan without limits."""


def sign(run: Path, signer: Signer, meaning: SignatureMeaning, name: str, comment: str = "") -> RunSignature:
    """Signs a run with its samples verified; returns the signature as it is then read, without a key ring.

    Raises `InputError` for a run that is not sealed or has no analysis, and `IntegrityError` for a changed run.
    """
    folder = open_run(run)
    try:
        lock = FolderLock(folder)
    except OSError as error:
        message = f"the run folder cannot be written: {error.strerror or error}"
        raise InputError.at(Mark(str(run)), "run-unwritable", message, "change its permissions") from None
    try:
        found = examine(folder, samples="digests")
        run_approvals(found, None)
        found.require_whole()
        faults = [*signature_faults(folder)]
        faults += [f"{one.file}: {one.why}" for one in signatures_of(folder) if one.standing == "invalid"]
        if faults:
            raise IntegrityError("\n".join(faults))
        if found.seal is None or found.state is None or not found.state.finished:
            hint = "finish the run with `planrunner resume`"
            raise InputError.at(Mark(str(run)), "sign-not-sealed", "only a finished, sealed run can be signed", hint)
        if not found.analyses:
            hint = "make an analysis with `planrunner estimate`"
            raise InputError.at(Mark(str(run)), "analysis-missing", "this run has no analysis yet", hint)
        results = stored_results(found.analyses[-1])
        warnings = sum(len(estimate.warnings) for estimate in results.estimates.values())
        result = _RESULTS[verdict_kind(results.limits, results.failures, warnings)]
        try:
            file = sign_run(folder, found.run["run"], signer, result, meaning, name, comment)
        except OSError as error:
            message = f"the signature cannot be written: {error.strerror or error}"
            raise InputError.at(Mark(str(run)), "run-unwritable", message, "make room") from None
    finally:
        lock.release()
    return next(one for one in signatures_of(folder) if one.file == file)
