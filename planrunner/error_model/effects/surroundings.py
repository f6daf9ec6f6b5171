"""Effects of the site, of the position of the sensor on the table, and of data acquisition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import (
    About,
    Actor,
    Column,
    Shaped,
    Variant,
    on_rate,
    on_stimulus,
    per_axis,
    single,
    whole,
)
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY

DEG = np.pi / 180


class MagneticSensitivity:
    """Adds K·m to the outputs of the gyros, where K is a 3×3 matrix and m is the Earth's magnetic field in sensor axes."""

    id, stage = "magnetic_sensitivity", "sensor"
    about = About(
        "gyro output depends on the magnetic field",
        "The magnetic field of the Earth shifts the output of the gyros as the sensor turns in it.",
        Actor.SENSOR,
        "Shield the sensor magnetically, or compensate with a magnetometer: {found}.",
    )
    shown_by = (
        "orientations that differ in the direction of the magnetic field in the axes of the sensor "
        "(`magnetic_field` of the bench's site)"
    )

    def variants(self, observed: Observed) -> list[Variant]:
        return single(_response_to_field(observed, "gyro", "deg/s", DEG))


class AccelMagneticSensitivity:
    """Adds K·m to the outputs of the accelerometers, where K is a 3×3 matrix and m is the Earth's magnetic field in sensor axes."""

    id, stage, hypothesis = "accel_magnetic_sensitivity", "sensor", False
    about = About(
        "accelerometer output depends on the magnetic field",
        "The magnetic field of the Earth shifts the output of the accelerometers as the sensor turns in it.",
        Actor.SENSOR,
        "Shield the sensor magnetically, or compensate with a magnetometer: {found}.",
    )
    shown_by = MagneticSensitivity.shown_by

    def variants(self, observed: Observed) -> list[Variant]:
        return single(_response_to_field(observed, "accel", "mg", 1e-3 * STANDARD_GRAVITY))


def _response_to_field(observed: Observed, kind: str, unit: str, factor: float) -> list[Column]:
    """Returns the columns for the nine elements of a 3×3 matrix of sensitivities to the magnetic field; no columns if the field is not
    declared. The field is divided by its strength at the site, so a sensitivity is the change of the output for a field of this
    strength."""
    if observed.magnetic is None:
        return []
    field = observed.in_sensor_axes(observed.magnetic / np.linalg.norm(observed.magnetic))
    columns = []
    for i, name in enumerate("xyz"):
        columns += per_axis(observed, kind, f"K_{name}", f"{unit}/field", factor, 1e-3 * factor, field[:, i])
    return [replace(column, plain=unit) for column in columns]


class SiteLatitude:
    """The Earth rate was computed for the wrong latitude. If the latitude is wrong by a small angle δ, the Earth rate is wrong by
    Ω·(0, −sin φ, cos φ)·δ in East-North-Up, where φ is the latitude."""

    id, stage = "site_latitude", "stimulus"
    about = About(
        "latitude of the site is wrong",
        "The simulation computes the rotation of the Earth for a latitude that is not the true one.",
        Actor.SITE,
        "Add the error to the latitude of the site in the bench file: {found}.",
    )
    shown_by = "orientations that differ by a turn of the axis in the plane of the meridian"

    def variants(self, observed: Observed) -> list[Variant]:
        return self.around(observed, np.zeros(1))

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        half = float(amplitudes[0]) / 2
        phi = observed.site.latitude + half  # the secant of a circle is parallel to the tangent halfway
        change = observed.site.earth_rate * np.sinc(half / np.pi) * np.array([0.0, -np.sin(phi), np.cos(phi)])
        parts = on_stimulus(observed, observed.in_sensor_axes(change), None)
        pole = np.pi / 2
        latitude = observed.site.latitude
        error = Column("error", "deg", DEG, DEG, parts, axis=None, smallest=-pole - latitude, largest=pole - latitude)
        return single([error] if parts else [])


class LeverArm:
    """Accelerometers that are not on the axis of rotation also sense ω×(ω×r) + α×r = ω·(ω·r) − ω²·r + α×r, where r is their
    position in sensor axes, and ω and α are the rate and the angular acceleration of the table. If other accelerometers record the
    motion, r is the position relative to those accelerometers."""

    id, stage = "lever_arm", "stimulus"
    about = About(
        "accelerometers are not on the axis of rotation",
        "While the table turns, the accelerometers measure centripetal and tangential acceleration.",
        Actor.BENCH,
        "Mount the accelerometers on the axis of rotation, or correct for the lever arm: {found}.",
    )
    shown_by, explains_turning = "rates or rocking, so that the accelerometers turn with the table", True

    def variants(self, observed: Observed) -> list[Variant]:
        turn, spin_up = observed.turn, observed.swing
        if not turn.any() or not observed.of_kind("accel"):
            return []
        largest = np.inf if observed.moved.any() else observed.reach
        columns = []
        squared = np.einsum("ni,ni->n", turn, turn)
        for axis, (name, arm) in enumerate(zip("xyz", np.eye(3), strict=True)):
            felt = turn * turn[:, [axis]] + spin_up @ np.cross(np.eye(3), arm)
            felt[:, axis] -= squared
            parts = on_stimulus(observed, None, felt)
            columns.append(Column(f"r_{name}", "mm", 1e-3, 1e-2, parts, axis=None, smallest=-largest, largest=largest))
        return single(columns)


class ReferenceLatency(Shaped):
    """The channels of a recorded motion are late by a constant delay: at a given time stamp, they show an earlier motion than the
    sensor."""

    id, stage, hypothesis, shape_name, shape_unit = "reference_latency", "acquisition", False, "delay", "s"
    about = About(
        "reference data are late",
        "The time stamps of the channels that show the motion are late, so these channels show an earlier motion than the sensor.",
        Actor.BENCH,
        "Correct the time stamps of the reference by the delay, or synchronise it with the sensor: {found}.",
    )
    shown_by, acts_on = "segments with a recorded motion whose rate changes", "rate"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(5e-4, 0.1, 10) if observed.moved.any() else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        return Variant(
            (whole(on_rate(observed, observed.turn_before(-value)), observed.moved, either_sign=True),), value
        )


class TimeLatency(Shaped):
    """The data of the sensor are late by a constant delay: they show an earlier stimulus than their time stamps state."""

    id, stage, shape_name, shape_unit = "time_latency", "acquisition", "delay", "s"
    about = About(
        "sensor data are late",
        "The time stamps of the sensor are late, so its samples show an earlier motion of the table.",
        Actor.BENCH,
        "Correct the time stamps by the delay, or synchronise the sensor with the table: {found}.",
    )
    shown_by, acts_on = "rocking segments", "rate"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(5e-4, 0.1, 10) if observed.unsteady.any() else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        return Variant(
            (whole(on_rate(observed, observed.turn_before(value)), observed.unsteady, either_sign=True),), value
        )
