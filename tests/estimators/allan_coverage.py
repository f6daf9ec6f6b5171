"""How often Allan intervals hold the truth: simulated records of one kind of noise each, made by a generator apart from the package.

`python tests/estimators/allan_coverage.py [records]` prints the tables of docs/allan-deviation.md. What is true of a deviation is not
taken from a formula: it is the root of the mean of the variances of all records, since the estimator of the variance has no bias.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import simulated_noise

from planrunner.estimators.allan.allan_deviation import LEAST_FREEDOM
from planrunner.estimators.allan.fit import TERMS, fit_noise
from planrunner.estimators.allan.phase import Phase
from planrunner.estimators.allan.table import deviations
from planrunner.estimators.root_of_square import root_of

KINDS = {"Q": 1.0, "N": 1.0, "B": 1.0, "K": 1.0}
MIXTURE = {"Q": 0.2, "N": 0.16, "B": 0.04, "K": 0.0013}
SAMPLES = 2**12


def record_of(values: np.ndarray) -> Phase:
    x = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    return Phase((x,), 1.0, 1, values.size, 0, 0, 0, 0)


def deviation_coverage(records: int, seed: int, **noise: float) -> dict[str, np.ndarray]:
    """By averaging factor, shape (k,): share of 95 % intervals below the truth, share above it, and share that holds it."""
    draw = np.random.default_rng(seed)
    factors = 2 ** np.arange(int(math.log2(SAMPLES // 4)) + 1)
    value, low, high = (np.empty((records, factors.size)) for _ in range(3))
    for n in range(records):
        phase = record_of(simulated_noise.rate(draw, SAMPLES, 1.0, **noise))
        for k, row in enumerate(deviations(phase, "overlapping", factors, 0.95)):
            value[n, k], low[n, k], high[n, k] = row.value, row.low, row.high
    truth = np.sqrt(np.mean(value**2, axis=0))
    below, above = np.mean(high < truth, axis=0), np.mean(low > truth, axis=0)
    return {"factor": factors, "below": below, "above": above, "inside": 1 - below - above}


def coefficient_coverage(records: int, seed: int, **noise: float) -> dict[str, tuple[float, float, float]]:
    """By coefficient: share of value ± 1.96 u that holds the truth, mean error over u, spread of the errors over the median u."""
    draw = np.random.default_rng(seed)
    factors = 2 ** np.arange(int(math.log2(SAMPLES // 4)) + 1)
    found = np.empty((records, 4, 2))
    for n in range(records):
        phase = record_of(simulated_noise.rate(draw, SAMPLES, 1.0, **noise))
        rows = [row for row in deviations(phase, "overlapping", factors, 0.95) if row.freedom >= LEAST_FREEDOM]
        fit = fit_noise(
            np.array([row.factor for row in rows]),
            np.array([row.value**2 for row in rows]),
            np.array([row.freedom for row in rows]),
            phase.lengths,
        )
        for k in range(4):
            found[n, k] = root_of(fit.squares[k], math.sqrt(fit.covariance[k, k]))
    result = {}
    for k, name in enumerate(TERMS):
        if name in noise:
            error, u = found[:, k, 0] - noise[name], found[:, k, 1]
            inside = float(np.mean(np.abs(error) <= 1.96 * u))
            result[name] = inside, float(np.mean(error / u)), float(np.std(error) / np.median(u))
    return result


def main() -> None:
    records = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print(f"{records} records of {SAMPLES} samples; 95 % intervals of the overlapping deviation, in %")
    for seed, (name, size) in enumerate(KINDS.items()):
        shares = deviation_coverage(records, 40 + seed, **{name: size})
        cells = [
            f"{m}: {100 * i:.1f} ({100 * b:.1f}, {100 * a:.1f})"
            for m, i, b, a in zip(shares["factor"], shares["inside"], shares["below"], shares["above"], strict=True)
        ]
        print(f"{name}: {'; '.join(cells)}", flush=True)
    for seed, noise in enumerate([MIXTURE, {"N": 1.0, "B": 0.2}, {"N": 1.0, "K": 0.01}, {"B": 1.0}, {"K": 1.0}]):
        found = coefficient_coverage(records, 60 + seed, **noise)
        cells = [f"{name} {100 * i:.1f} (bias {m:+.2f} u, spread {s:.2f} u)" for name, (i, m, s) in found.items()]
        print(f"{noise}: {'; '.join(cells)}", flush=True)


if __name__ == "__main__":
    main()
