"""Do the 95 % intervals of the twelve coefficients hold the truth 95 % of the time? Simulated eight-position experiments.

`python tests/estimators/coverage_experiment.py [runs [part of a name]]` prints the figures of docs/uncertainty-of-the-eight-positions.md.
The simulator is written apart from planrunner: pulses by the source's formulas, with noise in every sample (one sample each 3.75 s).
Its levels are those of the shipped virtual bench: white noise 0.9 pulse/√s, 120 s a position, 0.2 (deg/h)/(pulse/s).
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from recorded import played, segment, sensor
from simulated_flicker import flicker_series
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, TRUTH, attitude, pulses

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import combined
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.estimators.outputs_fit import BASES
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import InputQuantity, Inputs

GYRO = TRUTH | {"SF_X": 0.2012, "SF_Y": 0.1987, "epsilon": 8.0, "xi": -5.0}
NAMES = tuple(GYRO)
DWELL, PAUSE, SAMPLES, WHITE = 120.0, 60.0, 32, 0.9
SCENARIOS: dict[str, dict[str, Any]] = {
    "white noise": {},
    "white noise, second output four times noisier": {"ratio": 4.0},
    "white noise, outputs not pooled": {"pool": False},
    "position error 30 arcsec": {"tilt": 30.0},
    "position error 30 arcsec, noise ten times less": {"tilt": 30.0, "white": 0.09},
    "position error 30 arcsec, stated": {"tilt": 30.0, "stated": 30.0},
    "position error 30 arcsec, stated, noise ten times less": {"tilt": 30.0, "stated": 30.0, "white": 0.09},
    "position error 30 arcsec, stated as 15, noise ten times less": {"tilt": 30.0, "stated": 15.0, "white": 0.09},
}
for _floor in (0.025, 0.1, 0.4):
    SCENARIOS[f"flicker {_floor} pulse/s"] = {"flicker": _floor}
    SCENARIOS[f"flicker {_floor} pulse/s, declared"] = {"flicker": _floor, "declared": _floor}
    SCENARIOS[f"flicker {_floor} pulse/s, declared too small by 2"] = {"flicker": _floor, "declared": _floor / 2}
SCENARIOS["flicker 0.1 pulse/s, declared, outputs not pooled"] = {"flicker": 0.1, "declared": 0.1, "pool": False}
SCENARIOS["flicker 0.1 pulse/s and position error 30 arcsec, both stated"] = {
    "flicker": 0.1,
    "declared": 0.1,
    "tilt": 30.0,
    "stated": 30.0,
    "white": 0.3,
}
ARCSEC = math.radians(1) / 3600
SPAN = 86400.0  # s, over which constants hold


def flicker_in_segments(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    floor: float,
    segments: int = 8,
    dwell: float = DWELL,
    pause: float = PAUSE,
    span: float = SPAN,
) -> np.ndarray:
    """Samples of 1/f noise in segments that follow each other in the middle of a span of which it has no mean, (*shape, segments,
    SAMPLES). What is made is at least twice as long as the span, so that slower parts are there too."""
    step = dwell / SAMPLES
    each = SAMPLES + round(pause / step)
    count = 1 << math.ceil(math.log2(2 * span / step))
    first, half = (count - segments * each) // 2, round(span / step / 2)
    middle = first + (segments * each - (each - SAMPLES)) // 2
    made = np.empty((*shape, segments, SAMPLES))
    for place in np.ndindex(shape):
        series = flicker_series(rng, (), floor, step, count)
        series -= series[middle - half : middle + half].mean()
        made[place] = series[first : first + segments * each].reshape(segments, each)[:, :SAMPLES]
    return made


def experiment(
    rng: np.random.Generator, white: float, ratio: float, tilt: float, flicker: np.ndarray | float
) -> tuple[RecordedSegment, ...]:
    """One recording of the eight positions."""
    sizes = white / math.sqrt(DWELL / SAMPLES) * np.array([1.0, ratio])
    noise = sizes[:, None, None] * rng.normal(size=(2, 8, SAMPLES)) + flicker
    recorded = []
    for n, (label, words) in enumerate(OPTIMAL.items()):
        planned = attitude(words)
        turn = rng.normal(0, math.radians(tilt / 3600), 3)
        cross = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
        means = dict(zip(CHANNELS, pulses((np.eye(3) + cross) @ planned, GYRO), strict=True))
        named, start = replace(segment(label, planned), orientation=words), n * (DWELL + PAUSE)
        recorded.append(played(named, means, noise[:, n], "pulse/s", start))
    return tuple(recorded)


def coverage(
    runs: int,
    seed: int,
    white: float = WHITE,
    ratio: float = 1.0,
    tilt: float = 0.0,
    flicker: float = 0.0,
    pool: bool = True,
    declared: float = 0.0,
    stated: float = 0.0,
) -> dict[str, np.ndarray]:
    """Share of runs whose 95 % interval holds the truth: by basis, shape (12,) in the order of `NAMES`.

    white: pulse/√s; ratio: noise of the second output over the first's; tilt: standard uncertainty of the attitude about each axis, arcsec;
    flicker: bias instability, pulse/s; pool: the key `pool_outputs`; declared, stated: what the bench says of flicker and tilt.
    """
    rng = np.random.default_rng(seed)
    model = sensor(*CHANNELS)
    inputs = {f"bias instability {name}": InputQuantity("", 0.0, "pulse/s", declared) for name in CHANNELS if declared}
    if stated:
        inputs["table position"] = InputQuantity("", 0.0, "rad", stated * ARCSEC)
    setup = Setup(inputs=Inputs({name: replace(one, name=name) for name, one in inputs.items()}))
    hits = {basis: np.zeros(12) for basis in BASES}
    truth = np.array([GYRO[name] for name in NAMES])
    for _ in range(runs):
        slow = flicker_in_segments(rng, (2,), flicker) if flicker else 0.0
        segments = experiment(rng, white, ratio, tilt, slow)
        for basis, counts in hits.items():
            parameters = FlexureGyroStaticParameters(pool_outputs=pool, uncertainty=basis)
            request = EstimateRequest("d", segments, parameters, SITE, model, setup=setup)
            found = combined(FlexureGyroStatic().estimate(request))
            for place, name in enumerate(NAMES):
                one = found[name]
                width = expanded_uncertainty(one.standard_uncertainty, one.degrees_of_freedom)
                counts[place] += abs(one.value - truth[place]) <= width
    return {basis: counts / runs for basis, counts in hits.items()}


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    only = sys.argv[2] if len(sys.argv) > 2 else ""
    print(f"{runs} runs each; lowest and highest coverage over the twelve coefficients, in %")
    for name, keys in SCENARIOS.items():
        if only not in name:
            continue
        found = coverage(runs, 20, **keys)
        parts = [
            f"{basis}: {100 * share.min():.1f} ({NAMES[int(share.argmin())]}) … {100 * share.max():.1f} ({NAMES[int(share.argmax())]})"
            for basis, share in found.items()
        ]
        print(f"{name}: {'; '.join(parts)}", flush=True)


if __name__ == "__main__":
    main()
