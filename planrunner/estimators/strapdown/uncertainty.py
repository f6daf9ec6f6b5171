"""Uncertainties of the results of a strapdown navigation.

Uncertainties say how well one run determines what the constant errors of the sensors make of a navigation: white noise, as the alignment
shows it, and the alignment that it leaves uncertain, carried through the linear error equations. Constant errors themselves are part of
what is measured, and only enter where they hide from it, in the angles of the alignment.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.strapdown.alignment import levelled_out
from planrunner.estimators.strapdown.navigating import Navigated, StrapdownNavigationParameters
from planrunner.estimators.strapdown.navigation_errors import CEP_SHARE, CEP_SPREAD, HOUR, NAUTICAL_MILE
from planrunner.navigation import attitude
from planrunner.navigation.error_equations import INPUTS, SIZE, TILT, ErrorEquations
from planrunner.navigation.wgs84 import radii
from planrunner.uncertainty.influences import Influence, InputQuantity

Array = NDArray[np.float64]

SCHULER_PERIOD = 5064.0  # s, 84.4 min
PERIODS = {"heading": 360.0, "roll": 360.0}
"""Of those that are circular, in their units; pitch goes from -90 to 90 deg only."""
NAMES = {
    "heading": ("deg", "Azimuth of the unit's y axis after alignment, from true north towards east"),
    "pitch": ("deg", "Elevation of the unit's y axis after alignment"),
    "roll": ("deg", "Rotation about the unit's y axis after alignment, positive with the x axis down"),
    "east_error": ("m", "East position error at the end"),
    "north_error": ("m", "North position error at the end"),
    "east_velocity_error": ("m/s", "East velocity error at the end"),
    "north_velocity_error": ("m/s", "North velocity error at the end"),
    "radial_error": ("m", "Radial position error at the end"),
    "largest_radial_error": ("m", "Largest radial position error"),
    "rms_radial_error": ("m", "Root mean square of the radial position error over time"),
    "largest_velocity_error": ("m/s", "Largest horizontal velocity error"),
    "rms_velocity_error": ("m/s", "Root mean square of the horizontal velocity error over time"),
    "radial_error_rate": ("nmi/h", "Slope of the straight line through the origin fitted to radial error over time"),
    "cep_rate": ("nmi/h", "CEP rate that this run gives: √(ln 2) of the radial error rate"),
}
_DIRECT = 7  # the first so many follow the state linearly
DEGREE = math.degrees(1.0)
RATE = HOUR / NAUTICAL_MILE


class Spread:
    """What noise leaves uncertain: covariance (m, m) of the coefficients in their units; radial: (n,) standard uncertainty of the radial
    error at the points of the course [m]."""

    def __init__(self, equations: ErrorEquations, found: Navigated, points: Array, turns: bool):
        start = np.zeros((SIZE, SIZE))
        start[TILT, TILT] = found.aligned.alignment.tilt_covariance
        density = levelled_out(found.aligned.density) if turns else found.aligned.density
        step = float(points[0, 1] - points[0, 0]) if points.shape[1] > 1 else found.seconds
        count = points.shape[1] - 1
        covariances = np.array([start, *equations.covariances(start, density, step, count)])
        self.radial = self._along(points[1:3], covariances[:, :2, :2])
        self.speed = self._along(points[3:5], covariances[:, 2:4, 2:4])
        rest = found.seconds - count * step
        end = next(equations.covariances(covariances[-1], density, max(rest, 0.0), 1))
        carried = equations.step(found.seconds)[0] @ start
        self.covariance = self._joined(found, points, start, end, carried)

    @staticmethod
    def _along(errors: Array, covariances: Array) -> Array:
        """Standard uncertainty of the length of (2, n) vectors with covariances (n, 2, 2); of the longer axis where the length is zero."""
        size = np.hypot(*errors)
        unit = np.where(size > 0, errors / np.where(size > 0, size, 1.0), 0.0)
        along = np.einsum("in,nij,jn->n", unit, covariances, unit)
        lengths: Array = np.sqrt(np.where(size > 0, along, np.trace(covariances, axis1=1, axis2=2)))
        return lengths

    def _joined(self, found: Navigated, points: Array, start: Array, end: Array, carried: Array) -> Array:
        """The angles and the errors at the end follow the state linearly. Figures over time are bounded as if errors at all times went
        together, and are given no correlation."""
        angles = -attitude.angle_sensitivities(found.aligned.alignment.rotation) * DEGREE
        both = np.zeros((_DIRECT + 1, _DIRECT + 1))
        both[:3, :3] = angles @ start[TILT, TILT] @ angles.T
        both[:3, 3:7] = angles @ carried[:4, TILT].T
        both[3:7, :3] = both[:3, 3:7].T
        both[3:7, 3:7] = end[:4, :4]
        radial = float(np.hypot(*found.final[:2]))
        line = np.zeros((_DIRECT + 1, _DIRECT + 1))
        line[:_DIRECT, :_DIRECT] = np.eye(_DIRECT)
        line[_DIRECT, 3:5] = found.final[:2] / radial if radial else 0.0
        covariance = np.zeros((len(NAMES), len(NAMES)))
        covariance[: _DIRECT + 1, : _DIRECT + 1] = line @ both @ line.T
        time, size, speed = points[0], np.hypot(*points[1:3]), np.hypot(*points[3:5])
        rate = float(time @ self.radial / (time @ time)) * RATE
        over_time = (
            float(np.interp(found.record.largest_at, time, self.radial)),
            float(size @ self.radial / math.sqrt(size @ size * size.size)) if size.any() else float(self.radial[-1]),
            float(self.speed[int(np.argmax(speed))]),
            float(speed @ self.speed / math.sqrt(speed @ speed * speed.size)) if speed.any() else float(self.speed[-1]),
            rate,
            found.record.radial_rate * RATE * CEP_SHARE * CEP_SPREAD,
        )
        places = range(_DIRECT + 1, len(NAMES))
        covariance[places, places] = np.square(over_time)
        return covariance


def influences(
    request: EstimateRequest[StrapdownNavigationParameters], equations: ErrorEquations, found: Navigated
) -> tuple[Influence, ...]:
    """Constant sensor errors, for the angles alone, and the latitude, whose error makes the Earth's rate wrong."""
    parameters = request.parameters
    rotation = found.aligned.alignment.rotation
    turned = np.zeros((INPUTS, INPUTS))
    turned[:3, :3] = turned[3:, 3:] = rotation
    angles = -attitude.angle_sensitivities(rotation) * DEGREE @ equations.levelled() @ turned
    stated = (
        ("gyro constant error", "rad/s", parameters.gyro_uncertainty, slice(0, 3), "gyro_uncertainty"),
        (
            "accelerometer constant error",
            "m/s^2",
            parameters.accelerometer_uncertainty,
            slice(3, 6),
            "accelerometer_uncertainty",
        ),
    )
    influences = []
    for name, unit, quantity, columns, key in stated:
        if quantity is not None and not found.aligned.turned:
            sensitivities = np.zeros((len(NAMES), 3))
            sensitivities[:3] = angles[:, columns]
            source = f"plan estimates.{request.name}.{key}"
            influences.append(Influence(InputQuantity(name, 0.0, unit, quantity.value, source=source), sensitivities))
    latitude = request.setup.inputs.get("latitude")
    if latitude is not None:
        shift = np.zeros(SIZE)
        shift[1] = float(radii(found.site.latitude)[0]) + found.site.height
        change = (equations.step(found.seconds)[0] @ shift - shift)[:4]
        radial = math.hypot(*found.final[:2])
        sensitivities = np.zeros((len(NAMES), 1))
        sensitivities[3:7, 0] = change
        sensitivities[7, 0] = float(found.final[:2] @ change[:2]) / radial if radial else 0.0
        influences.append(Influence(latitude, sensitivities))
    return tuple(influences)
