"""A small simulated inertial unit on a turntable, for tests: formulas of its own, rotations by scipy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planrunner.error_model.observed import Channel, Observed
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Motion, Rest, Rock, Spin

Array = NDArray[np.float64]
DEG = np.pi / 180
G = 9.80154
RATE = 20.0  # Hz
SITE = Site(39.98 * DEG, G)
GYRO_WHITE, ACCEL_WHITE = 0.0014 * DEG, 3.5e-4  # SI·√s
Fault = Callable[[Observed, Array, Array, np.random.Generator], tuple[Array | float, Array | float]]


def _frames() -> list[Array]:
    """Twelve orientations: every sensor axis up and down, turned by a quarter about the vertical as well."""
    up = [np.eye(3), Rotation.from_euler("y", 90, degrees=True).as_matrix()]
    up += [
        Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        for axis, angle in (("y", -90), ("x", 90), ("x", -90), ("x", 180))
    ]
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    return [frame.round(12) for base in up for frame in (base, base @ quarter)]


def plan() -> list[tuple[Array, Motion, float, float]]:
    """Attitude, motion, seconds, temperature."""
    frames = _frames()
    rows: list[tuple[Array, Motion, float, float]] = [(frame, Rest(), 20.0, 25.0) for frame in frames]
    rows += [(frame, Spin(s * r * DEG), 20.0, 25.0) for frame in frames[::4] for r in (18, 40, 90) for s in (1, -1)]
    rows += [(frame, Rock(3 * DEG, 0.5, (0.0,), 20.0), 20.0, 25.0) for frame in frames[::4]]
    rows += [(frame, Rest(), 20.0, warm) for warm in (50.0, 0.0) for frame in frames[::3]]
    return rows


def record(
    seed: int = 1,
    fault: Fault | None = None,
    noise: float = 1.0,
    sampling: float = RATE,
    clean: bool = False,
    repeats: int = 1,
) -> Observed:
    """A recording with unknown matrices and biases, white noise and rounding, or with neither; `fault` gives what is added to rate and
    specific force. `repeats`: how often the plan is carried out."""
    draw = np.random.default_rng(seed)
    rows = plan() * repeats
    n = [int(seconds * sampling) for _, _, seconds, _ in rows]
    since = [np.arange(count) / sampling for count in n]
    starts = 600.0 + np.concatenate(([0.0], np.cumsum([seconds + 20.0 for _, _, seconds, _ in rows])[:-1]))
    angle, rate, acceleration = (np.concatenate(part) for part in zip(*map(_turned, rows, since), strict=True))
    warm = np.repeat([row[3] for row in rows], n)
    channels = tuple(
        Channel(f"{kind}_{axis}", kind, i, unit, factor, white, 0.0, count)
        for kind, unit, factor, white, count in (
            ("gyro", "deg/s", DEG, GYRO_WHITE, 5e-4 * DEG),
            ("accel", "m/s^2", 1.0, ACCEL_WHITE, 2e-4),
        )
        for i, axis in enumerate("xyz")
    )
    changed = np.sign(np.diff([25.0, *(row[3] for row in rows)]))
    last = np.array([next((c for c in changed[i::-1] if c), 0.0) for i in range(len(rows))])
    shell = Observed(
        SITE, channels, tuple(f"S{i}" for i in range(len(rows))), tuple(row[1] for row in rows),
        np.array([row[0] for row in rows]), np.concatenate(([0], np.cumsum(n))),
        np.concatenate([start + part for start, part in zip(starts, since, strict=True)]), angle, rate, acceleration,
        warm, np.zeros(len(warm)), last, np.zeros((len(warm), 6)), np.array([0.0, 0.55, -0.83]),
    )  # fmt: skip
    omega, force = felt(shell)
    more = fault(shell, omega, force, draw) if fault else (0.0, 0.0)
    matrices = [np.eye(3) + draw.normal(0, 2e-3, (3, 3)) for _ in range(2)]
    gyro = (omega + more[0]) @ matrices[0].T + draw.normal(0, 0.02 * DEG, 3)
    accel = (force + more[1]) @ matrices[1].T + draw.normal(0, 0.02, 3)
    exact = np.hstack([gyro, accel])
    gyro += draw.normal(0, noise * GYRO_WHITE * np.sqrt(sampling), gyro.shape)
    accel += draw.normal(0, ACCEL_WHITE * np.sqrt(sampling), accel.shape)
    if clean:
        return replace(shell, values=exact)
    values = np.hstack([np.round(gyro / (5e-4 * DEG)) * 5e-4 * DEG, np.round(accel / 2e-4) * 2e-4])
    return Observed(**{**{name: getattr(shell, name) for name in shell.__dataclass_fields__}, "values": values})


def _turned(row: tuple[Array, Motion, float, float], since: Array) -> tuple[Array, Array, Array]:
    motion = row[1]
    if isinstance(motion, Spin):
        return motion.rate * since, np.full(len(since), motion.rate), np.zeros(len(since))
    if isinstance(motion, Rock):
        w = 2 * np.pi * motion.frequency
        sine, cosine = motion.amplitude * np.sin(w * since), motion.amplitude * np.cos(w * since)
        return sine, w * cosine, -w * w * sine
    return np.zeros(len(since)), np.zeros(len(since)), np.zeros(len(since))


def felt(observed: Observed) -> tuple[Array, Array]:
    """Rate and specific force in sensor axes, by scipy's rotations."""
    earth = 15.041067 * DEG / 3600 * np.array([0, np.cos(SITE.latitude), np.sin(SITE.latitude)])
    back = Rotation.from_rotvec(-observed.angle[:, None] * np.array([0.0, 0.0, 1.0]))
    spin = observed.rate[:, None] * np.array([0.0, 0.0, 1.0])
    omega, force = back.apply(earth + spin), back.apply([0.0, 0.0, G])
    attitude = observed.attitude[observed.owner]
    return np.einsum("nij,nj->ni", attitude, omega), np.einsum("nij,nj->ni", attitude, force)


def kept(observed: Observed, chosen: list[int]) -> Observed:
    """Some segments of a recording, as if the others had never been."""
    parts = [observed.segments()[index] for index in chosen]

    def of(per_sample: Array) -> Array:
        return np.concatenate([per_sample[part] for part in parts])

    return replace(
        observed,
        labels=tuple(observed.labels[index] for index in chosen),
        motions=tuple(observed.motions[index] for index in chosen),
        attitude=observed.attitude[chosen],
        bounds=np.concatenate(([0], np.cumsum([part.stop - part.start for part in parts]))),
        last_change=observed.last_change[chosen],
        time=of(observed.time),
        angle=of(observed.angle),
        rate=of(observed.rate),
        acceleration=of(observed.acceleration),
        temperature=of(observed.temperature),
        temperature_rate=of(observed.temperature_rate),
        values=of(observed.values),
    )
