"""The part of a gap that the named effects do not explain: a goodness-of-fit test in every channel, and the size of this part.

The effects are fitted to all segments. In each channel the sum of squares of the whitened residuals is compared with the χ²
distribution for noise alone, with Bonferroni's correction for the number of channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planrunner.gap.evidence.dispersion import LEVEL
from planrunner.gap.hypotheses.candidates import Weighed, Weighing

VISIBLE = 1.2  # times the noise: smaller rests are within the uncertainty of the noise model


@dataclass(frozen=True, slots=True)
class Remainder:
    """The unexplained part. share: unexplained share of the gap, as a ratio of root mean squares without noise; 0 if noise alone
    explains the residuals. times_noise: by channel, root mean square of the residual coefficients in standard deviations of the
    noise, 1 for noise alone. sigma: by channel, size of all residuals in standard deviations, the square root of χ² − ν; 0 if they
    are not larger than the noise. p: p-value of the test. passes: True if noise alone explains the residuals, in every channel and
    for every pattern outside the catalogue."""

    share: float
    times_noise: Mapping[str, float]
    sigma: Mapping[str, float]
    p: float
    passes: bool


def remainder(weighing: Weighing, named: Weighed, something_else: bool = False) -> Remainder:
    """The part of a gap that effects leave unexplained if they are fitted together. something_else: True if this part follows a
    pattern outside the catalogue."""
    from scipy.special import chdtrc

    amplitudes = named.amplitudes[0]
    before = after = 0.0
    times: dict[str, float] = {}
    sigma: dict[str, float] = {}
    smallest = 1.0
    for index, channel in enumerate(weighing.observed.channels):
        weight = weighing.weights[index][0]
        degrees = max(len(weight.residual) - weight.basis.shape[1], 1)
        rest = weight.residual - named.by_channel[index] @ amplitudes
        squares = float(rest @ rest)
        before += float(weight.residual @ weight.residual) - degrees
        after += squares - degrees
        times[channel.name] = (squares / degrees) ** 0.5
        sigma[channel.name] = max(squares - degrees, 0.0) ** 0.5
        smallest = min(smallest, float(chdtrc(degrees, squares)))
    p = min(1.0, smallest * len(times))
    passes = not something_else and (p >= LEVEL or max(times.values()) < VISIBLE)
    share = 0.0 if passes or before <= 0 else min((max(after, 0.0) / before) ** 0.5, 1.0)
    return Remainder(share, times, sigma, p, passes)
