"""The course of a motion: the periodic signal in the samples of a segment that arises because the table turns or rocks and the
sensor measures the Earth's rate, gravity and its own motion. The scatter of the samples is computed from their differences from
this course.



The course repeats with the period of the motion. An output that is linear in the sensed quantity contains the fundamental; a
second-order effect adds twice its frequency. The amplitude and phase of the fundamental may change linearly over the segment,
because a table whose rate is wrong by some ppm drifts away from the planned phase. A rocking table causes more harmonics, because
the sensed quantity follows sines of an angle that is itself a sine.
"""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.sampled_motion import period_of
from planrunner.plan.schedule import Motion, Rock, Spin

_TURNING = 2  # harmonics
_ROCKING = 5  # harmonics: at an amplitude of 60 deg the next Bessel function, J6(1.05), is 3e-5
_VANISHING = 1e-6  # root mean square of a column that is zero but for rounding
_FADED = 0.1  # of a wave: averaging that leaves less is not undone, because noise would grow with it
_RANK = 1e-10  # of the largest eigenvalue
_PER_COLUMN = 4  # times as many means as columns that a fit needs


@dataclass(frozen=True, slots=True)
class MotionCourse:
    """The course of a motion, that is, the periodic signal that the motion causes in the samples.

    columns: (c, p), values of the p functions that make up the course, each as a mean over c short intervals. Weighted by the
    number of samples in each interval, the columns are orthonormal and have zero mean. samples: (c,), number of samples in each
    interval; zero while the table is not in its steady motion. products: (p, p), inner products of the p functions over single
    samples; unlike the means, single samples do not attenuate the functions."""

    columns: Array
    samples: Array
    products: Array


def follows_course(motion: Motion) -> bool:
    """Whether a motion causes a periodic course, that is, a periodic signal in the samples."""
    return isinstance(motion, Rock) or (isinstance(motion, Spin) and motion.rate != 0)


def course_of(motion: Motion, time: Array, samples: Array, interval: float) -> MotionCourse | None:
    """The course of a periodic motion in short means of consecutive samples; None if there are too few short means.

    time: (c,), s, middle of the interval of each short mean, counted from the segment's first sample. samples: (c,), number of
    samples in each mean. interval: time between samples, s.
    """
    if isinstance(motion, Rock):
        since = time - motion.steady
        samples = np.where((since >= 0) & (since <= motion.duration), samples, 0.0)
    harmonics = _ROCKING if isinstance(motion, Rock) else _TURNING
    if np.count_nonzero(samples) < _PER_COLUMN * 2 * (harmonics + 1):
        return None
    pulse = 2 * np.pi / period_of(motion)
    total = samples.sum()
    middle = float(samples @ time / total)
    along = (time - middle) / max(float(np.abs(time - middle).max()), interval)
    found, faded = [], []
    for harmonic in range(1, harmonics + 1):
        # The mean of n samples of a sine is the sine at their middle times Dirichlet's kernel sin(nx)/(n·sin x).
        half = harmonic * pulse * interval / 2
        waves, left = np.exp(1j * harmonic * pulse * time), np.sinc(samples * half / np.pi) / np.sinc(half / np.pi)
        for wave in (waves, waves * along) if harmonic == 1 else (waves,):
            found += [wave.real, wave.imag]
            faded += [left, left]
    fading = np.column_stack(faded)
    columns = np.column_stack(found) * fading
    columns -= samples @ columns / total
    size = np.sqrt(samples @ columns**2 / total)
    seen = size > _VANISHING
    columns, fading = columns[:, seen] / size[seen], np.maximum(np.abs(fading[:, seen]), _FADED)
    values, vectors = np.linalg.eigh(columns.T @ (samples[:, None] * columns))
    kept = values > _RANK * values.max(initial=0.0)
    mixed = vectors[:, kept] / np.sqrt(values[kept])
    unfaded = columns / fading @ mixed
    return MotionCourse(columns @ mixed, samples, unfaded.T @ (samples[:, None] * unfaded))
