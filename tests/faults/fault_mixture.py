"""Random faults from a seeded mix: one or two things that go wrong at a random moment of a run, and what must hold whatever they are."""

from __future__ import annotations

import time

import numpy as np
from fault_judging import run_folder
from fault_trial import RUN, finished, resumed, strike
from small_bench import SPEED, SmallBench

from planrunner.simulators.faults import OF_ROLE, WORDS

RUNS_FOR = 130.0
"""Seconds of the bench that a run takes at least, within which faults begin."""
ROLES = {"table": "table", "chamber": "chamber", "gyro": "sensor"}
SIGNALS = ("SIGKILL", "SIGTERM", "SIGINT", "disk full", "clock step", "clock leap")
MESSAGES = {
    "table": ("read", "demand", "mode", "status", ""),
    "chamber": ("PVALUE", "SPOINT", "ERROR", ""),
    "gyro": ("",),
}


def drawn(seed: int) -> list[tuple[float, str]]:
    """Faults of trial `seed`: when to strike, in seconds of the bench after the start, and what."""
    draw = np.random.default_rng([2026, seed])
    found = []
    for _ in range(1 + int(draw.random() < 0.3)):
        at = float(draw.uniform(0, RUNS_FOR))
        found.append((at, str(draw.choice(SIGNALS)) if draw.random() < 0.15 else _of_an_instrument(draw)))
    return sorted(found)


def _of_an_instrument(draw: np.random.Generator) -> str:
    name = str(draw.choice(list(ROLES)))
    fault = str(draw.choice(list(OF_ROLE[ROLES[name]])))
    keys = [f"instrument: {name}", f"fault: {fault}"]
    if draw.random() < 0.6:
        keys.append(f"for: {draw.uniform(0.5, 40):.2f} s")
    if fault in WORDS and name != "gyro" and fault != "refuse":
        if draw.random() < 0.6:
            keys.append(f"count: {draw.integers(1, 5)}")
        if message := str(draw.choice(MESSAGES[name])):
            keys.append(f"message: {message}")
    if fault == "late":
        keys.append(f"delay: {draw.uniform(0.05, 4):.2f} s")
    if fault in ("corrupt", "lose", "duplicate", "reorder"):
        keys.append(f"share: {100 * 10 ** draw.uniform(-3, 0):.3f} %")
    if fault == "overshoot":
        keys.append(f"overshoot: {draw.uniform(1, 20):.1f} K")
    if name == "table":
        keys.append(f"axis: {draw.integers(1, 3)}")
    return "{" + ", ".join(keys) + "}"


def trial(bench: SmallBench, seed: int) -> str:
    """Carry out one; how it ended, in words. Raises `AssertionError` where a promise is broken."""
    faults, older = drawn(seed), run_folder(bench)
    run = bench.planrunner(*RUN)
    begun = time.monotonic()
    killed = False
    for at, fault in faults:
        while run.code is None and time.monotonic() - begun < at / SPEED:
            time.sleep(0.02)
        if run.code is not None:
            break
        killed = killed or fault == "SIGKILL"
        strike(bench, fault, run)
        if fault == "SIGKILL":
            break
    ended = finished(bench, run, older, killed)
    told = f"{faults}: {ended.code}; {ended.said}"
    refused = (
        "error[runs-unwritable]" in ended.said and ended.folder is None
    )  # a disk that was full before anything moved
    assert ended.code in ((-9,) if killed else (2,) if refused else (0, 3, 130)), told
    assert "Traceback" not in ended.said and "internal error" not in ended.said, told
    assert ended.code != 0 or not ended.not_safe, told
    for name in ended.not_safe:
        assert f"NOT IN THE SAFE STATE: {name}" in ended.said or f"{name}: NOT SAFE" in ended.said, told
    if ended.code == 3:
        assert "error: " in ended.said, told
    resumed(bench, ended)
    return f"{faults}: {ended.code}, {len(ended.kept)} kept"
