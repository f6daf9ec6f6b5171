"""An index with synthetic runs: 100 devices and one with a hostile name, five benches, five coefficients with a limit."""

from __future__ import annotations

import random
from datetime import UTC, datetime, timedelta

from planrunner.estimators.limits import VerdictKind
from planrunner.night.history.index import Index
from planrunner.night.history.rows import CoefficientRow, IndexedRun, LimitRow, RunRow

HOSTILE = "<img src=x onerror=alert(1)> </script><script>alert(2)</script> ../../x"
COEFFICIENTS = ("X_F", "Y_F", "X_X", "Y_Y", "X_Z")
KINDS: tuple[VerdictKind, ...] = ("pass", "pass", "pass", "pass", "warned", "fail")


def synthetic_run(number: int) -> IndexedRun:
    rng = random.Random(number)
    device = f"FG-{number % 100:04d}" if number % 97 else HOSTILE
    moment = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(minutes=45 * number)
    folder = f"{moment:%Y%m%dT%H%M%SZ}-drift-{number:06x}"
    verdict = rng.choice(KINDS)
    row = RunRow(
        folder, folder, moment.isoformat(timespec="microseconds"), "drift", "Drift of a flexure gyro", device,
        f"bench-{number % 5}", "", "night", "virtual", "sealed", verdict, 1, 0,
    )  # fmt: skip
    coefficients = tuple(
        CoefficientRow(f"drift.D_{name}", 0.1 * place + rng.gauss(0, 0.02), "deg/h", 0.02, 20.0)
        for place, name in enumerate(COEFFICIENTS)
    )
    limit = LimitRow("drift.D_X_F", "within ±0.5 deg/h", "pass", "deg/h", -0.5, 0.5, 0.95)
    return IndexedRun(folder, "", row, coefficients, (limit,))


def filled(index: Index, count: int) -> None:
    """Put the first `count` synthetic runs into the index."""
    index._write([synthetic_run(number) for number in range(count)])
