"""Effects of the table: errors of its orientation and of its rate."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Column, Variant, on_stimulus, single
from planrunner.error_model.observed import Observed, orientation_key
from planrunner.plan.schedule import Rest

ARCSEC = np.pi / 180 / 3600
EAST, NORTH, UP = np.eye(3)
_RIPPLE = 0.1
"""Largest relative ripple of a rate. A larger variation is another kind of motion, for example a turn by hand whose rate varies."""


def tilted(observed: Observed, axis: Array, name: str, turned: Array) -> Column:
    """Computes the column for a table base that is turned by an angle ε about a site axis. The sensor senses every site vector v as
    v − ε·axis × v.

    The attitude of the sensor is A·R(−θ)·(I − ε[axis×]), where A is the attitude at table angle 0 and R(−θ) is the rotation of the
    table. The axis of the table turns with the base. For the sensor, the rate of the table about this axis is therefore unchanged.
    `turned`: array of shape (3,) in rad, the rotation vector of the base for which the columns of all axes together are exact (see
    `secant`). If it is zero, the column is valid for small angles.
    """
    earth, force = observed.site.earth_rate_enu, observed.site.specific_force_enu
    omega = observed.in_sensor_axes(secant(axis, earth, turned))
    felt = observed.in_sensor_axes(secant(axis, force, turned))
    parts = on_stimulus(observed, omega, felt)
    return Column(name, "arcsec", ARCSEC, 60 * ARCSEC, parts, axis=None, smallest=-np.pi, largest=np.pi)


def secant(axis: Array, vector: Array, turned: Array) -> Array:
    """Computes the change of a vector per radian of rotation about one axis. The result is exact for the complete rotation
    `turned`. `turned`: array of shape (3,) in rad, the complete rotation vector φ. The changes for the three axes, multiplied by
    the components of φ, have a sum that follows from Rodrigues' formula: (R(−φ) − I)·v = −(sin φ ÷ φ)·φ × v + ((1 − cos φ) ÷ φ²)·φ
    × (φ × v)."""
    first = np.cross(axis, vector)
    angle = float(np.linalg.norm(turned)) / np.pi
    return np.asarray(-np.sinc(angle) * first + np.sinc(angle / 2) ** 2 / 2 * np.cross(turned, first))


class TableTilt:
    """The base of the table is not level, but tilted by two small angles, about east and about north."""

    id, stage = "table_tilt", "stimulus"
    about = About(
        "table is not level",
        "The base of the table is tilted, so gravity and the rotation of the Earth act on the sensor from "
        "directions that were not planned.",
        Actor.BENCH,
        "Level the table: {found}.",
    )
    shown_by = "orientations that differ by a turn of the sensor about the vertical"

    def variants(self, observed: Observed) -> list[Variant]:
        return self.around(observed, np.zeros(2))

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        turned = np.append(amplitudes, 0.0)
        return single([tilted(observed, EAST, "about_east", turned), tilted(observed, NORTH, "about_north", turned)])


class TableAzimuth:
    """The assumed north direction of the table is not true north: the base is turned by an angle about the vertical."""

    id, stage = "table_azimuth", "stimulus"
    about = About(
        "north of the table is not true north",
        "The table is turned about the vertical, so the rotation of the Earth acts on the sensor from "
        "directions that were not planned.",
        Actor.BENCH,
        "Align the table with north, or correct the azimuth of the site in the bench file: {found}.",
    )
    shown_by = "orientations that differ by a turn of the axis about the vertical"

    def variants(self, observed: Observed) -> list[Variant]:
        return self.around(observed, np.zeros(1))

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        return single([tilted(observed, UP, "about_up", float(amplitudes[0]) * UP)])


class TablePositionError:
    """Each orientation has a small random error, given by three angles in sensor axes. The error is the same each time the
    orientation is set."""

    id, stage, each = "table_position_error", "stimulus", "orientation"
    about = About(
        "table misses its positions",
        "Each orientation has a small error that is the same every time it is set.",
        Actor.BENCH,
        "Calibrate the positions of the table and fixture, or declare their uncertainty in the bench file: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        keys = [orientation_key(attitude) for attitude in observed.attitude]
        distinct = list(dict.fromkeys(keys))
        if len(distinct) < 4:
            return []
        which = np.array([distinct.index(key) for key in keys])
        columns = []
        for i, axis in enumerate(np.eye(3)):
            turned = np.cross(np.eye(3), axis)
            parts = on_stimulus(observed, observed.omega @ turned, observed.force @ turned)
            for number in range(len(distinct)):
                name = f"orientation_{number + 1}_{'xyz'[i]}"
                columns.append(Column(name, "arcsec", ARCSEC, 20 * ARCSEC, parts, which == number, axis=i))
        return single(columns)


RIPPLES = (1, 2)
"""Numbers of periods per turn of the ripples that `TableRateRipple` describes."""


class TableRateRipple:
    """Multiplies the rate of the table by 1 + a·cos(nθ + φ), where θ is the angle of the table, and n is 1 or 2. The effect is a
    ripple with n periods per turn, which the encoder does not show."""

    id, stage, shape_name, shape_unit = "table_rate_ripple", "stimulus", "n", "per turn"
    about = About(
        "rate of the table has a ripple",
        "The rate of the table varies with its angle, and the recorded angle does not show this.",
        Actor.BENCH,
        "Record whole turns, or have the drive and the encoder checked: {found}.",
    )
    shown_by, acts_on = "turns about the axis", "amplitudes"

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.rate.any():
            return []
        turn = observed.rate[:, None] * observed.table_axis
        found = []
        for n in RIPPLES:
            waves = {"cos": np.cos(n * observed.angle), "sin": np.sin(n * observed.angle)}
            columns = tuple(
                Column(
                    name,
                    "ppm",
                    1e-6,
                    1e-3,
                    on_stimulus(observed, wave[:, None] * turn, None),
                    axis=None,
                    smallest=-_RIPPLE,
                    largest=_RIPPLE,
                )
                for name, wave in waves.items()
            )
            found.append(Variant(columns, float(n)))
        return found


class TableWobble:
    """While the table turns, its attitude is (I + [δ×])·R(θ) with δ = a·(cos(θ + φ), sin(θ + φ), 0) in site axes; the rate changes
    accordingly. R(θ) is the rotation of the table by its angle θ.

    With δ = R·δ₀, (I + [δ×])·R = R·(I + [δ₀×]). Seen from the turning table, the payload is tilted by the constant δ₀ = a·(cos φ,
    sin φ, 0). The whole stimulus of the sensor, including the rate of the table, is therefore rotated by −δ₀ in sensor axes.
    """

    id, stage = "table_wobble", "stimulus"
    about = About(
        "axis of the table wobbles",
        "While the table turns, its axis is tilted by a constant angle, in a direction that turns with the table.",
        Actor.BENCH,
        "Have the bearing and the mounting face of the table checked: {found}.",
    )
    shown_by = "turns and, in addition, segments at rest"

    def variants(self, observed: Observed) -> list[Variant]:
        moving = np.array([not isinstance(motion, Rest) for motion in observed.motions])
        if not moving.any():
            return []
        columns = []
        for name, axis in (("cos", EAST), ("sin", NORTH)):
            delta = np.einsum("sij,j->si", observed.attitude, axis)[observed.owner]
            omega, force = -np.cross(delta, observed.omega), -np.cross(delta, observed.force)
            columns.append(
                Column(
                    name,
                    "arcsec",
                    ARCSEC,
                    60 * ARCSEC,
                    on_stimulus(observed, omega, force),
                    moving,
                    axis=None,
                    smallest=-np.pi,
                    largest=np.pi,
                )
            )
        return single(columns)


class TableRateError:
    """Multiplies the rate of the table by 1 + ε: the table does not turn at the commanded rate. If the nominal model has free scale
    factors, they absorb this error."""

    id, stage = "table_rate_error", "stimulus"
    about = About(
        "table turns at the wrong rate",
        "The true rate of the table differs from the commanded rate by a constant factor.",
        Actor.BENCH,
        "Calibrate the rate of the table, or record its angle: {found}.",
    )
    shown_by = "rates; the scale factor must not be fitted at the same time"

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.rate.any():
            return []
        turn = observed.rate[:, None] * observed.table_axis
        parts = on_stimulus(observed, turn, None)
        return single([Column("epsilon", "ppm", 1e-6, 1e-3, parts, axis=None, smallest=-1.0, largest=1.0)])
