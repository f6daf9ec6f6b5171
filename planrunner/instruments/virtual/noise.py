"""Simulates the noise of an output, drawn in blocks. Memory and state do not grow with the length of the run.

White noise comes directly from the random generator. Bias instability (flicker) is a sum of Ornstein-Uhlenbeck processes whose
correlation times are one octave apart. If each process has the variance v, their two-sided power density is Σ 2vτ/(1 + (2πfτ)²) ≈
v/(2·ln2·f). With v = B²·ln2/π, this is the density B²/(2πf) of IEEE Std 952, and the Allan deviation is flat at B·√(2·ln2/π) =
0.664·B. A process is exact at the nodes of a grid of `hold` samples, and constant between the nodes. The shortest correlation time
is twice the interval of the grid; at such short times, white noise dominates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

OCTAVES = 15
PIECE = 10_000  # samples, 80 kB
SHORTEST = 2.0  # s; with fifteen octaves the longest correlation time is nine hours
_EXPONENT = 500.0  # keeps e^(n·step/τ) far from overflow
TIMES = SHORTEST * 2.0 ** np.arange(OCTAVES)


def generator(seed: int, *occasion: int) -> np.random.Generator:
    """Returns the random generator for one occasion. The arguments identify the occasion, for example by the index of a segment.
    For the same arguments, the generator always gives the same random numbers."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=occasion)))


@lru_cache(maxsize=8)
def _growth(step: float, length: int) -> Array:
    """Returns the values e^(n·step/τ) for every process and for n = 0 … length, shape (OCTAVES, length + 1). The exponent is
    limited, because after a long step, the process has decayed completely."""
    return np.exp(np.minimum(np.arange(length + 1) * (step / TIMES)[:, None], _EXPONENT))


class Flicker:
    """Bias instability of one output. `coefficient`: coefficient B, in the output's unit."""

    def __init__(self, coefficient: float):
        self.coefficient = coefficient
        self.deviation = coefficient * math.sqrt(math.log(2) / math.pi)
        self.state: Array | None = None
        self.time = 0.0

    def begin(self, time: float, draw: np.random.Generator) -> None:
        """Advances the processes to `time` [s], at which a segment starts. The advance is exact for any time since the last
        call."""
        fresh = draw.standard_normal(OCTAVES) * self.deviation
        if self.state is None:
            self.state = fresh
        else:
            decay = np.exp(-max(0.0, time - self.time) / TIMES)
            self.state = decay * self.state + np.sqrt(1 - decay**2) * fresh
        self.time = time

    def advance(self, nodes: int, step: float, draw: np.random.Generator) -> Array:
        """Returns the sum of the processes [unit] at the next `nodes` moments, which are `step` seconds apart. The first of these
        moments is the present one."""
        if self.coefficient == 0.0:
            return np.zeros(nodes)
        assert self.state is not None
        total = np.empty(nodes)
        longest = max(1, int(_EXPONENT * SHORTEST / step))
        for first in range(0, nodes, longest):
            length = min(longest, nodes - first)
            growth = _growth(step, length)
            # x_n = e^(-n·step/τ)·(x_0 + Σ_j drive_j·e^(j·step/τ)): one running sum instead of a recursion.
            drive = draw.standard_normal((OCTAVES, length))
            drive *= growth[:, 1:]
            drive *= (np.sqrt(-np.expm1(-2 * step / TIMES)) * self.deviation)[:, None]
            np.cumsum(drive, axis=1, out=drive)
            drive += self.state[:, None]
            drive /= growth[:, 1:]
            total[first] = self.state.sum()
            np.sum(drive[:, :-1], axis=0, out=total[first + 1 : first + length])
            self.state = drive[:, -1].copy()
        self.time += nodes * step
        return total

    def checkpoint(self) -> dict[str, float | list[float] | None]:
        return {"time": self.time, "state": None if self.state is None else self.state.tolist()}

    def restore(self, time: float, state: Sequence[float] | None) -> None:
        self.time = time
        self.state = None if state is None else np.array(state, dtype=float)


class RandomWalk:
    """Simulates a bias that is a random walk: after T s, its standard deviation is `coefficient`·√T [unit]. `coefficient`:
    coefficient K of the random walk, in unit/√s."""

    def __init__(self, coefficient: float):
        self.coefficient = coefficient
        self.value = 0.0
        self.time = 0.0

    def begin(self, time: float, draw: np.random.Generator) -> None:
        """Advances the walk to the time at which a segment starts, `time` [s]."""
        self.value += self.coefficient * math.sqrt(max(0.0, time - self.time)) * draw.standard_normal()
        self.time = time

    def advance(self, nodes: int, step: float, draw: np.random.Generator) -> Array:
        """Returns the value of the random walk [unit] at the next `nodes` moments, which are `step` seconds apart. The first of
        these moments is the present one."""
        if self.coefficient == 0.0:
            return np.zeros(nodes)
        walked = self.value + np.cumsum(self.coefficient * math.sqrt(step) * draw.standard_normal(nodes))
        values = np.concatenate(([self.value], walked[:-1]))
        self.value = float(walked[-1])
        self.time += nodes * step
        return values

    def checkpoint(self) -> dict[str, float]:
        return {"time": self.time, "value": self.value}

    def restore(self, time: float, value: float) -> None:
        self.time, self.value = time, value


