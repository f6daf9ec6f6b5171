"""Compares the overlapping Allan deviation of 10⁷ samples, at averaging times in octaves, with `allantools.oadev`."""

from __future__ import annotations

import time
from dataclasses import dataclass

import allantools
import numpy as np

from benchmarks.measuring import counted
from planrunner.estimators.allan.kernel import integrate, second_differences


@dataclass(frozen=True, slots=True)
class Size:
    samples: int
    turns: int


FULL, SMALL = Size(10_000_000, 3), Size(20_000, 1)


def ours(values: np.ndarray, factors: np.ndarray) -> np.ndarray:
    phase = np.zeros(values.size + 1)
    integrate(values, float(values.mean()), 0.0, phase[1:])
    sums = second_differences(phase, factors)
    return np.asarray(np.sqrt(sums / (2.0 * factors.astype(float) ** 2 * (phase.size - 2 * factors))))


def run(size: Size = FULL) -> dict[str, object]:
    values = 10 + np.random.default_rng(0).standard_normal(size.samples)
    factors = 2 ** np.arange(int(np.log2(size.samples // 2)) + 1, dtype=np.int64)
    ours(values[:1_000_000], factors[:10])  # compiled before it is timed
    mine, theirs = [], []
    for _ in range(size.turns):
        began = time.perf_counter()
        found = ours(values, factors)
        middle = time.perf_counter()
        taus, reference, _, _ = allantools.oadev(values, rate=1.0, data_type="freq", taus=factors.astype(float))
        theirs.append(time.perf_counter() - middle)
        mine.append(middle - began)
    same = np.isin(factors, np.round(taus).astype(np.int64))
    difference = float(np.max(np.abs(found[same] / reference - 1)))
    assert same.sum() == len(reference) >= factors.size - 3
    assert difference <= 1e-12
    return {
        f"overlapping deviation of {counted(size.samples)} samples [s]": min(mine),
        "allantools.oadev [s]": min(theirs),
        "ratio (target ≥ 8)": min(theirs) / min(mine),
        "averaging times": len(reference),
        "largest relative difference (target ≤ 1e-12)": difference,
    }
