"""Runs the benchmarks, each in a separate process, and prints their tables: `python -m benchmarks [NAME…]`.

`--write` writes the figures with commit and date to benchmarks/README.md. The figures are written after each benchmark, so they are
not lost if a later benchmark fails or the run is interrupted. `--list` lists the stored figures, the commit from which they come,
and the duration of each benchmark.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.measuring import ROOT, ProcessFailedError, figures_of, measured

NAMES = (
    "check_speed",
    "plan_difference",
    "history_index",
    "executor_steps",
    "verify_speed",
    "virtual_run",
    "least_squares_fit",
    "recording_memory",
    "screening",
    "allan",
    "monte_carlo",
    "inertial_stream",
    "strapdown",
    "navigation_72h",
    "tilted_scale_factor",
    "sensor_decoding",
    "sensor_streaming",
    "diagnosis",
    "night_overhead",
    "archive_site",
    "archive_scaling",
    "dask_workers",
)
README = Path(__file__).with_name("README.md")
START, END = "<!-- figures -->", "<!-- end of figures -->"
TOOK = re.compile(r"^`python -m benchmarks \w+` took (\d+) s(?: at commit `([^`]+)` on (\S+),.*)?\.$", re.MULTILINE)
BUSY = 0.3  # running processes beside ours, above which times are not to be trusted


@dataclass(frozen=True, slots=True)
class Kept:
    """Information about a benchmark in the file: its duration in seconds, the commit and the date. Commit and date are empty if the
    file does not state them."""

    seconds: int
    commit: str
    date: str


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "names", nargs="*", choices=[*NAMES, []], metavar="NAME", help=f"{', '.join(NAMES)} (default: all)"
    )
    parser.add_argument("--write", action="store_true", help="keep the figures in benchmarks/README.md")
    parser.add_argument("--list", action="store_true", help="which figures are kept, and from which commit")
    args = parser.parse_args(arguments)
    names = [name for name in NAMES if name in args.names] or list(NAMES)
    kept = {name: item for name, item in kept_figures(README.read_text(encoding="utf-8")).items() if name in names}
    if args.list:
        print(listed(names, kept))
        return 0
    minutes = sum(item.seconds for item in kept.values()) / 60
    say(f"{len(names)} benchmarks; they took {minutes:.0f} min when their figures were last kept")
    busy = load()
    if busy > BUSY:
        say(f"this machine is busy (load {busy:.1f}): figures taken now are not to be kept")
    return run(names, README if args.write else None)


def run(names: list[str], keep_in: Path | None) -> int:
    """Runs the benchmarks one after the other. Returns 1 if a benchmark failed. The figures of each benchmark are written as soon
    as it ends."""
    origin, failed, began = commit(), {}, time.monotonic()
    for name in names:
        say(f"running {name} …")
        start = time.perf_counter()
        busy = load()
        try:
            rows = figures_of(measured, name)
        except ProcessFailedError as error:
            failed[name] = str(error)
            say(f"{name} failed: {error}")
            continue
        taken = time.perf_counter() - start
        day = datetime.now(UTC).date().isoformat()
        section = table(name, rows, f"took {taken:.0f} s at commit `{origin}` on {day}, {machine(busy)}")
        print(section, flush=True)
        if keep_in is not None:
            text = keep_in.read_text(encoding="utf-8")
            keep_in.write_text(with_section(text, name, section), encoding="utf-8", newline="\n")
    say(f"{len(names) - len(failed)} of {len(names)} benchmarks in {(time.monotonic() - began) / 60:.1f} min")
    for name, reason in failed.items():
        say(f"no new figures of {name}: {reason}")
    return 1 if failed else 0


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def load() -> float:
    """Returns the mean number of processes that ran or waited in the last minute; NaN if the system does not count them."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan


def machine(busy: float) -> str:
    beside = "" if math.isnan(busy) else f", load {busy:.1f} before"
    return (
        f"Python {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()} {platform.system()}{beside}"
    )


def commit() -> str:
    """Returns the commit of the working tree, or 'unknown' outside a repository. If files other than the stored figures differ from
    the commit, `-dirty` is appended."""

    def git(*words: str) -> str:
        return subprocess.run(
            ("git", *words), check=True, capture_output=True, encoding="utf-8", cwd=ROOT
        ).stdout.strip()

    try:
        changed = git(
            "status", "--porcelain", "--untracked-files=no", "--", ".", f":!{README.relative_to(ROOT).as_posix()}"
        )
        return git("describe", "--always", "--tags", "--abbrev=10") + ("-dirty" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def table(name: str, rows: Mapping[str, Any], end: str) -> str:
    """Returns the table of one benchmark as Markdown: the measured quantities and their figures."""
    doc = (import_module(f"benchmarks.{name}").__doc__ or "").strip().splitlines()[0]
    lines = [f"### {name}", "", doc, "", "| what | figure |", "| --- | ---: |"]
    for what, figure in rows.items():
        lines.append(f"| {what} | {figure:.4g} |" if isinstance(figure, float) else f"| {what} | {figure} |")
    return "\n".join([*lines, "", f"`python -m benchmarks {name}` {end}."])


def sections(text: str) -> dict[str, str]:
    """Returns the stored tables in the text of the file, by the name of the benchmark."""
    figures = text.partition(START)[2].partition(END)[0]
    return {part.split("\n", 1)[0]: f"### {part}".rstrip() for part in figures.split("### ")[1:]}


def with_section(text: str, name: str, section: str) -> str:
    """Returns the text of the file after one table has been replaced or added. The tables have the order of NAMES. The other tables
    are unchanged."""
    before, _, rest = text.partition(START)
    found = sections(text) | {name: section}
    figures = "\n\n".join(found[name] for name in NAMES if name in found)
    return f"{before}{START}\n{figures}\n\n{END}{rest.partition(END)[2]}"


def kept_figures(text: str) -> dict[str, Kept]:
    """Returns the information about each benchmark whose figures the text of the file contains."""
    found = {name: TOOK.search(section) for name, section in sections(text).items()}
    return {name: Kept(int(line[1]), line[2] or "", line[3] or "") for name, line in found.items() if line}


def listed(names: list[str], kept: Mapping[str, Kept]) -> str:
    lines = []
    for name in names:
        item = kept.get(name)
        where = f"commit {item.commit} on {item.date}" if item and item.commit else "without a commit: run it again"
        lines.append(
            f"{name:20} {f'{item.seconds:5} s' if item else '      -'}  {where if item else 'no figures are kept'}"
        )
    return "\n".join([*lines, f"{'together':20} {sum(item.seconds for item in kept.values()):5} s"])


if __name__ == "__main__":
    sys.exit(main())
