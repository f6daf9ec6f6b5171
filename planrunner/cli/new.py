"""`planrunner new`: lists and copies the shipped plans, or makes a first plan from a recording."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from planrunner.base.findings import InputError, Mark, closest
from planrunner.base.shipped import shipped
from planrunner.cli import exit_codes
from planrunner.cli.printing import print_json, write_new
from planrunner.plan import source

SCHEMA = "plan.schema.json"
_HEADER = re.compile(rb"^# yaml-language-server: \$schema=(\S+)", re.MULTILINE)  # editors use it to find the schema


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "plan", nargs="?", metavar="NAME", help="shipped plan to copy (default: list the shipped plans)"
    )
    parser.add_argument(
        "target", nargs="?", metavar="FILE", help="file to write (default: NAME.yaml in the current folder)"
    )
    parser.add_argument(
        "--from-recording",
        type=Path,
        metavar="RECORDING",
        help="instead of a shipped plan: examine a file of samples, and write a first bench, plan and picture",
    )
    parser.add_argument(
        "--sample-rate",
        metavar="RATE",
        help="with --from-recording: the sample rate of a file without a time, such as '100 Hz'",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the list, or the names of the written files, as JSON"
    )


def run(args: argparse.Namespace) -> int:
    if args.from_recording is not None:
        from planrunner.cli.new_from_recording import new_from_recording

        if args.target is not None:
            raise InputError.at(
                Mark(args.target),
                "form-unknown-key",
                "one file too many",
                "name only the plan to write, after --from-recording RECORDING",
            )
        return new_from_recording(args.from_recording, args.plan, args.sample_rate, as_json=args.json)
    if args.sample_rate is not None:
        raise InputError.at(
            Mark("--sample-rate"),
            "meaning-range",
            "a sample rate applies to a recording",
            "add --from-recording RECORDING",
        )
    plans = {file.stem: file for file in sorted(shipped("plans").glob("*.yaml"))}
    if args.plan is None:
        return _list(plans, as_json=args.json)
    if args.plan not in plans:
        raise InputError.at(
            Mark(args.plan), "new-unknown", f"no shipped plan is called '{args.plan}'", closest(args.plan, plans)
        )
    target = Path(args.target or f"{args.plan}.yaml")
    schema = _copy(plans[args.plan], target)
    if args.json:
        print_json({"plan": str(target), "schema": str(schema)})
        return exit_codes.DONE
    print(f"{target}: check it with `planrunner check {target}`")
    return exit_codes.DONE


def _list(plans: dict[str, Path], *, as_json: bool) -> int:
    titles: dict[str, str] = {}
    for name, file in plans.items():
        written = source.load(file).get("title")
        titles[name] = written.text if isinstance(written, source.Scalar) else ""
    if as_json:
        print_json([{"name": name, "title": title} for name, title in titles.items()])
        return exit_codes.DONE
    for name, title in titles.items():
        print(f"{name:<36} {title}")
    print("\nCopy one with: planrunner new NAME [FILE]")
    return exit_codes.DONE


def _copy(original: Path, target: Path) -> Path:
    """Copies a plan atomically, and changes its first line so that it names an existing schema file. Returns the schema file.

    If the project of the target already has a schema file, the first line names that file; otherwise the shipped schema is written
    next to the plan. Raises `InputError` if a file cannot be written.
    """
    text = original.read_bytes()
    header = _HEADER.search(text)
    named = header.group(1).decode() if header else SCHEMA
    place = next((name for name in (named, f"schemas/{SCHEMA}", SCHEMA) if (target.parent / name).is_file()), None)
    schema = target.parent / (place or SCHEMA)
    if header:
        text = text[: header.start(1)] + (place or SCHEMA).encode() + text[header.end(1) :]
    write_new(target, text)
    if place is None:
        try:
            write_new(schema, (shipped("schemas") / SCHEMA).read_bytes())
        except InputError:
            target.unlink(missing_ok=True)
            raise
    return schema
