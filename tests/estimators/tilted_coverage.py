"""Do the 95 % intervals of tilted scale factors, temperature coefficients and fixture angles hold the truth 95 % of the time?

`python tests/estimators/tilted_coverage.py [runs [part of a row's name]]` prints the figures of
docs/scale-factor-in-one-mounting.md. Recordings come from hand formulas (`tilted_recording.py`), noise is drawn here: white noise
and flicker of the samples, scale factors that change from repeat to repeat, fixture angles off by their stated uncertainty, table rates
off by theirs, and the fixture skewed at each orientation. The samples go through the same pass as those of a recording.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planrunner.estimators.interface import Coefficient

sys.path.insert(0, str(Path(__file__).parent))

from coverage_experiment import SAMPLES, flicker_in_segments
from recorded import from_samples
from test_fixture_angles import GYROS as FIXED
from test_fixture_angles import TRUE, X_UP, Y_UP, Z_UP, found, spins
from tilted_recording import EARTH, HOUR, THETA, Gyro, estimate, inputs, series

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.outputs_fit import BASES
from planrunner.plan.schedule import Spin
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import InputQuantity, Inputs

AXES = {"x": (THETA, 0.0), "y": (THETA, 120.0)}
GYROS = {"x": Gyro(1.0002, 11e-6, 3e-5), "y": Gyro(0.9997, -7e-6, -2e-5)}
RATES = (300.0, -300.0, 100.0, -100.0, 20.0, -20.0)
CELSIUS = (-40.0, 20.0, 60.0)
DWELL = 36.0  # s: whole turns at every rate
WHITE = 5e-5  # deg/s·√s
SPAN = 7200.0  # s, longer than all dwells together
SAMPLE = 0.1  # s, for which the last sample stands
SPREAD = 5e-6  # relative, of K from repeat to repeat
SCENARIOS: dict[str, dict[str, Any]] = {
    "noise and repeatability": {},
    "with flicker, 0.1 deg/h": {"flicker": 0.1},
    "with flicker, 1 deg/h": {"flicker": 1.0},
    "with a fixture of 20 arcsec and table rates of 10 ppm": {"arcsec": 20.0, "rate": 10e-6},
    "with flicker of 0.1 deg/h, fixture and table": {"flicker": 0.1, "arcsec": 20.0, "rate": 10e-6},
}
NAMES = ("K_x", "K_x_-40degC", "temperature_coefficient_x", "F0_x")
# What the other bases make of declared flicker; the scale factors keep still from repeat to repeat, which neither basis would see.
OTHER_BASES: list[tuple[str, dict[str, Any]]] = [
    (basis, {"flicker": flicker, "spread": 0.0})
    for basis in ("residual", "within_segment")
    for flicker in (0.0, 0.1, 1.0)
]

FIXTURE: dict[str, dict[str, float]] = {
    "white noise": {},
    "flicker 1 deg/h": {"flicker": 1.0},
    "orientations off by 3 arcsec, rates by 10 ppm": {"skew": 3.0, "rate": 10e-6},
    "flicker 1 deg/h, orientations off by 3 arcsec, rates by 10 ppm": {"flicker": 1.0, "skew": 3.0, "rate": 10e-6},
}
PAUSE = 24.0  # s


def noisy(
    draw: np.random.Generator, made: Sequence[RecordedSegment], error: float, flicker: float, pause: float = 0.0
) -> list[RecordedSegment]:
    """The recording as samples, one dwell after the other, with noise and the horizontal Earth rate.

    Every axis that turns feels the Earth rate, and whole turns average it out. Noise: white, `error` in each mean, and flicker, deg/h,
    independent in each channel and constant over a batch.
    """
    n, channels, count = len(made), len(made[0].statistics.mean), round(DWELL / SAMPLE)
    values = error * math.sqrt(count) * draw.standard_normal((channels, n, count))
    if flicker:
        batches = flicker_in_segments(draw, (channels,), flicker / 3600, n, DWELL, pause, SPAN)
        values += batches[:, :, np.arange(count) * SAMPLES // count]
    found = []
    for k, one in enumerate(made):
        since, motion = SAMPLE * np.arange(count), one.segment.motion
        turned = motion.rate * since if isinstance(motion, Spin) else np.zeros(count)
        phase = draw.uniform(0, 2 * math.pi, (channels, 1))
        felt = EARTH / 3600 * np.sin(turned + phase) if turned.any() else 0.0
        samples = one.statistics.mean[:, None] + felt + values[:, k]
        named = dict(zip(one.statistics.channels, samples, strict=True))
        found.append(from_samples(one.segment, k * (DWELL + pause) + since, named, one.units))
    return found


def holds(item: Coefficient, truth: float) -> bool:
    factor = coverage_factor(item.degrees_of_freedom)
    return abs(item.value - truth) <= factor * item.standard_uncertainty


def scale_factor_coverage(
    runs: int,
    seed: int,
    repeats: int = 6,
    flicker: float = 0.0,
    arcsec: float = 0.0,
    rate: float = 0.0,
    basis: str = "repeats",
    spread: float = SPREAD,
) -> dict[str, float]:
    """Share of runs whose interval holds the truth: K at 20 and at −40 degC, temperature coefficient and offset, of the axis x.

    flicker: deg/h, declared as it is; arcsec: of the fixture; rate: relative; spread: of K from repeat to repeat, relative."""
    rng = np.random.default_rng(seed)
    hits = dict.fromkeys(NAMES, 0)
    stated, noise = inputs(AXES, arcsec, rate, flicker), WHITE / math.sqrt(DWELL)
    # The slope of K over temperature by K at 20 degC; K is linear here, so that the line's slope is the truth.
    truth = {"K_x": GYROS["x"].K, "K_x_-40degC": GYROS["x"].K * (1 - 60 * GYROS["x"].slope)}
    truth["F0_x"] = 0.0
    truth["temperature_coefficient_x"] = GYROS["x"].slope * 1e6
    for _ in range(runs):
        real = {
            axis: (angle + arcsec / 3600 * rng.standard_normal(), azimuth) for axis, (angle, azimuth) in AXES.items()
        }
        errors = {value: rate * rng.standard_normal() for value in RATES}
        recorded = []
        for celsius in CELSIUS:
            for repeat in range(1, repeats + 1):
                drawn = {
                    axis: Gyro(gyro.K * (1 + spread * rng.standard_normal()), gyro.slope, gyro.bias)
                    for axis, gyro in GYROS.items()
                }
                recorded += series(
                    real, drawn, celsius, repeat, RATES, lambda value: DWELL, error=noise, rate_error=errors
                )
        result = estimate(noisy(rng, recorded, noise, flicker), AXES, stated, uncertainty=basis)
        for name in hits:
            hits[name] += holds(result[name], truth[name])
    return {name: count / runs for name, count in hits.items()}


def spun(draw: np.random.Generator, world: Mapping[str, float]) -> list[RecordedSegment]:
    """Three orientations with four rates each: noise of batch means, white and flicker, on top of what the hand formulas give."""
    rates = (100.0, -100.0, 50.0, -50.0)
    off = world.get("skew", 0.0) * HOUR * draw.standard_normal((3, 3))
    errors = {value: world.get("rate", 0.0) * draw.standard_normal() for value in rates}
    made = spins([Z_UP, X_UP, Y_UP], TRUE, None, 0.0, off, errors)
    return noisy(draw, made, 1e-4, world.get("flicker", 0.0), PAUSE)


def fixture_coverage(runs: int, seed: int, basis: str = "residual", **world: float) -> dict[str, float]:
    """Share of runs whose interval holds the truth: angle and scale factor of each axis. world: skew, standard, arcsec; rate, relative;
    flicker, bias instability, deg/h; all stated as they are."""
    draw = np.random.default_rng(seed)
    hits = {f"{word}_{axis}": 0 for word in ("angle", "K") for axis in TRUE}
    held = [
        InputQuantity("table position", 0.0, "rad", world.get("skew", 0.0) * HOUR),
        InputQuantity("table rate", 0.0, "1", world.get("rate", 0.0)),
        *(InputQuantity(f"bias instability gyro_{x}", 0.0, "deg/s", world.get("flicker", 0.0) / 3600) for x in TRUE),
    ]
    stated = Inputs({one.name: one for one in held if one.standard_uncertainty})
    for _ in range(runs):
        result = found(spun(draw, world), inputs=stated, uncertainty=basis)
        for axis, (angle, _) in TRUE.items():
            hits[f"angle_{axis}"] += holds(result[f"angle_{axis}"], angle)
            hits[f"K_{axis}"] += holds(result[f"K_{axis}"], FIXED[axis].K)
    return {name: count / runs for name, count in hits.items()}


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print(f"{runs} runs each; share of the 95 % intervals that hold the truth, in %", flush=True)
    only = sys.argv[2] if len(sys.argv) > 2 else ""
    for name, keys in SCENARIOS.items():
        if only in f"repeats, {name}":
            told(f"repeats, {name}", scale_factor_coverage(runs, 31, **keys))
    for other, keys in OTHER_BASES:
        name = f"{other}, flicker {keys['flicker']:g} deg/h"
        if only in name:
            told(name, scale_factor_coverage(runs, 33, basis=other, **keys))
    for name, world in FIXTURE.items():
        for basis in BASES:
            label = f"fixture, {name}, {basis}"
            if only in label:
                told(label, fixture_coverage(runs, 32, basis, **world))


def told(name: str, shares: Mapping[str, float]) -> None:
    """Print one row of figures."""
    print(f"{name}: " + ", ".join(f"{what} {100 * share:.1f}" for what, share in shares.items()), flush=True)


if __name__ == "__main__":
    main()
