"""Prints the output of commands at the end of a run or an analysis, and determines the exit codes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.documents import JsonObject
from planrunner.base.findings import InputError
from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done
from planrunner.cli.printing import print_findings, print_json, print_line
from planrunner.cli.progress import reading_progress

if TYPE_CHECKING:
    from planrunner.estimators.results import Results
    from planrunner.execution.executor import Outcome
    from planrunner.reporting.verdict import Headline
    from planrunner.tasks.check import Sound
    from planrunner.tasks.estimate import Analysis


def tell(folder: Path, outcome: Outcome, *, as_json: bool) -> int:
    """Reports on stderr how an unfinished run ended, which data are stored, and how to continue. With JSON output, also prints
    JSON."""
    for failure in outcome.failures:
        print(f"error: {failure}", file=sys.stderr)
    for unsafe in outcome.unsafe:
        print(f"error: NOT IN THE SAFE STATE: {unsafe}; check the instrument now", file=sys.stderr)
    if outcome.untouched:
        print(f"Unchanged, because no command was sent to them: {', '.join(outcome.untouched)}.", file=sys.stderr)
    if not outcome.unsafe:
        which = "Every other instrument is in its" if outcome.untouched else "The instruments are in their"
        print(f"{which} safe state.", file=sys.stderr)
    if outcome.stopped:
        print(f"Stopped {outcome.stopped} on request.", file=sys.stderr)
    print(
        f"{outcome.completed} of {outcome.segments} segments were recorded in this session and are kept.",
        file=sys.stderr,
    )
    print(f"Continue with: planrunner resume {folder}", file=sys.stderr)
    code = (
        exit_codes.INTERRUPTED if outcome.stopped and not outcome.failures and not outcome.unsafe else exit_codes.FAULT
    )
    if as_json:
        print_json(
            {
                "run": str(folder),
                "exit_code": code,
                "failures": [str(failure) for failure in outcome.failures],
                "unsafe": list(outcome.unsafe),
                "stopped": outcome.stopped,
                "recorded": outcome.completed,
                "segments": outcome.segments,
            }
        )
    return code


def conclude(analysis: Analysis, *, as_json: bool) -> Done:
    """Prints the results, except if JSON output is requested. The last line is the path of the first report or, if there are no
    reports, of the analysis. Returns the exit code that follows from the results, and the results as JSON."""
    if not as_json:
        print_results(analysis.results, analysis.headline)
        for path in reversed(analysis.reports or (analysis.folder,)):
            print(path)
    print_findings((*analysis.remarks, *analysis.withheld, *analysis.unsigned))
    found = {"analysis": str(analysis.folder), **analysis.results.to_json()} if as_json else {}
    if as_json and analysis.unsigned:
        found["unsigned"] = [finding.message for finding in analysis.unsigned]
    return Done(code_of(analysis.results), found)


def evaluate(
    folder: Path, outcome: Outcome, args: argparse.Namespace, checked: Sound | None = None, *, standard: bool = True
) -> int:
    """Ends a command that made one run: evaluates the run, prints its results and returns the exit code. A missing signature of the
    bench counts as a fault, except if the results already cause another exit code. `args`: the arguments of `add_run_arguments`.
    `checked`: the checked plan of the run; by default, the plan in the folder is checked. `standard`: True to report whether the check
    standard of the bench is in control, if the run measured it."""
    from planrunner.tasks.estimate import analyse_run

    print_findings((*outcome.remarks, *outcome.unsigned))
    with reading_progress(args.quiet) as notice:
        analysis = analyse_run(folder, checked=checked, notice=notice)
    done = conclude(analysis, as_json=args.json)
    unsigned = [finding.message for finding in (*outcome.unsigned, *analysis.unsigned)]
    state, in_control = _check_standard(folder) if standard else ({}, True)
    if args.json:
        print_json(done.found | ({"unsigned": unsigned} if unsigned else {}) | state)
    return done.code or (exit_codes.FAULT if unsigned else exit_codes.DONE if in_control else exit_codes.LIMIT_FAILED)


def _check_standard(run: Path) -> tuple[JsonObject, bool]:
    """Reports on stderr the state of the check standard that a run measured. Returns this state as JSON data, and True if the
    standard is in control. If the state cannot be determined, the JSON data state null; the run is not affected. If the run did not
    measure a check standard, the JSON data are empty and the second value is True."""
    from planrunner.tasks.check_standard import state_after

    try:
        state = state_after(run)
    except InputError as error:
        message = f"warning: the state of the check standard cannot be determined: {error}"
        print_line(message, sys.stderr)
        return {"check_standard": None}, False
    if state is None:
        return {}, True
    print_line(f"{'note' if state.in_control else 'warning'}: {state.words()}", sys.stderr)
    return {"check_standard": state.to_json()}, state.in_control


def code_of(results: Results) -> int:
    """Returns the exit code that follows from the results: `WRONG_INPUT` if an estimate failed because of the plan; otherwise
    `LIMIT_FAILED` if a limit is not met or the data do not give an estimate; otherwise `DONE`."""
    if results.failures.keys() - set(results.unfit):
        return exit_codes.WRONG_INPUT
    met = all(limit.verdict == "pass" for limit in results.limits)
    return exit_codes.DONE if met and not results.unfit else exit_codes.LIMIT_FAILED


def print_results(results: Results, headline: Headline) -> None:
    """Prints coefficients, comparisons, limits, notes and warnings as tables, then the verdict and the source of the samples."""
    from planrunner.reporting import terminal
    from planrunner.reporting.verdict import stamp

    console = terminal.console()
    for estimate in results.estimates.values():
        console.print(terminal.coefficients_table(estimate, only=estimate.headline or None))
        for table in estimate.tables:
            if table.terminal:
                console.print(terminal.data_table(table))
        for text in estimate.warnings:
            console.print(f"warning: {text}", style="yellow")
        for text in estimate.notes:
            console.print(f"note: {text}", style="dim")
        console.print()
    if results.limits:
        console.print(terminal.limits_table(results.limits))
    for name, message in results.failures.items():
        print(f"error: {name}: {message}", file=sys.stderr)
    mark = stamp(results.origin)
    if mark is not None:
        console.print(f"{mark.word}: {mark.about}", style="bold red" if mark.alarming else "bold")
    console.print(headline.text, style=terminal.VERDICT[headline.kind] if mark is None else "bold")
