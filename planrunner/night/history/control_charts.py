"""Computes control charts of a coefficient over time. Every value has its own standard uncertainty.

The variance of value i about the mean is σ_i² = u_i² + τ², where u_i is the stated standard uncertainty of the value. The scatter τ
from run to run is the part of the scatter that the stated uncertainties do not include, for example the scatter due to mounting and
switch-on. τ² is estimated from the mean moving range, so that a shift or a drift of the mean hardly affects it:

    τ² = max(0, (mean |x_i − x_{i−1}| / d₂)² − mean u_i²),    d₂ = 2/√π

With u = 0 the charts are those of the NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2 (individuals), 6.3.2.3 (CUSUM) and 6.3.2.4
(EWMA). The run lengths of EWMA and CUSUM are those of Lucas and Saccucci (Technometrics 32, 1990) and of Montgomery (Introduction to
Statistical Quality Control, chapter 9).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

D2 = 2 / math.sqrt(math.pi)
"""Mean range of two normal values with σ = 1."""
SHEWHART = 3.0
"""Half-width of the limits of a Shewhart chart in σ."""
LAMBDA, EWMA_WIDTH = 0.2, 2.962
"""Weight of the newest value in the EWMA chart, and half-width of its limits in standard deviations of the average. On average, a
false alarm occurs after 500 values."""
ALLOWANCE, DECISION = 0.5, 5.0
"""Parameters k and h of the CUSUM chart in σ, for a shift of 1 σ. On average, a false alarm occurs after 465 values."""
BASELINE = 20
"""Maximum number of values from which the mean and τ are computed."""


@dataclass(frozen=True, slots=True)
class Centre:
    """The centre line of the charts.

    `mean`: mean of the values, weighted with 1/σ_i². `standard_uncertainty`: standard uncertainty of `mean`. `between`: τ, the
    scatter from run to run. `values`: number of values from which the centre line was computed. `mean`, `standard_uncertainty` and
    `between` are in the unit of the values.
    """

    mean: float
    standard_uncertainty: float
    between: float
    values: int


@dataclass(frozen=True, slots=True)
class Chart:
    """A control chart of n values.

    `statistic`: array of shape (n,), the quantity that the chart shows: the values, their moving averages or their cumulative sums.
    `lower`, `upper`: arrays of shape (n,), limits of the statistic. `alarms`: array of shape (n,), True where the statistic is
    outside its limits.
    """

    statistic: Array
    lower: Array
    upper: Array
    alarms: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ControlCharts:
    """The control charts of a coefficient. `sigma`: array of shape (n,), standard deviation of each value about the mean. The two
    sums of the CUSUM chart are in units of σ; the lower sum is negative."""

    centre: Centre
    sigma: Array
    shewhart: Chart
    ewma: Chart
    cusum_up: Chart
    cusum_down: Chart

    @property
    def out_of_control(self) -> bool:
        """Returns True if the newest value lies outside the limits of any chart."""
        return any(bool(chart.alarms[-1]) for chart in (self.shewhart, self.ewma, self.cusum_up, self.cusum_down))


def between_runs(values: Array, u: Array) -> float:
    """Returns the scatter τ from run to run, computed from the moving ranges of the values (n,) and their standard uncertainties
    (n,)."""
    if len(values) < 2:
        return 0.0
    sigma = float(np.abs(np.diff(values)).mean()) / D2
    return math.sqrt(max(0.0, sigma**2 - float(np.mean(u**2))))


def centre_of(values: Array, u: Array, baseline: int = BASELINE) -> Centre:
    """Returns the centre line of the charts, computed from the first `baseline` values. All arrays have the shape (n,)."""
    x, s = values[:baseline], u[:baseline]
    tau = between_runs(x, s)
    variance = s**2 + tau**2
    weight = 1 / variance if (variance > 0).all() else np.ones(len(x))
    mean = float(np.average(x, weights=weight))
    return Centre(mean, math.sqrt(1 / float(weight.sum())) if (variance > 0).all() else 0.0, tau, len(x))


def shewhart(values: Array, mean: float, sigma: Array, width: float = SHEWHART) -> Chart:
    """Returns the Shewhart chart with limits at mean ± width·σ_i. `values`, `sigma`: arrays of shape (n,), the values and their
    standard deviations about the mean."""
    half = width * sigma
    return _chart(values, np.broadcast_to(mean - half, values.shape), np.broadcast_to(mean + half, values.shape))


def ewma(
    values: Array, mean: float, sigma: Array, weight: float = LAMBDA, width: float = EWMA_WIDTH, *, steady: bool = False
) -> Chart:
    """Returns the exponentially weighted moving average E_i = λ x_i + (1 − λ) E_{i−1} with E_0 = mean. `values`: array of shape (n,
    …), the values in chronological order. `sigma`: array of shape (n,), or of the shape of `values`.

    The variance of E_i is V_i = λ² σ_i² + (1 − λ)² V_{i−1}. By default, V_0 = 0, so that the first limits are narrower. `steady`:
    True if the recursion starts from V_0 = λ/(2 − λ) σ² instead, as in the handbook. V_0 is then the final value of the variance
    for the first σ.
    """
    sigma = np.broadcast_to(sigma.reshape(sigma.shape + (1,) * (values.ndim - sigma.ndim)), values.shape)
    average, half = np.empty_like(values), np.empty_like(values)
    last = np.full(values.shape[1:], mean)
    variance = weight / (2 - weight) * sigma[0] ** 2 if steady else np.zeros(values.shape[1:])
    for i, (x, s) in enumerate(zip(values, sigma, strict=True)):
        last = weight * x + (1 - weight) * last
        variance = (1 - weight) ** 2 * variance + weight**2 * s**2
        average[i], half[i] = last, width * np.sqrt(variance)
    return _chart(average, mean - half, mean + half)


def cusum(
    values: Array, mean: float, sigma: Array, allowance: float = ALLOWANCE, decision: float = DECISION
) -> tuple[Chart, Chart]:
    """Returns the tabular CUSUM: sums S⁺_i = max(0, S⁺_{i−1} + z_i − k) and S⁻_i = min(0, S⁻_{i−1} + z_i + k) of z_i = (x_i −
    mean)/σ_i, with the limits ±h. `values`: array of shape (n, …), the values in chronological order. `sigma`: array of shape (n,),
    or of the shape of `values`; all elements are positive."""
    sigma = np.broadcast_to(sigma.reshape(sigma.shape + (1,) * (values.ndim - sigma.ndim)), values.shape)
    up, down = np.empty_like(values), np.empty_like(values)
    high, low = np.zeros(values.shape[1:]), np.zeros(values.shape[1:])
    for i, z in enumerate((values - mean) / sigma):
        high = np.maximum(0.0, high + z - allowance)
        low = np.minimum(0.0, low + z + allowance)
        up[i], down[i] = high, low
    none = np.zeros_like(values)
    return _chart(up, none, none + decision), _chart(down, none - decision, none)


def control_charts(values: Sequence[float], u: Sequence[float], baseline: int = BASELINE) -> ControlCharts | None:
    """Returns all charts of n ≥ 2 values. `values`, `u`: the values in chronological order, and their standard uncertainties. The
    result is None if there are no limits, because the values do not scatter at all and state no uncertainty."""
    x, s = np.asarray(values, dtype=float), np.asarray(u, dtype=float)
    return charts_about(x, s, centre_of(x, s, baseline)) if len(x) > 1 else None


def charts_about(x: Array, u: Array, centre: Centre) -> ControlCharts | None:
    """Returns all charts of the values x (n,) with the standard uncertainties u (n,) about a given centre line. The result is None
    if a value has the uncertainty 0 and `centre.between` is 0, because there are then no limits for this value."""
    sigma = np.sqrt(u**2 + centre.between**2)
    if not (sigma > 0).all():
        return None
    up, down = cusum(x, centre.mean, sigma)
    return ControlCharts(centre, sigma, shewhart(x, centre.mean, sigma), ewma(x, centre.mean, sigma), up, down)


def _chart(statistic: Array, lower: Array, upper: Array) -> Chart:
    return Chart(statistic, lower, upper, (statistic < lower) | (statistic > upper))
