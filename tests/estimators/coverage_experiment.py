"""Do the 95 % intervals of the twelve coefficients hold the truth 95 % of the time? Simulated eight-position experiments.

`python tests/estimators/coverage_experiment.py [runs]` prints the figures of docs/uncertainty-of-the-eight-positions.md. The simulator is
written apart from planrunner: pulses by the source's formulas, noise as batch means drawn here. Its levels are those of the shipped
virtual bench: white noise 0.9 pulse/√s, 120 s a position, 0.2 (deg/h)/(pulse/s).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from recorded import from_means, segment, sensor
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, TRUTH, attitude, pulses

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import EstimateRequest

GYRO = TRUTH | {"SF_X": 0.2012, "SF_Y": 0.1987, "epsilon": 8.0, "xi": -5.0}
NAMES = tuple(GYRO)
DWELL, PAUSE, BATCHES, WHITE = 120.0, 60.0, 32, 0.9
SCENARIOS: dict[str, dict[str, object]] = {
    "white noise": {},
    "white noise, second output four times noisier": {"ratio": 4.0},
    "flicker floor 0.025 pulse/s": {"flicker": 0.025},
    "flicker floor 0.1 pulse/s": {"flicker": 0.1},
    "flicker floor 0.4 pulse/s": {"flicker": 0.4},
    "position error 30 arcsec": {"tilt": 30.0},
    "position error 30 arcsec, noise ten times less": {"tilt": 30.0, "white": 0.09},
    "white noise, outputs not pooled": {"pool": False},
    "flicker floor 0.1 pulse/s, outputs not pooled": {"flicker": 0.1, "pool": False},
}


def flicker_series(rng: np.random.Generator, runs: int, floor: float) -> np.ndarray:
    """1/f noise on the batches' time grid through the whole test, shape (runs, 2, 8, BATCHES).

    One-sided density B²/(π·f): IEEE 952's bias instability B, whose Allan deviation has its floor at 0.664·B.
    """
    step = DWELL / BATCHES
    gap = round(PAUSE / step)
    count = 8 * (BATCHES + gap)
    n = 1 << (4 * count - 1).bit_length()  # longer than the test, so that slower parts are there too
    frequency = np.fft.rfftfreq(n, step)[1:]
    power = floor**2 / (math.pi * frequency) * (frequency[1] - frequency[0])
    spectrum = (rng.normal(size=(runs, 2, len(frequency))) + 1j * rng.normal(size=(runs, 2, len(frequency)))) * np.sqrt(
        power / 2
    )
    spectrum = np.concatenate([np.zeros((runs, 2, 1)), spectrum], axis=-1)
    series = np.fft.irfft(spectrum, n) * n / math.sqrt(2)
    return series[..., :count].reshape(runs, 2, 8, BATCHES + gap)[..., :BATCHES]


def experiment(
    rng: np.random.Generator, white: float, ratio: float, tilt: float, flicker: np.ndarray | float
) -> tuple[RecordedSegment, ...]:
    """One recording of the eight positions."""
    sizes = white / math.sqrt(DWELL / BATCHES) * np.array([1.0, ratio])
    batches = sizes[:, None, None] * rng.normal(size=(2, 8, BATCHES)) + flicker
    mean, error = batches.mean(axis=2), batches.std(axis=2, ddof=1) / math.sqrt(BATCHES)
    recorded = []
    for n, (label, words) in enumerate(OPTIMAL.items()):
        planned = attitude(words)
        turn = rng.normal(0, math.radians(tilt / 3600), 3)
        cross = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
        values = np.add(pulses((np.eye(3) + cross) @ planned, GYRO), mean[:, n])
        recorded.append(
            from_means(
                segment(label, planned), dict(zip(CHANNELS, values, strict=True)), "pulse/s", error[:, n], BATCHES
            )
        )
    return tuple(recorded)


def coverage(
    runs: int,
    seed: int,
    white: float = WHITE,
    ratio: float = 1.0,
    tilt: float = 0.0,
    flicker: float = 0.0,
    pool: bool = True,
) -> dict[str, np.ndarray]:
    """Share of runs whose 95 % interval holds the truth: by basis, shape (12,) in the order of `NAMES`.

    white: pulse/√s; ratio: noise of the second output over the first's; tilt: standard uncertainty of the attitude about each axis, arcsec;
    flicker: bias instability, pulse/s; pool: the key `pool_outputs`.
    """
    rng = np.random.default_rng(seed)
    parameters, model = FlexureGyroStaticParameters(pool_outputs=pool), sensor(*CHANNELS)
    hits = {"residual": np.zeros(12), "within segment": np.zeros(12)}
    truth = np.array([GYRO[name] for name in NAMES])
    chunk = 250
    for start in range(0, runs, chunk):
        slow = flicker_series(rng, chunk, flicker) if flicker else np.zeros(chunk)
        for n in range(min(chunk, runs - start)):
            segments = experiment(rng, white, ratio, tilt, slow[n])
            found = FlexureGyroStatic().estimate(EstimateRequest("d", segments, parameters, SITE, model))
            table = next(table for table in found.tables if table.title == "Uncertainties of the data, on either basis")
            rows = {row[0]: row for row in table.rows}
            values = np.array([rows[name][2] for name in NAMES])
            for basis, counts in hits.items():
                column = table.columns.index(f"U 95 % ({basis})")
                counts += np.abs(values - truth) <= np.array([rows[name][column] for name in NAMES])
    return {basis: counts / runs for basis, counts in hits.items()}


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print(f"{runs} runs each; lowest and highest coverage over the twelve coefficients, in %")
    for name, keys in SCENARIOS.items():
        found = coverage(runs, 20, **keys)  # type: ignore[arg-type]
        parts = [
            f"{basis}: {100 * share.min():.1f} ({NAMES[int(share.argmin())]}) … {100 * share.max():.1f} ({NAMES[int(share.argmax())]})"
            for basis, share in found.items()
        ]
        print(f"{name}: {'; '.join(parts)}", flush=True)


if __name__ == "__main__":
    main()
