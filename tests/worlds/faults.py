"""Worlds: what is wrong beside white noise, at its stated size, in every recording of a campaign.

A fault acts on the outputs of the whole test, sample by sample and in order of time. Sizes are in units of each channel's noise, so that
one world serves every sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
ARCSEC = np.radians(1) / 3600
DAY = 86400.0  # s: a constant is the average over so long
_MINUTE = 60.0  # s

Fault = Callable[["Recorded", np.random.Generator], Array]


@dataclass(frozen=True)
class Recorded:
    """values: (n, k) with white noise; time: (n,), s; step: (n,), numbers; white: (k,), of one sample; mean: (k,), standard deviation that
    white noise alone leaves in the mean of a step of usual length; sampling: Hz. celsius: (n,), of the sensor, in worlds that have a
    thermometer. signed: channels whose sign shows, None for all of them."""

    time: Array
    step: NDArray[np.int64]
    values: Array
    white: Array
    mean: Array
    sampling: float
    celsius: Array | None = None
    signed: Sequence[int] | None = None


@dataclass(frozen=True)
class World:
    """stated: what the bench file says of it, by the name of the blank in a campaign's bench; `flicker` is in units of `Recorded.mean`.
    celsius: temperature of the sensor at a share of the test, which a thermometer records. warns: the model is wrong in a way that cannot
    be mended, so that a warning is what is asked for, not coverage. cause: words of a warning that names what is wrong. silent: the bench
    file gives no flicker at all, not even that there is none. anew: every step has its own errors of position and rate; otherwise a
    position or a rate has the same error each time, as planrunner's documents say of what a bench file declares."""

    fault: Fault | None = None
    tilt: float = 0.0  # rad, standard uncertainty of an orientation about each axis
    rate: float = 0.0  # relative standard uncertainty of a rate
    flicker: float = 0.0  # bias instability, in units of `Recorded.mean`
    count: float = 0.0  # resolution, in units of `Recorded.white`
    celsius: Callable[[Array], Array] | None = None
    warns: bool = False
    cause: str = ""
    silent: bool = False
    anew: bool = False


def flicker(made: Recorded, draw: np.random.Generator, size: float) -> Array:
    """1/f noise with the two-sided density B²/(2πf), B = size · mean, as a sum of first-order processes whose time constants are spaced
    by a factor of two: each has the variance B²·ln 2/π, and their densities add to 1/f between the longest and the shortest. The average
    over the `DAY` around the test is taken from it: it belongs to the constant that is sought."""
    constants = 2.0 ** np.arange(-2, 20)  # s
    out = np.zeros_like(made.values)
    begin, length = float(made.time[0]), float(made.time[-1] - made.time[0])
    around = round(max(0.0, DAY - length) / 2 / _MINUTE)  # steps before the test and after it
    edges = np.flatnonzero(np.diff(made.step)) + 1
    pieces = np.split(np.arange(len(made.time)), edges)
    for constant in constants:
        before, state = _process(constant, _MINUTE, around, draw.standard_normal((out.shape[1],)), draw)
        total, last = _MINUTE * before, begin - 1 / made.sampling
        keep = np.exp(-1 / (constant * made.sampling))
        for rows in pieces:
            between = max(0.0, float(made.time[rows[0]]) - last - 1 / made.sampling)  # nothing is recorded
            left, was = np.exp(-between / constant), state
            state = left * state + np.sqrt(1 - left**2) * draw.standard_normal(len(state))
            total = total + between * (state + was) / 2
            new = np.sqrt(1 - keep**2) * draw.standard_normal((len(rows), len(state)))
            part, _ = lfilter([1.0], [1.0, -keep], new, axis=0, zi=(keep * state)[None])
            out[rows] += part
            total = total + part.sum(axis=0) / made.sampling
            state, last = part[-1], float(made.time[rows[-1]])
        after, _ = _process(constant, _MINUTE, around, state, draw)
        out -= (total + _MINUTE * after) / max(DAY, length)
    return np.asarray(size * made.mean * np.sqrt(np.log(2) / np.pi) * out)


