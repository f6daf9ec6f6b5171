"""Time and memory of a diagnosis over the samples of the recording: six channels, all installed effects and their pairs.

The second diagnosis in a process is timed, so that loading libraries is not in it; one thread of linear algebra.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time


def measure(samples: int) -> None:
    from planrunner.gap.diagnosis import diagnose
    from tests.gap.turntable import plan, record

    diagnose(record())
    observed = record(seed=2, sampling=samples / sum(row[2] for row in plan()))
    began, worked = time.perf_counter(), time.process_time()
    diagnose(observed)
    figures = {"wall": time.perf_counter() - began, "cpu": time.process_time() - worked, "samples": len(observed.time)}
    print(json.dumps(figures | {"peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))


def run() -> dict[str, object]:
    found: dict[str, object] = {}
    for samples in (25_000, 100_000, 400_000):
        command = [sys.executable, "-m", "benchmarks.diagnosis", str(samples)]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
        figures = json.loads(done.stdout)
        target = " (target ≤ 1)" if samples == 100_000 else ""
        found[f"{samples} samples × 6 channels, wall [s]{target}"] = figures["wall"]
        found[f"{samples} samples × 6 channels, processor [s]"] = figures["cpu"]
        found[f"{samples} samples × 6 channels, peak memory [MB]"] = figures["peak"]
    return found


if __name__ == "__main__":
    measure(int(sys.argv[1]))
