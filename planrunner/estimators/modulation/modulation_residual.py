"""Determines the effect of rotating the sensor on its navigation, by comparing a navigation without rotation with one or more
navigations with rotation.

Each navigation is a `strapdown_navigation` estimate. The errors of the navigations over their common time give the ratio of CEP
rates (CEP: circular error probable) and the suppression of the position error. Over whole cycles, the part of the error that
repeats with the cycle is separated and compared with a prediction. The prediction is computed from the declared constant errors,
from the harmonics of the cycle, and from the residual of the cycle, which is the part of an error that the cycle does not cancel.
docs/rotation-cycles.md gives the theory and results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    Foresight,
    Remark,
    UnfitDataError,
    Unpredicted,
)
from planrunner.estimators.modulation.fit import PeriodicPart, TooLittleError, periodic_part
from planrunner.estimators.modulation.navigations import Navigation, compared, rotation
from planrunner.estimators.modulation.prediction import errors_over_time, horizontal, periodic_amplitudes
from planrunner.estimators.strapdown.navigation_errors import HOUR, NAUTICAL_MILE
from planrunner.estimators.tables import Cell, Plot, Role, Table, TableColumn, by_columns
from planrunner.plan.kinds import ListOf, QuantityOf, Record, key
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Segment

_AMPLITUDE = "modulation_{}"
LONGEST = 4 * 86400.0  # s, longest planned navigation whose errors are predicted


class ModulationResidualParameters(Record):
    """Declares the plan keys of the estimator `modulation_residual`."""

    gyro_errors: tuple[Quantity, ...] = key(
        ListOf(QuantityOf("angular rate"), minimum=3, maximum=3),
        "Declared constant errors of the gyros about x, y and z; the prediction of navigation errors uses them.",
        ["0.02 deg/h", "-0.015 deg/h", "0.01 deg/h"],
        default_factory=tuple,
    )
    accelerometer_errors: tuple[Quantity, ...] = key(
        ListOf(QuantityOf("acceleration"), minimum=3, maximum=3),
        "Declared constant errors of the accelerometers along x, y and z.",
        ["50 ug", "-40 ug", "30 ug"],
        default_factory=tuple,
    )

    @property
    def declared(self) -> Array | None:
        """Returns the declared constant errors of gyros [rad/s] and accelerometers [m/s²], shape (6,); None if the plan states no
        constant errors."""
        if not self.gyro_errors and not self.accelerometer_errors:
            return None
        parts = (self.gyro_errors, self.accelerometer_errors)
        return np.concatenate([[item.value for item in part] if part else np.zeros(3) for part in parts])


class ModulationResidual:
    """Implements the estimator `modulation_residual`."""

    summary = "Navigation errors with and without rotation of the sensor: suppression, CEP rates, residual modulation"
    Parameters = ModulationResidualParameters

    def design(self, request: DesignRequest[ModulationResidualParameters]) -> Design:
        """Returns a design without coefficients. The notes of the design give the residuals of the cycles. If the navigations
        cannot be compared, a remark gives the reason."""
        moving = [segment for segment in request.segments if rotation(segment.motion, request.setup.table) is not None]
        if not moving or len(request.uses) < 2:
            message = (
                "the comparison needs a navigation with rotation and one without rotation, and the segments of both"
            )
            hint = "name both in `uses` and their segments in `segments`"
            return Design((), remarks=(Remark("physics-modulation", message, hint, "uses", error=True),))
        lacks = _lacks(request)
        if lacks is not None:
            return Design((), remarks=(lacks,))
        followed = {segment.index - 1: segment.motion for segment in moving}
        told = [
            segment for segment in moving if followed.get(segment.index) != segment.motion
        ]  # an alignment belongs to the segment that follows
        return Design((), notes=tuple(_left(segment, request) for segment in told))

    def foresee(self, request: DesignRequest[ModulationResidualParameters]) -> Foresight:
        """Gives the names of the coefficients, but no expected values. The values depend on the errors of the individual
        navigations, which cannot be predicted."""
        designs = list(request.uses.items())
        if not all("turned" in design.extra for _, design in designs):
            return Foresight()
        turned = [name for name, design in designs if design.extra["turned"]]
        still = next((name for name, design in designs if not design.extra["turned"]), "")
        why = "it compares the errors of single navigations, which cannot be predicted"
        rows = [row for name in turned for row in _compared(name, still)]
        rows += [(_AMPLITUDE.format(name), "m", _amplitude(name)) for name in turned]
        return Foresight(unpredicted=tuple(Unpredicted(name, text, why, words) for name, text, words in rows))

    def estimate(self, request: EstimateRequest[ModulationResidualParameters]) -> Estimate:
        """Compares the navigations. Raises `EstimationError` if the plan or the data are not suitable."""
        navigations = compared(request)
        (still,) = (item for item in navigations if item.cycle is None)
        turned = [item for item in navigations if item.cycle is not None]
        coefficients, covariance = _ratios(still, turned)
        periodic, notes = _periodic(turned, request)
        amplitudes = tuple(
            Coefficient(
                _AMPLITUDE.format(name), part.largest_position(), "m", part.position_noise(), description=_amplitude(name),
            )
            for name, part in periodic.items()
        )  # fmt: skip
        everything = (*coefficients, *amplitudes)
        whole = np.zeros((len(everything), len(everything)))
        whole[: len(coefficients), : len(coefficients)] = covariance
        for row, item in enumerate(amplitudes, start=len(coefficients)):
            whole[row, row] = item.standard_uncertainty**2
        tables = [_figures(navigations), *_cycles(turned, periodic, request), *_predicted(navigations, request)]
        return Estimate(
            request.name,
            "modulation_residual",
            everything,
            whole,
            headline=tuple(item.name for item in coefficients),
            settings={"compared over": f"{still.course[0, -1]:.6g} s", "without rotation": still.name},
            tables=tuple(tables),
            plots=_plots(navigations),
            notes=notes,
            segments=tuple(recorded.label for recorded in request.segments),
        )


def _lacks(request: DesignRequest[ModulationResidualParameters]) -> Remark | None:
    """Returns an error if the key `segments` lacks a segment of one of the navigations. Returns None if no segment is missing, or
    if the designs of the used estimates do not contain the labels of the segments."""
    told = {name: used.extra for name, used in request.uses.items() if used is not None and "navigated" in used.extra}
    if len(told) < len(request.uses):
        return None
    labels = {segment.label for segment in request.segments}
    for name, extra in told.items():
        if extra["navigated"] not in labels:
            message = f"`segments` lacks '{extra['navigated']}', the segment of the navigation '{name}'"
            return Remark("physics-modulation", message, "name the segments of every navigation in `uses`", error=True)
    still = [name for name, extra in told.items() if not extra["turned"]]
    if len(still) == 1:
        return None
    found = f"{' and '.join(still)} are" if still else "none is"
    message = (
        f"of the navigations used, {found} without rotation, but the comparison needs exactly one without rotation"
    )
    return Remark(
        "physics-modulation",
        message,
        "name one navigation at rest in `uses`, and those with rotation",
        "uses",
        error=True,
    )


def _amplitude(name: str) -> Said:
    return said("Amplitude of the part of the position error of '{name}' that repeats with its cycle", name=name)


def _compared(name: str, still: str) -> tuple[tuple[str, str, Said], tuple[str, str, Said]]:
    """Returns name, unit and description of two results of a navigation with rotation: the ratio of CEP rates and the
    suppression."""
    return (
        (
            f"cep_rate_ratio_{name}",
            "1",
            said("CEP rate of '{first}' divided by that of '{second}'", first=name, second=still),
        ),
        (
            f"suppression_{name}",
            "1",
            said("RMS radial error of '{first}' divided by that of '{second}'", first=still, second=name),
        ),
    )


def _ratios(still: Navigation, turned: Sequence[Navigation]) -> tuple[tuple[Coefficient, ...], Array]:
    """Returns the ratios of CEP rates and the suppressions, with their covariance (m, m). The m results are correlated, because
    each of them is a comparison with the same navigation without rotation."""
    if still.rms == 0.0:
        raise UnfitDataError(f"'{still.name}' has no position error at all, so nothing can be compared with it")
    coefficients, rows = [], []
    for number, item in enumerate(turned):
        ratio = item.cep_rate / still.cep_rate
        suppression = still.rms / item.rms if item.rms else math.inf
        if not math.isfinite(suppression):
            raise UnfitDataError(f"'{item.name}' has no position error at all, so no suppression can be computed")
        own = np.zeros(len(turned))
        own[number] = item.spread
        for (name, text, words), value, sign in zip(
            _compared(item.name, still.name), (ratio, suppression), (1.0, -1.0), strict=True
        ):
            row = value * sign * np.append(own, -still.spread)
            rows.append(row)
            coefficients.append(Coefficient(name, value, text, float(np.linalg.norm(row)), description=words))
    matrix = np.array(rows)
    return tuple(coefficients), matrix @ matrix.T


def _periodic(
    turned: Sequence[Navigation], request: EstimateRequest[ModulationResidualParameters]
) -> tuple[dict[str, PeriodicPart], tuple[Said, ...]]:
    found: dict[str, PeriodicPart] = {}
    notes = []
    for item in turned:
        assert item.cycle is not None
        time, velocity = item.course[0], item.course[3] + 1j * item.course[4]
        try:
            part = periodic_part(time, velocity, item.cycle.period, item.highest, request.site)
        except TooLittleError as error:
            notes.append(
                said(
                    "The part of '{name}' that repeats with its cycle cannot be determined: {reason}.",
                    name=item.name,
                    reason=str(error),
                )
            )
            continue
        found[item.name] = part
        if part.hidden:
            notes.append(
                said(
                    "'{name}': harmonic {numbers} of the cycle cannot be distinguished from free oscillations and is left out.",
                    name=item.name,
                    numbers=tuple(map(str, part.hidden)),
                )
            )
    notes.append(
        said(
            "The ratios compare navigation runs of one sensor over the same time. Their uncertainties come from the white noise and "
            "the declared bias instability of the navigation runs; the contribution of each run is an upper bound. Errors that rotation "
            "does not modulate (azimuth gyro, alignment) remain in all navigation runs. Scale factor errors and misalignments act during "
            "the turns and also repeat with the cycle; the prediction from constant errors does not include them."
        )
    )
    return found, tuple(notes)


def _figures(navigations: Sequence[Navigation]) -> Table:
    speeds = [float(np.sqrt(np.mean(item.course[3] ** 2 + item.course[4] ** 2))) for item in navigations]
    cycles = ["–" if item.cycle is None else f"{item.cycle.period:.1f} s" for item in navigations]
    return by_columns(
        "Navigation errors with and without rotation",
        (TableColumn("Navigation"), [item.name for item in navigations]),
        (TableColumn("Cycle"), cycles),
        (TableColumn("radial error at the end", Role.VALUE, "m"), [float(item.radial[-1]) for item in navigations]),
        (TableColumn("largest radial error", Role.VALUE, "m"), [float(item.radial.max()) for item in navigations]),
        (TableColumn("rms radial error", Role.VALUE, "m"), [item.rms for item in navigations]),
        (TableColumn("rms velocity", Role.VALUE, "m/s"), speeds),
        (TableColumn("CEP rate", Role.VALUE, "nmi/h"), [item.cep_rate for item in navigations]),
    )


def _cycles(
    turned: Sequence[Navigation],
    periodic: Mapping[str, PeriodicPart],
    request: EstimateRequest[ModulationResidualParameters],
) -> list[Table]:
    """Returns tables of the residual of each cycle, and of the predicted and the measured error that repeats with the cycle."""
    declared = request.parameters.declared
    columns = (
        TableColumn("Navigation"),
        TableColumn("residual of the stops, |∫exp(iθ) dt|", Role.VALUE, "s"),
        TableColumn("residual of the turns, |∫exp(iθ) dt|", Role.VALUE, "s"),
        TableColumn("fraction of the error that is not modulated", Role.SHARE),
        TableColumn("velocity", Role.VALUE, "m/s"),
        TableColumn("predicted velocity", Role.VALUE, "m/s"),
        TableColumn("position", Role.VALUE, "m"),
        TableColumn("predicted position", Role.VALUE, "m"),
    )
    rows: list[tuple[Cell, ...]] = []
    for item in turned:
        assert item.cycle is not None
        stops, turns = item.cycle.integral()
        part = periodic.get(item.name)
        measured: tuple[Cell, Cell] = (part.largest_velocity(), part.largest_position()) if part else ("–", "–")
        expected: tuple[Cell, Cell] = ("–", "–")
        if declared is not None and part is not None and item.attitude is not None:
            expected = periodic_amplitudes(declared, item.attitude, item.cycle, part.orders, request.site)
        share = abs(item.cycle.residual) / item.cycle.period
        rows.append(
            (
                item.name, f"{abs(stops):.2f}", f"{abs(turns):.2f}", f"{100 * share:.3f} %", measured[0], expected[0], measured[1],
                expected[1],
            )
        )  # fmt: skip
    return [Table("Residual of each cycle, and errors that repeat with it", columns, tuple(rows))]


def _predicted(
    navigations: Sequence[Navigation], request: EstimateRequest[ModulationResidualParameters]
) -> list[Table]:
    """Returns tables of the position errors that the linear error equations predict for the declared constant errors of the
    sensors. A second prediction uses only the horizontal components of these errors. The second prediction shows the benefit of the
    rotation cycle, because a cycle about the vertical does not modulate the vertical components."""
    declared = request.parameters.declared
    if declared is None:
        return []
    rows: list[tuple[Cell, ...]] = []
    for item in navigations:
        if item.attitude is None:
            continue
        radial = [
            np.hypot(
                *errors_over_time(errors, item.attitude, item.cycle, item.aligned, item.seconds, request.site)[1].T
            )
            for errors in (declared, horizontal(declared, item.attitude))
        ]
        rms = [float(np.sqrt(np.mean(one**2))) for one in radial]
        rows.append((item.name, item.rms, *rms))
    titles = ("rms radial error", "predicted", "predicted from horizontal sensor errors alone")
    columns = (TableColumn("Navigation"), *(TableColumn(title, Role.VALUE, "m") for title in titles))
    return [Table("Position errors predicted from the declared constant errors", columns, tuple(rows))]


def _plots(navigations: Sequence[Navigation]) -> tuple[Plot, ...]:
    grid = max((item.course[0] for item in navigations), key=lambda time: -len(time))
    hours = tuple((grid / HOUR).tolist())
    radial = {
        item.name: tuple((np.interp(grid, item.course[0], item.radial) / NAUTICAL_MILE).tolist())
        for item in navigations
    }
    north = {
        item.name: tuple((np.interp(grid, item.course[0], item.course[2]) / NAUTICAL_MILE).tolist())
        for item in navigations
    }
    return (
        Plot(
            "Position error over time, with and without rotation",
            "time [h]",
            "radial error [nmi]",
            hours,
            radial,
            lines=True,
        ),
        Plot("North position error over time", "time [h]", "north error [nmi]", hours, north, lines=True),
    )


def _left(segment: Segment, request: DesignRequest[ModulationResidualParameters]) -> str:
    """Returns a sentence that states the residual of a planned cycle (the part of an error that the cycle does not cancel), and the
    resulting position error for the declared horizontal errors."""
    table, declared = request.setup.table, request.parameters.declared
    cycle = rotation(segment.motion, table)
    assert cycle is not None
    share = 0.0 if cycle.balanced else 100 * abs(cycle.residual) / cycle.period
    left = f"'{segment.label}': {share:.3g} % of a constant horizontal error remains unmodulated in its cycle of {cycle.period:.1f} s"
    dwell = segment.dwell or 0.0
    if declared is None or segment.attitude is None or not 0 < dwell <= LONGEST:
        return f"{left}."
    before = next((item for item in request.segments if item.index == segment.index - 1), None)
    aligned = rotation(before.motion, table) if before is not None else None
    errors = horizontal(declared, segment.attitude)
    position = errors_over_time(errors, segment.attitude, cycle, aligned, dwell, request.site)[1]
    rms = float(np.sqrt(np.mean(np.sum(position**2, axis=1))))
    return f"{left}; the declared horizontal errors cause {rms:.3g} m rms of position error over {dwell / HOUR:.3g} h."
