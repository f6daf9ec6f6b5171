"""Fits straight lines through many series of rates simultaneously: F_j = K·x_j + F_0 + ν_j, by ordinary least squares.

For the asymmetry, two half-lines that meet at zero rate are fitted as well. The module also computes the change of the output
between the lowest rates.

Other functions give the unit of a scale factor (unit of the output divided by unit of the rate).
"""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import EstimationError
from planrunner.plan.units import Unit, UnknownUnitError, unit

ENOUGH = 3  # different rates that asymmetry needs, in addition to rates of both signs
TOLERANCE = 1e-12  # reciprocal of the largest condition number of normal equations; beyond, rounding errors dominate


@dataclass(frozen=True, slots=True)
class RateLines:
    """The fits of q series of n rates on m axes.

    `slope`: array of shape (q, m), slopes K of the lines. `offset`: array of shape (q, m), offsets F_0 of the lines. `residuals`:
    array of shape (q, n, m). `asymmetry`: array of shape (q, m), 2·(K₊ − K₋)/(K₊ + K₋), NaN if the rates do not allow it.
    `response`: array of shape (q, m), change of the output between the two lowest rates, divided by the change according to the
    line.
    """

    slope: Array
    offset: Array
    residuals: Array
    asymmetry: Array
    response: Array


def line_through(rates: Array) -> tuple[Array, Array]:
    """Returns the design of a line through rates (n,), rad/s: the matrix (n, 2) with the columns for offset and rate, and the
    magnitudes (2,) of these columns."""
    return np.column_stack([np.ones(len(rates)), rates]), np.array([1.0, np.abs(rates).max(initial=1e-12)])


def fit_lines(x: Array, f: Array) -> RateLines:
    """Fits a line to each series of each axis. `x`: array of shape (q, n, m) in rad/s, input of each axis. `f`: array of shape (q,
    n, m), outputs minus the output at rest. The rates of a series must not all be equal."""
    centre = x.mean(axis=1, keepdims=True)
    off = x - centre
    slope = np.sum(off * f, axis=1) / np.sum(off * off, axis=1)
    offset = f.mean(axis=1) - slope * centre[:, 0]
    residuals = f - offset[:, None] - slope[:, None] * x
    return RateLines(slope, offset, residuals, _asymmetry(x, f), _response(x, f, slope))


def lowest_pair(x: Array) -> tuple[int, int]:
    """Returns two indices in a series of rates x (n,): the index of the lowest positive rate, and the index of the negative rate
    with the smallest magnitude. If all rates have the same sign, these are the indices of the two rates with the smallest
    magnitudes."""
    order = np.argsort(np.abs(x), kind="stable")
    positive, negative = [k for k in order if x[k] > 0], [k for k in order if x[k] < 0]
    first, second = (positive[0], negative[0]) if positive and negative else (order[1], order[0])
    return int(first), int(second)


def _response(x: Array, f: Array, slope: Array) -> Array:
    high, low = lowest_pair(x[0, :, 0])
    return np.asarray((f[:, high] - f[:, low]) / (slope * (x[:, high] - x[:, low])))


def _asymmetry(x: Array, f: Array) -> Array:
    """Returns the asymmetry of each series and axis. The asymmetry is NaN in two cases: if there are too few inputs to separate the
    half-lines, and if all inputs of an axis have the same sign. The second case occurs, for example, if the Earth's rotation is
    larger than the rates. The asymmetry is computed from normal equations, after the columns have been divided by the largest
    rate."""
    told = np.full((x.shape[0], x.shape[2]), np.nan, dtype=f.dtype)
    if np.unique(x[0, :, 0]).size < ENOUGH:
        return told
    scaled = np.moveaxis(x / np.abs(x).max(), 1, 2)
    columns = np.stack([np.ones_like(scaled), np.maximum(scaled, 0), np.minimum(scaled, 0)], axis=-1)
    normal = np.einsum("qmni,qmnj->qmij", columns, columns)
    right = np.einsum("qmni,qnm->qmi", columns, f)
    sound = np.linalg.cond(normal) < 1 / TOLERANCE
    solved = np.linalg.solve(normal[sound], right[sound][..., None])[..., 0]
    plus, minus = solved[..., 1], solved[..., 2]
    told[sound] = asymmetry(plus, minus)
    return told


def asymmetry(forward: Array, backward: Array) -> Array:
    """Returns the asymmetry 2·(K₊ − K₋)/(K₊ + K₋) of the scale factors K₊ (`forward`) and K₋ (`backward`)."""
    return 2 * (forward - backward) / (forward + backward)


def rate_and_output(rate_unit: str, output_unit: str) -> tuple[Unit, Unit]:
    """Returns the units of the rate and of the output. Raises `EstimationError` for a text that is not a unit, and for a
    `rate_unit` that is not a unit of angular rate."""
    try:
        rate, own = unit(rate_unit), unit(output_unit)
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    if rate.dimension != unit("rad/s").dimension:
        raise EstimationError(
            f"rate_unit is '{rate_unit}', which is not a unit of angular rate; write for example 'deg/s'"
        )
    return rate, own


def slope_unit(rate: Unit, own: Unit) -> tuple[str, float]:
    """Returns the unit of the scale factor K, and the factor that converts (output unit)/(rad/s) to this unit. If the output is
    itself a rate, K is a ratio without a unit."""
    if own.dimension == rate.dimension:
        return "1", own.factor
    return f"({own.text})/({rate.text})", rate.factor
