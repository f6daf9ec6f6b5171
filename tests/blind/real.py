"""Real noise behind simulated motion: recordings of sensors at rest, made by nobody here, stand in for drawn noise.

Each background is a stretch of samples in which a sensor of `../shared/data` did not move. Drift slower than `SLOW` is taken out, because
it may be an effect of the catalogue, a warm-up say, of which no label would know. Without it, however, the noise would have less slow
parts than any sensor's. A drift drawn at random therefore takes its place; its polynomials are as large as the next higher ones of the
recording. Each channel is scaled to the common level of its triad. Nothing else is changed, so lines, anti-correlated rounding, counts,
flicker and spikes remain. Declared is what a laboratory would read
off such a recording: the scatter of single samples as white noise, and the minimum of the Allan deviation as bias instability.

A case takes consecutive samples from a place drawn at random. The recordings are short, so the noise of different cases overlaps.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from tests.blind.device import SENSORS, Sensor, Triad
from tests.blind.motion import Array, Schedule

DATA = Path(os.environ.get("PLANRUNNER_DATA", Path(__file__).resolve().parents[2].parent / "shared" / "data"))
SLOW = 100.0  # s; polynomials of one degree for each such span are taken out
LSB_RING_LASER = 0.00816  # °/s, of the ring-laser IMU: its readings are multiples of it, but for some 0.0001 °/s
SHORT = 1.0  # s; averaging time at which the level of the noise is measured that effects must exceed
FLICKER_FLOOR = 0.664  # minimum of the Allan deviation of flicker noise ÷ its bias instability (IEEE Std 952)


@dataclass(frozen=True)
class Background:
    """Noise of a sensor at rest, shape (n, 3 or 6) in °/s and m/s², scaled to one level a triad; the count of each channel.

    slow: shape (n, d), the polynomials that were taken out, each of length 1. sizes: shape (d, 3 or 6), the standard deviations of those
    that take their place.
    lattice: °/s, spacing of the values that the gyros' noise takes, where it is wider than their count. Such noise does not dither counts
    of a similar size: the rounding errors of its few values do not average out.
    """

    sampling: float
    values: Array
    steps: Array
    slow: Array
    sizes: Array
    lattice: float = 0.0

    def cut(self, count: int, rng: np.random.Generator) -> Array:
        """Consecutive samples; raises ValueError where the recording is too short.

        They are spread evenly within their counts, because they are rounded again once a signal is added: rounded values and a constant
        would be off by the constant's own rounding.
        """
        spare = len(self.values) - count
        if spare < 0:
            raise ValueError(f"{count} samples are wanted of a recording of {len(self.values)}")
        first = int(rng.integers(spare + 1))
        drift = self.slow[first : first + count] @ (self.sizes * rng.standard_normal(self.sizes.shape))
        return (
            self.values[first : first + count] + drift + self.steps * rng.uniform(-0.5, 0.5, (count, len(self.steps)))
        )


def allan_deviation(values: Array, samples: int) -> Array:
    """Overlapping, of each column, for means of `samples` consecutive values."""
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    means = (sums[samples:] - sums[:-samples]) / samples
    steps = means[samples:] - means[:-samples]
    return np.sqrt(np.mean(steps**2, axis=0) / 2)


def _polynomials(count: int, degrees: range) -> Array:
    """Legendre polynomials of these degrees, each of length 1, shape (count, d)."""
    columns = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), degrees.stop - 1)
    whole, _ = np.linalg.qr(columns)
    return np.asarray(whole[:, degrees.start :])


def _degree(piece: Array, sampling: float) -> int:
    return round(len(piece) / sampling / SLOW)


def _without_drift(piece: Array, sampling: float) -> Array:
    columns = _polynomials(len(piece), range(_degree(piece, sampling) + 1))
    return piece - columns @ (columns.T @ piece)


def _sizes(piece: Array, sampling: float) -> Array:
    """Root mean square, of each triad alike, of as many polynomials as were taken out, from the next higher degree on."""
    degree = _degree(piece, sampling)
    next_ones = _polynomials(len(piece), range(degree + 1, 2 * degree + 1)).T @ piece
    level = np.sqrt(np.mean(next_ones.reshape(degree, piece.shape[1] // 3, 3) ** 2, axis=(0, 2)))
    return np.tile(np.repeat(level, 3), (degree, 1))


def _scaled(sampling: float, pieces: list[Array], lattice: float = 0.0) -> Background:
    values = np.vstack([_without_drift(piece, sampling) for piece in pieces])
    counts = np.array([np.diff(np.unique(column)).min() for column in np.vstack(pieces).T])
    level = values.std(axis=0)
    common = np.repeat([np.sqrt(np.mean(triad**2)) for triad in level.reshape(-1, 3)], 3)
    scale = common / level
    slow = block_diag(*[_polynomials(len(piece), range(1, _degree(piece, sampling) + 1)) for piece in pieces])
    sizes = np.vstack([_sizes(piece * scale, sampling) for piece in pieces])
    return Background(sampling, values * scale, counts * scale, slow, sizes, lattice * float(scale[:3].max()))


def _mpu6050() -> Background:
    """An MPU-6050 at rest for 449 s at 100 Hz; 131 counts per °/s, 16384 counts per g."""
    counts = np.loadtxt(
        DATA / "mpu6050_multi_position" / "example_data_tinit_calc.csv", delimiter=",", skiprows=5
    )  # ax ay az gx gy gz
    return _scaled(100.0, [np.hstack([counts[:, 3:] / 131, counts[:, :3] / 16384 * 9.80665])])


def _ring_laser() -> Background:
    """A ring-laser IMU at rest in two positions, 300 s each at 64 Hz."""
    pieces = [np.fromfile(DATA / "ln100" / f"x_LN100_{way}.ins", "<f8").reshape(-1, 7)[:, 1:] for way in ("up", "down")]
    return _scaled(64.0, pieces, LSB_RING_LASER)


def _beside_a_turning_one() -> Background:
    """The gyros of an IMU beside a turning one, at 100 Hz in coarse counts of 0.06 °/s: the 510 s in which its scatter stays the same."""
    import scipy.io

    columns = scipy.io.loadmat(DATA / "two_imus_encoder" / "raw_yaw_slow.mat")
    return _scaled(100.0, [np.column_stack([columns[f"all_gyro_1_{axis}"] for axis in "xyz"])[64_000:115_000]])


_READERS: dict[str, Callable[[], Background]] = {
    "mpu6050": _mpu6050,
    "ring_laser": _ring_laser,
    "beside_a_turning_one": _beside_a_turning_one,
}
SETUPS = (
    ("poor", "mpu6050"),
    ("rocking", "mpu6050"),
    ("poor", "ring_laser"),
    ("rates", "ring_laser"),
    ("rocking", "ring_laser"),
    ("poor", "beside_a_turning_one"),
    ("rocking", "beside_a_turning_one"),
)
"""Plans that are not longer than the recording."""


@lru_cache(maxsize=len(_READERS))
def background(name: str) -> Background:
    """Raises OSError where the recording is not there."""
    return _READERS[name]()


def _triad(values: Array, sampling: float, step: float) -> Triad:
    """What a laboratory would declare: white noise from the scatter, instability from the least Allan deviation."""
    longest = int(np.log2(len(values) / 10))
    deviations = [float(np.sqrt(np.mean(allan_deviation(values, 2**k) ** 2))) for k in range(longest + 1)]
    instability = min(deviations) / FLICKER_FLOOR
    white = float(np.sqrt(np.mean(values.var(axis=0))) / np.sqrt(sampling / 2))
    return Triad(white, instability, step)


@lru_cache(maxsize=len(_READERS))
def _sensor(name: str) -> Sensor:
    found = background(name)
    triads = [
        _triad(found.values[:, i : i + 3], found.sampling, float(found.steps[i : i + 3].min()))
        for i in range(0, found.values.shape[1], 3)
    ]
    return Sensor(
        name, found.sampling, triads[0], triads[1] if len(triads) > 1 else None, real=True, counts=tuple(found.steps)
    )


def sensor_called(name: str) -> Sensor:
    """A sensor type of `SENSORS`, or one with real noise."""
    return SENSORS[name] if name in SENSORS else _sensor(name)


@lru_cache(maxsize=len(_READERS))
def true_factors(name: str) -> tuple[float, ...]:
    """True ÷ declared level of each triad: true is what remains after averaging for a second, as effects must exceed it."""
    found, sensor = background(name), _sensor(name)
    samples = round(SHORT * found.sampling)
    level = allan_deviation(found.values, samples) * np.sqrt(samples)
    return tuple(float(f) for f in np.sqrt(np.mean((level / sensor.sigma()).reshape(-1, 3) ** 2, axis=1)))


def noise(schedule: Schedule, sensor: Sensor, factors: Array, rng: np.random.Generator) -> Array:
    """A cut of the recording, larger by what `factors` (per channel) have beyond the recording's own."""
    return background(sensor.name).cut(len(schedule.time), rng) * (factors / np.repeat(true_factors(sensor.name), 3))
