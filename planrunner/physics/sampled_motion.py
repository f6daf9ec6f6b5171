"""Motion of the table at the samples of a segment, from the plan and the encoder, and its attenuation by averaging over bins."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.plan.schedule import Motion, Rock, Spin


def motion_at(motion: Motion, since: Array, encoder: Array | None, left: float = 1.0) -> dict[str, Array]:
    """Angle, rate and acceleration of the table `since` s after a segment's first sample.

    left: factor by which averaging over a bin reduces the rate and angle of a rocking table (see `fading`). The rate is then the mean over
    the bin; angle and acceleration apply to its middle. With an encoder, the planned form (a constant rate or a sine) is fitted to the
    measured angle, so that phases follow the actual motion.
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
    """Duration of a turn or of one rocking period, s; infinite at rest."""
    if isinstance(motion, Spin):
        return 2 * np.pi / abs(motion.rate) if motion.rate else np.inf
    return 1 / motion.frequency if isinstance(motion, Rock) else np.inf


def fading(motion: Motion, size: int, rate: float) -> float:
    """Factor by which averaging over a bin of `size` samples reduces the rate of a rocking table: Dirichlet's kernel sin(k·x)/(k·sin x)
    with k = `size` and x half of the phase [rad] from one sample to the next. rate: samples per second."""
    if size == 1 or not isinstance(motion, Rock):
        return 1.0
    half = np.pi * motion.frequency / rate
    return float(np.sin(size * half) / (size * np.sin(half)))


def turned_by(motion: Motion, since: Array) -> Array:
    """The planned angle of a turning table, rad; zero for a table at rest or rocking."""
    return motion.rate * since if isinstance(motion, Spin) else np.zeros(len(since))
