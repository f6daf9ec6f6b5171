"""Computes scale factors of tilted axes from means of segments. In each repeat, the output at rest F_r is subtracted from the
output F_j at each rate j. A straight line is fitted to these differences as a function of the input of each axis. The results are
then averaged over repeats and compared between temperatures.

The core of the module is one function of the recorded means and of the conditions of the recording. Uncertainties are derived from
this function.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.tilted.mounted_axes import MountedAxes
from planrunner.estimators.tilted.rate_lines import RateLines, fit_lines
from planrunner.estimators.tilted.rate_series import RateSeries
from planrunner.uncertainty.derivatives import jacobian

QUANTITIES = ("K", "F0", "nonlinearity", "asymmetry", "response")
K, F0, NONLINEARITY, ASYMMETRY, RESPONSE = range(len(QUANTITIES))


@dataclass(frozen=True, slots=True)
class TiltedConditions:
    """States the conditions under which scale factors are computed, for N segments.

    `axes`: the sensor axes with their directions. `commanded`: array of shape (N,) in rad/s, the table's rate in each segment.
    `along`: array of shape (N, 3), the rotation axis in the fixture's frame. `felt`: array of shape (N, 3) in rad/s, mean rate
    including the Earth's rotation; None if the Earth's rotation is not corrected for. `rate_error`: relative error of the table's
    rate, either one value for all segments or (N,).
    """

    axes: MountedAxes
    commanded: Array
    along: Array
    felt: Array | None
    rate_error: Array | float = 0.0

    def inputs(self, group: Group) -> Array:
        """Returns the input of each axis minus its input at rest [rad/s], shape (q, n, m)."""
        turning = self.along * self.commanded[:, None] * (1.0 if self.felt is None else 0.0)
        felt = turning if self.felt is None else self.felt
        felt = felt + self.along * (self.rate_error * self.commanded)[:, None]
        home = group.rest @ felt
        return np.asarray((felt[group.spins] - home[:, None]) @ self.axes.directions.T)


@dataclass(frozen=True, slots=True)
class Group:
    """Contains the data of n rates at one temperature; each rate is repeated q times. The recording has N segments and m axes.

    `kelvin`: measured or planned temperature, K; NaN if neither is known. `rates`: array of shape (n,) in rad/s, rates of the
    table. `spins`: array of shape (q, n), index of the segment of each repeat and rate. `rest`: array of shape (q, N), one row of
    weights for each repeat. The weighted sum of the segment means is the output at rest in this repeat, which is the mean of the
    average zeros before and after the rates. `between`: array of shape (q, N), weights of another sum of the segment means, which
    is the zero after the rates minus the zero before the rates. `outputs`: array of shape (q, n, m), the output at each rate minus
    the output at rest, F_j − F_r. `drift`: array of shape (q, m), the zero after the rates minus the zero before the rates.
    """

    label: str
    kelvin: float
    names: tuple[str, ...]
    rates: Array
    spins: NDArray[np.int64]
    rest: Array
    between: Array
    outputs: Array
    drift: Array

    @property
    def full_scale(self) -> Array:
        """Returns the largest absolute output of each axis, shape (m,)."""
        largest: Array = np.abs(self.outputs.mean(axis=0)).max(axis=0)
        return largest

    @property
    def averages(self) -> Array:
        """Returns the weights of the segments in averages over the repeats, shape (n + 1, N). There is one row for each rate, and a
        last row for the rest value."""
        q, n = self.spins.shape
        weights = np.zeros((n + 1, self.rest.shape[1]))
        weights[np.arange(n), self.spins] = 1 / q
        weights[n] = self.rest.mean(axis=0)
        return weights


@dataclass(frozen=True, slots=True)
class TiltedResults:
    """Contains the results of an evaluation for g temperatures and m axes.

    `means`: array of shape (g, m, 5), the five `QUANTITIES`, averaged over the repeats. `repeats`: for each temperature, an array
    (q, m, 5) with the quantities of each repeat. `residuals`: for each temperature, an array (n, m) with the residuals averaged
    over the repeats. `repeatability`: array of shape (g, m), standard deviation of K divided by K; NaN for a single repeat.
    `coefficient`: array of shape (m,), slope of K as a function of temperature, divided by K at the reference temperature.
    `sensitivity`: array of shape (m,), the largest |K_T − K_0|/(K_0·|T − T_0|), where K_T is the scale factor at the temperature T,
    and K_0 is the scale factor at the reference temperature T_0. `coefficient` and `sensitivity` are NaN for a single temperature.
    """

    means: Array
    repeats: tuple[Array, ...]
    residuals: tuple[Array, ...]
    repeatability: Array
    coefficient: Array
    sensitivity: Array

    @property
    def vector(self) -> Array:
        """Returns the results as one vector, in the order means, repeatability, coefficient, sensitivity."""
        return np.concatenate(
            [self.means.ravel(), self.repeatability.ravel(), self.coefficient.ravel(), self.sensitivity.ravel()]
        )


@dataclass(frozen=True, slots=True)
class Worst:
    """States which rates determine the nonlinearity, and which temperatures determine the sensitivity, of each axis.

    `rate`: array of shape (g, m), index of the rate with the largest residual at each temperature. `sign`: array of shape (g, m),
    sign of this residual. `temperature`: array of shape (m,), index of the temperature that determines the sensitivity.
    """

    rate: NDArray[np.int64]
    sign: Array
    temperature: NDArray[np.int64]


def make_group(series: Sequence[RateSeries], label: str, kelvin: float, commanded: Array, mean: Array) -> Group:
    """Combines the repeats at one temperature. `commanded`: array of shape (N,) in rad/s, rate of each segment. `mean`: array of
    shape (N, m), means of all segments. `kelvin`: the temperature, K."""
    spins = np.array([one.spins for one in series])
    before, after = (
        _weights(series, [one.start for one in series], mean),
        _weights(series, [one.end for one in series], mean),
    )
    rest = (before + after) / 2
    names, rates = tuple(one.name for one in series), commanded[spins[0]]
    between = after - before
    return Group(
        label, kelvin, names, rates, spins, rest, between, mean[spins] - (rest @ mean)[:, None], between @ mean
    )


def _weights(series: Sequence[RateSeries], rows: Sequence[tuple[int, ...]], mean: Array) -> Array:
    weights = np.zeros((len(series), len(mean)))
    for repeat, own in enumerate(rows):
        weights[repeat, [*own]] = 1 / len(own)
    return weights


def evaluate(
    groups: Sequence[Group], conditions: TiltedConditions, reference: int, worst: Worst | None = None
) -> TiltedResults:
    """Computes all results of an evaluation. `reference`: index of the group whose scale factor K is the reference for the other
    groups. `worst`: the rates and temperatures that determine nonlinearity and sensitivity, by default found from the data. `worst`
    is given if the evaluation is repeated with changed conditions, so that the same rates and temperatures are used."""
    lines = [fit_lines(conditions.inputs(group), group.outputs) for group in groups]
    residuals = [line.residuals.mean(axis=0) for line in lines]
    held = worst or _worst(residuals, np.zeros(lines[0].slope.shape[1], dtype=np.int64))
    repeats = [
        quantities(line, group.full_scale, held.rate[k], held.sign[k])
        for k, (group, line) in enumerate(zip(groups, lines, strict=True))
    ]
    means = np.array([one.mean(axis=0) for one in repeats])
    spread = [one[..., K].std(axis=0, ddof=1) if len(one) > 1 else np.full(one.shape[1], np.nan) for one in repeats]
    kelvin = np.array([group.kelvin for group in groups])
    coefficient, sensitivity = np.full((2, means.shape[1]), np.nan)
    if np.isfinite(kelvin).all() and np.ptp(kelvin) > 0:
        decides = worst.temperature if worst else _decisive(means[..., K], kelvin, reference)
        coefficient, sensitivity = over_temperature(means[..., K], kelvin, reference, decides)
    return TiltedResults(
        means, tuple(repeats), tuple(residuals), np.array(spread) / means[..., K], coefficient, sensitivity
    )


def quantities(line: RateLines, full_scale: Array, rate: NDArray[np.int64], sign: Array) -> Array:
    """Returns the five `QUANTITIES` (q, m, 5) of each repeat. `rate`: array of shape (m,), index of the rate with the largest
    residual. `sign`: array of shape (m,), sign of this residual. `full_scale`: array of shape (m,), largest absolute output of each
    axis."""
    at = line.residuals[:, rate, np.arange(len(rate))]
    return np.stack([line.slope, line.offset, sign * at / full_scale, line.asymmetry, line.response], axis=-1)


def columns_of_repeats(groups: Sequence[Group], conditions: TiltedConditions, axis: int) -> Array:
    """Returns the design matrix for the means of one output and R repeats, shape (N, 3·R). The model of a repeat has its own zero,
    its own offset at the rates, and its own scale factor, as in `fit_lines`. `axis`: index of the output's axis."""
    columns = []
    for group in groups:
        inputs = conditions.inputs(group)[..., axis]
        for spins, rest, x in zip(group.spins, group.rest, inputs, strict=True):
            zero, offset, slope = np.zeros((3, len(rest)))
            zero[rest != 0], zero[spins], offset[spins] = 1.0, 1.0, 1.0
            slope[spins] = x / np.abs(x).max()
            columns += [zero, offset, slope]
    return np.column_stack(columns)


