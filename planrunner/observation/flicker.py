"""Computes how an output's bias instability affects the means of segments. Bias instability is flicker noise. The slow part of this
noise correlates the means of all segments of a test.

Flicker has the one-sided density B²/(π·f) (IEEE Std 952, where B is the coefficient of bias instability). The spectrum of flicker
has no lower frequency limit, so a constant can be defined only as an average over some time span. The plan states this span, and
the test lies in its middle. No cut-off frequency is then needed: after the average over the span has been subtracted, the means
have a finite covariance. This covariance has the kernel −ln|t − t′|/π, whose double integrals over segments are known in closed
form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.observations import Observations
from planrunner.plan.kinds import QuantityOf, key
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.uncertainty.influences import Aspect, InputQuantity, Inputs
from planrunner.uncertainty.monte_carlo import square_root

SPAN = parse_quantity("24 h")


def drift_span() -> Quantity:
    """Makes the plan key for the time span. A constant is defined as the average over this span."""
    span: Quantity = key(
        QuantityOf("time", "positive"),
        "A reported constant is the mean over this time span. The span is at least as long as the test, and the test is in the "
        "middle of it. The span affects the uncertainties only if a bias instability is declared.",
        "24 h",
        default=SPAN,
    )
    return span


def flicker_errors(observations: Observations, inputs: Inputs, span: float) -> tuple[CorrelatedError, ...]:
    """Returns the correlated error of each output whose bias instability is stated. `span`: time span [s] around the test; a
    constant is defined as the average over this span."""
    outputs = observations.channels
    stated = {
        k: quantity for k, name in enumerate(outputs) if (quantity := inputs.of_output(Aspect.BIAS_INSTABILITY, name))
    }
    return _effects(observations, stated, span)


def _effects(
    observations: Observations, stated: Mapping[int, InputQuantity], span: float
) -> tuple[CorrelatedError, ...]:
    """Returns the flicker of the outputs whose bias instability is given. `stated`: bias instability by the index of the output.
    `span`: the same as in `flicker_errors`."""
    if not stated:
        return ()
    root = _root(mean_covariance(observations.start, observations.end, span))
    seen = scatter_within(observations.batches, observations.courses or ())
    return tuple(
        CorrelatedError(quantity, {k: root}, within={k: seen}, channel=observations.channels[k])
        for k, quantity in stated.items()
    )


def _root(covariance: Array) -> Array:
    """Returns a matrix L for which L·Lᵀ is the covariance (n, n). A Cholesky factor is used if possible, because its computation
    takes a tenth of the time that eigenvectors need. Eigenvectors are needed only if the covariance is singular, for example for a
    test without gaps that fills the whole span."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        return square_root(covariance)


def unstated_flicker(observations: Observations, inputs: Inputs, span: float) -> tuple[CorrelatedError, ...]:
    """Returns the flicker of each output for which the bench file states no bias instability, with the size B = 1 in the output's
    unit. For expected observations, the result is empty, because such observations contain only declared effects. `span`: the same
    as in `flicker_errors`."""
    outputs = [] if observations.expected else [*enumerate(observations.channels)]
    silent = {k: of_unit_size(name, observations.units[k]) for k, name in outputs if name in inputs.without_flicker}
    return _effects(observations, silent, span)


def of_unit_size(channel: str, unit: str) -> InputQuantity:
    """Returns the coefficient B of a channel whose bias instability is not stated, as an input quantity. B is set to one unit, so
    that influences of the flicker are stated per unit of B."""
    return InputQuantity(Aspect.BIAS_INSTABILITY.of(channel), 0.0, unit, 1.0)


def mean_covariance(start: Array, end: Array, span: float) -> Array:
    """Computes the covariance of the means of flicker noise over n segments, shape (n, n). The noise has B = 1, and its average
    over `span` [s] around the segments has been subtracted.

    `start`, `end`: arrays of shape (n,), start and end times of the segments, s. A span shorter than the time from the first start
    to the last end is extended to that time.
    """
    first, last = float(start.min()), float(end.max())
    middle, half = (first + last) / 2, max(span, last - first) / 2
    low, high = np.append(start, middle - half), np.append(end, middle + half)
    kernel = -_mean_logarithm(low, high) / np.pi
    to_span = kernel[:-1, -1]
    return np.asarray(kernel[:-1, :-1] - to_span[:, None] - to_span[None, :] + kernel[-1, -1])


