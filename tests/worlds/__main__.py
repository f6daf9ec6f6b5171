"""Coverage and warnings of each estimator in each world:

python -m tests.worlds [--runs N] [--seed S] [--estimator NAME] [--world NAME] [--keep FILE] [--jobs N | --scheduler ADDRESS]

The runs of a batch are simulated together, by one process of this machine or of a Dask cluster. Its random numbers come from the seed and
the numbers of its runs, and batches are added in their order: the figures do not depend on the processes.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Collection, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path

from planrunner.base.findings import InputError
from planrunner.base.workers import results_in_order
from planrunner.cli.arguments import add_workers, workers_of
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import Batch, Tally, tally_of, world_of
from tests.worlds.faults import WORLDS

AT_ONCE = 25
"""Runs of a batch."""


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.worlds", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="0 only prints what the file holds")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--estimator", default="", help="its name, or a part of the names of several")
    parser.add_argument("--world", default="", help="its name, or a part of the names of several")
    parser.add_argument("--keep", type=Path, help="file for the results; runs that it already holds are not repeated")
    add_workers(parser, "processes of this machine (default: 1)")
    args = parser.parse_args(arguments)
    cells = _kept(args.keep, args.seed)
    print("| estimator | world | runs | coverage in % | lowest | highest | warned | cause named | no estimate |")
    print("| --- | --- | ---: | --- | --- | --- | ---: | ---: | ---: |")
    asked = {cell: cells.get(cell, Tally()) for cell in _cells(args.estimator, args.world)}
    batches = [batch for cell, found in asked.items() for batch in _batches(cell, found.runs, args.runs)]
    tallies = results_in_order(partial(tally_of, args.seed), batches, workers_of(args))
    for (estimator, world), found in asked.items():
        while found.runs < args.runs:
            more = next(tallies)
            found.add(more)
            if args.keep:
                line = {"estimator": estimator, "world": world, "seed": args.seed, **asdict(more)}
                with args.keep.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
        if found.runs:
            print(_row(estimator, world, found), flush=True)


def _cells(estimator: str, world: str) -> Iterator[tuple[str, str]]:
    for one, campaign in CAMPAIGNS.items():
        for other in WORLDS:
            if _asked(estimator, one, CAMPAIGNS) and _asked(world, other, WORLDS) and other not in campaign.without:
                yield one, other


def _batches(cell: tuple[str, str], done: int, runs: int) -> Iterator[Batch]:
    for first in range(done, runs, AT_ONCE):
        yield Batch(*cell, min(AT_ONCE, runs - first), first)


def _asked(text: str, name: str, known: Collection[str]) -> bool:
    return name == text if text in known else text in name


def _kept(path: Path | None, seed: int) -> dict[tuple[str, str], Tally]:
    found: dict[tuple[str, str], Tally] = {}
    if path and path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            held = json.loads(line)
            cell = held.pop("estimator"), held.pop("world")
            if held.pop("seed") == seed:
                found.setdefault(cell, Tally()).add(Tally(**held))
    return found


def _row(estimator: str, world: str, found: Tally) -> str:
    figures = "– | – | –"
    if found.estimates:
        shares = {name: 100 * held / found.estimates for name, held in found.held.items()}
        low, high = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
        mean, error = found.coverage
        figures = f"{100 * mean:.1f} ± {100 * error:.1f} | {shares[low]:.1f} ({low}) | {shares[high]:.1f}"
    named = f"{100 * found.named / found.runs:.1f} %" if world_of(estimator, world).cause else ""
    counts = f"{100 * found.warned / found.runs:.1f} % | {named} | {len(found.failed)}"
    return f"| {estimator} | {world} | {found.runs} | {figures} | {counts} |"


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"tests.worlds: {error}")
