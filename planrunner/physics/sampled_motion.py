"""How the table moved at the samples of a segment, by its plan and its encoder, and what averaging over a bin leaves of that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.plan.schedule import Motion, Rock, Spin

Array = NDArray[np.float64]


def motion_at(motion: Motion, since: Array, encoder: Array | None, left: float = 1.0) -> dict[str, Array]:
    """Angle, rate and acceleration of the table `since` s after a segment's first sample.

    left: what the mean over a bin leaves of a rocking table's rate and angle; the rate is then that mean, the others are in its
    middle. With an encoder the planned form (a constant rate; a sine) is fitted to its angle, so that phases are those of the table that
    turned.
    """
    zero = np.zeros(len(since))
    if isinstance(motion, Spin):
        start = 0.0 if encoder is None else float(np.angle(np.mean(np.exp(1j * (encoder - motion.rate * since)))))
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


def period_of(motion: Motion) -> float:
    """Seconds of a turn or of rocking; infinite at rest."""
    if isinstance(motion, Spin):
        return 2 * np.pi / abs(motion.rate) if motion.rate else np.inf
    return 1 / motion.frequency if isinstance(motion, Rock) else np.inf


def fading(motion: Motion, size: int, rate: float) -> float:
    """What the mean over a bin leaves of a rocking table's rate: Dirichlet's kernel sin(kx)/(k·sin x), x half a sample's phase."""
    if size == 1 or not isinstance(motion, Rock):
        return 1.0
    half = np.pi * motion.frequency / rate
    return float(np.sin(size * half) / (size * np.sin(half)))


def turned_by(motion: Motion, since: Array) -> Array:
    """The angle by which a turning table has planned to turn, rad; zero of one that rests or rocks."""
    return motion.rate * since if isinstance(motion, Spin) else np.zeros(len(since))
