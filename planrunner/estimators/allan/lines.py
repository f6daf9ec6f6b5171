"""Finds periodic disturbances in a record at rest, and subtracts them from its phase.

A periodic disturbance is a line in the spectrum. Its Allan variance is A²·sin⁴(πfτ)/(πfτ)² (IEEE Std 952, annex C), which no
mixture of the four kinds of noise describes. A line with a constant frequency, amplitude and phase is determined far more
accurately than the noise. The subtraction of a line hardly changes the noise, because a line uses only three of the n degrees of
freedom of n samples.

A value of the periodogram counts as a line if the probability that noise alone exceeds this value is at most `CHANCE`. The level of
the noise is the median of the neighbouring values (exponential distribution: median = mean·ln 2). A vibration whose frequency or
amplitude changes is not a line: after the largest lines are subtracted, other large values remain. Nothing is subtracted from such
a record.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.allan.phase import Phase

CHANCE = 1e-6
"""Probability that white noise alone has a line anywhere in the periodogram of a run."""
_MOST = 8  # most lines of a run
_SHORTEST = 1024  # fewest samples of a run that is searched
_FIRST = (
    128  # lowest frequency that is searched, in periods per run: below, the level of coloured noise is not known well
)
_OCTAVE = 4  # bands per octave for the level of the noise
_ROUNDS = 20  # most steps that improve a frequency


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A line of one run. `frequency` [Hz], `amplitude` in the unit of the output."""

    frequency: float
    amplitude: float


def without_lines(phase: Phase) -> tuple[Phase, tuple[SpectralLine, ...]]:
    """Returns the phase after its lines have been subtracted, and the lines, largest first. If there are no lines, or if the
    disturbance is not periodic, returns the phase unchanged, and an empty tuple."""
    runs: list[Array] = []
    found: list[SpectralLine] = []
    for run in phase.runs:
        values = np.diff(run)
        lines = _lines(values) if len(values) >= _SHORTEST else []
        if lines is None:
            return phase, ()
        if not lines:
            runs.append(run)
            continue
        waves = np.zeros(len(values))
        for turn, cosine, sine in lines:
            waves += _waves(turn, len(values)) @ [cosine, sine]
            found.append(SpectralLine(turn / (2 * math.pi * phase.interval), math.hypot(cosine, sine)))
        runs.append(run - np.concatenate(([0.0], np.cumsum(waves))))
    if not found:
        return phase, ()
    return replace(phase, runs=tuple(runs)), tuple(sorted(found, key=lambda line: -line.amplitude))


def _lines(values: Array) -> list[tuple[float, float, float]] | None:
    """Returns the lines in the equally spaced samples `values` (n,): for each line, the angle per sample [rad], and the amplitudes
    of cosine and sine. Returns None if there are more lines than a periodic disturbance has."""
    rest = values - values.mean()
    lines: list[tuple[float, float, float]] = []
    while (turn := _peak(rest)) is not None:
        if len(lines) == _MOST:
            return None
        line = _fitted(rest, turn)
        rest = rest - _waves(line[0], len(rest)) @ line[1:]
        lines.append(line)
    return lines


def _peak(values: Array) -> float | None:
    """Returns the angle per sample [rad] of the largest value of the periodogram that is a line; None if there is none."""
    from scipy.fft import next_fast_len, rfft

    length = next_fast_len(len(values), real=True)
    power = np.abs(rfft(values, length)) ** 2
    edges = np.unique(
        np.round(np.append(2 ** np.arange(np.log2(_FIRST), np.log2(len(power)), 1 / _OCTAVE), len(power)))
    )
    bands = [power[int(low) : int(high)] for low, high in itertools.pairwise(edges)]
    levels = np.array([float(np.median(band)) for band in bands]) / math.log(2)
    if not (levels > 0).all():
        return None
    centres = np.log((edges[:-1] + edges[1:]) / 2)
    places = np.arange(_FIRST, len(power))
    level = np.exp(np.interp(np.log(places), centres, np.log(levels)))
    ratio = power[_FIRST:] / level
    top = int(np.argmax(ratio))
    return float(2 * math.pi * places[top] / length) if ratio[top] > math.log(len(places) / CHANCE) else None


def _fitted(values: Array, turn: float) -> tuple[float, float, float]:
    """Fits a cosine and a sine to the samples `values` (n,). Returns the angle per sample [rad] and the two amplitudes with the
    least sum of squared residuals. `turn`: first guess of the angle per sample [rad], with an error of at most the distance between
    two frequencies of the periodogram. Gauss-Newton steps improve the angle."""
    n = len(values)
    middle = np.arange(n) - (n - 1) / 2
    size = 0.25 * 2 * math.pi / n  # largest step
    for _ in range(_ROUNDS):
        waves = _waves(turn, n)
        cosine, sine = np.linalg.lstsq(waves, values, rcond=None)[0]
        slope = middle * (sine * waves[:, 0] - cosine * waves[:, 1])
        matrix = np.column_stack([waves, slope])
        step = float(np.linalg.lstsq(matrix, values, rcond=None)[0][2])
        turn += min(max(step, -size), size)
        if abs(step) < 1e-6 * size:
            break
    cosine, sine = np.linalg.lstsq(_waves(turn, n), values, rcond=None)[0]
    return turn, float(cosine), float(sine)


def _waves(turn: float, n: int) -> Array:
    """Returns a cosine and a sine, shape (n, 2), whose angle advances by `turn` [rad] per sample. The angle is zero in the middle
    of the samples, so that the errors of a fitted frequency and of a fitted phase are uncorrelated."""
    angle = turn * (np.arange(n) - (n - 1) / 2)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def largest(lines: Sequence[SpectralLine], count: int) -> tuple[SpectralLine, ...]:
    """Returns the first `count` lines with different frequencies. `lines`: lines of all runs, the largest first. Lines whose
    frequencies differ by less than 1 %, such as the same disturbance in several runs, count as one line."""
    found: list[SpectralLine] = []
    for line in lines:
        if not any(abs(line.frequency / one.frequency - 1) < 0.01 for one in found):
            found.append(line)
    return tuple(found[:count])
