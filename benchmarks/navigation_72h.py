"""Measures 72 h of rotation–stop navigation at 200 Hz on the virtual bench: run, seal, navigation, report and peak memory.

The plan is a longer version of the shipped cycle of sixteen moves with alignment in motion. To compare the memory, a run of a
twelfth of the time is also measured.
"""

from __future__ import annotations

import json
import re
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measuring import ROOT, Figures, figures_of, peak_memory


@dataclass(frozen=True, slots=True)
class Size:
    hours: float
    hertz: float
    separate: bool = True


FULL, SMALL = Size(72, 200), Size(0.25, 10, separate=False)

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
    """Returns the sixteen moves of the shipped plan."""
    text = (ROOT / "plans" / "rotation_stop_navigation.yaml").read_text(encoding="utf-8")
    return max(re.findall(r"\[A [^\]]*\]", text), key=len).replace("\n", " ")


def whole(hours: float, hertz: float) -> Figures:
    """Executes the run from the check to the report, and returns its figures."""
    from planrunner.cli import main

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = folder / "three_days.yaml"
        plan.write_text(PLAN.format(hertz=hertz, hours=hours, moves=moves()), encoding="utf-8")
        began = time.perf_counter()
        code = main(["run", str(plan), "--runs", str(folder / "runs"), "--flushed", "--quiet"])
        taken = time.perf_counter() - began
        size = sum(path.stat().st_size for path in folder.rglob("*.parquet")) / 1e9
        results = json.loads(next(folder.rglob("results.json")).read_text(encoding="utf-8"))
    (estimate,) = results["estimates"]
    rate = next(item["value"] for item in estimate["coefficients"] if item["name"] == "cep_rate")
    assert code == 0
    return {"seconds": taken, "gigabytes": size, "cep": rate, "peak": peak_memory()}


def run(size: Size = FULL) -> dict[str, object]:
    hours = size.hours
    short, long = (figures_of(whole, length, size.hertz, separate=size.separate) for length in (hours / 12, hours))
    return {
        f"{hours:g} h at {size.hertz:g} Hz, end to end [s]": long["seconds"],
        "size of the recorded samples of all channels [GB]": long["gigabytes"],
        "resulting CEP rate [nmi/h]": long["cep"],
        f"peak memory at {hours / 12:g} h [MB]": short["peak"],
        f"peak memory at {hours:g} h [MB]": long["peak"],
        "difference [MB]": long["peak"] - short["peak"],
    }
