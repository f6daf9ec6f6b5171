"""72 h of rotation–stop navigation at 200 Hz, end to end on the virtual bench: run, seal, navigate, report; peak memory of the process.

The sixteen moves of the shipped plan, aligned in the motion and then made to last; a twelfth of the time beside it for the memory.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.recording_memory import peak_memory

ROOT = Path(__file__).resolve().parents[1]
HOURS, HERTZ = 72, 200

PLAN = """\
planrunner: 1
title: Rotation and stop for three days
bench: virtual_imu
sensor: {{kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, sample_rate: {hertz} Hz, on_break: keep}}
segments:
  - motion:
      sense: clockwise
      cycle: {{A: 0 deg, B: 90 deg, C: 180 deg, D: 270 deg}}
      moves: {moves}
      turn_rate: 10 deg/s
      stop: 3 min
    steps:
      - {{label: align, dwell: {{cycles: 1}}}}
      - {{label: navigate, dwell: {hours} h}}
estimates:
  turned: {{estimator: strapdown_navigation, segments: [align, navigate]}}
report: [report.html, summary.md]
"""


def moves() -> str:
    """The sixteen moves of the shipped plan."""
    text = (ROOT / "plans" / "rotation_stop_navigation.yaml").read_text(encoding="utf-8")
    return max(re.findall(r"\[A [^\]]*\]", text), key=len).replace("\n", " ")


def whole(hours: float) -> None:
    """In a process of its own: the run, then its figures as JSON."""
    from planrunner.cli import main

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = folder / "three_days.yaml"
        plan.write_text(PLAN.format(hertz=HERTZ, hours=hours, moves=moves()), encoding="utf-8")
        began = time.perf_counter()
        code = main(["run", str(plan), "--runs", str(folder / "runs"), "--flushed", "--quiet"])
        taken = time.perf_counter() - began
        size = sum(path.stat().st_size for path in folder.rglob("*.parquet")) / 1e9
        results = json.loads(next(folder.rglob("results.json")).read_text(encoding="utf-8"))
    (estimate,) = results["estimates"]
    rate = next(item["value"] for item in estimate["coefficients"] if item["name"] == "cep_rate")
    print(json.dumps({"code": code, "seconds": taken, "gigabytes": size, "cep": rate, "peak": peak_memory()}))


def run(hours: float = HOURS) -> dict[str, object]:
    figures = {}
    for length in (hours / 12, hours):
        command = [sys.executable, "-m", "benchmarks.navigation_72h", str(length)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        figures[length] = json.loads(done.stdout.splitlines()[-1])
        assert figures[length]["code"] == 0, done.stderr
    short, long = figures[hours / 12], figures[hours]
    return {
        f"{hours:g} h at {HERTZ} Hz, end to end [s]": long["seconds"],
        "samples × channels recorded [GB]": long["gigabytes"],
        "CEP rate found [nmi/h]": long["cep"],
        f"peak memory at {hours / 12:g} h [MB]": short["peak"],
        f"peak memory at {hours:g} h [MB]": long["peak"],
        "difference [MB]": long["peak"] - short["peak"],
    }


if __name__ == "__main__":
    whole(float(sys.argv[1]))
