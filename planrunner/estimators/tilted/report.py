"""Makes the report on tilted scale factors: tables, plots, and notes on how reliable the results are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.estimators.method import Words
from planrunner.estimators.tables import Cell, Plot, Role, Table, TableColumn, by_columns
from planrunner.estimators.tilted.evaluation import ASYMMETRY, F0, NONLINEARITY, RESPONSE, Group, K
from planrunner.estimators.tilted.influences import Situation
from planrunner.estimators.tilted.mounting_comparison import comparison_table, scheduled_seconds, time_note
from planrunner.estimators.tilted.parameters import ScaleFactorTiltedParameters
from planrunner.estimators.tilted.rate_lines import lowest_pair, slope_unit
from planrunner.estimators.tilted.scatter import NoiseOfMeans, Scatter
from planrunner.estimators.tilted.turning_rates import part_turns
from planrunner.plan.schedule import Spin
from planrunner.plan.units import ZERO_CELSIUS, Unit, unit
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import Aspect, Influence

Units = Sequence[tuple[Unit, Unit]]

HALF = 0.5  # fraction of the expected change at which threshold and resolution are reached (IEEE Std 528)


def report(
    situation: Situation,
    units: Units,
    scatter: Scatter,
    within: Scatter,
    noise: NoiseOfMeans,
    acting: Sequence[Influence],
    parameters: ScaleFactorTiltedParameters,
) -> Words:
    """Makes the tables, plots, notes and warnings."""
    spread = _spread(scatter, situation)
    tables = (
        _per_axis(situation, units, spread),
        _per_repeat(situation),
        _residuals(situation, units),
        _lowest_rate(situation, units, noise),
        comparison_table(
            situation.conditions.axes, _relative(_spread(within, situation), situation), _angles(situation, acting)
        ),
    )
    plots = (_residual_plot(situation, units), *_temperature_plot(situation, spread))
    return Words(
        tables=tables,
        plots=plots,
        notes=tuple(_notes(situation, scatter, acting, parameters)),
        warnings=tuple(_warnings(situation)),
    )


# -- tables ----------------------------------------------------------------------------------------------------------


def _per_axis(situation: Situation, units: Units, spread: Array) -> Table:
    found, axes = situation.found, situation.conditions.axes
    slope, factor = slope_unit(*units[0])
    own = units[0][1].text
    along = axes.directions @ _along(situation)
    rows = [(axis, k, group) for axis in range(len(axes.names)) for k, group in enumerate(situation.groups)]

    def mean(quantity: int) -> Array:
        return np.array([found.means[k, axis, quantity] for axis, k, _ in rows])

    cosine = np.array([along[axis] for axis, _, _ in rows])
    repeatability = np.array([found.repeatability[k, axis] for axis, k, _ in rows])
    return by_columns(
        "Scale factor of each axis at each temperature",
        (TableColumn("axis"), [axes.names[axis] for axis, _, _ in rows]),
        (TableColumn("temperature"), [_celsius(group) for _, _, group in rows]),
        (TableColumn("K", Role.VALUE, slope), mean(K) * factor),
        (TableColumn("K'", Role.VALUE, slope), mean(K) * factor * cosine),
        (
            TableColumn("u(K), data alone", Role.STANDARD_UNCERTAINTY, slope),
            [float(spread[k, axis] * factor) for axis, k, _ in rows],
        ),
        (TableColumn("F0", Role.VALUE, own), mean(F0)),
        (TableColumn("nonlinearity", Role.VALUE, "ppm"), mean(NONLINEARITY) * 1e6),
        (TableColumn("asymmetry", Role.VALUE, "ppm"), mean(ASYMMETRY) * 1e6),
        (TableColumn("repeatability", Role.VALUE, "ppm"), repeatability * 1e6),
        (TableColumn("zero drift", Role.VALUE, own), [float(group.drift[:, axis].mean()) for axis, _, group in rows]),
        (TableColumn("repeats", Role.COUNT), [len(group.names) for _, _, group in rows]),
    )


def _per_repeat(situation: Situation) -> Table:
    names, found = situation.conditions.axes.names, situation.found
    rows: list[tuple[Cell, ...]] = [
        (group.label or "–", name, *(float(value) for value in (repeat[:, K] / mean[:, K] - 1) * 1e6))
        for group, repeats, mean in zip(situation.groups, found.repeats, found.means, strict=True)
        for name, repeat in zip(group.names, repeats, strict=True)
    ]
    columns = (
        TableColumn("temperature"),
        TableColumn("series"),
        *(TableColumn(name, Role.VALUE, "ppm") for name in names),
    )
    return Table("Scale factor in each repeat, relative to the mean at its temperature", columns, tuple(rows))


def _residuals(situation: Situation, units: Units) -> Table:
    rate = units[0][0]
    names = situation.conditions.axes.names
    rows: list[tuple[Cell, ...]] = []
    for group, residuals in zip(situation.groups, situation.found.residuals, strict=True):
        for own, one in zip(group.rates, residuals / group.full_scale * 1e6, strict=True):
            rows.append((group.label or "–", f"{own / rate.factor:+g}", *(float(value) for value in one)))
    columns = (
        TableColumn("temperature"),
        TableColumn("rate", Role.NUMBER, rate.text),
        *(TableColumn(name, Role.VALUE, "ppm") for name in names),
    )
    return Table("Residuals, means over the repeats, in ppm of the largest output", columns, tuple(rows))


def _lowest_rate(situation: Situation, units: Units, noise: NoiseOfMeans) -> Table:
    """Returns a table of two quantities: the response at the lowest rate (IEEE Std 528), and the smallest change of rate that can
    be distinguished from noise in a recording at this rate. This change is k·√2·u, where k is the coverage factor, and u is the
    standard uncertainty of the mean, converted to a rate."""
    axes, hour = situation.conditions.axes, unit("deg/h").factor
    group, found = situation.groups[situation.reference], situation.found
    high, low = lowest_pair(group.rates)
    repeats = math.sqrt(len(group.names))
    rows: list[tuple[Cell, ...]] = []
    for axis, name in enumerate(axes.names):
        cosine = abs(float(np.cos(axes.angles[axis])))
        own = noise.rates[situation.reference][[high, low], axis].max() * repeats
        freedom = float(noise.degrees_of_freedom[axis])
        rate = math.sqrt(2) * own / abs(found.means[situation.reference, axis, K]) / hour
        change = float(coverage_factor(freedom) * rate) if freedom > 0 else None
        seen = abs(group.rates[[high, low]]).max() * cosine
        response = float(found.means[situation.reference, axis, RESPONSE])
        rows.append(
            (
                name,
                float(seen / units[axis][0].factor),
                response,
                "yes" if response >= HALF else "no",
                change,
            )
        )
    text = units[0][0].text
    columns = (
        TableColumn("axis"),
        TableColumn("lowest rate along the axis", Role.VALUE, text),
        TableColumn("change of output, divided by the expected change", Role.VALUE),
        TableColumn("at least half of the expected change (IEEE Std 528)"),
        TableColumn("smallest change that can be distinguished from noise", Role.VALUE, "deg/h"),
    )
    return Table("Threshold and resolution at the lowest rate", columns, tuple(rows))


# -- plots -----------------------------------------------------------------------------------------------------------


def _residual_plot(situation: Situation, units: Units) -> Plot:
    group, residuals = situation.groups[situation.reference], situation.found.residuals[situation.reference]
    rate, order = units[0][0], np.argsort(group.rates)
    scaled = (residuals / group.full_scale * 1e6)[order]
    series = {
        name: tuple(float(value) for value in scaled[:, axis])
        for axis, name in enumerate(situation.conditions.axes.names)
    }
    where = f" at {group.label}" if group.label else ""
    x = tuple(float(value / rate.factor) for value in group.rates[order])
    return Plot(
        f"Residuals from the straight line{where}",
        f"rate [{rate.text}]",
        "residual [ppm of the largest output]",
        x,
        series,
    )


def _temperature_plot(situation: Situation, spread: Array) -> tuple[Plot, ...]:
    if not np.isfinite(situation.found.coefficient).all():
        return ()
    values, reference = situation.found.means[..., K], situation.reference
    kelvin = np.array([group.kelvin for group in situation.groups])
    order = np.argsort(kelvin)
    x = tuple(float(value - ZERO_CELSIUS) for value in kelvin[order])
    change = (values / values[reference] - 1)[order] * 1e6
    width = (spread / np.abs(values))[order] * 1e6
    names = situation.conditions.axes.names
    series = {name: tuple(float(value) for value in change[:, axis]) for axis, name in enumerate(names)}
    widths = {name: tuple(float(value) for value in width[:, axis]) for axis, name in enumerate(names)}
    title = f"Scale factor over temperature, relative to {situation.groups[reference].label}"
    return (Plot(title, "temperature [degC]", "change of K [ppm]", x, series, widths),)


# -- words -----------------------------------------------------------------------------------------------------------


def _notes(
    situation: Situation, scatter: Scatter, acting: Sequence[Influence], parameters: ScaleFactorTiltedParameters
) -> list[Said]:
    axes, segments = situation.conditions.axes, situation.segments
    seconds = scheduled_seconds(segments, situation.seconds)
    notes = [
        _basis_words(situation, scatter, parameters.uncertainty, acting),
        _earth_words(situation, parameters.earth_rate),
        time_note(seconds, len(axes.names), parameters.remounting.value),
        said(
            "Nonlinearity, response and offset are computed from the means over the repeats; asymmetry is "
            "2·(K₊ − K₋)/(K₊ + K₋), where K₊ and K₋ are the slopes of two half-lines that meet at zero rate. K' is the slope of the "
            "output over the rate of the table; K is the slope over the rate about the axis."
        ),
    ]
    angles = _angles(situation, acting)
    if not angles.any():
        notes.append(
            said(
                "No uncertainty of the fixture's angles is stated, so the budgets lack the usually dominant contribution: "
                "tan θ·u(θ)."
            )
        )
    if not np.isfinite(situation.found.coefficient).all():
        notes.append(said("All rates were run at one temperature, so there is no temperature coefficient."))
    return notes


def _basis_words(situation: Situation, scatter: Scatter, basis: str, acting: Sequence[Influence]) -> Said:
    names_of_acting = {item.quantity.name for item in acting}
    outputs = situation.conditions.axes.outputs
    declared = [output for output in outputs if Aspect.BIAS_INSTABILITY.of(output) in names_of_acting]
    if basis == "residual" and declared:
        return said(
            "Uncertainties are based on the residuals of the rates (means over the repeats) about the line. For "
            "{outputs}, a common factor from the residuals multiplies noise and declared flicker. The budget "
            "therefore lists flicker without adding it; "
            "it does not add the drift between the zeros either, because that drift is one sample of the flicker. Any other "
            "drift is in the budget as an offset.",
            outputs=tuple(declared),
        )
    if basis == "residual":
        return said(
            "Uncertainties are based on the residuals of the rates (means over the repeats) about the line; a drift between "
            "the zeros that exceeds their noise (1 %) is also in the budget, as an offset."
        )
    if basis == "within_segment" and declared:
        return said(
            "Uncertainties are based on the noise within the segments; changes from segment to segment are included only if "
            "stated. The budget contains the flicker of {outputs} as declared, in place of the drift between the zeros, "
            "which is one sample of that flicker.",
            outputs=tuple(declared),
        )
    if basis == "within_segment":
        return said(
            "Uncertainties are based on the noise within the segments; changes from segment to segment are included only if "
            "stated."
        )
    repeats = min(len(group.names) for group in situation.groups)
    if len(situation.groups) == 1:
        return said("Uncertainties are based on the scatter of {repeats} repeats at each temperature.", repeats=repeats)
    apart = int((~scatter.pooled).sum())
    if not apart:
        return said(
            "Uncertainties are based on the scatter of {repeats} repeats at each temperature, pooled over the temperatures.",
            repeats=repeats,
        )
    return said(
        "Uncertainties are based on the scatter of {repeats} repeats at each temperature. The scatter is pooled over the "
        "temperatures, except in {apart} of {quantities} quantities, where it differs between temperatures (Bartlett's test at a "
        "significance level of 1 %).",
        repeats=repeats,
        apart=apart,
        quantities=len(scatter.pooled),
    )


def _earth_words(situation: Situation, how: str) -> Said:
    site, axes = situation.site, situation.conditions.axes
    hour = unit("deg/h").factor
    about = next(
        np.asarray(one.motion.about) for one in situation.segments if isinstance(one.motion, Spin) and one.rate
    )
    earth = site.earth_rate_enu
    across = float(np.linalg.norm(earth - about * (earth @ about) / (about @ about)))
    most = across * float(np.abs(np.sin(axes.angles)).max()) / hour
    if how == "corrected":
        parts = part_turns(situation.segments, situation.seconds, [0.0] * len(situation.segments))
        if parts:
            return said(
                "The results are corrected for the Earth rate; its component perpendicular to the table's rotation axis contributes up to "
                "{most:.3g} deg/h to the input of a sensor axis. If a recording covers an incomplete turn, its "
                "starting angle is computed from the planned spin-up "
                "and settling.",
                most=most,
            )
        return said(
            "The results are corrected for the Earth rate; its component perpendicular to the table's rotation axis contributes up to "
            "{most:.3g} deg/h to the input of a sensor axis.",
            most=most,
        )
    ways = {"averaged": said("averaged"), "ignored": said("ignored")}
    return said(
        "The component of the Earth rate perpendicular to the table's rotation axis is {how}, not corrected. F0 contains "
        "the part of this component that the gyros measured at rest in the home position, up to {most:.3g} deg/h on a "
        "sensor axis.",
        how=ways.get(how, how),
        most=most,
    )


def _warnings(situation: Situation) -> list[Said]:
    found, axes = situation.found, situation.conditions.axes
    return [
        said(
            "{axis}: at the lowest rate, the change of the output is {share:.2g} times the change expected from the scale "
            "factor. This is less than half, so the rate is within the threshold or dead zone (IEEE Std 528).",
            axis=name,
            share=float(value),
        )
        for name, value in zip(axes.names, found.means[situation.reference, :, RESPONSE], strict=True)
        if value < HALF
    ]


# -- figures that several of them need -------------------------------------------------------------------------------


def _spread(scatter: Scatter, situation: Situation) -> Array:
    """Returns the standard uncertainty of K from the data alone, shape (g, m)."""
    diagonal = np.diagonal(scatter.covariance, axis1=1, axis2=2)
    return np.sqrt(diagonal).reshape(situation.found.means.shape)[..., K]


def _relative(spread: Array, situation: Situation) -> Array:
    at = situation.reference
    shares: Array = np.abs(spread[at] / situation.found.means[at, :, K])
    return shares


def _angles(situation: Situation, acting: Sequence[Influence]) -> Array:
    """Returns the standard uncertainty [rad] of each axis's angle, shape (m,), from the plan or from the calibration of the
    fixture; zero if none is stated."""
    axes = situation.conditions.axes
    stated = {f"fixture angle {name}": k for k, name in enumerate(axes.names)}
    found = np.zeros(len(axes.names))
    for item in situation.fixture:
        found += item.quantity.standard_uncertainty**2 * np.sum(item.sensitivities**2, axis=1)
    if not situation.fixture:
        for item in acting:
            if item.quantity.name in stated:
                found[stated[item.quantity.name]] = item.quantity.standard_uncertainty**2
    return np.sqrt(found)


def _along(situation: Situation) -> Array:
    """Returns the rotation axis as a vector (3,) in the fixture's frame."""
    along = situation.conditions.along
    return np.asarray(along[int(np.argmax(np.abs(along).sum(axis=1)))])


def _celsius(group: Group) -> str:
    return "–" if math.isnan(group.kelvin) else f"{group.kelvin - ZERO_CELSIUS:.2f} °C"