def worst_of(groups: Sequence[Group], found: TiltedResults, reference: int) -> Worst:
    kelvin = np.array([group.kelvin for group in groups])
    return _worst(found.residuals, _decisive(found.means[..., K], kelvin, reference))


def _worst(residuals: Sequence[Array], temperature: NDArray[np.int64]) -> Worst:
    rate = np.array([np.abs(one).argmax(axis=0) for one in residuals])
    sign = np.array([np.sign(one[own, np.arange(len(own))]) for one, own in zip(residuals, rate, strict=True)])
    return Worst(rate, np.where(sign == 0, 1.0, sign), temperature)


def slope_weights(kelvin: Array) -> Array:
    """Returns one weight [1/K] for each of g temperatures, shape (g,). If values at these temperatures are multiplied by the
    weights and summed, the result is the slope of the straight line that fits the values. `kelvin`: array of shape (g,), the
    temperatures."""
    off = kelvin - kelvin.mean()
    return np.asarray(off / np.sum(off * off))


def answers_of(groups: Sequence[Group], conditions: TiltedConditions, worst: Worst) -> tuple[Array, ...]:
    """Returns, for each group, the derivatives of the quantities (averaged over the repeats) with respect to the output at each
    rate. The output is changed equally in all repeats. Each array has the shape (n, m, 5)."""
    return tuple(_answers(group, conditions, worst.rate[k], worst.sign[k]) for k, group in enumerate(groups))


