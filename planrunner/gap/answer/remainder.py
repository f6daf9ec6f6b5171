"""Examines the part of a gap that a fit does not explain. Computes a goodness-of-fit test for every channel, the size of the
unexplained part, and the dispersion, which corrects the evidence.

The test determines whether noise alone explains the whitened residuals of a channel. The test compares the sum of the squared
residuals with the χ² distribution, with Bonferroni's correction for the number of tests. The unexplained part is called the
remainder. It is computed after the named effects have been fitted to all segments.

If the test shows that noise alone does not explain the residuals, their dispersion is the ratio χ²/ν. Sometimes the residuals of
every explanation are larger than the noise. The differences between log evidences are then too large by this ratio. The reason is
that the evidence treats the samples as independent, but the errors of an explanation are the same in all samples. In this case, the
noise variance is multiplied by the dispersion before the evidence is computed. This factor is the dispersion of quasi-likelihood
(McCullagh and Nelder, Generalized Linear Models, 1989, section 4.5). In metrology it is the squared Birge ratio (Birge, Physical
Review 40, 1932). This correction corresponds to a likelihood raised to the power ν/χ² (Miller and Dunson, Journal of the American
Statistical Association 114, 2019). If chance can explain the ratio, the dispersion is 1. Therefore, without a misfit, the evidence
does not change.

In array shapes, M is the number of coefficients of a channel, S is the number of segments, and K is the number of channels. ν is
the number of degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.hypotheses.candidates import Weighed, Weighing

LEVEL = 0.001
"""Significance level of the test. Of a thousand recordings without misfit, one fails the test."""


def dispersion(rest: Array, degrees: int, means: NDArray[np.int64], tests: int) -> float:
    """Returns the dispersion of one channel. Two sums of squares are tested against χ²: the sum over all coefficients, and the sum
    over the means. The result is the largest ratio χ²/ν among the sums that fail the test, or 1 if both pass.

    `rest`: array of shape (M,), the whitened residuals. `degrees`: degrees of freedom of `rest`. `means`: array of shape (S,),
    indices of the coefficients of order 0, which are the segment means. The means are also tested alone: if the assumed form of an
    effect is slightly wrong, the errors accumulate in the means. `tests`: number of tests in all channels, for Bonferroni's
    correction.
    """
    from scipy.special import chdtrc

    found = 1.0
    lost = len(rest) - degrees
    parts: Sequence[tuple[float, int]] = (
        (float(rest @ rest), degrees),
        (float(rest[means] @ rest[means]), max(len(means) - lost, 1)),
    )
    for squares, free in parts:
        if tests * float(chdtrc(free, squares)) < LEVEL:
            found = max(found, squares / free)
    return found


def dispersions(weighing: Weighing, known: Weighed, setting: int = 0) -> Array:
    """Returns the dispersion of each channel's residuals, shape (K,), after known effects have been fitted. `setting`: index of the
    setting of the noise (levels of flicker and random walk) that is used in the fit."""
    amplitudes = known.amplitudes_at(setting)[0]
    found, count = [], len(weighing.weights)
    for weight, columns in weighing.whitened_at(known, setting):
        rest = weight.residual - columns @ amplitudes
        degrees = max(len(rest) - weight.basis.shape[1], 1)
        found.append(dispersion(rest, degrees, weighing.spectrum.means, 2 * count))
    return np.array(found)


VISIBLE = 1.2  # in units of the noise; a smaller misfit lies within the uncertainty of the noise model


@dataclass(frozen=True, slots=True)
class Remainder:
    """Describes the part of a gap that the named effects do not explain.

    `share`: size of the unexplained part divided by the size of the gap; both sizes are root mean squares without noise. `share` is
    0 if noise alone explains the residuals. `times_noise`: for each channel, root mean square of the residuals, in standard
    deviations of the noise; 1 for noise alone. `sigma`: for each channel, the size √(χ² − ν) of all residuals together, in standard
    deviations of the noise; 0 if they are not larger than the noise. `p`: p-value of the goodness-of-fit test over all channels.
    `passes`: True if noise alone explains the residuals in every channel, and no pattern outside the catalogue explains them
    better. A misfit of less than `VISIBLE` standard deviations of the noise is ignored.
    """

    share: float
    times_noise: Mapping[str, float]
    sigma: Mapping[str, float]
    p: float
    passes: bool


def remainder(weighing: Weighing, named: Weighed, something_else: bool = False) -> Remainder:
    """Determines the part of a gap that remains unexplained after the named effects have been fitted together. `something_else`:
    True if the unexplained part follows a pattern outside the catalogue."""
    from scipy.special import chdtrc

    amplitudes = named.amplitudes[0]
    before = after = 0.0
    times: dict[str, float] = {}
    sigma: dict[str, float] = {}
    smallest = 1.0
    for index, (channel, columns) in enumerate(zip(weighing.observed.channels, named.by_channel, strict=True)):
        weight = weighing.weights[index][0]
        degrees = max(len(weight.residual) - weight.basis.shape[1], 1)
        rest = weight.residual - columns @ amplitudes
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
