"""Computes the evidence for the effects that act only on the noise. White noise and resolution are compared with their
declarations.

A declaration can be wrong. With probability 0.8, the declaration is assumed to be correct within a few per cent. Otherwise, the
declaration is wrong by up to a factor of two. This factor is either the same in all channels or different in each triad. Only
larger deviations, or deviations of the gyros alone, are evidence of excess noise.

In array shapes, K is the number of channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Literal, get_args

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import STRONGEST, WEAKEST, log_mean_exp
from planrunner.gap.evidence.rounding import is_coarse
from planrunner.observation.lattice import COARSER, coarsening, holds, seen_levels, undeclared_step

HOLDS = 0.02  # standard deviation of the logarithm of (true ÷ declared noise) if the declaration is correct
WRONG = 0.2  # probability that a declaration is wrong by up to a factor of two
EXCESS = HOLDS * np.sqrt(np.geomspace(WEAKEST, STRONGEST, 60))
"""Possible excesses of the white noise: the logarithms of the ratio of the true to the declared noise. The energy of an excess is
(logarithm ÷ `HOLDS`)². This energy is log-uniform, like the energy of every effect."""
_TRIADS = ("gyro", "accel")
CERTAIN = 60.0  # log odds that the recording shows the true size of a count


def counts(observed: Observed) -> Array:
    """Returns the size of one count of each channel, shape (K,). The declared count is returned unless the recording shows a
    coarser count. If the values are not multiples of the declared count, the count found in the recording is returned, or 0 if
    there is none."""
    found = []
    for index, channel in enumerate(observed.channels):
        step = channel.resolution
        if step > 0:
            whole = observed.bins
            levels = seen_levels(observed.values[:, index], step) if whole is None else whole.levels[index]
            step = step * coarsening(levels) if holds(levels) else 0.0
        if step == 0 and observed.bins is None:
            step = undeclared_step(observed.values[:, index])
        found.append(step)
    return np.array(found)


Level = Literal["declared", "white", "resolution"]
"""Possible states of the noise of a triad. `declared`: as declared. `white`: more white noise than declared. `resolution`: as
declared, but with a coarser count."""


def log_densities(observed: Observed, white: Array, degrees: Array, steps: Array) -> dict[tuple[Level, Level], float]:
    """Computes the log density of the measured white levels for every combination of two noise states: one of the gyros and one of
    the accelerometers. `white`: array of shape (K,) in SI units, measured standard deviation of a single sample due to white noise.
    `degrees`: array of shape (K,), degrees of freedom of these levels. `steps`: array of shape (K,) in SI units, size of one count
    (`counts`).

    A triad whose noise is too small to dither the counts has no white level to compare. The level of this triad is then assumed to
    deviate from its declaration as much as the level of the other triad. If neither triad can be compared, both levels are assumed
    to agree with their declarations.
    """
    declared = [channel.resolution or step for channel, step in zip(observed.channels, steps, strict=True)]
    (plain, sigma), (counted, _) = (_excess(observed, white, degrees, each) for each in (declared, steps))
    plainly = {kind: _rounded(observed, kind, white, declared) for kind in _TRIADS}
    known = {kind: any(observed.channels[c].resolution > 0 for c in observed.of_kind(kind)) for kind in _TRIADS}
    seen = {
        kind: any(0 < COARSER * observed.channels[c].resolution < steps[c] for c in observed.of_kind(kind))
        for kind in _TRIADS
    }
    found: dict[tuple[Level, Level], float] = {}
    for levels in product(get_args(Level), repeat=2):
        excess, value = {}, 0.0
        rounded = {
            kind: _rounded(observed, kind, white, steps) if level == "resolution" else plainly[kind]
            for kind, level in zip(_TRIADS, levels, strict=True)
        }
        for kind, level in zip(_TRIADS, levels, strict=True):
            coarse, other = level == "resolution", _other(kind)
            own = counted if coarse else plain
            if rounded[kind]:
                excess[kind] = 0.0 if rounded[other] else own.get(other, 0.0)
            elif kind in own:
                excess[kind] = own[kind]
            if (coarse and not known[kind]) or (level == "white" and kind not in own):
                value = -np.inf
            value -= CERTAIN * (known[kind] and seen[kind] != coarse)
        if np.isfinite(value):
            value += _density(excess, sigma, [k for k, level in zip(_TRIADS, levels, strict=True) if level == "white"])
        found[levels] = value
    return found


def _other(kind: str) -> str:
    return "accel" if kind == "gyro" else "gyro"


def _rounded(observed: Observed, kind: str, white: Array, counts_: Sequence[float] | Array) -> bool:
    """Returns True if, in any channel of the triad, both the declared and the measured noise are too small to dither the counts.
    `white`: array of shape (K,), measured standard deviation of a single sample due to white noise, SI. `counts_`: size of a count
    in each channel, SI."""
    for index in observed.of_kind(kind):
        declared = observed.channels[index].sample_variance(observed.sample_rate, float(counts_[index]))
        if is_coarse(max(float(white[index]), np.sqrt(declared)), counts_[index]):
            return True
    return False


def _excess(
    observed: Observed, white: Array, degrees: Array, steps: Sequence[float] | Array
) -> tuple[dict[str, float], float]:
    """Returns the logarithm of (measured ÷ declared) white level for each triad, and the standard deviation of this logarithm.
    `white`, `degrees`: the same as in `log_densities`. `steps`: size of a count in each channel, SI; the declared level includes
    its rounding error."""
    found, sigma = {}, 0.01
    for kind in ("gyro", "accel"):
        ratios = []
        for index in observed.of_kind(kind):
            channel = observed.channels[index]
            if channel.white > 0:
                declared = channel.sample_variance(observed.sample_rate, float(steps[index]))
                ratios.append(np.log(white[index] ** 2 / declared) / 2)
                sigma = float(np.sqrt(1 / (2 * degrees[index] * len(observed.of_kind(kind))) + 1e-6))
        if ratios:
            found[kind] = float(np.mean(ratios))
    return found, sigma


def excess_by_channel(observed: Observed, white: Array, degrees: Array) -> Array:
    """Returns, for each channel, the log Bayes factor of the hypothesis that the white noise is larger than declared, shape (K,).
    The alternative is that the declaration is correct or has a usual error. `white`, `degrees`: the same as in `log_densities`."""
    found = np.full(len(observed.channels), -np.inf)
    for index, channel in enumerate(observed.channels):
        if channel.white > 0:
            level = white[index] ** 2 / channel.sample_variance(observed.sample_rate)
            sigma = float(np.sqrt(1 / (2 * degrees[index]) + 1e-6))
            excess = {"gyro": float(np.log(level)) / 2}
            found[index] = _density(excess, sigma, ["gyro"]) - _density(excess, sigma, [])
    return found


def _normal(x: Array | float, sigma: float) -> Array:
    return np.asarray(np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)))


def _within_two(x: Array | float) -> Array:
    """Returns the value at x of a probability density, element by element. The density is uniform between −ln 2 and ln 2, which is
    a factor of two in either direction. The edges of the density are smoothed over 10 %. Outside the edges, the density has a small
    constant value."""
    edge = 0.1
    top = 1 / (1 + np.exp(np.minimum((np.abs(x) - np.log(2.0)) / (edge / 4), 500.0)))
    return np.asarray(top / (2 * np.log(2.0)) + 1e-9)


def _declared(excess: Mapping[str, Array | float], sigma: float) -> Array:
    """Returns the log density of the excesses of the triads if no effect acts and only the declaration can be wrong. The arrays in
    `excess` are evaluated element by element. `sigma`: standard deviation of an excess due to its measurement."""
    width = float(np.hypot(HOLDS, sigma))
    holds, each = np.ones(()), np.ones(())
    for x in excess.values():
        holds, each = holds * _normal(x, width), each * _within_two(x)
    alike = each
    if len(excess) == 2:
        alike = _within_two(excess["gyro"]) * _normal(excess["accel"] - excess["gyro"], width)
    return np.asarray(np.log((1 - WRONG) * holds + WRONG * (alike + each) / 2 + 1e-300))


def _density(excess: Mapping[str, float], sigma: float, larger: Sequence[str]) -> float:
    """Returns the log density of the excesses of the triads if effects raise the noise of the triads in `larger`. The declaration
    of a triad may also be wrong. The effect of each triad in `larger` has its own factor. `sigma`: the same as in `_declared`."""
    shapes = [EXCESS[:, None], EXCESS[None, :]]
    lowered: dict[str, Array | float] = dict(excess)
    for kind, more in zip(larger, shapes, strict=False):
        lowered[kind] = excess[kind] - more
    return float(log_mean_exp(np.ravel(_declared(lowered, sigma)), 0))
