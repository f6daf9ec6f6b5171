"""Do the 95 % intervals of tilted scale factors, temperature coefficients and fixture angles hold the truth 95 % of the time?

`python tests/estimators/tilted_coverage.py [runs]` prints the figures of docs/scale-factor-in-one-mounting.md. Recordings come from hand
formulas (`tilted_recording.py`), noise is drawn here: white noise and flicker of each mean, scale factors that change from repeat to
repeat, fixture angles off by their stated uncertainty, table rates off by theirs, and the fixture skewed at each orientation.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from test_fixture_angles import GYROS as FIXED
from test_fixture_angles import TRUE, X_UP, Y_UP, Z_UP, found, spins
from tilted_recording import HOUR, THETA, Gyro, estimate, inputs, series

from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import InputQuantity, Inputs

AXES = {"x": (THETA, 0.0), "y": (THETA, 120.0)}
GYROS = {"x": Gyro(1.0002, 11e-6, 3e-5), "y": Gyro(0.9997, -7e-6, -2e-5)}
RATES = (300.0, -300.0, 100.0, -100.0, 20.0, -20.0)
CELSIUS = (-40.0, 20.0, 60.0)
DWELL = 36.0  # s: whole turns at every rate
WHITE = 5e-5  # deg/s·√s
SPREAD = 5e-6  # relative, of K from repeat to repeat
SCENARIOS: dict[str, dict[str, float]] = {
    "noise and repeatability": {},
    "with flicker, 0.1 deg/h": {"flicker": 0.1},
    "with flicker, 1 deg/h": {"flicker": 1.0},
    "with a fixture of 20 arcsec and table rates of 10 ppm": {"arcsec": 20.0, "rate": 10e-6},
    "with flicker of 0.1 deg/h, fixture and table": {"flicker": 0.1, "arcsec": 20.0, "rate": 10e-6},
}


def flicker_means(rng: np.random.Generator, count: int, floor: float) -> np.ndarray:
    """Means of `count` consecutive dwells of 1/f noise with IEEE 952's coefficient `floor`: one-sided density B²/(π·f)."""
    if floor == 0:
        return np.zeros(count)
    n, inside = 1 << (8 * count - 1).bit_length(), 8  # eight points a dwell, and slower parts than the test
    frequency = np.fft.rfftfreq(n * inside)[1:]
    size = np.sqrt(floor**2 / (math.pi * frequency) * (frequency[1] - frequency[0]) / 2)
    spectrum = (rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))) * size
    values = np.fft.irfft(np.concatenate([[0], spectrum]), n * inside) * n * inside / math.sqrt(2)
    return np.asarray(values[: count * inside].reshape(count, inside).mean(axis=1))


def noise_of_a_mean(rng: np.random.Generator, slow: Mapping[str, Iterator[float]], axis: str, seconds: float) -> float:
    return WHITE / math.sqrt(seconds) * float(rng.standard_normal()) + next(slow[axis])


def holds(item: object, truth: float) -> bool:
    factor = coverage_factor(item.degrees_of_freedom)  # type: ignore[attr-defined]
    return abs(item.value - truth) <= factor * item.standard_uncertainty  # type: ignore[attr-defined]


def scale_factor_coverage(
    runs: int, seed: int, repeats: int = 6, flicker: float = 0.0, arcsec: float = 0.0, rate: float = 0.0
) -> dict[str, float]:
    """Share of runs whose interval holds the truth: K at 20 and at −40 degC, and the temperature coefficient, of the axis x."""
    rng = np.random.default_rng(seed)
    hits = dict.fromkeys(("K_x", "K_x_-40degC", "temperature_coefficient_x"), 0)
    stated = inputs(AXES, arcsec, rate)
    # The slope of K over temperature by K at 20 degC; K is linear here, so that the line's slope is the truth.
    truth = {"K_x": GYROS["x"].K, "K_x_-40degC": GYROS["x"].K * (1 - 60 * GYROS["x"].slope)}
    truth["temperature_coefficient_x"] = GYROS["x"].slope * 1e6
    steps = len(RATES) + 2
    for _ in range(runs):
        real = {
            axis: (angle + arcsec / 3600 * rng.standard_normal(), azimuth) for axis, (angle, azimuth) in AXES.items()
        }
        errors = {value: rate * rng.standard_normal() for value in RATES}
        slow = {axis: iter(flicker_means(rng, 3 * repeats * steps, flicker / 3600)) for axis in AXES}
        draw = partial(noise_of_a_mean, rng, slow)
        recorded = []
        for celsius in CELSIUS:
            for repeat in range(1, repeats + 1):
                drawn = {
                    axis: Gyro(gyro.K * (1 + SPREAD * rng.standard_normal()), gyro.slope, gyro.bias)
                    for axis, gyro in GYROS.items()
                }
                recorded += series(
                    real, drawn, celsius, repeat, RATES, lambda value: DWELL, draw, WHITE / math.sqrt(DWELL), errors
                )
        result = estimate(recorded, AXES, stated, uncertainty="repeats")
        for name in hits:
            hits[name] += holds(result[name], truth[name])
    return {name: count / runs for name, count in hits.items()}


def fixture_coverage(
    runs: int, seed: int, basis: str = "residual", skew: float = 0.0, rate: float = 0.0
) -> dict[str, float]:
    """Share of runs whose interval holds the truth: angle and scale factor of each axis. skew: standard, arcsec; rate: relative."""
    rng = np.random.default_rng(seed)
    hits = {f"{word}_{axis}": 0 for word in ("angle", "K") for axis in TRUE}
    held = {}
    if skew:
        held["table position"] = InputQuantity("table position", 0.0, "rad", skew * HOUR)
    if rate:
        held["table rate"] = InputQuantity("table rate", 0.0, "1", rate)
    for _ in range(runs):
        off = skew * HOUR * rng.standard_normal((3, 3))
        errors = {value: rate * rng.standard_normal() for value in (100.0, -100.0, 50.0, -50.0)}
        recorded = spins([Z_UP, X_UP, Y_UP], TRUE, rng, 1e-4, off, errors)
        result = found(recorded, inputs=Inputs(held), uncertainty=basis)
        for axis, (angle, _) in TRUE.items():
            hits[f"angle_{axis}"] += holds(result[f"angle_{axis}"], angle)
            hits[f"K_{axis}"] += holds(result[f"K_{axis}"], FIXED[axis].K)
    return {name: count / runs for name, count in hits.items()}


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print(f"{runs} runs each; share of the 95 % intervals that hold the truth, in %", flush=True)
    for name, keys in SCENARIOS.items():
        shares = scale_factor_coverage(runs, 31, **keys)  # type: ignore[arg-type]
        print(f"{name}: " + ", ".join(f"{what} {100 * share:.1f}" for what, share in shares.items()), flush=True)
    for skew, rate in ((0.0, 0.0), (3.0, 10e-6)):
        shares = fixture_coverage(runs, 32, skew=skew, rate=rate)
        shown = ", ".join(f"{what} {100 * share:.1f}" for what, share in shares.items())
        print(f"fixture, skew {skew:g} arcsec, rates {rate * 1e6:g} ppm: {shown}", flush=True)


if __name__ == "__main__":
    main()
