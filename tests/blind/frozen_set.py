"""`python -m tests.blind.frozen_set FOLDER ANSWERS`: a frozen blind set is diagnosed once, as a user would, by committed code.

FOLDER contains a folder with `recording.parquet` for each case and `segments.csv`, of its own or in common. If the cases follow several
plans, `cases.csv` (`case,plan`) says which recording follows which, and `--plan NAME=PLAN` names the plan file of each. The answers are
the JSON of the diagnosis without its pictures and the text of the proposed plan, with the commit that made them. They are written once:
if ANSWERS exists, or files differ from the commit, nothing is run.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
PLAN = "plans/imu_recorded_over_temperature.yaml"  # unless another is named
PLACES = 10  # of the ranked list of places
LEAST = 1e-6  # probability of a hypothesis that is kept


class NotFrozenError(ValueError):
    """Answers may not be made now."""


def commit() -> str:
    """The commit that is checked out. Raises `NotFrozenError` when files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True).stdout

    if git("status", "--porcelain").strip():
        raise NotFrozenError("files differ from the commit: answers are those of committed code")
    return git("rev-parse", "HEAD").strip()


def diagnosed(recording: Path, segments: Path, plan: str) -> dict[str, Any]:
    """What `planrunner diagnose --json` prints."""
    words = ["diagnose", plan, "--recording", str(recording), "--segments", str(segments), "--json"]
    done = subprocess.run([sys.executable, "-m", "planrunner", *words], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        return {"error": done.stderr.strip()}
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def shortened(answer: dict[str, Any]) -> dict[str, Any]:
    """Without the long arrays, and the hundreds of hypotheses that are as good as impossible."""
    short = {name: value for name, value in answer.items() if name not in ("pictures", "priors")}
    if "posterior" in short:
        short["posterior"] = {name: p for name, p in short["posterior"].items() if p >= LEAST}
    if "where" in short:
        short["where"] = short["where"][:PLACES]
    if short.get("next"):
        short["next"] = {name: value for name, value in short["next"].items() if name != "text"}
    return short


def plans_of(folder: Path, plans: Mapping[str, str]) -> dict[str, str]:
    """The plan file of each case that `cases.csv` lists; plans: file by name. Raises `NotFrozenError` if one is not named."""
    if not (folder / "cases.csv").is_file():
        return {}
    with open(folder / "cases.csv", encoding="utf-8", newline="") as table:
        named = {row["case"]: row["plan"] for row in csv.DictReader(table)}
    if missing := sorted(set(named.values()) - set(plans)):
        raise NotFrozenError(f"no plan file is named for {', '.join(missing)}: add --plan {missing[0]}=PLAN")
    return {case: plans[name] for case, name in named.items()}


def answer_all(
    folder: Path,
    answers: Path,
    by: Callable[[Path, Path, str], dict[str, Any]] = diagnosed,
    of: Callable[[], str] = commit,
    plans: Mapping[str, str] | None = None,
) -> int:
    """How many cases were answered. plans: plan files by their names in `cases.csv`. Raises `NotFrozenError`."""
    if answers.exists():
        raise NotFrozenError(f"{answers} is there already: a frozen set is answered once")
    made_by, own = of(), plans_of(folder, plans or {})
    recordings = sorted(folder.resolve().glob("*/recording.parquet"))
    tables = [one.with_name("segments.csv") for one in recordings]
    tables = [one if one.is_file() else folder.resolve() / "segments.csv" for one in tables]
    if not recordings or not all(one.is_file() for one in tables):
        raise NotFrozenError(f"{folder} holds no blind set: segments.csv and case folders with recording.parquet")
    cases, begun = {}, time.monotonic()
    for done, (recording, segments) in enumerate(zip(recordings, tables, strict=True), start=1):
        case = recording.parent.name
        cases[f"{folder.name}/{case}"] = shortened(by(recording, segments, own.get(case, PLAN)))
        left = (time.monotonic() - begun) / done * (len(recordings) - done)
        print(f"{done} of {len(recordings)} answered, about {left:.0f} s left", file=sys.stderr, flush=True)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(answer)}" for name, answer in cases.items())
    answers.parent.mkdir(parents=True, exist_ok=True)
    answers.write_text(f'{{"commit": {json.dumps(made_by)}, "cases": {{\n{lines}\n}}}}\n', encoding="utf-8")
    return len(cases)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.frozen_set", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("answers", type=Path)
    parser.add_argument(
        "--plan", action="append", default=[], metavar="NAME=PLAN", help="plan file of a plan in cases.csv"
    )
    given = parser.parse_args(argv)
    try:
        answer_all(given.folder, given.answers, plans=dict(one.split("=", 1) for one in given.plan))
    except NotFrozenError as error:
        print(f"tests.blind.frozen_set: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
