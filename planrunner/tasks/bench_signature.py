"""Automatically signs the seal of every run, and every analysis made on the computer of the bench, with the key of the bench.

A failure to sign never damages a run. The run stays sealed, the command warns, and `sign_later` can sign the run when the key is
available.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from planrunner.archive import seal as seals
from planrunner.archive.analyses import StoredAnalysis
from planrunner.archive.lock import FolderLock
from planrunner.archive.run_reader import RunReader
from planrunner.archive.storage import digest
from planrunner.base.findings import Finding, Findings, InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.bench.model import Bench
from planrunner.estimators.limits import VerdictKind, verdict_kind
from planrunner.estimators.results import Results
from planrunner.signing.bench_key import BenchKeyError, bench_signer, reason
from planrunner.signing.keys import PublicKey, Signer, parse_public
from planrunner.signing.run_signatures import (
    BenchMeaning,
    TestResult,
    bench_signing,
    sign_run,
    signatures_of,
)

PATIENCE = 10.0
"""Longest time [s] to wait while another process signs or writes the same run."""

_RESULTS: dict[VerdictKind, TestResult] = {"pass": "PASSED", "warned": "WARNED", "fail": "FAILED", "none": "WARNED"}
"""For each verdict, the result in the statement. The statement has no word for a plan without limits."""


def statement_result(results: Results) -> TestResult:
    """Returns the result of a run in the form in which a signed statement contains it."""
    warnings = sum(len(estimate.warnings) for estimate in results.estimates.values())
    return _RESULTS[verdict_kind(results.limits, results.failures, warnings)]


def key_of(bench: Bench) -> PublicKey | None:
    """Returns the public key that must sign the runs of a bench; None if the bench names none. The bench file must already have
    been checked."""
    return None if bench.signing is None else parse_public(bench.signing.key)


def check_signing(bench: Bench, log: Findings, *, key_needed: bool) -> None:
    """Adds an error if the public key in the bench file cannot be read. `key_needed`: True if a run on this computer may follow the
    check. In this case, a warning is added if the private key is not available. A missing private key is not an error, because a
    run is worth more than its signature."""
    if bench.signing is None:
        return
    mark = bench.signing.at("key")
    try:
        public = parse_public(bench.signing.key)
        if key_needed:
            bench_signer(public)
    except ValueError as error:
        log.error("bench-signing-key", mark, str(error), "copy the line from the public key file")
    except BenchKeyError as error:
        message = f"the private key of this bench is not on this computer: {error}; a run would not be signed"
        log.warning("bench-signing-key-missing", mark, message, "`planrunner key new --for-bench`, or ssh-add")


def sign_seal(folder: GuardedFolder, run: str, bench: Bench) -> tuple[Finding, ...]:
    """Signs the seal that the caller has just written. The caller must still hold the lock of the run folder. Returns the reason
    why the seal is not signed; empty if it is signed or does not need a signature."""
    public = key_of(bench)
    if public is None:
        return ()
    try:
        _sign(folder, run, bench.name, bench_signer(public), "recorded", "WARNED", ())
    except (BenchKeyError, InputError, OSError) as error:
        hint = f"`planrunner sign {folder.path} --as recorded` signs it later"
        message = f"the seal is not signed by the key of the bench: {reason(error)}"
        return (Finding(Mark(str(folder.path)), "run-bench-unsigned", "warning", message, hint),)
    return ()


def sign_analysis(
    reader: RunReader, bench: Bench, analysis: StoredAnalysis, results: Results, *, elsewhere: bool = False
) -> tuple[Finding, ...]:
    """Signs an analysis that has just been made from the run. Returns the reason why the analysis is not signed; empty if it is
    signed or does not need a signature.

    The bench signs an analysis only if it also signed the seal. The signed seal guarantees that the bench recorded the samples.
    `elsewhere`: True if another computer computed the results; the bench then does not sign them.
    """
    public = key_of(bench)
    if public is None or not reader.sealed:
        return ()
    try:
        with locked(reader.folder):
            _require_signed_seal(reader)
            if elsewhere:
                raise BenchKeyError("another computer made it")
            signer, result = bench_signer(public), statement_result(results)
            _sign(reader.folder, reader.run["run"], bench.name, signer, "evaluated", result, (analysis.number,))
    except (BenchKeyError, InputError, OSError) as error:
        hint = f"`planrunner sign {reader.path} --as recorded` on the computer of the bench"
        message = f"analysis {analysis.number} is not signed by the key of the bench: {reason(error)}"
        return (Finding(Mark(str(reader.path)), "run-analysis-unsigned", "warning", message, hint),)
    return ()


def _require_signed_seal(reader: RunReader) -> None:
    """Raises `BenchKeyError` if the seal has changed since it was read, or if it is not signed with the key in the bench file."""
    signing = bench_signing(reader.bench_bytes, reader.state.earlier_seals)
    seal = digest(reader.folder.read(seals.NAME, seals.MOST_BYTES))
    good = (one for one in signatures_of(reader.folder, bench=signing) if one.standing != "invalid")
    if seal != reader.basis.seal or not any(one.meaning == "recorded" and one.current for one in good):
        raise BenchKeyError("the seal is not signed by it")


def _sign(
    folder: GuardedFolder,
    run: str,
    bench: str,
    signer: Signer,
    meaning: BenchMeaning,
    result: TestResult,
    analyses: tuple[int, ...],
) -> None:
    sign_run(folder, run, signer, result, meaning, bench, analyses=analyses)


@contextmanager
def locked(folder: GuardedFolder) -> Iterator[None]:
    """Holds the lock of a run folder while the enclosed code runs; first waits until other processes release it. Raises
    `InputError` if the lock cannot be obtained."""
    until = time.monotonic() + PATIENCE
    while True:
        try:
            lock = FolderLock(folder)
            break
        except InputError:
            if time.monotonic() > until:
                raise
            time.sleep(0.05)
        except OSError as error:
            message = f"the run folder cannot be written: {error.strerror or error}"
            raise InputError.at(Mark(str(folder.path)), "run-unwritable", message, "change its permissions") from None
    try:
        yield
    finally:
        lock.release()


def sign_recorded(reader: RunReader, bench: Bench, signer: Signer, proven: dict[int, Results]) -> None:
    """Makes the signatures that should have been made automatically. Signs the seal of a verified run and its recomputed
    analyses. The caller must hold the lock of the run folder. `proven`: maps the number of each recomputed analysis to its
    results. Raises `InputError` if a signature cannot be made, and `OSError` if a file cannot be written."""
    signing = bench_signing(reader.bench_bytes, reader.state.earlier_seals)
    run = reader.run["run"]
    good = [one for one in signatures_of(reader.folder, bench=signing) if one.standing != "invalid" and one.by_bench]
    if not any(one.current for one in good):
        _sign(reader.folder, run, bench.name, signer, "recorded", "WARNED", ())
    for number, results in proven.items():
        _sign(reader.folder, run, bench.name, signer, "evaluated", statement_result(results), (number,))


def unsigned_analyses(reader: RunReader) -> tuple[int, ...]:
    """Returns the numbers of the analyses that have no good signature. A signature is good if it is valid, or if it cannot be
    verified only because no key ring is given. Raises `OSError` if a file cannot be read."""
    signing = bench_signing(reader.bench_bytes, reader.state.earlier_seals)
    good = [one for one in signatures_of(reader.folder, bench=signing) if one.standing != "invalid"]
    covered = {number for one in good for number in one.analyses}
    return tuple(one.number for one in reader.analyses if one.number not in covered)
