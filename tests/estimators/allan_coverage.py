"""How often Allan intervals hold the truth: simulated records of one kind of noise each, made by a generator apart from the package.

`python tests/estimators/allan_coverage.py [records]` prints the tables of docs/allan-deviation.md. What is true of a deviation is
integrated from the spectrum of the noise, and so is what a chi-squared interval can cover (`exact_allan_coverage`).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import simulated_noise
from exact_allan_coverage import POWER, exact_coverage, true_variance

from planrunner.estimators.allan.confidence import degrees_of_freedom, interval
from planrunner.estimators.allan.fit import TERMS, fit_noise
from planrunner.estimators.allan.phase import Phase
from planrunner.estimators.allan.planning import LEAST_FREEDOM
from planrunner.estimators.allan.table import deviations
from planrunner.estimators.root_of_square import root_of

MIXTURE = {"Q": 0.2, "N": 0.16, "B": 0.04, "K": 0.0013}
SAMPLES = 2**12


def record_of(values: np.ndarray) -> Phase:
    x = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    return Phase((x,), 1.0, 1, values.size, 0, 0, 0, 0)


def factors_of(samples: int) -> np.ndarray:
    return 2 ** np.arange(int(math.log2(samples // 4)) + 1)


def deviation_coverage(kind: str, records: int, seed: int, samples: int = SAMPLES) -> dict[str, np.ndarray]:
    """By averaging factor, shape (k,): share of 95 % intervals below the truth, above it, and with the truth inside; `told`: inside, where
    the noise type is told and not found; `alphas`, (k, 7): how often each type from 2 to −4 was found."""
    draw, factors = np.random.default_rng(seed), factors_of(samples)
    truth = np.array([math.sqrt(true_variance(kind, m)) for m in factors])
    freedoms = [degrees_of_freedom(POWER[kind], 2, m, samples + 1) for m in factors.tolist()]
    below, above, told = np.zeros(factors.size), np.zeros(factors.size), np.zeros(factors.size)
    alphas = np.zeros((factors.size, 7))
    for _ in range(records):
        phase = record_of(simulated_noise.rate(draw, samples, 1.0, **{kind: 1.0}))
        for k, row in enumerate(deviations(phase, "overlapping", factors, 0.95)):
            below[k] += row.high < truth[k]
            above[k] += row.low > truth[k]
            alphas[k, 2 - row.alpha] += 1
            low, high = interval(row.value, freedoms[k], 0.95)
            told[k] += low <= truth[k] <= high
    inside = records - below - above
    return {
        "factor": factors,
        "below": below / records,
        "above": above / records,
        "inside": inside / records,
        "told": told / records,
        "alphas": alphas / records,
    }


def coefficient_coverage(records: int, seed: int, **noise: float) -> dict[str, tuple[float, float, float]]:
    """By coefficient: share of value ± 1.96 u that holds the truth, mean error over u, spread of the errors over the median u."""
    draw = np.random.default_rng(seed)
    factors = factors_of(SAMPLES)
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
    for seed, name in enumerate(POWER):
        shares = deviation_coverage(name, records, 40 + seed)
        for k, m in enumerate(shares["factor"].tolist()):
            exact = exact_coverage(name, m, SAMPLES, degrees_of_freedom(POWER[name], 2, m, SAMPLES + 1))
            inside, below, above, told = (100 * shares[what][k] for what in ("inside", "below", "above", "told"))
            rightly = 100 * shares["alphas"][k, 2 - POWER[name]]
            shown = f"{inside:.1f} ({below:.1f}, {above:.1f}); type told {told:.1f}, exactly {100 * exact:.1f}; found in {rightly:.0f}"
            print(f"{name} {m}: {shown}", flush=True)
    for seed, noise in enumerate([MIXTURE, {"N": 1.0, "B": 0.2}, {"N": 1.0, "K": 0.01}, {"B": 1.0}, {"K": 1.0}]):
        found = coefficient_coverage(records, 60 + seed, **noise)
        cells = [f"{name} {100 * i:.1f} (bias {m:+.2f} u, spread {s:.2f} u)" for name, (i, m, s) in found.items()]
        print(f"{noise}: {'; '.join(cells)}", flush=True)


if __name__ == "__main__":
    main()
