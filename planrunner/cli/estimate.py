"""`planrunner estimate`: from the recording alone, as a new analysis beside the earlier ones."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from planrunner.cli.outcome import conclude


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_folder", metavar="RUN", type=Path, help="run folder")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")


def run(args: argparse.Namespace) -> int:
    from planrunner import running

    analysis = running.analyse_run(args.run_folder)
    earlier = analysis.folder.parent / str(int(analysis.folder.name) - 1) / "results.json"
    if earlier.is_file():
        same = json.loads(earlier.read_text(encoding="utf-8")) == json.loads(
            (analysis.folder / "results.json").read_text(encoding="utf-8")
        )
        verdict = "the same numbers as" if same else "OTHER NUMBERS than"
        print(f"analysis {analysis.folder.name} has {verdict} analysis {earlier.parent.name}", file=sys.stderr)
    return conclude(analysis, as_json=args.json)
