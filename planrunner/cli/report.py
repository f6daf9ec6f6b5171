"""`planrunner report`: the reports of a run, again, as a new analysis; a certificate; or a template of your own."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner import cli
from planrunner.cli.printing import print_findings, write_file
from planrunner.plan.findings import InputError, closest
from planrunner.run_information import COMMAND_LINE, gather_for_issue


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument(
        "names", metavar="NAME", nargs="*", help="reports to write instead of the plan's, such as certificate.html"
    )
    parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="what a certificate says and the run did not record",
    )
    parser.add_argument("--info", metavar="FILE", type=Path, help="the same as a YAML file of name: value")
    parser.add_argument("--before", metavar="RUN", type=Path, help="run folder of the same item before its adjustment")
    parser.add_argument(
        "--template", metavar="FILE", type=Path, help="a template of your own (ending in .html.j2 or .md.j2)"
    )
    parser.add_argument("--output", metavar="FILE", type=Path, help="with --template: the file to write")


def run(args: argparse.Namespace) -> int:
    from planrunner import certifying, running
    from planrunner.archive.run_reader import RunReader
    from planrunner.checking import report_names

    known = report_names()
    for name in args.names:
        if name not in known:
            message = f"there is no report '{name[:60]}'"
            raise InputError.at(COMMAND_LINE, "meaning-unknown-report", message, closest(name, known))
    recorded = RunReader.open(args.run_folder).run["info"]
    given = gather_for_issue([*certifying.names(), *recorded], args.set, args.info)
    issue = running.Issue(tuple(args.names), given, args.before)
    if args.template is None:
        analysis = running.analyse_run(args.run_folder, issue)
        print_findings(analysis.withheld)
        for path in analysis.reports:
            print(path)
        return cli.DONE
    text = running.report_through(args.run_folder, args.template, issue)
    target = args.output or Path(args.template.name.removesuffix(".j2"))
    write_file(target, text)
    print(target)
    return cli.DONE
