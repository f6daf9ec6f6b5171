"""Takes the angles of a fixture, and the influences on these angles, from an estimate of `fixture_angles` instead of from the
plan."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.estimators.interface import Coefficient, Design, Estimate, EstimationError
from planrunner.estimators.tilted.mounted_axes import MountedAxes, seeing
from planrunner.plan.units import unit
from planrunner.uncertainty.influences import Influence, InputQuantity

Used = TypeVar("Used", Design, Estimate)

_ANGLE = "angle_{}"
_AZIMUTH = "azimuth_{}"


def calibrated_axes(axes: MountedAxes, uses: Mapping[str, Estimate]) -> tuple[MountedAxes, tuple[Influence, ...]]:
    """Returns the axes with their calibrated angles, and the influences (m, r) on these angles, rad. If there is no calibration,
    the axes are unchanged.

    Raises `EstimationError` for an estimate that is not a calibration of the fixture, or that does not contain all axes.
    """
    if not uses:
        return axes, ()
    name, used = _only(uses)
    rows = _rows(axes, [item.name for item in used.coefficients], name)
    covariance = used.covariance if used.data_covariance is None else used.data_covariance
    freedom = [_data_freedom(used, used.coefficients[row]) for row in rows]
    influences = _carried(axes, used.coefficients, rows, covariance, used.influences, freedom, name)
    return seeing(_at(axes, used.coefficients)), influences


def require_calibration(axes: MountedAxes, uses: Mapping[str, Design]) -> None:
    """Checks that a planned estimate will calibrate the fixture. Raises `EstimationError` if this estimate will not be a
    calibration of the fixture, or will not contain all axes."""
    if uses:
        name, used = _only(uses)
        if used.known:
            _rows(axes, list(used.foreseen), name)


def _only(uses: Mapping[str, Used]) -> tuple[str, Used]:
    if len(uses) > 1:
        raise EstimationError(f"it uses {' and '.join(uses)}: name one calibration of the fixture")
    return next(iter(uses.items()))


def _rows(axes: MountedAxes, names: Sequence[str], used: str) -> list[int]:
    wanted = [_ANGLE.format(axis) for axis in axes.names]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise EstimationError(
            f"'{used}' has no coefficient '{missing[0]}': `uses` must name a `fixture_angles` estimate of the same axes"
        )
    return [names.index(name) for name in wanted]


def _carried(
    axes: MountedAxes,
    coefficients: Sequence[Coefficient],
    rows: Sequence[int],
    covariance: Array,
    acting: Sequence[Influence],
    freedom: Sequence[float],
    name: str,
) -> tuple[Influence, ...]:
    """Returns the influences on the angles: one influence for each axis, due to the data of the calibration, and the influences
    that acted on the calibration itself."""
    factors = np.array([unit(coefficients[row].unit).factor for row in rows])
    arcsec = unit("arcsec").factor
    found = []
    for k, row in enumerate(rows):
        spread = float(np.sqrt(covariance[row, row]) * factors[k])
        quantity = InputQuantity(
            f"fixture angle {axes.names[k]}",
            float(coefficients[row].value * factors[k]),
            "rad",
            spread,
            freedom[k],
            "t" if math.isfinite(freedom[k]) else "normal",
            f"data of the estimate '{name}'",
            shown="arcsec",
            shown_factor=arcsec,
        )
        found.append(Influence(quantity, np.eye(len(rows))[:, [k]]))
    found += [replace(item, sensitivities=item.sensitivities[[*rows]] * factors[:, None]) for item in acting]
    return tuple(found)


def _at(axes: MountedAxes, coefficients: Sequence[Coefficient]) -> MountedAxes:
    known = {item.name: item.value * unit(item.unit).factor for item in coefficients if item.unit == "deg"}

    def of(form: str, stated: Array) -> Array:
        return np.array(
            [known.get(form.format(axis), float(own)) for axis, own in zip(axes.names, stated, strict=True)]
        )

    return replace(axes, angles=of(_ANGLE, axes.angles), azimuths=of(_AZIMUTH, axes.azimuths))


def _data_freedom(used: Estimate, item: Coefficient) -> float:
    """Returns the degrees of freedom that an angle has because of the data of the calibration alone, without the influences. The
    degrees of freedom are computed from the budget, because the degrees of freedom in the estimate include the influences."""
    for budget in used.budgets:
        if budget.coefficient == item.name:
            return next((line.degrees_of_freedom for line in budget.lines if line.kind == "A"), item.degrees_of_freedom)
    return item.degrees_of_freedom
