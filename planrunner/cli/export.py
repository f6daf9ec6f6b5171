"""`planrunner export`: writes coefficients of the newest analysis of one or more runs for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path

from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, InputError, Mark, closest
from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done, each_run, run_folders
from planrunner.cli.printing import print_findings, write_file

FORMS = {"csv": "csv", "matlab": "m", "yaml": "yaml", "c": "h"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "words",
        metavar="RUN|ESTIMATE",
        nargs="+",
        type=Path,
        help="one or more run folders; then the name of the estimate (default: the first)",
    )
    parser.add_argument("--format", choices=FORMS, default="csv", help="csv, matlab, yaml or c (default: csv)")
    parser.add_argument("--analysis", type=int, metavar="N", help="number of the analysis (default: the newest)")
    parser.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        help="file to write, or a folder for one file per run (default: standard output)",
    )
    parser.add_argument("--json", action="store_true", help="print a list of coefficients as JSON, one entry per run")


def run(args: argparse.Namespace) -> int:
    runs, name = _told(args.words)
    runs = run_folders(runs)
    folder = args.output is not None and args.output.is_dir()
    if len(runs) > 1 and not args.json and not folder:
        message = "the coefficients of several runs cannot be written to one file"
        raise InputError.at(COMMAND_LINE, "export-several", message, "give --json, or an existing folder as --output")
    return each_run(runs, lambda run: _export(run, name, args, folder=folder), as_json=args.json)


def _told(words: list[Path]) -> tuple[list[Path], str]:
    """Splits the arguments into the run folders and the name of an estimate. The first argument is always a run. The last of
    several arguments is the name of an estimate if it is not a folder."""
    *others, last = words
    return (others, str(last)) if others and not last.is_dir() else (words, "")


def _export(run: Path, asked: str, args: argparse.Namespace, *, folder: bool) -> Done:
    from planrunner.archive.analyses import chosen_analysis
    from planrunner.archive.run_reader import RunReader
    from planrunner.archive.segment_file import safe_name
    from planrunner.estimators.results import Results
    from planrunner.reporting.export import export
    from planrunner.tasks.estimate import stored_results

    reader = RunReader.open(run)
    print_findings(reader.findings)
    analysis = chosen_analysis(run, reader.analyses, args.analysis)
    results = stored_results(analysis)
    if not results.estimates:
        message, hint = "no estimate of this analysis has a result", "its reports give the reasons"
        raise InputError.at(Mark(str(analysis.path)), "estimate-missing", message, hint)
    name = asked or next(iter(results.estimates), "")
    if name not in results.estimates:
        hint = closest(name, results.estimates)
        raise InputError.at(Mark(str(analysis.path)), "estimate-missing", f"there is no estimate '{name}'", hint)
    estimate = results.estimates[name]
    whole = Results({name: estimate}).to_json()["estimates"][0]
    found: JsonObject = {
        "analysis": analysis.number,
        "plan": reader.run["plan"],
        "estimate": name,
        **{key: whole[key] for key in ("estimator", "coefficients", "covariance")},
    }
    target: Path | None = args.output
    if target is None and args.json:
        return Done(exit_codes.DONE, found)
    text = export(
        estimate, args.format, {"run": reader.run["run"], "analysis": str(analysis.number), "plan": reader.run["plan"]}
    )
    if target is None:
        print(text, end="")
        return Done(exit_codes.DONE)
    target = target / f"{reader.run['run']}-{safe_name(name)}.{FORMS[args.format]}" if folder else target
    write_file(target, text)
    if not args.json:
        print(target)
    return Done(exit_codes.DONE, {**found, "file": str(target)})
