"""Chooses the averaging times of a record, and determines whether there are enough averages for a fit.

The same rules apply to planned and to recorded data.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Integers
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import count_of
from planrunner.estimators.allan.confidence import freedom_of_runs
from planrunner.estimators.allan.table import octave_factors
from planrunner.estimators.interface import DesignRequest, EstimationError, Remark
from planrunner.plan.quantity import Quantity

LEAST_FREEDOM = 3.0  # fewest degrees of freedom of an Allan variance that takes part in the fit
_NEGLIGIBLE = 1e-6  # probability
_EXPONENTS = (-2, -1, 0, 1, 2)  # of the kinds of noise that an Allan variance distinguishes


@dataclass(frozen=True, slots=True)
class PlannedRecord:
    """The size of a planned record. `interval`: time between samples, s. `lengths`: array of shape (r,), number of phase points of
    each segment, one more than the number of its samples."""

    interval: float
    lengths: Integers


def planned_record(request: DesignRequest[object]) -> PlannedRecord | None:
    """Predicts which record the planned segments will give. Returns None if the length of a dwell is not known. Raises
    `EstimationError` if the segments have different sample rates."""
    hertz = {segment.sample_rate or request.sensor.sample_rate for segment in request.segments}
    if not request.segments or any(segment.dwell is None for segment in request.segments):
        return None
    if len(hertz) > 1:
        rates = " and ".join(f"{rate:g}" for rate in sorted(hertz)[:2])
        raise EstimationError(f"the segments are sampled at {rates} Hz: choose `segments` with one sample rate")
    rate = hertz.pop()
    lengths = [1 + max(1, round((segment.dwell or 0.0) * rate)) for segment in request.segments]
    return PlannedRecord(1 / rate, np.array(lengths, dtype=np.int64))


def averaging_factors(taus: Sequence[Quantity], lengths: Integers, interval: float, name: str) -> Integers:
    """Returns the averaging factors to use, as an array. The factors belong to the times in `taus` that fit at least twice into the
    longest run. If `taus` is empty, the factors are octaves. `lengths`: number of phase points of each run. `interval`: time
    between phase points, s. Raises `EstimationError` if there is no such factor."""
    if not taus:
        return octave_factors(lengths)
    wanted = np.unique([max(1, round(tau.value / interval)) for tau in taus]).astype(np.int64)
    usable: Integers = wanted[2 * wanted + 1 <= lengths.max()]
    if not usable.size:
        longest = (int(lengths.max()) - 1) * interval
        raise EstimationError(
            f"'{name}': every averaging time in `taus` needs a stretch without gaps that is longer than the {longest:.4g} s of the plan"
        )
    return usable


def takes_part(tau: float, freedom: float, fit_up_to: Quantity | None) -> bool:
    """Returns True if an Allan variance at `tau` [s] with `freedom` degrees of freedom takes part in the fit."""
    return freedom >= LEAST_FREEDOM and (fit_up_to is None or tau <= fit_up_to.value * (1 + 1e-9))


def require_averaging_times(name: str, count: int) -> None:
    """Raises `EstimationError` if the variances can be fitted at fewer than two averaging times."""
    if count < 2:
        raise EstimationError(
            f"'{name}': the deviations are known well enough to be fitted at only {count_of(count, 'averaging time')}: "
            f"record for longer, or raise `fit_up_to`"
        )


def planned_averaging(
    request: DesignRequest[object],
    names: Sequence[str],
    taus: Sequence[Quantity],
    fit_up_to: Quantity | None,
) -> tuple[Remark, ...]:
    """Returns remarks about averaging times for which the planned record is too short. Raises `EstimationError` in the same cases
    as the estimate."""
    record = planned_record(request)
    if record is None or not names:
        return ()
    lengths, interval = record.lengths, record.interval
    factors = averaging_factors(taus, lengths, interval, names[0])
    freedoms = {factor: _least_freedom(factor, lengths) for factor in factors.tolist()}
    fitted = [factor for factor, freedom in freedoms.items() if takes_part(factor * interval, freedom, fit_up_to)]
    require_averaging_times(names[0], len(fitted))
    longest = interval * max(
        factor for factor, freedom in freedoms.items() if takes_part(factor * interval, freedom, None)
    )
    whole = (int(lengths.max()) - 1) * interval
    found = []
    if fit_up_to is not None and fit_up_to.value > whole / 2:
        message = (
            f"`fit_up_to` is {fit_up_to}, but with the longest dwell of {whole:.4g} s, the deviations are known "
            f"well enough to be fitted only up to {longest:.4g} s"
        )
        hint = f"dwell for at least {_twice(fit_up_to)}, or lower `fit_up_to`"
        found.append(Remark("physics-averaging", message, hint, "fit_up_to"))
    beyond = [tau for tau in taus if 2 * max(1, round(tau.value / interval)) + 1 > lengths.max()]
    if beyond:
        message = (
            f"the averaging time {beyond[0]} needs a dwell of twice its length, but the longest dwell is {whole:.4g} s: this "
            "averaging time is left out"
        )
        found.append(
            Remark(
                "physics-averaging",
                message,
                f"dwell for at least {_twice(beyond[0])}, or remove it from `taus`",
                "taus",
            )
        )
    for output in (output for output in request.sensor.outputs if output.name in names and output.noise.white > 0):
        if output.noise.chance_of_no_change(whole, 1 / interval) > _NEGLIGIBLE:
            message = f"the declared noise of '{output.name}' may be too small to change a reading within {whole:.4g} s"
            hint = "dwell longer, or leave the output out: a reading that never changes has no Allan deviation"
            found.append(Remark("physics-resolution", message, hint, "outputs"))
    return tuple(found)


def _least_freedom(factor: int, lengths: Integers) -> float:
    """Returns the smallest number of degrees of freedom that an Allan variance can have. The number depends on the type of noise,
    which is not known before the recording. `lengths`: number of phase points of each run."""
    return min(freedom_of_runs(alpha, 2, factor, lengths) for alpha in _EXPONENTS)


def _twice(tau: Quantity) -> str:
    return f"{2 * tau.value / tau.unit.factor:g} {tau.unit.text}"
