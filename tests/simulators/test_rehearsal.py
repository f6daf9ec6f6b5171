"""A plan carried out over the wire gives what it gives on the virtual bench behind it, within the sensor's noise."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_simulate_bench import started

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


def means(plan: Path, bench: str, runs: Path) -> np.ndarray:
    """Mean outputs of each segment, shape (3, 2), pulse/s."""
    import pyarrow.parquet as parquet

    command = [sys.executable, "-m", "planrunner", "run", str(plan), "--bench", bench, "--runs", str(runs), "--quiet"]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    files = sorted(next(runs.iterdir()).glob("segments/*.parquet"))
    tables = [parquet.read_table(file) for file in files]
    for table in tables:
        time = table["time"].to_numpy()
        assert time[-1] - time[0] == pytest.approx(30.0, abs=0.1)
        assert np.all(np.diff(time) > 0)
    return np.array(
        [[float(np.mean(table[name].to_numpy())) for name in ("torquer_x", "torquer_y")] for table in tables]
    )


def test_what_is_recorded_over_the_wire_is_what_the_virtual_bench_gives(tmp_path: Path) -> None:
    """White noise of 0.9 pulse/√s: the difference of two means over 30 s scatters by 0.23 pulse/s; six times that is allowed. The
    positions differ by tens of pulses a second, the turning by 180 (36 deg/h at 0.2 (deg/h)/(pulse/s))."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    virtual = means(plan, "virtual", tmp_path / "virtual")
    process, _ = started(tmp_path, "--speed", "10")
    try:
        wired = means(plan, str(tmp_path / "bench.yaml"), tmp_path / "wired")
    finally:
        process.terminate()
        process.communicate(timeout=20)
    np.testing.assert_allclose(wired, virtual, rtol=0, atol=1.4)
    assert np.max(np.abs(virtual[2] - virtual[0])) > 100
    assert np.max(np.abs(virtual[1] - virtual[0])) > 20
