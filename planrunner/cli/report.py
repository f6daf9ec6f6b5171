"""`planrunner report`: the reports of a run, again, as a new analysis; or through a template of your own."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner import cli
from planrunner.cli.printing import write_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument(
        "--template", metavar="FILE", type=Path, help="a template of your own (ending in .html.j2 or .md.j2)"
    )
    parser.add_argument("--output", metavar="FILE", type=Path, help="with --template: the file to write")


def run(args: argparse.Namespace) -> int:
    from planrunner import running

    if args.template is None:
        for path in running.analyse_run(args.run_folder).reports:
            print(path)
        return cli.DONE
    text = running.report_through(args.run_folder, args.template)
    target = args.output or Path(args.template.name.removesuffix(".j2"))
    write_file(target, text)
    print(target)
    return cli.DONE
