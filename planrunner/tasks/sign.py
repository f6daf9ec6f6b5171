"""Signs a sealed run: the run is verified, its result is read from the newest analysis, and the signature is written into its
folder."""

from __future__ import annotations

from pathlib import Path

from planrunner.archive.analyses import chosen_analysis
from planrunner.archive.formats import IntegrityError
from planrunner.archive.origin import foreign
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import BENCH, Examined, examine, open_run
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.bench.model import bench_of
from planrunner.signing.bench_key import BenchKeyError, bench_signer
from planrunner.signing.keys import Signer
from planrunner.signing.run_signatures import (
    PersonMeaning,
    RunSignature,
    sign_run,
    signature_faults,
    signatures_of,
    signing_of,
)
from planrunner.tasks.approvals import run_approvals
from planrunner.tasks.bench_signature import key_of, locked, sign_recorded, statement_result, unsigned_analyses
from planrunner.tasks.estimate import stored_results
from planrunner.tasks.prove import prove


def sign(run: Path, signer: Signer, meaning: PersonMeaning, name: str, comment: str = "") -> RunSignature:
    """Verifies a run with its samples, and signs it. Returns the signature as read without a key ring.

    Raises `InputError` for a run without a seal or an analysis, or for a key that must not sign, and `IntegrityError` for a run
    that was changed.
    """
    folder = open_run(run)
    with locked(folder):
        found = _verified(folder)
        signing = signing_of(found)
        if signing.key == signer.public:
            message = "this is the key of the bench: persons sign with keys of their own"
            raise InputError.at(Mark(str(run)), "sign-bench-key", message, "make one with `planrunner key new`")
        result = statement_result(stored_results(chosen_analysis(run, found.analyses)))
        try:
            file = sign_run(folder, found.run["run"], signer, result, meaning, name, comment)
        except OSError as error:
            message = f"the signature cannot be written: {error.strerror or error}"
            raise InputError.at(Mark(str(run)), "run-unwritable", message, "free disk space") from None
    return next(one for one in signatures_of(folder) if one.file == file)


def sign_later(run: Path, signer: Signer | None = None) -> tuple[RunSignature, ...]:
    """Adds the missing signatures to a run that was made on this computer. Signs with the key of the run's bench. Returns the new
    signatures; empty if everything is already signed.

    The whole run is verified first. An analysis is signed only if its results can be recomputed from the samples. `signer`: the key
    of the bench, if the user gives it. By default, the key is searched for on this computer, which must be the computer that made
    the run. Raises `InputError` if something cannot be signed, and `IntegrityError` if the run was changed.
    """
    folder = open_run(run)
    with locked(folder):
        found = _verified(folder)
        reader = RunReader.of(found)
        mark = Mark(str(run))
        bench = bench_of(reader.bench_bytes, str(run / BENCH))
        public = key_of(bench)
        if public is None:
            hint = "add `signing` to the bench file before a run"
            raise InputError.at(mark, "sign-bench-key", "the bench of this run names no key", hint)
        before = {one.file for one in signatures_of(folder)}
        proven = {}
        for number in unsigned_analyses(reader):
            if prove(run, number).verdict == "different":
                message = f"the samples do not give the results of analysis {number}"
                raise InputError.at(mark, "sign-not-reproduced", message, "find out why before it is signed")
            proven[number] = stored_results(next(one for one in reader.analyses if one.number == number))
        try:
            if signer is None:
                _require_made_here(reader)
                signer = bench_signer(public)
            if signer.public != public:
                message = "this is not the key that the bench file of the run names"
                raise InputError.at(mark, "sign-bench-key", message, f"give the private key of {public.fingerprint}")
            sign_recorded(reader, bench, signer, proven)
        except BenchKeyError as error:
            raise InputError.at(mark, "sign-bench-key", str(error), "give the key with --by or --agent") from None
        except OSError as error:
            message = f"the signature cannot be written: {error.strerror or error}"
            raise InputError.at(mark, "run-unwritable", message, "free disk space") from None
    return tuple(one for one in signatures_of(folder) if one.file not in before)


def _verified(folder: GuardedFolder) -> Examined:
    """Verifies that a sealed run has not been changed. Signatures that its bench must make may still be missing. Raises
    `IntegrityError` if the run was changed, and `InputError` if it is not sealed."""
    found = examine(folder, samples="digests")
    run_approvals(found, None)
    found.require_whole()
    faults = [*signature_faults(folder)]
    faults += [
        f"{one.file}: {one.why}" for one in signatures_of(folder, None, signing_of(found)) if one.standing == "invalid"
    ]
    if faults:
        raise IntegrityError("\n".join(faults))
    if found.seal is None or found.state is None or not found.state.finished:
        hint = "finish the run with `planrunner resume`"
        raise InputError.at(
            Mark(str(folder.path)), "sign-not-sealed", "only a finished, sealed run can be signed", hint
        )
    return found


def _require_made_here(reader: RunReader) -> None:
    """Raises `BenchKeyError` for a run of unknown origin, because the bench file in its folder must not decide which key signs it."""
    if why := foreign(reader.folder, reader.first):
        raise BenchKeyError(why)
