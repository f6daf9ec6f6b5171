"""`python -m tests.blind.frozen_set FOLDER ANSWERS`: a frozen blind set is diagnosed once, as a user would, by committed code.

FOLDER holds `segments.csv` and a folder with `recording.parquet` for each case. The answers are the diagnosis' JSON without its pictures
and the text of the proposed plan, with the commit that made them. They are written once: where ANSWERS is there already, or the tree
differs from the commit, nothing is run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
PLAN = "plans/imu_recorded_over_temperature.yaml"
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


def diagnosed(recording: Path, segments: Path) -> dict[str, Any]:
    """What `planrunner diagnose --json` prints."""
    words = ["diagnose", PLAN, "--recording", str(recording), "--segments", str(segments), "--json"]
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


def answer_all(
    folder: Path, answers: Path, by: Callable[[Path, Path], dict[str, Any]] = diagnosed, of: Callable[[], str] = commit
) -> int:
    """How many cases were answered. Raises `NotFrozenError`."""
    if answers.exists():
        raise NotFrozenError(f"{answers} is there already: a frozen set is answered once")
    made_by, segments = of(), folder.resolve() / "segments.csv"
    recordings = sorted(folder.resolve().glob("*/recording.parquet"))
    if not recordings or not segments.is_file():
        raise NotFrozenError(f"{folder} holds no blind set: segments.csv and case folders with recording.parquet")
    cases, begun = {}, time.monotonic()
    for done, recording in enumerate(recordings, start=1):
        cases[f"{folder.name}/{recording.parent.name}"] = shortened(by(recording, segments))
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
    given = parser.parse_args(argv)
    try:
        answer_all(given.folder, given.answers)
    except NotFrozenError as error:
        print(f"tests.blind.frozen_set: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
