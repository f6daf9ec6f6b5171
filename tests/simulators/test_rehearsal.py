"""A plan carried out over the wire gives what it gives on the virtual bench behind it, within the sensor's noise."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_simulate_bench import PATIENCE, ROOT, patient, started

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are not for Windows"),
]
PLAN = """planrunner: 1
title: Two positions and a rate
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
defaults: {temperature: 30 degC, settle: 10 s, dwell: 30 s}
segments:
  - for_each:
      orientation:
        P1: {x: up, y: north, z: west}
        P5: {x: east, y: south, z: down}
  - {label: turning, orientation: {x: up, y: north, z: west}, rate: 0.01 deg/s}
"""


def lab(folder: Path) -> str:
    """A copy of the shipped bench with long time-outs, for a busy computer."""
    shipped = ROOT / "plans" / "benches" / "lab_simulated.yaml"
    (folder / "lab.yaml").write_text(patient(shipped.read_text(encoding="utf-8")), encoding="utf-8")
    return str(folder / "lab.yaml")


def tables(plan: Path, bench: str, runs: Path) -> list[Any]:
    """What a run recorded, segment by segment."""
    import pyarrow.parquet as parquet

    command = [sys.executable, "-m", "planrunner", "run", str(plan), "--bench", bench, "--runs", str(runs), "--quiet"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * PATIENCE, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return [parquet.read_table(file) for file in sorted(next(runs.iterdir()).glob("segments/*.parquet"))]


def means(plan: Path, bench: str, runs: Path) -> np.ndarray:
    """Mean outputs of each segment, shape (3, 2), pulse/s."""
    recorded = tables(plan, bench, runs)
    for table in recorded:
        time = table["time"].to_numpy()
        assert time[-1] - time[0] == pytest.approx(30.0, abs=0.1)
        assert np.all(np.diff(time) > 0)
    return np.array(
        [[float(np.mean(table[name].to_numpy())) for name in ("torquer_x", "torquer_y")] for table in recorded]
    )


CYCLE = """planrunner: 1
title: There and back, the longer way
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
defaults: {temperature: 25 degC, settle: 10 s}
segments:
  - label: cycle
    orientation: {x: up, y: north, z: west}
    motion: {cycle: {A: 0 deg, B: 270 deg}, moves: [A +270 B, B -270 A], turn_rate: 30 deg/s, stop: 20 s}
    dwell: 75 s
"""


def turned(plan: Path, bench: str, runs: Path) -> tuple[float, float]:
    """What the gyro was turned by in the first turn and in the second [deg], by its nominal scale factor, which is 0.6 % off; integrated
    over the times of the samples, of which a busy computer loses some."""
    (table,) = tables(plan, bench, runs)
    time, pulses = table["time"].to_numpy(), table["torquer_y"].to_numpy()
    middle = time[0] + 42.0  # of the second stop
    degrees = (pulses[1:] + pulses[:-1]) / 2 * np.diff(time) * 0.2 / 3600
    first = time[1:] < middle
    return float(np.sum(degrees[first])), float(np.sum(degrees[~first]))


def test_a_cycle_over_the_wire_turns_as_on_the_virtual_bench(tmp_path: Path) -> None:
    """The longer way, in the sense that the plan says; the table's delays are made good within the stops. The Earth turns by a third of a
    degree meanwhile, the drift is a thousandth of that."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(CYCLE, encoding="utf-8")
    virtual = turned(plan, "virtual", tmp_path / "virtual")
    assert np.abs(virtual) == pytest.approx([270.0, 270.0], rel=0.01) and virtual[0] * virtual[1] < 0
    process, _ = started(tmp_path, "--speed", "5", bench=lab(tmp_path))
    try:
        wired = turned(plan, str(tmp_path / "bench.yaml"), tmp_path / "wired")
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)
    assert wired == pytest.approx(virtual, abs=0.2)


def test_what_is_recorded_over_the_wire_is_what_the_virtual_bench_gives(tmp_path: Path) -> None:
    """White noise of 0.9 pulse/√s: the difference of two means over 30 s scatters by 0.23 pulse/s; six times that is allowed. The
    positions differ by tens of pulses a second, the turning by 180 (36 deg/h at 0.2 (deg/h)/(pulse/s))."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    virtual = means(plan, "virtual", tmp_path / "virtual")
    process, _ = started(tmp_path, "--speed", "10", bench=lab(tmp_path))
    try:
        wired = means(plan, str(tmp_path / "bench.yaml"), tmp_path / "wired")
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)
    np.testing.assert_allclose(wired, virtual, rtol=0, atol=1.4)
    assert np.max(np.abs(virtual[2] - virtual[0])) > 100
    assert np.max(np.abs(virtual[1] - virtual[0])) > 20
