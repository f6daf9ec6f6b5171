"""`planrunner verify`: what was changed in run folders since they were written; exit code 4 if anything was."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.archive.verifying import Examined
from planrunner.base.findings import COMMAND_LINE, InputError, Mark
from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done, add_runs, each_run
from planrunner.cli.log import add_heads, heads_of, ring_of, show_log
from planrunner.plan.source import read_bytes
from planrunner.reporting.printable import printable
from planrunner.signing.run_signatures import RunSignature
from planrunner.signing.time_stamps import StampAuthority, parse_authority
from planrunner.tasks.run_log import log_of, missing_log, verify_log
from planrunner.tasks.verify import Verification, runs_beneath, runs_in, verify_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_runs(parser)
    parser.add_argument("--all", action="store_true", help="RUN is an archive: verify every run folder in it")
    add_heads(parser)
    parser.add_argument(
        "--authority", metavar="CERT", type=Path, help="certificate in PEM that time stamps are verified with"
    )
    parser.add_argument("--json", action="store_true", help="print a list of verifications as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    runs: list[Path] = args.runs
    archive = runs[0]
    if args.all:
        if len(runs) > 1:
            message = "--all takes one folder"
            raise InputError.at(COMMAND_LINE, "command-usage", message, "give the folder that contains the runs")
        runs = runs_beneath(archive) if log_of(archive) is None else runs_in(archive)
    elif args.head:
        message = "--head belongs to the log of an archive"
        raise InputError.at(COMMAND_LINE, "command-usage", message, "give the folder that contains the runs, and --all")
    ring = ring_of(args)
    heads = heads_of(args.head, ring)
    authority = None if args.authority is None else _authority(args.authority)
    bad: list[Path] = []
    examined: list[Examined] = []

    def one(folder: Path) -> Done:
        verification = verify_run(folder, ring, authority)
        examined.append(verification.found)
        if not args.json:
            _show("" if len(runs) > 1 else f"{folder}: ", verification)
        if verification.changes:
            bad.append(folder)
        return Done(exit_codes.INTEGRITY if verification.changes else exit_codes.DONE, verification.to_json())

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

    code = each_run(runs, one, as_json=args.json, last=of_all)
    if len(runs) > 1 and not args.json:
        print(f"{len(runs)} runs: {len(bad)} changed" if bad else f"{len(runs)} runs: all unchanged")
    return code


def _authority(path: Path) -> StampAuthority:
    try:
        return parse_authority(read_bytes(path))
    except ValueError as error:
        hint = "give the certificate of the time stamp authority, or of its root"
        raise InputError.at(Mark(str(path)), "bench-stamp-certificate", str(error), hint) from None


def _show(name: str, verification: Verification) -> None:
    """name: of the folder; empty where it is already printed."""
    found = verification.found
    state = "CHANGED" if verification.changes else "unchanged" if verification.sealed else "unchanged, NOT SEALED"
    _say(f"{name or '    '}{state}")
    for change, finding in verification.changes:
        _say(f"    {change}: {finding.message}")
    if found.seal is not None and found.seal_digest is not None:
        _say(f"    sealed {found.seal['sealed']}, SHA-256 of seal.json: {found.seal_digest}")
    if found.scan is not None:
        files = found.files.values()
        size = sum(part.bytes for part in files) / 1e6
        _say(f"    {found.scan.count} events, {len(files)} files of samples ({size:.1f} MB), {_analyses(verification)}")
    for number, words in verification.amendments.items():
        _say(f"    analysis {number} {words}")
    for one in verification.signatures:
        if one.standing != "invalid":
            standing = f"valid, key of {one.owner}" if one.standing == "valid" else f"NOT VERIFIED: {one.why}"
            result = _covered(one)
            _say(f"    {one.meaning} by {one.name}, {one.signed} ({result}): {standing} ({one.key})")
    dated = [one for one in verification.stamps if one.standing != "invalid" and one.time]
    if dated:
        valid = all(one.standing == "valid" for one in dated)
        times = sorted(one.time for one in dated)
        standing = "valid" if valid else "NOT VERIFIED: by the certificate in the bench file of the run only"
        _say(f"    {len(dated)} time stamps, {times[0]} to {times[-1]}: {standing}")
    for approval in verification.approvals:
        known = approval.judged.key
        if approval.judged.standing == "counts":
            owner = (
                f"valid, key of {known.name}" if known and approval.verified else "NOT VERIFIED: no key ring was given"
            )
            _say(f"    plan approved by {approval.words()}: {owner}")
    for finding in verification.remarks:
        _say(f"    {finding.message}")
    for hint in dict.fromkeys(finding.hint for _, finding in verification.changes if finding.hint):
        _say(f"    hint: {hint}")


def _covered(one: RunSignature) -> str:
    """What a signature covers, with its result."""
    if not one.current:
        return "an earlier seal"
    if not one.analyses:
        return "seal"
    if len(one.analyses) == 1:
        return f"{one.result}, analysis {one.analyses[0]}"
    return f"{one.result}, analyses {one.analyses[0]} to {one.analyses[-1]}"


def _analyses(verification: Verification) -> str:
    numbers = [one.number for one in verification.found.analyses]
    return f"{len(numbers)} {'analysis' if len(numbers) == 1 else 'analyses'}"


def _say(text: str) -> None:
    print(printable(text, keep=""))