class GaussMarkov:
    """A bias with the covariance σ²·exp(−|t − t'|/τ) [unit²]. `sigma`: standard deviation σ of the bias, in the output's unit.
    `tau`: correlation time τ of the bias, s."""

    def __init__(self, sigma: float, tau: float):
        self.sigma, self.tau = sigma, tau
        self.value: float | None = None
        self.time = 0.0

    def begin(self, time: float, draw: np.random.Generator) -> None:
        """Advances the bias to `time` [s], at which a segment starts. The advance is exact for any time since the last call."""
        fresh = self.sigma * draw.standard_normal()
        if self.value is None:
            self.value = fresh
        else:
            kept = math.exp(-max(0.0, time - self.time) / self.tau)
            self.value = kept * self.value + math.sqrt(1 - kept**2) * fresh
        self.time = time

    def advance(self, nodes: int, step: float, draw: np.random.Generator) -> Array:
        """Returns the bias [unit] at the next `nodes` moments, which are `step` seconds apart. The first of these moments is the
        present one."""
        from scipy.signal import lfilter

        assert self.value is not None
        kept = math.exp(-step / self.tau)
        drive = math.sqrt(1 - kept**2) * self.sigma * draw.standard_normal(nodes)
        following, _ = lfilter([1.0], [1.0, -kept], drive, zi=[kept * self.value])
        values = np.concatenate(([self.value], following[:-1]))
        self.value = float(following[-1])
        self.time += nodes * step
        return values

    def checkpoint(self) -> dict[str, float | None]:
        return {"time": self.time, "value": self.value}

    def restore(self, time: float, value: float | None) -> None:
        self.time, self.value = time, value


class PulseCounter:
    """Simulates an integrating output that counts pulses. The remainder of a sample that does not fill a pulse is carried to the
    next sample. `step`: smallest step of one sample, in the output's unit."""

    def __init__(self, step: float):
        self.step = step
        self.left = 0.0

    def count(self, samples: Array) -> None:
        """Replaces the samples by whole multiples of the step, in place."""
        samples /= self.step
        samples[0] += self.left
        np.cumsum(samples, out=samples)
        last = float(samples[-1])
        np.rint(samples, out=samples)
        self.left = last - float(samples[-1])
        samples[1:] -= samples[:-1].copy()
        samples *= self.step


@dataclass(frozen=True, slots=True)
class Readout:
    """Converts the values of one output to readings, as the electronics of the sensor do. White noise of the standard deviation
    `sigma` is added to each sample. The sample is then rounded to counts of the size `resolution` (0 for no rounding) and limited
    to ±`full_scale`."""

    sigma: float
    resolution: float = 0.0
    full_scale: float = math.inf

    def samples(self, draw: np.random.Generator, level: Array, length: int, hold: int) -> Array:
        """Draws readings (length,) around `level`, which has one value for each sample, or one value for every `hold` samples.

        The readings are computed in pieces that fit the processor's cache, because a pass through memory takes as long as drawing
        the noise.
        """
        out = np.empty(length)
        held = level.size != length
        piece = max(hold, PIECE // hold * hold)
        # Beyond ten standard deviations no number is drawn (probability 1e-23).
        clips = math.isfinite(self.full_scale) and self._largest(level) > self.full_scale
        for first in range(0, length, piece):
            last = min(first + piece, length)
            part = out[first:last]
            felt = level[first // hold : -(-last // hold)] if held else level[first:last]
            self._fill(draw, part, felt, hold if held else 1)
            if clips:
                np.clip(part, -self.full_scale, self.full_scale, out=part)
        return out

    def _fill(self, draw: np.random.Generator, part: Array, level: Array, hold: int) -> None:
        """Fills the array `part` with readings. All steps except the last one use units of counts, so that no separate pass is
        needed to convert to counts. `level`, `hold`: the same as in `samples`."""
        counts = 1.0 / self.resolution if self.resolution > 0 else 1.0
        if self.sigma > 0:
            draw.standard_normal(out=part)
            part *= self.sigma * counts
        else:
            part.fill(0.0)
        if self.resolution > 0:
            level = level * counts
        whole = part.size // hold
        part[: whole * hold].reshape(whole, hold)[...] += level[:whole, None]
        part[whole * hold :] += level[-1]
        if self.resolution > 0:
            np.rint(part, out=part)
            part *= self.resolution

    def _largest(self, level: Array) -> float:
        return float(np.max(np.abs(level))) + 10 * self.sigma + self.resolution
