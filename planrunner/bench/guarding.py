"""A bench opened for a run: locked against other runs, guarded by a watchdog, connected, and left safe, in this order.

A bench without real instruments needs neither lock nor watchdog.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from planrunner.bench.lock import bench_lock
from planrunner.bench.model import Bench, real_instruments, runs_on_virtual_clock
from planrunner.bench.opening import OpenBench, open_bench
from planrunner.bench.watchdog import Watchdog


@contextmanager
def guarded_bench(
    bench: Bench, bench_file: bytes, shown: str, *, data_root: Path | None = None, seed: int | None = None
) -> Iterator[OpenBench]:
    """The bench, connected, for the length of a `with` block; safe and closed afterwards.

    bench_file: the exact bytes of its file, from which the watchdog connects; shown: its name in messages. Raises `InputError` when
    another run holds the bench, `InstrumentError` when the watchdog or an instrument fails.
    """
    with bench_lock(bench, shown):
        watchdog = None
        if real_instruments(bench) and not runs_on_virtual_clock(bench):
            silence = bench.protection.silence.value
            watchdog = Watchdog(bench_file, shown, data_root, silence)
        safe = False
        try:
            # Until the bench is controlled, the watchdog answers for nothing, whatever ends this process.
            opened = open_bench(bench, data_root=data_root, seed=seed)
            opened.watchdog = watchdog
            try:
                with opened:
                    yield opened
            finally:
                safe = opened.safe
        finally:
            if watchdog is not None:
                watchdog.stand_down() if safe else watchdog.let_act()
