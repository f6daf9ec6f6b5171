"""Evidence for the effects that act only on the noise: white noise and resolution, compared with their declarations.

A declaration can be wrong: with probability 0.8 it is correct within a few per cent, and otherwise wrong by up to a factor of two, equally
in all channels or differently in each triad. Only larger deviations, or deviations of the gyros alone, are evidence of excess noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import STRONGEST, WEAKEST, log_mean_exp
from planrunner.observation.lattice import COARSER, coarsening, holds, seen_levels, undeclared_step

Array = NDArray[np.float64]
HOLDS = 0.02  # standard deviation of the logarithm of a correct declaration
WRONG = 0.2  # chance that it is off by up to a factor of two
EXCESS = HOLDS * np.sqrt(np.geomspace(WEAKEST, STRONGEST, 60))
"""ln of (true ÷ declared white noise), its energy (ln ratio ÷ `HOLDS`)² log-uniform like that of every effect."""
CERTAIN = 60.0  # log odds assigned to a lattice of counts that is seen, or not seen


def counts(observed: Observed) -> Array:
    """The count (K,) of each channel, of which all values are multiples: the declared count unless a coarser one is found; for a channel
    whose values do not lie on a declared lattice, the count that is found, or 0."""
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


def log_densities(observed: Observed, white: Array, degrees: Array, steps: Array) -> dict[str, float]:
    """Log densities of the white levels under 'declared', 'white' (excess in the gyros) and 'resolution' (a coarser count explains it).

    If the noise does not dither the count, there is no white level to compare; the level of the gyros then counts as declared.
    """
    declared = [channel.resolution or step for channel, step in zip(observed.channels, steps, strict=True)]
    gyro, counted = (_excess(observed, white, degrees, each) for each in (declared, steps))
    for excess, counts_ in ((gyro, declared), (counted, steps)):
        if any(
            counts_[c] > 2 * observed.channels[c].white * np.sqrt(observed.sample_rate)
            for c in observed.of_kind("gyro")
        ):
            excess[0]["gyro"] = excess[0].get("accel", 0.0)
    seen = any(
        channel.kind == "gyro" and channel.resolution > 0 and step > COARSER * channel.resolution
        for channel, step in zip(observed.channels, steps, strict=True)
    )
    known = any(channel.kind == "gyro" and channel.resolution > 0 for channel in observed.channels)
    lattice = 0.0 if not known else (0.0 if seen else -CERTAIN)
    missed = -CERTAIN if seen else 0.0
    return {
        "declared": float(_declared(*gyro)) + missed,
        "white": (_larger(*gyro) if "gyro" in gyro[0] else -np.inf) + missed,
        "resolution": (float(_declared(*counted)) if known else -np.inf) + lattice,
    }


def _excess(
    observed: Observed, white: Array, degrees: Array, steps: Sequence[float] | Array
) -> tuple[dict[str, float], float]:
    """Log of (measured ÷ declared) white level by triad, and its standard deviation."""
    found, sigma = {}, 0.01
    for kind in ("gyro", "accel"):
        ratios = []
        for index in observed.of_kind(kind):
            channel = observed.channels[index]
            declared = channel.white**2 * observed.sample_rate
            step = float(steps[index])
            if channel.white > 0:
                ratios.append(np.log(white[index] ** 2 / (declared + step**2 / 12)) / 2)
                sigma = float(np.sqrt(1 / (2 * degrees[index] * len(observed.of_kind(kind))) + 1e-6))
        if ratios:
            found[kind] = float(np.mean(ratios))
    return found, sigma


def excess_by_channel(observed: Observed, white: Array, degrees: Array) -> Array:
    """log BF (K,) of more white noise than declared in one channel, against a declaration that is right or wrong."""
    found = np.full(len(observed.channels), -np.inf)
    for index, channel in enumerate(observed.channels):
        if channel.white > 0:
            level = white[index] ** 2 / (channel.white**2 * observed.sample_rate + channel.resolution**2 / 12)
            sigma = float(np.sqrt(1 / (2 * degrees[index]) + 1e-6))
            excess = {"gyro": float(np.log(level)) / 2}
            found[index] = _larger(excess, sigma) - float(_declared(excess, sigma))
    return found


def _normal(x: Array | float, sigma: float) -> Array:
    return np.asarray(np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)))


def _within_two(x: Array | float) -> Array:
    """Uniform in the logarithm up to a factor of two in both directions, with edges of 10 %, and a floor beyond them."""
    edge = 0.1
    top = 1 / (1 + np.exp(np.minimum((np.abs(x) - np.log(2.0)) / (edge / 4), 500.0)))
    return np.asarray(top / (2 * np.log(2.0)) + 1e-9)


def _declared(excess: Mapping[str, Array | float], sigma: float) -> Array:
    """Log density of an excess by triad, for all elements of the arrays."""
    width = float(np.hypot(HOLDS, sigma))
    holds, each = np.ones(()), np.ones(())
    for x in excess.values():
        holds, each = holds * _normal(x, width), each * _within_two(x)
    alike = each
    if len(excess) == 2:
        alike = _within_two(excess["gyro"]) * _normal(excess["accel"] - excess["gyro"], width)
    return np.asarray(np.log((1 - WRONG) * holds + WRONG * (alike + each) / 2 + 1e-300))


def _larger(excess: Mapping[str, float], sigma: float) -> float:
    """The level of the gyros is the declared level, right or wrong, times an excess."""
    return float(log_mean_exp(_declared({**excess, "gyro": excess["gyro"] - EXCESS}, sigma), 0))
