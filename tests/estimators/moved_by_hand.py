"""Sensors that a hand moves: recordings with formulas of their own, for estimates and diagnoses of motion that nobody commanded.

The body's rates are sums of sines, its attitude is stepped through them as quaternions on a fine grid. An accelerometer beside the
reference feels the second differences of its own path through space; nothing here knows ω×(ω×r).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from recorded import from_samples

from planrunner.archive.recording import RecordedSegment
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.plan.schedule import RecordedMotion, Segment

RATE = 100.0  # Hz
FINE = 4  # steps of the motion in a sample
GRAVITY = np.array([0.0, 0.0, 9.81])
GYRO_NOISE, FORCE_NOISE = 0.05, 0.02  # deg/s and m/s², of a sample
UNITS = {
    **{
        f"{who}_{kind}_{axis}": unit
        for who in ("one", "two")
        for kind, unit in (("gyro", "deg/s"), ("accel", "m/s^2"))
        for axis in "xyz"
    },
    "q_w": "1",
    "q_x": "1",
    "q_y": "1",
    "q_z": "1",
    "angle": "deg",
}
SENSOR = SensorModel(
    "under test",
    tuple(
        OutputModel(
            name,
            unit,
            noise=NoiseModel(white={"deg/s": GYRO_NOISE, "m/s^2": FORCE_NOISE}.get(unit, 0.0) / np.sqrt(RATE)),
        )
        for name, unit in UNITS.items()
    ),
    RATE,
)
BY_REFERENCE = RecordedMotion(
    rates=tuple(f"one_gyro_{a}" for a in "xyz"), forces=tuple(f"one_accel_{a}" for a in "xyz")
)
BY_POSES = RecordedMotion(attitude=("q_w", "q_x", "q_y", "q_z"), averaging=0.1)


@dataclass(frozen=True)
class Hand:
    """A hand with two units on a board: the second at `arm` (m) from the first, with gyro matrix and bias (deg/s) and accelerometer matrix
    and bias (m/s²) of its own, late by `delay` s. late: s, of the quaternion. axis: about which alone it turns, None for all."""

    arm: Sequence[float] = (0.0, 0.0, 0.0)
    gyro: np.ndarray = field(default_factory=lambda: np.eye(3))
    gyro_bias: Sequence[float] = (0.0, 0.0, 0.0)
    accel: np.ndarray = field(default_factory=lambda: np.eye(3))
    accel_bias: Sequence[float] = (0.0, 0.0, 0.0)
    delay: float = 0.0
    late: float = 0.0
    axis: int | None = None
    fast: float = 150.0  # deg/s
    shaken: float = 1.0  # m/s²
    noise: float = 1.0

    def recording(
        self, seed: int, motion: RecordedMotion, parts: int = 4, seconds: float = 8.0
    ) -> list[RecordedSegment]:
        rng = np.random.default_rng(seed)
        return [self._part(f"part_{k}", 100.0 * k, seconds, motion, rng) for k in range(parts)]

    def _part(
        self, label: str, begin: float, seconds: float, motion: RecordedMotion, rng: np.random.Generator
    ) -> RecordedSegment:
        h = 1 / RATE / FINE
        margin = 40 * FINE
        time = (np.arange(int(seconds * RATE) * FINE + 2 * margin) - margin) * h
        frequencies = rng.uniform(0.2, 1.5, (3, 3))
        phases = rng.uniform(0, 2 * np.pi, (3, 3))
        sizes = np.radians(self.fast) * rng.uniform(0.5, 1, (3, 3)) / np.sqrt(3)
        if self.axis is not None:
            sizes[np.arange(3) != self.axis] = 0.0
        rates = np.stack(
            [
                (a[:, None] * np.sin(2 * np.pi * f[:, None] * time + p[:, None])).sum(0)
                for a, f, p in zip(sizes, frequencies, phases, strict=True)
            ],
            1,
        )
        attitude = _stepped(rates, h, np.array([1.0, 0.0, 0.0, 0.0]))
        shake = self.shaken * np.stack(
            [np.sin(2 * np.pi * rng.uniform(0.5, 3) * time + rng.uniform(0, 6)) for _ in range(3)], 1
        )
        to_site = _matrices(attitude)
        at_one = np.einsum("nij,ni->nj", to_site, shake + GRAVITY)
        path = np.einsum("nij,j->ni", to_site, np.asarray(self.arm, dtype=float))
        away = np.zeros_like(path)
        away[1:-1] = (path[2:] - 2 * path[1:-1] + path[:-2]) / h**2
        at_two = np.einsum("nij,ni->nj", to_site, shake + GRAVITY + away)
        own = rates[:, self.axis or 0]
        angle = np.concatenate([[0.0], np.cumsum((own[1:] + own[:-1]) / 2)]) * h
        samples = np.arange(int(seconds * RATE)) * FINE + margin
        now = time[samples]

        def seen(values: np.ndarray, late: float = 0.0) -> np.ndarray:
            return np.stack([np.interp(now - late, time, column) for column in values.T], 1)

        def noisy(values: np.ndarray, sigma: float) -> np.ndarray:
            return values + self.noise * sigma * rng.standard_normal(values.shape)

        degrees = np.degrees(rates)
        channels = _named("one_gyro_", noisy(seen(degrees), GYRO_NOISE)) | _named(
            "one_accel_", noisy(seen(at_one), FORCE_NOISE)
        )
        two = seen(degrees, self.delay) @ np.asarray(self.gyro).T + self.gyro_bias
        channels |= _named("two_gyro_", noisy(two, GYRO_NOISE))
        channels |= _named("two_accel_", noisy(seen(at_two) @ np.asarray(self.accel).T + self.accel_bias, FORCE_NOISE))
        shown = noisy(seen(attitude, self.late), 1e-5)
        channels |= dict(
            zip(("q_w", "q_x", "q_y", "q_z"), (shown / np.linalg.norm(shown, axis=1)[:, None]).T, strict=True)
        )
        zero = np.interp(0.0, time, angle)
        channels["angle"] = np.mod(np.degrees(np.interp(now - self.late, time, angle) - zero), 360.0)
        planned = Segment(0, label, _matrices(attitude[samples[:1]])[0].T, "by hand", motion, None)
        return from_samples(planned, begin + now, channels, UNITS)


def _named(prefix: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{prefix}{axis}": column for axis, column in zip("xyz", values.T, strict=True)}


def _stepped(rates: np.ndarray, h: float, start: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) from the body to the site, by the midpoint of each step."""
    turns = (rates[1:] + rates[:-1]) / 2 * h
    half = np.linalg.norm(turns, axis=1) / 2
    steps = np.column_stack([np.cos(half), turns / 2 * np.sinc(half / np.pi)[:, None]])
    w, i, j, m = start.tolist()
    listed = [(w, i, j, m)]
    for c, x, y, z in steps.tolist():
        w, i, j, m = (
            w * c - i * x - j * y - m * z,
            w * x + i * c + j * z - m * y,
            w * y - i * z + j * c + m * x,
            w * z + i * y - j * x + m * c,
        )
        listed.append((w, i, j, m))
    found = np.array(listed)
    return found / np.linalg.norm(found, axis=1)[:, None]


def _matrices(q: np.ndarray) -> np.ndarray:
    """(n, 3, 3), from the body's axes to the site's."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
