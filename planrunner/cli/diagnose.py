"""`planrunner diagnose`: shows the places at which recording and simulation differ, the effects that explain the difference, and
proposals for the next measurement."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, InputError, Mark, closest
from planrunner.cli import exit_codes
from planrunner.cli.arguments import add_workers
from planrunner.cli.each_run import archive_of, run_folders
from planrunner.cli.printing import print_findings, print_json, write_file
from planrunner.cli.progress import reading_progress

if TYPE_CHECKING:
    from planrunner.base.progress import Announce
    from planrunner.gap.answer.diagnosis import DiagnosisOptions
    from planrunner.reporting.diagnosis_page import DiagnosisContext
    from planrunner.tasks.diagnose import Diagnosed, Recorded


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments that name a recording."""
    parser.add_argument(
        "subject", metavar="RUN|PLAN", type=Path, help="run folder, or the plan of a recording in a file"
    )
    parser.add_argument("--bench", metavar="BENCH", help="with a plan: bench that maps the recording's columns")
    parser.add_argument(
        "--recording", metavar="FILE", type=Path, help="with a plan: CSV or Parquet file of the samples"
    )
    parser.add_argument("--segments", metavar="CSV", type=Path, help="with a plan: table of the segments by label")


def add_nominal(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments for the terms that the simulation fits."""
    parser.add_argument(
        "--nominal",
        metavar="TERM",
        nargs="+",
        help="terms that the simulation fits (default: those in the plan, or all); a term that is left out "
        "becomes a candidate like any other effect",
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    parser.add_argument(
        "others",
        metavar="RUN",
        type=Path,
        nargs="*",
        help="further run folders, of other devices, benches or occasions: effects are attributed to device, bench or "
        "occasion",
    )
    parser.add_argument(
        "--origins",
        metavar="CSV",
        type=Path,
        help="with several runs: table with the columns run, device, bench, occasion; its entries replace those of the "
        "run folders",
    )
    parser.add_argument(
        "--also",
        metavar="RUN",
        action="append",
        type=Path,
        default=[],
        help="a later run of the same sensor, such as a run of a proposed plan, to be analysed together with the "
        "first; may be repeated",
    )
    parser.add_argument(
        "--given",
        metavar="EFFECT[=VALUE]",
        action="append",
        default=[],
        help="an effect that is known to act; may be repeated. EFFECT alone is fitted; EFFECT=VALUE or "
        "EFFECT=NAME:VALUE,… is subtracted. The remaining gap is diagnosed",
    )
    parser.add_argument("--json", action="store_true", help="print the diagnosis as JSON")
    parser.add_argument("--html", metavar="FILE", type=Path, help="write a page with pictures")
    parser.add_argument(
        "--next",
        metavar="FILE",
        type=Path,
        help="write the plan that would resolve the remaining ambiguity (default: next to the page, if there is one)",
    )
    parser.add_argument(
        "--write-plan",
        metavar="FILE",
        type=Path,
        help="write the plan with an additional estimate of the named effects",
    )
    parser.add_argument(
        "--write-bench", metavar="FILE", type=Path, help="write a virtual bench with the named effects as found"
    )
    parser.add_argument(
        "--simulation",
        metavar="BENCH",
        help="with --write-bench and --compare: the virtual bench (default: that of the recording)",
    )
    parser.add_argument(
        "--compare",
        action="store_true",
        help="simulate the plan without and with the named effects, and compare the recording with both",
    )
    add_nominal(parser)
    parser.add_argument("--all", action="store_true", help="RUN is an archive: diagnose all run folders in it together")
    add_workers(
        parser,
        "threads of the linear algebra (default: 1, usually the fastest); with several runs: processes (default: one per processor)",
    )


def run(args: argparse.Namespace) -> int:
    if args.others or args.all:
        from planrunner.cli.diagnose_fleet import run_fleet
        from planrunner.tasks.verify import runs_beneath

        runs = [args.subject, *args.others]
        options = options_of(args.nominal)
        return run_fleet(
            args,
            runs_beneath(archive_of(runs)) if args.all else run_folders(runs),
            None if options is None else options.nominal,
        )
    if args.scheduler is not None:
        message, hint = "--scheduler is for several runs", "give two or more run folders, or an archive with --all"
        raise InputError.at(COMMAND_LINE, "gap-arguments", message, hint)
    if args.origins is not None:
        raise InputError.at(
            COMMAND_LINE, "gap-arguments", "--origins is for several runs", "give two or more run folders"
        )
    from planrunner.tasks.diagnose import diagnose_recorded, joined

    with reading_progress() as notice:
        recorded = joined(recorded_of(args, notice), args.also, notice)
        print_findings(recorded.remarks)
        made = diagnose_recorded(recorded, options_of(args.nominal), args.jobs or 1, notice, args.given)
    print_findings(made.findings)
    found = made.to_json()
    if args.compare:
        if made.diagnosis.verdict.named:
            found["comparison"] = _compared(made, args.simulation)
        else:
            print("No effect is named: there is nothing to compare.", file=sys.stderr)
    text = _next(args, found)
    context = context_of(made, found, text)
    if args.html is not None:
        from planrunner.reporting.diagnosis_page import render_page

        write_file(args.html, render_page(context))
    if args.json:
        print_json(found)
    else:
        _show(context)
    out = sys.stderr if args.json else sys.stdout
    if args.html is not None:
        print(args.html, file=out)
    if args.next is not None:
        print(args.next if text else "No plan is proposed.", file=out)
    for line in _write(args, made):
        print(line, file=out)
    return exit_codes.DONE


def _compared(made: Diagnosed, simulation: str | None) -> JsonObject:
    from planrunner.execution.stopping import StopRequest
    from planrunner.tasks.closing import comparison

    with StopRequest() as stop:
        return comparison(made, stop, simulation).to_json()


def _write(args: argparse.Namespace, made: Diagnosed) -> list[str]:
    """Writes the plan and the bench with the effects that the diagnosis named, if the user requests them. Returns the lines to
    print about these files."""
    asked = [path for path in (args.write_plan, args.write_bench) if path is not None]
    if asked and not made.diagnosis.verdict.named:
        return [f"No effect is named: {path} is not written." for path in asked]
    from planrunner.tasks.named_effects import bench_with_effects, plan_with_estimate

    if args.write_plan is not None:
        checked = plan_with_estimate(made)
        write_file(args.write_plan, checked.plan_bytes.decode())
        print_findings(checked.findings)
    if args.write_bench is not None:
        write_file(args.write_bench, bench_with_effects(made, args.simulation))
    return list(map(str, asked))


def options_of(nominal: list[str] | None) -> DiagnosisOptions | None:
    """Returns the options of the diagnosis from the command line; None if none are given, so that the options in the plan apply.
    Raises `InputError` for an unknown nominal term."""
    from planrunner.gap.answer.diagnosis import DiagnosisOptions
    from planrunner.gap.hypotheses.candidates import FULL

    for name in nominal or ():
        if name not in FULL:
            raise InputError.at(
                Mark("--nominal"), "gap-nominal", f"'{name}' is not a nominal term", closest(name, FULL)
            )
    return None if nominal is None else DiagnosisOptions(nominal=tuple(nominal))


def recorded_of(args: argparse.Namespace, notice: Announce | None) -> Recorded:
    """Reads the recording from a run folder, or from a file that is given together with a plan. Raises `InputError` if the
    arguments do not fit together or the recording cannot be read."""
    from planrunner.tasks.diagnose import recorded_file, recorded_run

    subject: Path = args.subject
    if subject.is_dir():
        given = [f"--{name}" for name in ("bench", "recording", "segments") if vars(args)[name] is not None]
        if given:
            message = (
                f"{' and '.join(given)} cannot be given for a run folder, which contains its plan, bench and samples"
            )
            raise InputError.at(
                Mark(str(subject)), "gap-arguments", message, "give the run folder alone, or a plan instead"
            )
        return recorded_run(subject, notice)
    if args.recording is None:
        hint = "add --recording FILE, or give a run folder instead of the plan"
        raise InputError.at(Mark(str(subject)), "gap-arguments", "a plan alone contains nothing to diagnose", hint)
    return recorded_file(subject, args.bench, args.recording, args.segments, notice)


def _next(args: argparse.Namespace, found: JsonObject) -> str:
    """Writes the proposed plan to the file that `--next` names; by default, to a file next to the page. Enters the path of the file
    in the diagnosis."""
    following = found["next"]
    if following is None:
        return ""
    text = str(following["text"])
    if args.next is None and args.html is not None:
        args.next = args.html.with_suffix(".next.yaml")
    if args.next is not None and text:
        write_file(args.next, text)
        following["plan"] = str(args.next)
    return text


def context_of(made: Diagnosed, found: JsonObject, next_plan: str) -> DiagnosisContext:
    from planrunner.reporting.context import site_facts
    from planrunner.reporting.diagnosis_page import DiagnosisContext

    sound = made.recorded.sound
    facts = {
        "Recording": made.recorded.where,
        "Plan": sound.file,
        "Bench": sound.bench.name,
        "Segments": str(len(found["pictures"]["heat"]["segments"])),
        "Fitted by the simulation": ", ".join(made.diagnosis.grounds.nominal) or "nothing",
        **_given(found),
        **site_facts(sound.models.site),
    }
    remarks = tuple(f"{finding.message}: {finding.hint}" for finding in made.findings)
    return DiagnosisContext(sound.plan.title, found, facts, remarks, next_plan, sound.models.origin)


def _given(found: JsonObject) -> dict[str, str]:
    """Returns the effects that the user declared to act, as one fact for the page; empty if there are none."""
    fitted = dict.fromkeys(f"{one['effect']} (fitted)" for one in found["given"]["fitted"])
    stated = [
        f"{name} = {', '.join(filter(None, (f'{key} {text}'.strip() for key, text in values.items())))}"
        for name, values in found["given"]["stated"].items()
    ]
    known = [*fitted, *stated]
    return {"Known to act": ", ".join(known)} if known else {}


def _show(context: DiagnosisContext) -> None:
    """Prints the answer, then the tables that support it."""
    from planrunner.reporting import diagnosis_page, terminal
    from planrunner.reporting.verdict import stamp

    found = context.diagnosis
    console = terminal.console()
    mark = stamp(context.origin)
    if mark is not None and mark.alarming:
        console.print(f"{mark.word}: {mark.about}", style="bold red")
    for one in diagnosis_page.named_effects(found):
        console.print(one.heading, style="bold")
        console.print(f"  {one.remedy}")
        console.print(f"  {one.physics}", style="dim")
    known = context.facts.get("Known to act")
    if known:
        console.print(f"Known to act: {known}. The remaining gap is diagnosed.")
    console.print(diagnosis_page.verdict(found), style="bold")
    for sentence in filter(None, (diagnosis_page.unknown_words(found), diagnosis_page.closure_words(found))):
        console.print(sentence)
    for table in diagnosis_page.tables(found).values():
        console.print(terminal.data_table(table))
    expected = diagnosis_page.expected_words(found)
    if expected:
        console.print(f"next: {expected}")
    console.print(diagnosis_page.priors_words(found), style="dim")
