"""Compares the results of every shipped plan before and after a change that must not alter them.

`python -m benchmarks.shipped_results write FILE` checks every plan in `plans/`, runs it with a fixed seed, and diagnoses some of
the runs. It writes the output of `--json` for each plan: predicted uncertainties, coefficients with standard uncertainty and
covariance, budgets, tables, verdicts on limits. `python -m benchmarks.shipped_results compare FILE` repeats this and lists every
figure that differs from FILE by more than 1e-9, relative to the larger of the two figures. It looks for recordings in
`PLANRUNNER_DATA` or `../shared/data`. For three plans, it writes a recording with the independent physics of `tests/recorded_imu.py`.

To compare with an earlier commit, make a clone of it, copy this file into the clone, and give the first command there.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from planrunner.base.arrays import Array
from planrunner.plan.schedule import Rock
from planrunner.tasks.check import check_plan
from tests.directions import WORDS
from tests.recorded_imu import Felt, Row, write_recording

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("PLANRUNNER_DATA", ROOT.parent / "shared" / "data"))
SEED = 7
TOLERANCE = 1e-9
INFORMATION = {"device_serial": "A-1", "operator": "tester", "fixture": "F-1", "accelerometer_range": "10 g"}
RECORDED = ("imu_recorded_over_temperature", "imu_recorded_hot", "imu_recorded_cold_and_hot")
"""Plans that play back a recording of an IMU. There is no such recording in the folder of recordings."""
G_SENSITIVITY = 0.004
"""Rate that the x gyro of such a recording shows in addition, in deg/s per m/s² of the specific force along y."""
DIAGNOSED = ("imu_multi_position", "mpu9150_imu0", "rimu_rate_staircase", "flexure_gyro_eight_position", *RECORDED)
PATHS = {"analysis", "folder", "file"}
"""Keys whose values differ from run to run."""


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shipped_results", description=__doc__)
    parser.add_argument("action", choices=("write", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--plan", action="append", help="only this plan, by the name of its file without ending")
    args = parser.parse_args(arguments)
    plans = [path for path in sorted((ROOT / "plans").glob("*.yaml")) if not args.plan or path.stem in args.plan]
    found = {path.stem: results_of(path) for path in plans}
    if args.action == "write":
        args.file.write_text(json.dumps(found, indent=1, sort_keys=True), encoding="utf-8", newline="\n")
        return 0
    kept = json.loads(args.file.read_text(encoding="utf-8"))
    kept = {name: own for name, own in kept.items() if name in found}
    changes = list(differences(kept, found))
    figures = sum(1 for _ in numbers(kept))
    for change in changes:
        print(change)
    print(f"{len(found)} plans, {figures} figures, {len(changes)} differ by more than {TOLERANCE:g}")
    return 1 if changes else 0


def results_of(plan: Path) -> dict[str, Any]:
    """Returns the output of `check`, `run` and, for some plans, `diagnose` for one plan."""
    print(plan.stem, file=sys.stderr, flush=True)
    with tempfile.TemporaryDirectory() as runs, tempfile.TemporaryDirectory() as made:
        data = str(recording_of(plan, Path(made)) if plan.stem in RECORDED else DATA)
        told = [
            word for name, value in INFORMATION.items() for word in ("--set", f"{name}={value}") if asked(plan, name)
        ]
        found = {
            "check": printed("check", str(plan), "--data", data, "--json"),
            "run": printed("run", str(plan), "--seed", str(SEED), "--flushed", "--runs", runs, "--data", data,
                           "--json", *told),
        }  # fmt: skip
        if plan.stem in DIAGNOSED:
            (folder,) = (path.parent for path in Path(runs).glob("*/run.json"))
            found["diagnose"] = printed("diagnose", str(folder), "--json")
    return found


def recording_of(plan: Path, folder: Path) -> Path:
    """Writes a recording of the segments of a plan in `folder`, and returns the folder. The x gyro has a g-sensitivity."""
    words = {direction: word for word, direction in WORDS.items()}
    listed, time = [], 600.0
    for segment in check_plan(plan).sound().schedule.segments:
        assert segment.attitude is not None and segment.dwell is not None
        axes = " ".join(words[tuple(np.rint(row).astype(int).tolist())] for row in segment.attitude)
        motion, kelvin = segment.motion, segment.temperature if segment.ramp_to is None else segment.ramp_to
        rock = (math.degrees(motion.amplitude), motion.frequency) if isinstance(motion, Rock) else None
        celsius = 25.0 if kelvin is None else kelvin - 273.15
        rate = math.degrees(segment.rate)
        listed.append(
            Row(segment.label, axes, segment.dwell, rate, rock, celsius, segment.ramp_to is not None, time + 15)
        )
        time += 15 + segment.dwell + (1800 if segment.ramp_to is not None else 0)
    return write_recording(folder, SEED, g_sensitivity, listed=listed)


def g_sensitivity(felt: Felt) -> tuple[Array, Array]:
    rate = np.zeros_like(felt.rate)
    rate[:, 0] = G_SENSITIVITY * felt.force[:, 1]
    return rate, np.zeros_like(felt.force)


def asked(plan: Path, name: str) -> bool:
    """Returns True if `record` of the plan names this item of the run information."""
    return f"{name}: " in next(
        (line for line in plan.read_text(encoding="utf-8").splitlines() if line.startswith("record:")), ""
    )


def printed(*words: str) -> dict[str, Any]:
    """Returns the exit code and the JSON output of a command. The command may end with a failed limit."""
    done = subprocess.run([sys.executable, "-m", "planrunner", *words], capture_output=True, text=True, cwd=ROOT)
    try:
        return {"code": done.returncode, "printed": json.loads(done.stdout)}
    except json.JSONDecodeError:
        return {"code": done.returncode, "printed": done.stdout + done.stderr}


def differences(kept: Any, found: Any, place: str = "") -> Iterator[str]:
    """Yields every place where `found` differs from `kept` by more than the tolerance."""
    if isinstance(kept, dict) and isinstance(found, dict):
        for key in sorted(set(kept) | set(found)):
            if key in PATHS:
                continue
            if key not in kept or key not in found:
                yield f"{place}.{key}: only {'before' if key in kept else 'after'}"
            else:
                yield from differences(kept[key], found[key], f"{place}.{key}")
    elif isinstance(kept, list) and isinstance(found, list):
        if len(kept) != len(found):
            yield f"{place}: {len(kept)} before, {len(found)} after"
        for index, (one, other) in enumerate(zip(kept, found, strict=False)):
            yield from differences(one, other, f"{place}[{index}]")
    elif number(kept) and number(found):
        if abs(kept - found) > TOLERANCE * max(abs(kept), abs(found)):
            yield f"{place}: {kept!r} before, {found!r} after"
    elif kept != found:
        yield f"{place}: {kept!r} before, {found!r} after"


def numbers(tree: Any) -> Iterator[float]:
    """Yields every number in nested data."""
    if isinstance(tree, dict):
        tree = list(tree.values())
    if isinstance(tree, list):
        for item in tree:
            yield from numbers(item)
    elif number(tree):
        yield tree


def number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


if __name__ == "__main__":
    sys.exit(main())
