"""Dispersion: the ratio of the residuals to the noise, if a test shows that noise alone does not explain the residuals.

If no explanation leaves only noise, differences of evidence are too large by the ratio χ²/ν of the residuals. The reason is that all
samples contain the same errors of the explanation, but count as independent. Evidence is then computed with the noise enlarged by that
ratio. This is the dispersion of quasi-likelihood (McCullagh and Nelder, Generalized Linear Models, 1989, section 4.5), in metrology the
squared Birge ratio (Birge, Physical Review 40, 1932), and corresponds to a likelihood raised to the power ν/χ² (Miller and Dunson,
Journal of the American Statistical Association 114, 2019). If chance explains the ratio, it is set to 1, so that evidence without misfit
does not change.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array

LEVEL = 0.001
"""Significance of the test: one recording in a thousand without misfit fails it."""


def dispersion(rest: Array, degrees: int, means: NDArray[np.int64], tests: int) -> float:
    """The dispersion of one channel. Two sums of squares are tested against χ²: the sum over all coefficients, and the sum over the
    means. The result is the largest ratio χ²/ν among the sums that fail the test, or 1 if both pass.

    rest: (M,), whitened residuals; degrees: degrees of freedom of `rest`. means: (S,), indices of the coefficients of order 0, which
    collect the errors in the form of an effect. tests: number of tests in all channels, for Bonferroni's correction.
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
