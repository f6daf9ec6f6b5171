"""Makes the results of a strapdown navigation: coefficients, tables, plots and notes.

The uncertainties of the coefficients come from the module `uncertainty`.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, counted, said
from planrunner.estimators.interface import Coefficient, Estimate, EstimateRequest
from planrunner.estimators.strapdown.navigating import Navigated, StrapdownNavigationParameters, wandering_sensors
from planrunner.estimators.strapdown.navigation_errors import CEP_INTERVAL, CEP_SHARE, HOUR, NAUTICAL_MILE
from planrunner.estimators.strapdown.uncertainty import (
    DEGREE,
    NAMES,
    PERIODS,
    RATE,
    SCHULER_PERIOD,
    Spread,
    Wander,
    drift_influence,
    influences,
)
from planrunner.estimators.tables import Plot, Role, Table, TableColumn, by_columns
from planrunner.navigation import attitude
from planrunner.navigation.error_equations import INPUTS, SIZE, ErrorEquations
from planrunner.plan.schedule import Rest
from planrunner.plan.units import STANDARD_GRAVITY

_GYROS = 3
_SHOWN = 3.0  # the drift of a sensor is named from this number of standard uncertainties


def assemble(request: EstimateRequest[StrapdownNavigationParameters], found: Navigated) -> Estimate:
    """Makes the estimate from a navigation."""
    points = found.record.points()
    equations = ErrorEquations.at(found.site)
    spread, wander = Spread(equations, found, points, _turns(request)), Wander(request, found, points)
    drift = drift_influence(found, points)
    coefficients = _coefficients(found, spread)
    values = {item.name: item.value for item in coefficients}
    return Estimate(
        request.name,
        "strapdown_navigation",
        coefficients,
        spread.covariance,
        headline=(
            "heading",
            "radial_error",
            "largest_radial_error",
            "rms_radial_error",
            "radial_error_rate",
            "cep_rate",
        ),
        settings=_settings(request, found),
        tables=(_table(points, np.hypot(spread.radial, wander.radial)), *_constants(request, found)),
        plots=_plots(points),
        notes=_notes(request, found, values),
        warnings=_warnings(request, found),
        segments=tuple(recorded.label for recorded in request.segments),
        extra={
            "time_s": points[0].tolist(),
            "east_m": points[1].tolist(),
            "north_m": points[2].tolist(),
            "velocity_east": points[3].tolist(),
            "velocity_north": points[4].tolist(),
            "cep_rate_nmi_h": values["cep_rate"],
            "duration_s": found.seconds,
        },
        influences=(
            *influences(request, equations, found, points),
            *wander.influences,
            *(() if drift is None else (drift,)),
        ),
        unstated=wander.unstated,
    )


def _turns(request: EstimateRequest[StrapdownNavigationParameters]) -> bool:
    return any(not isinstance(recorded.segment.motion, Rest) for recorded in request.segments)


def _coefficients(found: Navigated, spread: Spread) -> tuple[Coefficient, ...]:
    record = found.record
    east, north, velocity_east, velocity_north = found.final.tolist()
    values = (
        *(attitude.angles(found.aligned.alignment.rotation) * DEGREE).tolist(),
        east,
        north,
        velocity_east,
        velocity_north,
        math.hypot(east, north),
        record.largest,
        record.rms,
        record.largest_speed,
        record.rms_speed,
        record.radial_rate * RATE,
        record.radial_rate * RATE * CEP_SHARE,
    )
    uncertainties = np.sqrt(np.diag(spread.covariance)).tolist()
    return tuple(
        Coefficient(name, value, unit, u, description=words, period=PERIODS.get(name, math.inf))
        for (name, (unit, words)), value, u in zip(NAMES.items(), values, uncertainties, strict=True)
    )


def _settings(request: EstimateRequest[StrapdownNavigationParameters], found: Navigated) -> dict[str, object]:
    parameters = request.parameters
    white = found.aligned.white * np.array([60 * DEGREE] * 3 + [60.0] * 3)
    return {
        "vertical": parameters.vertical,
        "gravity": parameters.gravity,
        "start_latitude": f"{math.degrees(found.site.latitude):.7f} deg",
        "start_longitude": f"{math.degrees(found.site.longitude):.7f} deg",
        "start_height": f"{found.site.height:.2f} m",
        "alignment": f"{found.aligned.seconds:.6g} s",
        "navigation": f"{found.seconds:.6g} s",
        "velocity innovations, relative to their expected size": f"{found.aligned.alignment.consistency:.2g}",
        "gyro noise seen": ", ".join(f"{value:.3g}" for value in white[:3]) + " deg/sqrt(h)",
        "accelerometer noise seen": ", ".join(f"{value:.3g}" for value in white[3:]) + " m/s/sqrt(h)",
    }


def _table(points: Array, uncertainty: Array) -> Table:
    """Returns a table of the errors at whole hours or, for shorter runs, every ten minutes, every minute or every second. `points`:
    array of shape (5, n), errors as `ErrorRecord.points` returns them. `uncertainty`: array of shape (n,), standard uncertainty of
    the radial error, m."""
    time = points[0]
    steps = [3600.0, 600.0, 60.0, 1.0]
    step = next((seconds for seconds in steps if time[-1] >= 3 * seconds), steps[-1])
    moments = np.arange(1, int(time[-1] / step + 1e-6) + 1) * step
    at = [int(np.argmin(np.abs(time - moment))) for moment in moments]
    _, east, north, velocity_east, velocity_north = points[:, at]
    return by_columns(
        "Navigation errors over time",
        (TableColumn("time", Role.NUMBER, "h"), time[at] / HOUR),
        (TableColumn("east", Role.VALUE, "m"), east),
        (TableColumn("north", Role.VALUE, "m"), north),
        (TableColumn("radial error", Role.VALUE, "m"), np.hypot(east, north)),
        (TableColumn("uncertainty of the radial error", Role.STANDARD_UNCERTAINTY, "m"), uncertainty[at]),
        (TableColumn("east velocity", Role.VALUE, "m/s"), velocity_east),
        (TableColumn("north velocity", Role.VALUE, "m/s"), velocity_north),
    )


def _constants(request: EstimateRequest[StrapdownNavigationParameters], found: Navigated) -> tuple[Table, ...]:
    """Returns a table of the constant errors that the alignment estimates. The result is empty if the sensor is not turned during
    the alignment, because the alignment then estimates no constant errors."""
    if not found.aligned.turned:
        return ()
    alignment = found.aligned.alignment
    scales = np.repeat([DEGREE * HOUR, 1e6 / STANDARD_GRAVITY], 3)
    uncertainties = np.sqrt(np.diag(alignment.covariance)[SIZE : SIZE + INPUTS])
    table = by_columns(
        "Constant errors found in alignment",
        (TableColumn("sensor"), (*request.parameters.gyros, *request.parameters.accelerometers)),
        (TableColumn("error", Role.VALUE), alignment.constant * scales),
        (TableColumn("standard uncertainty", Role.STANDARD_UNCERTAINTY), uncertainties * scales),
        (TableColumn("unit"), ["deg/h"] * 3 + ["ug"] * 3),
    )
    return (table,)


def _plots(points: Array) -> tuple[Plot, ...]:
    hours = tuple((points[0] / HOUR).tolist())
    position = {
        "east": tuple((points[1] / NAUTICAL_MILE).tolist()),
        "north": tuple((points[2] / NAUTICAL_MILE).tolist()),
        "radial": tuple((np.hypot(points[1], points[2]) / NAUTICAL_MILE).tolist()),
    }
    velocity = {"east": tuple(points[3].tolist()), "north": tuple(points[4].tolist())}
    return (
        Plot("Position error over time", "time [h]", "position error [nmi]", hours, position, lines=True),
        Plot("Velocity error over time", "time [h]", "velocity error [m/s]", hours, velocity, lines=True),
    )


def _source(request: EstimateRequest[StrapdownNavigationParameters], found: Navigated) -> Said:
    """Returns a note about the sources of the uncertainties of the navigation errors."""
    if not wandering_sensors(request.setup.inputs, request.parameters):
        return said(
            "The uncertainties of the errors come from the white noise observed during alignment, propagated through the linear "
            "error equations; constant sensor errors are part of the measured errors."
        )
    return said(
        "The uncertainties of the errors come from the white noise observed during alignment and from the declared bias "
        "instability, propagated through the linear error equations. Constant sensor errors (averages over {span}) are part of "
        "the measured errors. For the largest error, the root mean square and the rate, the uncertainties are upper bounds.",
        span=str(request.parameters.drift_span),
    )


def _notes(
    request: EstimateRequest[StrapdownNavigationParameters], found: Navigated, values: dict[str, float]
) -> tuple[Said, ...]:
    low, high = (values["cep_rate"] * share for share in CEP_INTERVAL)
    notes = [
        said(
            "One run determines a CEP poorly: if the errors are normally distributed with equal variances and zero mean, the CEP rate is "
            "between {low:.3g} and {high:.3g} nmi/h (95 %). For a better value, multiply the root mean square of "
            "radial_error_rate over several runs by 0.8326.",
            low=low,
            high=high,
        ),
        _source(request, found),
    ]
    parameters = request.parameters
    unknown = parameters.gyro_uncertainty is None or parameters.accelerometer_uncertainty is None
    if unknown and found.aligned.turned:
        notes.append(
            said(
                "Alignment assumes constant errors with standard uncertainties of 0.1 deg/h and 1 mg unless gyro_uncertainty "
                "and accelerometer_uncertainty are given."
            )
        )
    elif unknown:
        notes.append(
            said(
                "The uncertainties of heading, pitch and roll include only the noise: the contribution of constant gyro and "
                "accelerometer errors (ε_E/(Ω·cos φ) and ∇/g) is not known without gyro_uncertainty and "
                "accelerometer_uncertainty."
            )
        )
    if found.seconds < SCHULER_PERIOD:
        notes.append(
            said(
                "The navigation lasts {minutes:.3g} min, less than a Schuler period of 84.4 min: rates in nmi/h describe the "
                "beginning of an oscillation and must not be extrapolated.",
                minutes=found.seconds / 60,
            )
        )
    if found.gap:
        notes.append(
            said(
                "There are no samples for {gap:.4g} s between alignment and navigation: the attitude was "
                "carried over, because the "
                "unit was at rest or the table brought it back to the same orientation.",
                gap=found.gap,
            )
        )
    truncated = [recorded.label for recorded in request.segments if recorded.truncated]
    if truncated:
        notes.append(
            said(
                "'{segment}' was cut short; the results are for {hours:.3g} h.",
                segment=truncated[0],
                hours=found.seconds / HOUR,
            )
        )
    return tuple(notes)


def _warnings(request: EstimateRequest[StrapdownNavigationParameters], found: Navigated) -> tuple[Said, ...]:
    warnings = [*found.aligned.warnings, *_at_stops(request, found)]
    if found.bridged:
        warnings.append(
            counted(
                "{count} missing sample was filled by linear interpolation; this may increase the navigation errors.",
                "{count} missing samples were filled by linear interpolation; this may increase the navigation errors.",
                found.bridged,
            )
        )
    return tuple(warnings)


def _at_stops(request: EstimateRequest[StrapdownNavigationParameters], found: Navigated) -> list[Said]:
    """Returns warnings about sensors whose readings at the stops change unexpectedly."""
    channels, warnings = request.parameters.channels, []
    if found.opposed:
        warnings.append(
            said(
                "From stop to stop, the rates of {outputs} change in the opposite direction to the Earth's rate in the navigated "
                "orientation: check the signs and the order of the channels.",
                outputs=tuple(channels[k] for k in found.opposed),
            )
        )
    drift = found.drift
    if drift is None:
        return warnings
    if drift.fitted.courses:
        shown = np.flatnonzero(drift.changes > _SHOWN * drift.uncertainties)
        if not len(shown):
            shown = np.array([int(np.argmax(drift.changes / drift.uncertainties))])
        warnings.append(
            said(
                "The readings at stops show a drift during alignment and navigation ({drifts}): {changes}. The navigation is not corrected "
                "for this drift. According to the error equations, the drift causes {metres:.3g} m of the position error at the end. The "
                "uncertainties include the effect of the drift. Without the drift, the errors would be those of the mean biases.",
                drifts=tuple(dict.fromkeys(course.name for course in drift.fitted.courses)),
                changes=tuple(_change(channels[k], float(drift.changes[k]), k) for k in shown.tolist()),
                metres=float(np.hypot(*drift.effect[:2, -1, 0])),
            )
        )
    if drift.unexplained.any():
        warnings.append(
            said(
                "At the stops, the readings of {outputs} vary by up to {ratio:.2g} times the amount that noise explains. Flicker that "
                "the bench file does not declare, a drift whose form was not fitted, or a base that tilts can cause this. The "
                "uncertainties do not include its effect.",
                outputs=tuple(channels[k] for k in np.flatnonzero(drift.unexplained)),
                ratio=float(drift.scatter.max()),
            )
        )
    return warnings


def _change(channel: str, size: float, sensor: int) -> Said:
    """Returns a text that states the drift of one sensor. `size`: size of the drift, rad/s or m/s²."""
    text, factor = ("deg/h", DEGREE * HOUR) if sensor < _GYROS else ("ug", 1e6 / STANDARD_GRAVITY)
    return said("{output} by {size:.2g} {unit}", output=channel, size=size * factor, unit=text)