def weighted_covariance(weights: Array, step: float, span: float) -> Array:
    """Computes the covariance of q weighted sums of the means of flicker noise. Returns an array of shape (…, q, q). The means are
    taken over n consecutive intervals of the length `step` [s]. The noise has B = 1, and its average over `span` [s] around the
    intervals has been subtracted. `weights`: array of shape (…, q, n), the weights of the n means in each sum.

    The result agrees with `mean_covariance`. As all intervals have the same length, the covariance of two means depends only on the
    distance between their intervals. The product of the covariance matrix with the weights is therefore a convolution (a Toeplitz
    matrix embedded in a circulant one), so that n may be several thousand.
    """
    n = weights.shape[-1]
    low: Array = step * np.arange(n, dtype=np.float64)
    length = n * step
    middle, half = length / 2, max(span, length) / 2
    ends = np.array([middle - half]), np.array([middle + half])
    apart = -_between(low[:1], low[:1] + step, low, low + step)[0] / np.pi
    to_span = -_between(low, low + step, *ends)[:, 0] / np.pi
    around = float(-_between(*ends, *ends)[0, 0] / np.pi)
    power = np.fft.rfft(np.concatenate([apart, [0.0], apart[:0:-1]])).real
    power[1:-1] *= 2
    spectra = np.fft.rfft(weights, 2 * n)
    found = ((spectra * power) @ spectra.conj().swapaxes(-1, -2)).real / (2 * n)
    total, along = weights.sum(axis=-1), weights @ to_span
    tied = along[..., :, None] * total[..., None, :]
    return np.asarray(found - tied - tied.swapaxes(-1, -2) + around * total[..., :, None] * total[..., None, :])


def _mean_logarithm(low: Array, high: Array) -> Array:
    """Returns the average of ln|t − t′| over t in one interval and t′ in another, for all pairs of n intervals, shape (n, n).
    `low`, `high`: arrays of shape (n,), start and end of each interval."""
    return _between(low, high, low, high)


def _between(low: Array, high: Array, other_low: Array, other_high: Array) -> Array:
    """Returns the average of ln|t − t′| over t in one of n intervals and t′ in one of m other intervals, shape (n, m).

    The second antiderivative of ln|x| is F(x) = x²·ln|x|/2 − 3x²/4. The average is a sum of four values of F. The argument of each
    value is the difference between an end of the first interval and an end of the second. If the lengths a and b of the intervals
    are small compared with their distance d, the four values nearly cancel. The average is then computed as ln d − (a² +
    b²)/(24·d²), with an error of fourth order in a/d and b/d.
    """
    if len(low) > _ROWS:
        parts = [slice(first, first + _ROWS) for first in range(0, len(low), _ROWS)]
        return np.concatenate([_between(low[part], high[part], other_low, other_high) for part in parts])
    length, other = high - low, other_high - other_low
    ends, others = np.array((low, high)), np.array((other_low, other_high))
    apart = np.maximum(np.abs(ends[:, None, :, None] - others[:, None, :]), np.finfo(float).tiny)
    antiderivative = apart**2 * (np.log(apart) / 2 - 0.75)
    exact = antiderivative[1, 0] + antiderivative[0, 1] - antiderivative[1, 1] - antiderivative[0, 0]
    exact /= length[:, None] * other
    distance = np.abs((low + high)[:, None] / 2 - (other_low + other_high) / 2)
    squares = length[:, None] ** 2 + other**2
    far = distance**2 > 1e5 * squares
    distance = np.where(far, distance, 1.0)
    return np.asarray(np.where(far, np.log(distance) - squares / (24 * distance**2), exact))


_ROWS = 64  # computed at a time, so that the parts of the sum stay in the processor's cache


def scatter_within(batches: NDArray[np.int64], courses: Sequence[Array] = ()) -> Array:
    """Returns the contribution of flicker with B = 1 to the squared standard error of each mean, shape (n,). If the standard error
    is estimated from b batch means, this contribution is ln b/(π·(b − 1)).

    A mean over the time T has the variance (c − ln T + 3/2)/π, where c is a constant. The variance of one batch mean is therefore
    larger by ln b/π than the variance of the mean of all batches. If functions of time are fitted to the batch means, the fit
    removes a part of the flicker. The contribution is then tr(R·K·R)/(b·ν), where R is the projection onto the residuals of the
    fit, K is the covariance of the batch means, and ν is the number of degrees of freedom. `batches`: array of shape (n,), number b
    of batches of each mean. `courses`: the fitted functions of time, as in `Observations`.
    """
    b = np.maximum(batches, 2).astype(float)
    plain = np.where(batches > 1, np.log(b) / (np.pi * (b - 1)), 0.0)
    for row, course in enumerate(courses):
        if not len(course):
            continue
        count, freedom = course.shape[1], course.shape[1] - 1 - float(np.sum(course**2))
        if freedom > 0:
            edges = np.arange(count + 1.0)
            kernel = -_mean_logarithm(edges[:-1], edges[1:]) / np.pi
            left = np.eye(count) - 1 / count - course.T @ course
            plain[row] = float(np.sum((left @ kernel) * left)) / (count * freedom)
    return plain
