"""Tables that go with a fit of several outputs: means and residuals by segment, uncertainties on either basis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.interface import Cell, Role, Table, TableColumn
from planrunner.estimators.outputs_fit import BASES, OutputsFit
from planrunner.observation.observations import Observations
from planrunner.uncertainty.decision import expanded_uncertainty

Array = NDArray[np.float64]


def residual_table(title: str, observed: str, observations: Observations, fit: OutputsFit) -> Table:
    """Means, residuals and each mean's uncertainty from its own segment. observed: what a row is, such as `position`."""
    columns = [TableColumn(observed)]
    for name, unit in zip(observations.channels, observations.units, strict=True):
        columns += [TableColumn(f"{name} {what}", Role.VALUE, unit) for what in ("mean", "residual")]
        columns.append(TableColumn(f"{name} u within", Role.STANDARD_UNCERTAINTY, unit))
    rows = []
    for n, label in enumerate(observations.labels):
        row: list[Cell] = [label]
        for k, one in enumerate(fit.fits):
            own = observations.standard_error[n, k]
            row += [
                float(observations.mean[n, k]),
                float(one.residuals[n]),
                float(own) if np.isfinite(own) else None,
            ]
        rows.append(tuple(row))
    return Table(title, tuple(columns), tuple(rows))


def bases_shown(chosen: str, fits: Sequence[OutputsFit]) -> list[str]:
    """The chosen basis, and the other one where all fits give it."""
    return [chosen, *(other for other in BASES if other != chosen and all(fit.available(other) for fit in fits))]


def spread_columns(basis: str) -> tuple[TableColumn, ...]:
    """Standard uncertainty, degrees of freedom and expanded uncertainty by one basis."""
    shown = basis.replace("_", " ")
    return (
        TableColumn(f"u ({shown})", Role.STANDARD_UNCERTAINTY),
        TableColumn(f"dof ({shown})", Role.DEGREES_OF_FREEDOM),
        TableColumn(f"U 95 % ({shown})", Role.EXPANDED_UNCERTAINTY),
    )


def basis_table(
    names: Sequence[str], units: Sequence[str], values: Array, spreads: Mapping[str, tuple[Array, Array]]
) -> Table:
    """Uncertainties (q,) by what the data show. spreads: basis → standard uncertainties and degrees of freedom, both (q,)."""
    columns = [TableColumn("coefficient"), TableColumn("unit"), TableColumn("value", Role.VALUE)]
    for basis in spreads:
        columns += spread_columns(basis)
    rows = []
    for q, name in enumerate(names):
        row: list[Cell] = [name, units[q], float(values[q])]
        for spread, freedom in spreads.values():
            u, dof = float(spread[q]), float(freedom[q])
            row += [u, dof, expanded_uncertainty(u, dof)]
        rows.append(tuple(row))
    return Table("Uncertainties of the data, on either basis", tuple(columns), tuple(rows))