def answers_to_averages(answers: Array) -> Array:
    """Returns the sensitivities of the five `QUANTITIES` of a group, shape (n + 1, m, 5). The first n rows are the sensitivities
    to the mean outputs at the n rates. The last row is the sensitivity to the mean output at rest, which is subtracted from the
    output at every rate. `Group.averages` gives these means. `answers`: array of shape (n, m, 5), sensitivities to the outputs at
    the rates (`answers_of`)."""
    return np.concatenate([answers, -answers.sum(axis=0)[None]])


def _answers(group: Group, conditions: TiltedConditions, rate: NDArray[np.int64], sign: Array) -> Array:
    """Returns the sensitivities of the quantities of one group to its outputs, shape (n, m, 5). The quantities of an axis depend
    only on the output of this axis, so the outputs of all axes are changed simultaneously. `rate`, `sign`: the same as in
    `quantities`."""
    x, full_scale = conditions.inputs(group), group.full_scale
    q, n, m = x.shape

    def means(changes: Array) -> Array:
        """Adds `changes` (n, k) to the outputs at each rate, and returns the resulting quantities (m·5, k), averaged over the
        repeats."""
        outputs = group.outputs + changes.T[:, None, :, None]
        lines = fit_lines(np.broadcast_to(x, outputs.shape).reshape(-1, n, m), outputs.reshape(-1, n, m))
        found = quantities(lines, full_scale, rate, sign)
        return np.asarray(found.reshape(-1, q, m * len(QUANTITIES)).mean(axis=1).T)

    return jacobian(means, np.zeros(n)).T.reshape(n, m, len(QUANTITIES))


def over_temperature(values: Array, kelvin: Array, reference: int, decides: NDArray[np.int64] | int) -> Array:
    """Returns an array of shape (2, m): the temperature coefficients and the sensitivities of the scale factors `values` (g, m) at
    the temperatures `kelvin` (g,). `reference`: index of the reference temperature. `decides`: index of the temperature that
    determines the sensitivity."""
    base, decisive = values[reference], values[decides, np.arange(values.shape[1])]
    change = (decisive - base) / (base * (kelvin[decides] - kelvin[reference]))
    return np.stack([slope_weights(kelvin) @ values / base, np.where(change.real < 0, -1.0, 1.0) * change])


def _decisive(values: Array, kelvin: Array, reference: int) -> NDArray[np.int64]:
    """Returns the indices (m,) of the temperatures at which the change of the scale factors `values` (g, m), divided by the
    distance from the reference temperature, is largest. `kelvin`: array of shape (g,), temperatures. `reference`: index of the
    reference temperature."""
    apart = np.abs(kelvin - kelvin[reference])
    away = np.isfinite(apart) & (apart > 0)
    size = np.abs(values - values[reference]) / np.where(away, apart, 1.0)[:, None]
    return np.asarray(np.where(away[:, None] & np.isfinite(size), size, -1.0).argmax(axis=0))
