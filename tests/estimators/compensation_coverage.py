"""How often the range that `compensation_residual` expects of the ratio of residual sums holds the measured ratio: 90 % is meant.

`python tests/estimators/compensation_coverage.py [runs]` prints the figures of docs/uncertainty-of-the-eight-positions.md. A run measures
the optimal and the traditional eight positions and three verification positions one after the other: pulses by the source's formulas,
white noise and flicker of every sample, and a table that stands off each orientation by an error of its own, the same in both calibrations
and the verification. Nothing is taken from planrunner's physics.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from coverage_experiment import ARCSEC, DWELL, GYRO, PAUSE, SAMPLES, flicker_in_segments
from recorded import figure, played, segment, sensor
from test_compensation_residual import TRADITIONAL, VERIFY
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, attitude, pulses

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.flexure_gyro.compensation_residual import (
    CompensationResidual,
    CompensationResidualParameters,
)
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.uncertainty.influences import InputQuantity, Inputs

AGAIN = dict(list(OPTIMAL.items())[:3])  # verification where one of the sets was calibrated
MEANT = 0.9
TRIALS = 4000


@dataclass(frozen=True)
class World:
    """white: pulse/√s; flicker: pulse/s, declared as it is; tilt, stated: arcsec about each axis; again: verified at `AGAIN`."""

    white: float = 0.9
    flicker: float = 0.0
    tilt: float = 0.0
    stated: float = 0.0
    again: bool = False


QUIET = 0.09  # pulse/√s
SCENARIOS = {
    "white noise": World(),
    "flicker 0.1 pulse/s, declared": World(flicker=0.1),
    "positions off by 120 arcsec, stated, noise ten times less": World(QUIET, 0.0, 120.0, 120.0),
    "the same, verified at three of the optimal positions": World(QUIET, 0.0, 120.0, 120.0, again=True),
    "the same with flicker 0.02 pulse/s, declared": World(QUIET, 0.02, 120.0, 120.0, again=True),
    "verified at three of the optimal positions, positions not stated": World(QUIET, 0.0, 120.0, again=True),
}


def recorded(draw: np.random.Generator, world: World) -> dict[str, tuple[RecordedSegment, ...]]:
    sets = {"drift": OPTIMAL, "traditional": TRADITIONAL, "verify": AGAIN if world.again else VERIFY}
    count = sum(map(len, sets.values()))
    noise = world.white / math.sqrt(DWELL / SAMPLES) * draw.standard_normal((2, count, SAMPLES))
    if world.flicker:
        noise = noise + flicker_in_segments(draw, (2,), world.flicker, count)
    turns: dict[str, np.ndarray] = {}
    made: dict[str, list[RecordedSegment]] = {name: [] for name in sets}
    n = 0
    for name, positions in sets.items():
        for label, words in positions.items():
            x, y, z = turns.setdefault(words, world.tilt * ARCSEC * draw.standard_normal(3))
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            values = pulses((np.eye(3) + cross) @ attitude(words), GYRO)
            planned = replace(segment(f"{name}/{label}", attitude(words)), orientation=words)
            means = dict(zip(CHANNELS, map(float, values), strict=True))
            made[name].append(played(planned, means, noise[:, n], "pulse/s", n * (DWELL + PAUSE)))
            n += 1
    return {name: tuple(segments) for name, segments in made.items()}


def coverage(world: World, runs: int, seed: int) -> dict[str, float]:
    """Share of runs in which the measured ratio lies below, within and above the range that is expected."""
    draw, model = np.random.default_rng(seed), sensor(*CHANNELS)
    known = [InputQuantity(f"bias instability {one}", 0.0, "pulse/s", world.flicker) for one in CHANNELS]
    known = known if world.flicker else []
    if world.stated:
        known.append(InputQuantity("table position", 0.0, "rad", world.stated * ARCSEC))
    setup = Setup(inputs=Inputs({one.name: one for one in known}))
    counts = dict.fromkeys(("below", "within", "above"), 0)
    for run in range(runs):
        segments = recorded(draw, world)
        keys = FlexureGyroStaticParameters()
        uses = {
            name: FlexureGyroStatic().estimate(EstimateRequest(name, segments[name], keys, SITE, model, setup=setup))
            for name in ("drift", "traditional")
        }
        parameters = CompensationResidualParameters(trials=TRIALS, seed=run)
        request = EstimateRequest("r", segments["verify"], parameters, SITE, model, uses, setup=setup)
        row = CompensationResidual().estimate(request).tables[0].rows[0]
        measured, low, high = (figure(row[k]) for k in (1, 4, 5))
        counts["below" if measured < low else "above" if measured > high else "within"] += 1
    return {name: count / runs for name, count in counts.items()}


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    only = sys.argv[2] if len(sys.argv) > 2 else ""
    print(f"{runs} runs each; share of measured ratios below, within and above the expected 5 to 95 %, in %")
    for name, world in SCENARIOS.items():
        if only in name:
            shares = coverage(world, runs, 70)
            print(f"{name}: " + ", ".join(f"{100 * share:.1f}" for share in shares.values()), flush=True)


if __name__ == "__main__":
    main()
