"""Effect of an output's bias instability on the means of segments: flicker noise, whose slow part correlates all segments of a test.

Flicker has the one-sided density B²/(π·f) (IEEE Std 952, where B is the coefficient of bias instability). Its spectrum has no lower limit,
so a constant is defined only as the average over some span. Here that span is stated, and a constant means the average over the span around
the test. No cut-off frequency is then needed: the covariance of means less the average over the span is finite. Its kernel is −ln|t −
t′|/π, whose double integrals over segments are known in closed form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.observations import Observations
from planrunner.plan.kinds import QuantityOf, key
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.uncertainty.influences import Aspect, Inputs
from planrunner.uncertainty.monte_carlo import square_root

Array = NDArray[np.float64]

SPAN = parse_quantity("24 h")


def drift_span() -> Quantity:
    """The key of estimators that report constants."""
    span: Quantity = key(
        QuantityOf("time", "positive"),
        "Time span for which constants are reported. With a declared bias instability, the uncertainty of a constant is that "
        "of its average over this span around the test, or over the test itself if the test is longer.",
        "24 h",
        default=SPAN,
    )
    return span


def flicker_errors(observations: Observations, inputs: Inputs, span: float) -> tuple[CorrelatedError, ...]:
    """One effect for each output whose bias instability is stated. span: s."""
    outputs = observations.channels
    stated = {
        k: quantity for k, name in enumerate(outputs) if (quantity := inputs.of_output(Aspect.BIAS_INSTABILITY, name))
    }
    if not stated:
        return ()
    root = square_root(mean_covariance(observations.start, observations.end, span))
    seen = scatter_within(observations.batches)
    return tuple(CorrelatedError(quantity, {k: root}, within={k: seen}) for k, quantity in stated.items())


def mean_covariance(start: Array, end: Array, span: float) -> Array:
    """Covariance (n, n) of the means of flicker with B = 1 over n segments, less its average over `span` around them.

    start, end: (n,), s. A span shorter than the time from the first start to the last end is replaced by that time.
    """
    first, last = float(start.min()), float(end.max())
    middle, half = (first + last) / 2, max(span, last - first) / 2
    low, high = np.append(start, middle - half), np.append(end, middle + half)
    kernel = -_mean_logarithm(low, high) / np.pi
    to_span = kernel[:-1, -1]
    return np.asarray(kernel[:-1, :-1] - to_span[:, None] - to_span[None, :] + kernel[-1, -1])


def _mean_logarithm(low: Array, high: Array) -> Array:
    """Average of ln|t − t′| over t in one interval and t′ in another, (n, n).

    From the second antiderivative x²·ln|x|/2 − 3x²/4 at the four differences of the ends; for intervals that are short compared with their
    distance d, where these differences cancel, from ln d − (a² + b²)/(24·d²), with an error of fourth order in a/d and b/d.
    """
    length = high - low

    ends = np.array((low, high))
    apart = np.maximum(np.abs(ends[:, None, :, None] - ends[:, None, :]), np.finfo(float).tiny)
    antiderivative = apart**2 * (np.log(apart) / 2 - 0.75)
    exact = antiderivative[1, 0] + antiderivative[0, 1] - antiderivative[1, 1] - antiderivative[0, 0]
    exact /= length[:, None] * length
    middle = (low + high) / 2
    distance = np.abs(middle[:, None] - middle)
    squares = length[:, None] ** 2 + length**2
    far = distance**2 > 1e5 * squares
    distance = np.where(far, distance, 1.0)
    return np.asarray(np.where(far, np.log(distance) - squares / (24 * distance**2), exact))


def scatter_within(batches: NDArray[np.int64]) -> Array:
    """Contribution (n,) of flicker with B = 1 to the square of a mean's standard error that is estimated from b batch means: ln b/(π·(b −
    1)).

    A mean over T has the variance (c − ln T + 3/2)/π with some constant c; the variance of a batch minus that of all is ln b/π.
    """
    b = np.maximum(batches, 2).astype(float)
    return np.where(batches > 1, np.log(b) / (np.pi * (b - 1)), 0.0)
