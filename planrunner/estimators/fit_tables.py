"""Makes the tables and the plot of a fit of several outputs: means and residuals of the segments, and uncertainties from residuals
and from noise within segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.estimators.derived import Derived
from planrunner.estimators.outputs_fit import BASES, OutputsFit
from planrunner.estimators.tables import Cell, FilledColumn, Plot, Role, Table, TableColumn, by_columns, known
from planrunner.observation.observations import Observations
from planrunner.uncertainty.decision import expanded_uncertainty


def mean_and_residual(observations: Observations, fit: OutputsFit, output: int) -> list[FilledColumn]:
    """Returns two columns of a table for one output: the means of the segments, and the residuals of these means."""
    name, unit = observations.channels[output], observations.units[output]
    return [
        (TableColumn(f"{name} mean", Role.VALUE, unit), observations.mean[:, output]),
        (TableColumn(f"{name} residual", Role.VALUE, unit), fit.fits[output].residuals[: len(observations.labels)]),
    ]


def residual_table(title: str, observed: str, observations: Observations, fit: OutputsFit) -> Table:
    """Makes a table of the means, their residuals, and the uncertainty that each mean has from the noise within its segment.
    `observed`: title of the first column, such as `position`."""
    columns: list[FilledColumn] = [(TableColumn(observed), observations.labels)]
    for k, (name, unit) in enumerate(zip(observations.channels, observations.units, strict=True)):
        within = TableColumn(f"{name} u within segment", Role.STANDARD_UNCERTAINTY, unit)
        columns += [*mean_and_residual(observations, fit, k), (within, known(observations.standard_error[:, k]))]
    return by_columns(title, *columns)


def drift_tables(fits: Sequence[OutputsFit], basis: str) -> tuple[Table, ...]:
    """Makes a table of the drifts that are fitted together with the coefficients. Returns no table if no drift is fitted."""
    rows: list[tuple[Cell, ...]] = []
    for fit in fits:
        spreads, p = fit.drift_spreads, fit.matrix.shape[1]
        size = np.sqrt(fit.variance_factors) if basis == "residual" else np.ones(len(fit.outputs))
        moved = fit.columns[:, p:] * fit.all_coefficients[:, None, p:]  # (m, n, q)
        for k, (output, unit) in enumerate(zip(fit.outputs, fit.units, strict=True)):
            freedom = fit.drift_freedom(k, basis)
            for q, (name, per) in enumerate(zip(fit.drift.names, fit.drift.units, strict=True)):
                u = float(spreads[k, q] * size[k])
                amplitude, change = float(fit.all_coefficients[k, p + q]), float(np.ptp(moved[k, :, q]))
                share = None if fit.drift.explained is None else float(100 * fit.drift.explained[k])
                row = (output, name, amplitude, u, freedom, expanded_uncertainty(u, freedom), f"{unit}/{per}")
                rows.append((*row, change, unit, share))
    if not rows:
        return ()
    columns = (
        TableColumn("output"),
        TableColumn("drift"),
        TableColumn("amplitude", Role.VALUE),
        TableColumn("u", Role.STANDARD_UNCERTAINTY),
        TableColumn("dof", Role.DEGREES_OF_FREEDOM),
        TableColumn("U 95 %", Role.EXPANDED_UNCERTAINTY),
        TableColumn("unit of the amplitude"),
        TableColumn("range during the test", Role.VALUE),
        TableColumn("unit"),
        TableColumn("share of the scatter that all drifts explain", Role.VALUE, "%"),
    )
    return (Table("Drifts fitted together with the coefficients", columns, tuple(rows)),)


def bases_shown(chosen: str, fits: Sequence[OutputsFit]) -> list[str]:
    """Lists the kinds of uncertainty that a table shows: first the chosen kind, then the other kind if all fits have it."""
    return [chosen, *(other for other in BASES if other != chosen and all(fit.available(other) for fit in fits))]


def spread_columns(basis: str) -> tuple[TableColumn, ...]:
    """Makes the table columns for one kind of uncertainty: standard uncertainty, degrees of freedom and expanded uncertainty."""
    shown = basis.replace("_", " ")
    return (
        TableColumn(f"u ({shown})", Role.STANDARD_UNCERTAINTY),
        TableColumn(f"dof ({shown})", Role.DEGREES_OF_FREEDOM),
        TableColumn(f"U 95 % ({shown})", Role.EXPANDED_UNCERTAINTY),
    )


def bases_table(found: Derived, chosen: str, count: int | None = None) -> Table:
    """Makes a table of the Type A uncertainties of the first `count` quantities. The table contains the chosen kind of uncertainty.
    The table also contains the other kind, if this kind is known for all fits."""
    bases = bases_shown(chosen, found.fits)
    spreads = [found.spread(basis) for basis in bases]
    columns = [TableColumn("coefficient"), TableColumn("unit"), TableColumn("value", Role.VALUE)]
    columns += [column for basis in bases for column in spread_columns(basis)]
    rows = []
    for q, one in enumerate(found.quantities[:count]):
        row: list[Cell] = [one.name, one.unit, float(found.values[q])]
        for spread, freedom in spreads:
            u, dof = float(spread[q]), float(freedom[q])
            row += [u, dof, expanded_uncertainty(u, dof)]
        rows.append(tuple(row))
    return Table("Uncertainties from the data, on each basis", tuple(columns), tuple(rows))


def residual_plot(
    observations: Observations,
    fit: OutputsFit,
    title: str = "Residuals per position",
    x_title: str = "position",
    x: tuple[float | str, ...] = (),
) -> Plot:
    """Plots the residuals with one series per output, in the unit of the first output. The abscissa is `x`, or the labels of the
    segments if `x` is not given."""
    n = len(observations.labels)
    series = {
        name: tuple(map(float, one.residuals[:n])) for name, one in zip(observations.channels, fit.fits, strict=True)
    }
    spreads = {
        name: tuple(map(float, noise.sigma[:n]))
        for name, noise in zip(observations.channels, fit.noises, strict=True)
        if noise.known
    }
    return Plot(title, x_title, f"residual [{observations.units[0]}]", x or observations.labels, series, spreads)
