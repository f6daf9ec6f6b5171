"""Finds segments that do not agree with the other segments. Also finds segments in which an error would remain unnoticed, because
the other segments do not check them.

The test uses the mean-shift model: segment i of an output has an error δ. An additional column, which is 1 in row i and 0
elsewhere, describes this error. The t value of δ is the externally studentised residual (Cook and Weisberg, Residuals and Influence
in Regression, 1982, 2.2.2; for correlated observations Baarda, A Testing Procedure for Use in Geodetic Networks, 1968). The largest
t value of all segments is tested with Bonferroni's bound. If the largest t value is significant, the search is repeated among the
other segments, so that two wrong segments do not hide each other.

The redundancy of a segment is the fraction of an error of this segment that appears in the segment's residual. If the redundancy is
small, this segment alone determines a coefficient: an error of the segment changes the coefficient, but does not appear in the
residuals (Baarda, ibid.).
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.least_squares import whitener
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.observation.observations import SIGNIFICANCE

LEAST_REDUNDANCY = 0.1
"""An error of a segment is easily visible only if the redundancy of the segment is at least this value. At this redundancy, an
error must be three times (1/√0.1) as large as in a segment with the redundancy 1 to be equally visible."""
_MOST = 5  # outliers reported for one output; more of them mean that the model is wrong
_ROUNDING = 1e-10  # of an output's largest fitted value: smaller errors are rounding errors


@dataclass(frozen=True, slots=True)
class Outlier:
    """Describes a segment that does not agree with the other segments.

    `error`: the segment's mean minus the value that the fit to the other segments predicts, in the output's unit. `deviations`:
    this difference in standard deviations. `probability`: probability that chance alone gives a difference at least this large in
    any of the segments and outputs. `changes`: array of shape (p,), change of the output's coefficients if the segment is left out.
    """

    output: str
    label: str
    error: float
    deviations: float
    probability: float
    changes: Array


@dataclass(frozen=True, slots=True)
class Agreement:
    """States how well the segments of a fit agree. `outliers`: outliers of all outputs, the least probable first; empty if the
    residuals have fewer than two degrees of freedom. `unchecked`: labels of the segments whose error would hardly appear in the
    residuals of at least one output; empty if the fit has no residuals."""

    outliers: tuple[Outlier, ...] = ()
    unchecked: tuple[str, ...] = ()


def agreement(fit: OutputsFit, basis: str) -> Agreement:
    """Tests whether the segments of a fit agree with each other."""
    if not fit.freedom:
        return Agreement()
    found: list[Outlier] = []
    redundancy = np.full(fit.gains.shape[2], math.inf)
    for k in range(len(fit.outputs)):
        weighed = _Weighed.of(fit, k, basis)
        whole = weighed.shifts(())
        redundancy = np.minimum(redundancy, whole.redundancy)
        found += _of_output(fit, k, weighed, whole)
    means = fit.labels[: len(fit.labels) - fit.within]
    hardly = tuple(label for label, share in zip(means, redundancy, strict=False) if share < LEAST_REDUNDANCY)
    return Agreement(tuple(sorted(found, key=lambda one: one.probability)), hardly)


def _of_output(fit: OutputsFit, k: int, weighed: _Weighed, whole: _Shifts) -> list[Outlier]:
    """Finds the outliers of one output. `whole`: the result of `weighed.shifts(())`, in which no segment has an additional column
    yet."""
    from scipy.special import stdtr

    found: list[Outlier] = []
    taken: tuple[int, ...] = ()
    least = _ROUNDING * float(np.max(np.abs(fit.columns) @ np.abs(fit.all_coefficients[k])))
    comparisons = fit.gains.shape[2] * len(fit.outputs)
    while len(taken) < _MOST and fit.freedom - len(taken) > 1:
        shifts = weighed.shifts(taken) if taken else whole
        freedom = fit.freedom - len(taken) - 1
        worst = int(np.argmax(shifts.drops[: len(fit.labels) - fit.within]))
        left = (shifts.chi_squared - shifts.drops[worst]) / freedom
        error = float(shifts.errors[worst])
        if abs(error) <= least:
            break
        deviations = math.sqrt(shifts.drops[worst] / left) if left > 0 else math.inf
        probability = min(1.0, comparisons * 2 * float(stdtr(freedom, -deviations)))
        if probability >= SIGNIFICANCE:
            break
        changes = -fit.gains[k, :, worst] * error
        found.append(Outlier(fit.outputs[k], fit.labels[worst], error, deviations, probability, changes))
        taken = (*taken, worst)
    return found


@dataclass(frozen=True, slots=True)
class _Shifts:
    """States, for each segment, how one additional column for this segment changes the fit.

    `errors`: array of shape (n,), the error δ of each segment. `drops`: array of shape (n,), the decrease of χ² due to the
    additional column. `errors` and `drops` are 0 for a segment that the model fits exactly, whatever its reading is. `redundancy`:
    array of shape (n,), redundancy of each segment. `chi_squared`: χ² without the additional columns.
    """

    errors: Array
    drops: Array
    redundancy: Array
    chi_squared: float


@dataclass(frozen=True, slots=True)
class _Weighed:
    """The weighted observations of one output.

    `covariance`: array of shape (n, n), covariance of the observations. `weights`: array of shape (n, n), the inverse of
    `covariance`. `columns`: array of shape (n, P), scaled columns of the fit. `residuals`: array of shape (n,), residuals of the
    fit.
    """

    covariance: Array
    weights: Array
    columns: Array
    residuals: Array

    @classmethod
    def of(cls, fit: OutputsFit, k: int, basis: str) -> _Weighed:
        covariance = fit.observed(k, basis)
        whitening = whitener(covariance)
        scale = np.sqrt(np.einsum("ij,ij->j", fit.columns, fit.columns))
        columns = fit.columns / np.where(scale > 0, scale, 1.0)
        return cls(covariance, whitening.T @ whitening, columns, fit.fits[k].residuals)

    def shifts(self, taken: tuple[int, ...]) -> _Shifts:
        """Computes, for each segment, how one additional column for this segment changes the fit. `taken`: indices of the segments
        that already have an additional column."""
        n = len(self.residuals)
        columns = np.column_stack([self.columns, np.eye(n)[:, list(taken)]])
        weighted = self.weights @ columns
        # Weights after the columns have been fitted: χ² = yᵀ·left·y.
        left = self.weights - weighted @ np.linalg.pinv(columns.T @ weighted) @ weighted.T
        pulled, own = left @ self.residuals, np.diag(left)
        redundancy = np.einsum("ij,ji->i", left, self.covariance)
        seen = redundancy > 1e-9
        errors = np.where(seen, pulled / np.where(seen, own, 1.0), 0.0)
        return _Shifts(errors, errors * pulled * seen, redundancy, float(self.residuals @ pulled))
