"""`planrunner verify`: shows what was changed in run folders after they were written. The exit code is 4 if anything was
changed."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from planrunner.base.documents import JsonObject
from planrunner.base.findings import InputError, Mark, count_of
from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_workers, folder_to_verify, workers_of
from planrunner.cli.each_run import Done, add_runs, archive_of, each_result, run_folders
from planrunner.cli.log import add_heads, heads_of, ring_of, show_log
from planrunner.cli.printing import print_line
from planrunner.plan.source import read_bytes
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.run_signatures import RunSignature
from planrunner.signing.time_stamps import StampAuthority, parse_authority
from planrunner.tasks.run_log import LoggedRun, log_of, logged_run, missing_log, verify_log
from planrunner.tasks.verify import Verification, runs_beneath, runs_in, verify_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser, folder_to_verify)
    parser.add_argument("--all", action="store_true", help="RUN is an archive: verify every run folder in it")
    add_heads(parser)
    parser.add_argument(
        "--authority", metavar="CERT", type=Path, help="certificate in PEM that time stamps are verified with"
    )
    parser.add_argument(
        "--revoked",
        metavar="CRL",
        type=Path,
        help="with --authority: list of revoked certificates (PEM or DER) that stamps are verified with",
    )
    add_workers(parser, "number of processes for several runs (default: 1)")
    parser.add_argument("--json", action="store_true", help="print a list of verifications as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    runs: list[Path] = args.runs
    archive = runs[0]
    if args.all:
        archive = archive_of(runs)
        runs = runs_beneath(archive) if log_of(archive) is None else runs_in(archive)
    elif args.head:
        message = "--head belongs to the log of an archive"
        raise InputError.of_usage(message, "give the folder that contains the runs, and --all")
    runs = run_folders(runs)
    ring = ring_of(args)
    heads = heads_of(args.head, ring)
    if args.revoked is not None and args.authority is None:
        raise InputError.of_usage("--revoked belongs to --authority", "give the certificate of the authority too")
    authority = None if args.authority is None else _authority(args.authority, args.revoked)
    workers = workers_of(args)
    examined: list[LoggedRun] = []
    bad = 0

    def show(verified: _Verified) -> Done:
        nonlocal bad
        examined.append(verified.run)
        bad += verified.changed
        for line in () if args.json else verified.lines:
            print_line(line)
        return Done(exit_codes.INTEGRITY if verified.changed else exit_codes.DONE, verified.found)

    def of_all() -> Done | None:
        if not args.all:
            return None
        log = log_of(archive)
        found = missing_log(archive, examined, heads) if log is None else verify_log(log, examined, ring, heads)
        if found is None:
            return None
        if not args.json:
            show_log(found)
        return Done(exit_codes.INTEGRITY if found.changes else exit_codes.DONE, found.to_json())

    work = partial(_verified, ring, authority, len(runs) > 1)
    code = each_result(runs, work, show, workers, what="verifying the runs", as_json=args.json, last=of_all)
    if len(runs) > 1 and not args.json:
        print(f"{len(runs)} runs: {bad} changed" if bad else f"{len(runs)} runs: all unchanged")
    return code


def _authority(path: Path, revoked: Path | None) -> StampAuthority:
    try:
        return parse_authority(read_bytes(path), b"" if revoked is None else read_bytes(revoked))
    except ValueError as error:
        hint = "give the certificate of the time stamp authority or of its root, and the list that its issuer signed"
        raise InputError.at(Mark(str(path)), "bench-stamp-certificate", str(error), hint) from None


@dataclass(frozen=True, slots=True)
class _Verified:
    """The verification of a run: the lines to print, the data to compare with the log of the archive, and the JSON data."""

    run: LoggedRun
    changed: bool
    lines: tuple[str, ...]
    found: JsonObject


def _verified(ring: KeyRing | None, authority: StampAuthority | None, named: bool, folder: Path) -> _Verified:
    """Verifies one run. `named`: True if the name of the folder has already been printed."""
    verification = verify_run(folder, ring, authority)
    lines = tuple(_lines("" if named else f"{folder}: ", verification))
    return _Verified(logged_run(verification.found), bool(verification.changes), lines, verification.to_json())


def _lines(name: str, verification: Verification) -> Iterator[str]:
    """Yields the lines that report on one run. `name`: the text before the first line, which contains the name of the folder; empty
    if the name has already been printed."""
    found = verification.found
    state = "CHANGED" if verification.changes else "unchanged" if verification.sealed else "unchanged, NOT SEALED"
    yield (f"{name or '    '}{state}")
    for change, finding in verification.changes:
        yield (f"    {change}: {finding.message}")
    if found.seal is not None and found.seal_digest is not None:
        yield (f"    sealed {found.seal['sealed']}, SHA-256 of seal.json: {found.seal_digest}")
    if found.scan is not None:
        files = found.files.values()
        recorded = f"{count_of(len(files), 'file')} of samples ({sum(part.bytes for part in files) / 1e6:.1f} MB)"
        yield (f"    {count_of(found.scan.count, 'event')}, {recorded}, {_analyses(verification)}")
    for number, words in verification.amendments.items():
        yield (f"    analysis {number} {words}")
    for one in verification.signatures:
        if one.standing != "invalid":
            standing = f"valid, key of {one.owner}" if one.standing == "valid" else f"NOT VERIFIED: {one.why}"
            result = _covered(one)
            yield (f"    {one.meaning} by {one.name}, {one.signed} ({result}): {standing} ({one.key})")
    dated = [one for one in verification.stamps if one.standing != "invalid" and one.time]
    if dated:
        valid = all(one.standing == "valid" for one in dated)
        times = sorted(one.time for one in dated)
        standing = "valid" if valid else "NOT VERIFIED: checked only with the certificate in the bench file of the run"
        yield (f"    {len(dated)} time stamps, {times[0]} to {times[-1]}: {standing}")
    for approval in verification.approvals:
        known = approval.judged.key
        if approval.judged.standing == "counts":
            owner = (
                f"valid, key of {known.name}" if known and approval.verified else "NOT VERIFIED: no key ring was given"
            )
            yield (f"    plan approved by {approval.words()}: {owner}")
    for evaluation in verification.evaluations:
        if evaluation.covered:
            yield f"    analysis {evaluation.analysis}: its evaluation is {evaluation.words}"
    for finding in verification.remarks:
        yield (f"    {finding.message}")
    for hint in dict.fromkeys(finding.hint for _, finding in verification.changes if finding.hint):
        yield (f"    hint: {hint}")


def _covered(one: RunSignature) -> str:
    """Describes what a signature covers and the result of the run that the signature states."""
    if not one.current:
        return "an earlier seal"
    if not one.analyses:
        return "seal"
    if len(one.analyses) == 1:
        return f"{one.result}, analysis {one.analyses[0]}"
    return f"{one.result}, analyses {one.analyses[0]} to {one.analyses[-1]}"


def _analyses(verification: Verification) -> str:
    numbers = [one.number for one in verification.found.analyses]
    return count_of(len(numbers), "analysis", "analyses")
