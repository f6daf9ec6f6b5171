"""A run in a process of its own, for tests that kill it: `python killed_run.py ROOT [RUN] [DURABILITY]`.

Begins a run beneath ROOT, or goes on with RUN, and prints the run folder's name as soon as it stands.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from fake_bench import make_bench, mixed_schedule

from planrunner.archive.run_folder import RunWriter
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest

PART_BYTES = 24 * 50  # fifty rows: every segment has several parts


def main() -> int:
    root, run = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else ""
    writer = RunWriter.reopen(root / run) if run else RunWriter.create(root, "mixed", b"plan", b"bench", {}, "durable")
    print(writer.path.name, flush=True)
    writer.part_bytes = PART_BYTES
    bench = make_bench(block=20)
    sleep = bench.clock.sleep

    def slowly(seconds: float) -> None:
        time.sleep(0.003)
        sleep(seconds)

    bench.clock.sleep = slowly
    with writer, StopRequest() as stop:
        outcome = execute(mixed_schedule(), bench, writer, stop=stop, start_at=writer.next_segment)
    return 0 if outcome.ok else 3


if __name__ == "__main__":
    sys.exit(main())
