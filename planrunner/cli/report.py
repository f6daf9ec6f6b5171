"""`planrunner report`: makes the reports of one or more runs again, as a new analysis. The command also makes certificates, and
reports from the user's own templates."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from planrunner.base.findings import COMMAND_LINE, InputError, closest
from planrunner.cli import exit_codes
from planrunner.cli.arguments import folder_argument
from planrunner.cli.each_run import Done, each_run, run_folders
from planrunner.cli.log import ring_of
from planrunner.cli.printing import print_findings, write_file
from planrunner.cli.progress import reading_progress
from planrunner.plan.run_information import gather_for_issue


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "words",
        metavar="RUN|NAME",
        nargs="+",
        help="one or more run folders; then reports to write instead of those in the plan, such as certificate.html",
    )
    parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="certificate details that the run did not record",
    )
    parser.add_argument("--info", metavar="FILE", type=Path, help="the same details as a YAML file of `name: value`")
    parser.add_argument("--before", metavar="RUN", type=Path, help="run folder of the same item before its adjustment")
    parser.add_argument(
        "--keys",
        metavar="RING",
        type=Path,
        help="key ring, with which the signatures that the reports print are verified",
    )
    parser.add_argument(
        "--template", metavar="FILE", type=Path, help="your own template (ending in .html.j2 or .md.j2)"
    )
    parser.add_argument("--output", metavar="FILE", type=Path, help="with --template: the file to write")
    parser.add_argument(
        "--json", action="store_true", help="print a list of the written files as JSON, one entry per run"
    )


def run(args: argparse.Namespace) -> int:
    runs, names = _told(args.words)
    runs = run_folders(runs)
    if len(runs) > 1:
        _check_several(args, names)
    return each_run(runs, lambda folder: _report(folder, names, args), as_json=args.json)


def _told(words: Sequence[str]) -> tuple[list[Path], tuple[str, ...]]:
    """Splits the arguments into run folders and names of reports. The first argument is always a run; a later argument is a run if
    it is a folder or a URL. Raises `InputError` for an unknown report."""
    from planrunner.tasks.check import report_names

    known = report_names()
    runs, names = [folder_argument(words[0])], []
    for word in words[1:]:
        if word in known:
            names.append(word)
        elif "://" in word or Path(word).is_dir():
            runs.append(folder_argument(word))
        else:
            message = f"there is no report '{word[:60]}'"
            raise InputError.at(COMMAND_LINE, "meaning-unknown-report", message, closest(word, known))
    return runs, tuple(names)


def _check_several(args: argparse.Namespace, names: Sequence[str]) -> None:
    """Refuses a certificate and the options that apply to a single run (--set, --info, --before, --template) if several runs are
    given. Raises `InputError` if such an option is given."""
    from planrunner.reporting.certificate_requirements import is_certificate

    given = {"--set": args.set, "--info": args.info, "--before": args.before, "--template": args.template}
    alone = [*(name for name in names if is_certificate(name)), *(option for option, value in given.items() if value)]
    if alone:
        message = f"{' and '.join(alone)} {'belongs' if len(alone) == 1 else 'belong'} to one run"
        raise InputError.at(COMMAND_LINE, "report-several", message, "give one run folder at a time")


def _report(run: Path, names: tuple[str, ...], args: argparse.Namespace) -> Done:
    from planrunner.archive.remote import push_back
    from planrunner.archive.run_reader import RunReader
    from planrunner.tasks import certify as certifying
    from planrunner.tasks.estimate import Issue, analyse_run, report_through

    recorded = RunReader.open(run).run["info"]
    given = gather_for_issue([*certifying.names(), *recorded], args.set, args.info)
    issue = Issue(names, given, args.before, ring_of(args))
    if args.template is None:
        with reading_progress() as notice:
            analysis = analyse_run(run, issue, notice=notice)
        push_back(run, analysis.folder)
        print_findings((*analysis.remarks, *analysis.withheld, *analysis.unsigned))
        written = [*analysis.reports]
        found = {"analysis": str(analysis.folder), "withheld": [finding.to_json() for finding in analysis.withheld]}
    else:
        with reading_progress() as notice:
            text = report_through(run, args.template, issue, notice)
        written = [args.output or Path(args.template.name.removesuffix(".j2"))]
        write_file(written[0], text)
        found = {}
    if not args.json:
        for path in written:
            print(path)
    return Done(exit_codes.DONE, {**found, "files": [str(path) for path in written]})