def _process(constant: float, step: float, count: int, state: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Sum over `count` steps of a first-order process of unit variance, (k,), and its last state, from the one before."""
    keep = np.exp(-step / constant)
    new = np.sqrt(1 - keep**2) * draw.standard_normal((count, len(state)))
    if not count:
        return np.zeros(len(state)), state
    part, _ = lfilter([1.0], [1.0, -keep], new, axis=0, zi=(keep * state)[None])
    return np.asarray(part.sum(axis=0)), np.asarray(part[-1])


def _flicker(size: float) -> Fault:
    return lambda made, draw: made.values + flicker(made, draw, size)


def _ramp(made: Recorded, draw: np.random.Generator) -> Array:
    """A bias that drifts evenly, by ten times the noise of a mean from the first sample to the last, either way. The true bias is the mean
    over all samples, here as below."""
    return _drifting(made, draw, (made.time - made.time[0]) / (made.time[-1] - made.time[0]))


def _warming(made: Recorded, draw: np.random.Generator) -> Array:
    """A bias that follows a unit that warms up, by ten times the noise of a mean, with a third of the test as time constant."""
    return _drifting(made, draw, 1 - np.exp(-3 * (made.time - made.time[0]) / (made.time[-1] - made.time[0])))


def _warming_less(made: Recorded, draw: np.random.Generator) -> Array:
    """The same, by five times the noise of a mean."""
    return np.asarray((made.values + _warming(made, draw)) / 2)


def _laboratory(share: Array) -> Array:
    """A unit that warms up by 5 K in a room that heats and cools by 3 K, twice and a third during the test."""
    return np.asarray(20 + 5 * (1 - np.exp(-3 * share)) + 3 * np.sin(2 * np.pi * 2.33 * share))


def _following(made: Recorded, draw: np.random.Generator) -> Array:
    """A bias that follows the temperature, by about ten times the noise of a mean over the test."""
    assert made.celsius is not None
    return _drifting(made, draw, (made.celsius - made.celsius[0]) / 8)


def _drifting(made: Recorded, draw: np.random.Generator, course: Array) -> Array:
    sizes = 10 * made.mean * draw.choice([-1.0, 1.0], len(made.mean))
    return np.asarray(made.values + sizes * (course - course.mean())[:, None])


def _counts(size: float) -> Fault:
    def fault(made: Recorded, draw: np.random.Generator) -> Array:
        step = size * made.white
        return np.asarray(step * np.round(made.values / step))

    return fault


def _fed_back(made: Recorded, draw: np.random.Generator) -> Array:
    """Increments that a counter rounds: what is left of one is carried into the next, so that errors of neighbours have opposite signs."""
    step = 4 * made.white
    total = np.cumsum(made.values, axis=0)
    return np.asarray(step * np.diff(np.round(total / step), axis=0, prepend=0.0))


def _spike(made: Recorded, draw: np.random.Generator) -> Array:
    """One sample of one channel, a thousand times the noise."""
    out = made.values.copy()
    row, channel = draw.integers(len(out)), draw.integers(out.shape[1])
    out[row, channel] += 1000 * made.white[channel] * draw.choice([-1, 1])
    return out


def _stuck(made: Recorded, draw: np.random.Generator) -> Array:
    """All channels keep one value for a second, and then come back: what was read when they stopped, and a large step from the mean."""
    out = made.values.copy()
    rows = round(made.sampling)
    first = int(draw.integers(len(out) - rows))
    rows = min(rows, int(np.searchsorted(made.step, made.step[first] + 1)) - first)
    out[first : first + rows] = out[first] + 30 * made.white
    return out


def _burst(made: Recorded, draw: np.random.Generator) -> Array:
    """Twenty samples of one channel scatter fifty times as widely as the others."""
    out = made.values.copy()
    row, channel = draw.integers(len(out) - 20), draw.integers(out.shape[1])
    out[row : row + 20, channel] += 50 * made.white[channel] * draw.standard_normal(20)
    return out


def _limited(made: Recorded, draw: np.random.Generator) -> Array:
    """For two seconds one channel reads a large value at which its electronics saturate."""
    out = made.values.copy()
    rows, channel = round(2 * made.sampling), draw.integers(out.shape[1])
    first = int(draw.integers(len(out) - rows))
    rows = min(rows, int(np.searchsorted(made.step, made.step[first] + 1)) - first)
    out[first : first + rows, channel] = out[:, channel].max() + 100 * made.white[channel]
    return out


def _line(made: Recorded, draw: np.random.Generator) -> Array:
    """Vibration at 20 Hz, three times the noise of a sample."""
    phase = draw.uniform(0, 2 * np.pi, len(made.white))
    return np.asarray(made.values + 3 * made.white * np.sin(2 * np.pi * 20 * made.time[:, None] + phase))


def _reversed(made: Recorded, draw: np.random.Generator) -> Array:
    """One channel with the wrong sign, of those whose sign shows."""
    out = made.values.copy()
    signed = range(out.shape[1]) if made.signed is None else made.signed
    out[:, signed[int(draw.integers(len(signed)))]] *= -1
    return out


WORLDS: Mapping[str, World] = {
    "white noise": World(),
    "white noise, flicker not declared": World(silent=True),
    "flicker, declared": World(_flicker(1.0), flicker=1.0),
    "flicker, not declared": World(_flicker(1.0), warns=True, cause="bias_instability", silent=True),
    "linear drift": World(_ramp, cause="drift"),
    "warming up": World(_warming, cause="drift"),
    "warming up, half as much": World(_warming_less, cause="drift"),
    "temperature drift, recorded": World(_following, celsius=_laboratory, cause="temperature"),
    "positions 5 arcsec, stated": World(tilt=5 * ARCSEC),
    "rates 10 ppm, stated": World(rate=10e-6),
    "positions and rates anew at each step": World(tilt=5 * ARCSEC, rate=10e-6, anew=True),
    "counts of 5 times the noise": World(_counts(5.0), count=5.0, cause="too small for counts"),
    "rounding carried over": World(_fed_back),
    "one spike": World(_spike, cause="Bad samples"),
    "stuck for a second": World(_stuck, cause="Bad samples"),
    "burst of 20 samples": World(_burst, cause="Bad samples"),
    "saturated for two seconds": World(_limited, cause="Bad samples"),
    "20 Hz line": World(_line),
    "reversed channel": World(_reversed, warns=True, cause="sign"),
}
