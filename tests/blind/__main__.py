"""`python -m tests.blind make|answer|score FOLDER`: the blind campaign; `ceiling`: what nobody could surpass in it;
`curve`: its calibration as a drawing."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from planrunner.base.findings import InputError
from planrunner.cli.arguments import add_workers, workers_of
from tests.blind import campaign
from tests.blind.commitment import BrokenSealError


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("make", help="make cases and commit to their labels")
    make.add_argument("count", type=int)
    make.add_argument("--seed", type=int, required=True, help="any whole number; who knows it knows the labels")
    source = make.add_mutually_exclusive_group()
    source.add_argument(
        "--real-noise", action="store_true", help="add the noise of recordings at rest in ../shared/data"
    )
    source.add_argument(
        "--further", action="store_true", help="triples, steps, counts, delays, coloured noise and wrong labels"
    )
    answer = commands.add_parser("answer", help="have every case answered")
    answer.add_argument(
        "--by",
        action="append",
        help=f"{', '.join(campaign.ANSWERERS)} or module:function; may be repeated (default: planrunner)",
    )
    score = commands.add_parser("score", help="verify the commitments and score all answers")
    score.add_argument("--json", type=Path, help="write the figures to this file")
    curve = commands.add_parser("curve", help="draw the calibration curve of a score")
    curve.add_argument("score", type=Path, help="what `score --json` wrote")
    curve.add_argument("file", type=Path, help="the drawing, an SVG")
    ceiling = commands.add_parser("ceiling", help="what an answerer reaches that knows all but the draw")
    ceiling.add_argument("count", type=int)
    ceiling.add_argument("--seed", type=int, required=True)
    for command in (make, answer, score):
        command.add_argument("folder", type=Path)
    for command in (answer, score):
        command.add_argument("--first", type=int, metavar="N", help="only the first N cases (default: all)")
    for command in (make, answer):
        add_workers(command, "processes of this machine (default: 1)")
    return parser.parse_args(argv)


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main(argv: list[str] | None = None) -> int:
    given = _arguments(argv)
    try:
        if given.command == "make":
            source: campaign.Source = "further" if given.further else "real noise" if given.real_noise else "drawn"
            campaign.make_all(given.folder, given.count, given.seed, workers_of(given), _tell, source)
        elif given.command == "answer":
            names = given.by or ["planrunner"]
            campaign.answer_all(given.folder, names, workers_of(given), _tell, given.first)
        elif given.command == "ceiling":
            from tests.blind.ceiling import told

            print(told(given.count, given.seed), end="")
        elif given.command == "curve":
            from tests.blind.curve import drawn

            drawn(given.score, given.file)
        else:
            from tests.blind import report

            print(report.scored(given.folder, given.json, given.first), end="")
    except (BrokenSealError, InputError, ValueError, OSError) as error:
        _tell(f"tests.blind: {error}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
