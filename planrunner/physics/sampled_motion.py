"""Computes the motion of the table at the samples of a segment, from the plan and the encoder. Also computes how averaging over
bins attenuates this motion. Without an encoder, the angle of a turning table is found from the outputs of the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from planrunner.base.arrays import Array
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Motion, Rock, Spin

SHOWS_ANGLE = 1.0
"""Gravity shows the angle of a turning table only if the component of gravity along an accelerometer varies once per turn with at
least this amplitude [m/s²]. Errors of an accelerometer, or a tilt of the table, cause much smaller variations."""

OFFSET = 0.1
"""Standard deviation of the constant error of an accelerometer in the search for the angle of a table, m/s². The value (10 mg)
limits the error of the angle if the table covers only a small part of a turn."""

FOREIGN = 3.0
"""If the measured variation of the input once per turn is at least this many times as large as the expected variation, it has
a cause other than the rotation of the Earth."""


class AngleFrom(StrEnum):
    """States the source from which the angle of the table is known. `PLAN`: the angle is known from an encoder or, if the table
    does not turn continuously, from the plan. `GRAVITY`: it is known from the accelerometers, because the table turns about an axis
    that is not vertical. `NOTHING`: it is not known, because the table turns and its angle at the start of the segment is
    unknown."""

    PLAN = "plan"
    GRAVITY = "gravity"
    NOTHING = "nothing"


def motion_at(
    motion: Motion, since: Array, encoder: Array | None, left: float = 1.0, start: float = 0.0
) -> dict[str, Array]:
    """Returns the angle, rate and acceleration of the table at the times `since` [s] after the first sample of a segment.

    `left`: factor by which averaging over a bin reduces the rate and the angle of a rocking table (see `fading`). For bins, the
    returned rate is the mean over the bin; the angle and the acceleration are those at the middle of the bin. With an encoder, the
    planned form of the motion (a constant rate or a sine) is fitted to the measured angle, so that the phase agrees with the actual
    motion. `start`: angle of a turning table without encoder at the first sample, rad.
    """
    zero = np.zeros(len(since))
    if isinstance(motion, Spin):
        if encoder is not None:
            start = float(np.angle(np.mean(np.exp(1j * (encoder - motion.rate * since)))))
        return {"angle": start + motion.rate * since, "rate": zero + motion.rate, "acceleration": zero}
    if isinstance(motion, Rock):
        pulse = 2 * np.pi * motion.frequency
        still = (since < motion.steady) | (since > motion.steady + motion.duration)
        phase = pulse * (since - motion.steady) + motion.phases[0]
        sine, cosine = np.sin(phase), np.cos(phase)
        a, b, c = motion.amplitude, 0.0, 0.0
        if encoder is not None:
            terms = np.column_stack([sine, cosine, zero + 1])[~still]
            a, b, c = np.linalg.lstsq(terms, np.unwrap(encoder)[~still], rcond=None)[0]
            a, b = a / left, b / left
        swing = np.where(still, 0.0, a * sine + b * cosine)
        rate = np.where(still, 0.0, pulse * (a * cosine - b * sine) * left)
        return {"angle": swing + c, "rate": rate, "acceleration": np.where(still, 0.0, -(pulse**2) * swing)}
    level = zero if encoder is None else zero + float(np.angle(np.mean(np.exp(1j * encoder))))
    return {"angle": level, "rate": zero, "acceleration": zero}


def once_per_turn(motion: Spin, attitude: Array, vector: Array) -> Array:
    """Returns the part of a site vector that changes once per turn, seen in sensor axes: complex amplitudes (3,).

    At the angle θ of the table, the sensor sees the vector A·(p + q·cos θ − (a × q)·sin θ). Here A is the attitude of the sensor, a
    is the axis of the table, p is the part of the vector along this axis, and q is the other part. The part that changes is the
    real part of A·(q + i·a × q)·exp(iθ); its complex amplitude is A·(q + i·a × q).
    """
    about = np.asarray(motion.about, dtype=float)
    across = vector - (about @ vector) * about
    return np.asarray(attitude @ (across + 1j * np.cross(about, across)))


def along_axis(motion: Spin, attitude: Array, vector: Array) -> Array:
    """Returns the part of a site vector along the axis of the table, seen in sensor axes (3,). This part does not change while the
    table turns. `attitude`: array of shape (3, 3), attitude at table angle 0."""
    about = np.asarray(motion.about, dtype=float)
    return np.asarray(attitude @ ((about @ vector) * about))


def angle_from(motion: Motion, attitude: Array, site: Site, accelerometers: Sequence[int]) -> AngleFrom:
    """Determines how the angle of a table without encoder is known. `attitude`: array of shape (3, 3), attitude at table angle 0.
    `accelerometers`: the sensor axes (0, 1, 2) that have an accelerometer."""
    if not isinstance(motion, Spin):
        return AngleFrom.PLAN
    seen = once_per_turn(motion, attitude, site.specific_force_enu)[list(accelerometers)]
    return AngleFrom.GRAVITY if np.abs(seen).max(initial=0.0) > SHOWS_ANGLE else AngleFrom.NOTHING


def start_angle(motion: Spin, since: Array, values: Array, expected: Array, offset: float) -> float:
    """Returns the angle [rad] of a turning table at the first sample. With this angle, the outputs agree best with the expected
    input.

    `values`: array of shape (n, K) in SI units, outputs after the expected input along the axis of the table has been subtracted.
    `expected`: array of shape (K,), complex, result of `once_per_turn`. `offset`: standard deviation of the constant error of a
    channel, SI, infinite if unknown.

    The model of channel k is Re(z·eₖ·exp(iφ)) + oₖ, where φ is the angle by which the table has turned since the first sample. The
    complex factor z is the same for all channels, and its argument is the angle at the first sample. The offset oₖ has the prior
    N(0, `offset`²). The fit uses weighted least squares. The noise is estimated from the differences between successive samples. If
    |z| is `FOREIGN` or more, the change once per turn has another cause, and its phase does not show the angle. In this case, and
    if there are fewer than three samples, the result is 0.
    """
    if len(since) < 3:
        return 0.0
    noise = np.diff(values, axis=0).std(axis=0) / np.sqrt(2)
    weight = 1 / np.maximum(noise, 1e-9 * np.abs(values).max(initial=1e-300)) ** 2
    input_ = np.exp(1j * motion.rate * since)[:, None] * expected
    terms = np.stack([input_.real, -input_.imag, values])
    shrunk = 1 / (len(since) + 1 / (weight * offset**2))
    sums = terms.sum(axis=1)
    products = np.tensordot(terms * weight, terms, ([1, 2], [1, 2])) - (sums * (weight * shrunk)) @ sums.T
    real, imaginary = np.linalg.lstsq(products[:2, :2], products[:2, 2], rcond=None)[0]
    return 0.0 if np.hypot(real, imaginary) >= FOREIGN else float(np.arctan2(imaginary, real))


def period_of(motion: Motion) -> float:
    """Returns the duration of one turn or of one period of rocking, s; infinite at rest."""
    if isinstance(motion, Spin):
        return 2 * np.pi / abs(motion.rate) if motion.rate else np.inf
    return 1 / motion.frequency if isinstance(motion, Rock) else np.inf


def fading(motion: Motion, size: int, rate: float) -> float:
    """Returns the factor by which averaging over a bin of `size` samples reduces the rate of a rocking table. The factor is
    Dirichlet's kernel sin(k·x)/(k·sin x), where k = `size` and x is half of the phase step [rad] between samples. `rate`: number of
    samples per second."""
    if size == 1 or not isinstance(motion, Rock):
        return 1.0
    half = np.pi * motion.frequency / rate
    return float(np.sin(size * half) / (size * np.sin(half)))


def turned_by(motion: Motion, since: Array) -> Array:
    """Returns the planned angle of a table at the times `since` [s], rad, in the shape of `since`. The angle is zero if the table
    does not turn continuously."""
    return motion.rate * since if isinstance(motion, Spin) else np.zeros(len(since))
