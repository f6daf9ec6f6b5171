"""`planrunner export`: coefficients of a run's newest analysis for other tools."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from planrunner import cli
from planrunner.cli.printing import write_file
from planrunner.plan.findings import InputError, Mark, closest

FORMS = {"csv": "csv", "matlab": "m", "yaml": "yaml", "c": "h"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument("estimate", metavar="ESTIMATE", nargs="?", help="name of the estimate (default: the first)")
    parser.add_argument("--format", choices=FORMS, default="csv", help="csv, matlab, yaml or c (default: csv)")
    parser.add_argument("--analysis", type=int, metavar="N", help="number of the analysis (default: the newest)")
    parser.add_argument("--output", metavar="FILE", type=Path, help="file to write (default: standard output)")


def run(args: argparse.Namespace) -> int:
    from planrunner.archive.analyses import check_analysis
    from planrunner.archive.run_reader import RunReader
    from planrunner.estimators.analysis import Results
    from planrunner.reporting.export import export

    reader = RunReader.open(args.run_folder)
    folders = {int(folder.name): folder for folder in reader.analyses()}
    number = args.analysis if args.analysis is not None else max(folders, default=0)
    if number not in folders:
        message = "this run has no such analysis" if folders else "this run has no analysis yet"
        known = ", ".join(map(str, folders))
        hint = f"known here: {known}" if folders else "make one with `planrunner estimate`"
        raise InputError.at(Mark(str(args.run_folder)), "analysis-missing", message, hint)
    check_analysis(folders[number])
    results = Results.from_json(json.loads((folders[number] / "results.json").read_text(encoding="utf-8")))
    if not results.estimates:
        message, hint = "no estimate of this analysis came to a result", "its reports say why"
        raise InputError.at(Mark(str(folders[number])), "estimate-missing", message, hint)
    name = args.estimate or next(iter(results.estimates), "")
    if name not in results.estimates:
        hint = closest(name, results.estimates)
        raise InputError.at(Mark(str(folders[number])), "estimate-missing", f"there is no estimate '{name}'", hint)
    provenance = {"run": reader.run["run"], "analysis": str(number), "plan": reader.run["plan"]}
    text = export(results.estimates[name], args.format, provenance)
    if args.output is None:
        print(text, end="")
    else:
        write_file(args.output, text)
        print(args.output)
    return cli.DONE
