"""Effects that are proportional to the supply voltage or to the ambient pressure. These effects change the bias or the scale
factor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Follows, Variant, per_axis, single
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

DEG = np.pi / 180


class _Quantity(NamedTuple):
    """A quantity to which errors are proportional.

    `unit`: unit in which the excess over the nominal value is displayed. `size`: SI value of this unit. `name`, `acts`, `remedy`,
    `shown_by`: texts for `About` and `shown_by`.
    """

    unit: str
    size: float
    name: str
    acts: str
    remedy: str
    shown_by: str


_QUANTITIES = {
    Follows.SUPPLY: _Quantity(
        "V",
        1.0,
        "supply voltage",
        "the voltage that supplies the sensor",
        "Regulate the supply more closely, or compensate with the measured voltage: {found}.",
        "two supply voltages, given by `supply_voltage` of the segments or recorded in `supply_channel`",
    ),
    Follows.PRESSURE: _Quantity(
        "hPa",
        100.0,
        "ambient pressure",
        "the pressure of the air around the sensor",
        "Seal the sensor, or compensate with the measured pressure: {found}.",
        "two ambient pressures, given by `ambient_pressure` of the segments or recorded in `pressure_channel`",
    ),
}
_VARIED = {Follows.SUPPLY: 0.1, Follows.PRESSURE: 1000.0}
"""A variation of the supply voltage [V] or of the air pressure [Pa] between segments counts as intended if it is larger than this
value. A regulated supply does not vary so much by itself, and the weather rarely causes such a change during a test."""
_BIAS = {"gyro": ("deg/s", DEG), "accel": ("ug", 1e-6 * G)}
"""Unit of a bias, and its SI value."""
_NAMES = {"gyro": "gyro", "accel": "accelerometer"}


def _about(kind: str, error: str, follows: Follows, because: str = "") -> About:
    quantity, name = _QUANTITIES[follows], _NAMES[kind]
    return About(
        f"{name} {error} depends on the {quantity.name}",
        f"The {error} of each {name} changes in proportion to {quantity.acts}{because}.",
        Actor.SENSOR,
        quantity.remedy,
    )


class _OfSurroundings:
    """An error of each axis of a triad that is proportional to the supply voltage or to the ambient pressure. `kind`: kind of the
    triad, gyro or accel. `natural`: usual change per V or per hPa. For a bias, it is in the unit of `_BIAS`; for a scale factor, it
    is a fraction."""

    stage, hypothesis = "sensor", False
    kind: str
    follows: Follows
    natural: float

    def _excess(self, observed: Observed) -> Array:
        """Returns the excess of the supply voltage [V] over its nominal value, or of the pressure [Pa] over the standard atmosphere
        of 1013.25 hPa, shape (N,)."""
        return observed.overvoltage if self.follows is Follows.SUPPLY else observed.overpressure

    def shown_in(self, observed: Observed) -> bool:
        """Returns True if the voltage or the pressure differs between segments by more than the usual variation from regulation or
        weather."""
        excess = observed.excess_voltage if self.follows is Follows.SUPPLY else observed.excess_pressure
        if excess is None:
            return False
        means = np.add.reduceat(excess, observed.bounds[:-1]) / np.diff(observed.bounds)
        return bool(np.ptp(means) > _VARIED[self.follows])


class _Bias(_OfSurroundings):
    """Adds c·e to the bias of each axis, where e is the excess of the supply voltage or of the pressure over its nominal value."""

    @property
    def shown_by(self) -> str:
        return _QUANTITIES[self.follows].shown_by

    def variants(self, observed: Observed) -> list[Variant]:
        quantity = _QUANTITIES[self.follows]
        unit, size = _BIAS[self.kind]
        factor = size / quantity.size
        name = f"{unit}/{quantity.unit}"
        return single(per_axis(observed, self.kind, "c", name, factor, self.natural * factor, self._excess(observed)))


class _ScaleFactor(_OfSurroundings):
    """Multiplies the scale factor of each axis by 1 + k·e. Here, e is the excess of the supply voltage or of the pressure over its
    nominal value."""

    @property
    def shown_by(self) -> str:
        needed = "rates about the axis at " if self.kind == "gyro" else "the axis up and down at "
        return needed + _QUANTITIES[self.follows].shown_by

    def variants(self, observed: Observed) -> list[Variant]:
        quantity = _QUANTITIES[self.follows]
        stimulus = observed.omega if self.kind == "gyro" else observed.force
        product = stimulus * self._excess(observed)[:, None]
        name, natural = f"ppm/{quantity.unit}", self.natural / quantity.size
        return single(per_axis(observed, self.kind, "k", name, 1e-6 / quantity.size, natural, product))


class GyroBiasSupply(_Bias):
    """Adds c·ΔV to the bias of each axis, where ΔV is the excess over the nominal supply voltage of the sensor."""

    id, kind, follows, natural = "gyro_bias_supply", "gyro", Follows.SUPPLY, 1e-3
    about = _about(kind, "bias", follows)


class GyroScaleSupply(_ScaleFactor):
    """Multiplies the scale factor of each axis by 1 + k·ΔV, where ΔV is the excess over the nominal supply voltage of the sensor."""

    id, kind, follows, natural = "gyro_scale_supply", "gyro", Follows.SUPPLY, 1e-4
    about = _about(kind, "scale factor", follows)


class AccelBiasSupply(_Bias):
    """Adds c·ΔV to the bias of each axis, where ΔV is the excess over the nominal supply voltage of the sensor."""

    id, kind, follows, natural = "accel_bias_supply", "accel", Follows.SUPPLY, 100.0
    about = _about(kind, "bias", follows)


class AccelScaleSupply(_ScaleFactor):
    """Multiplies the scale factor of each axis by 1 + k·ΔV, where ΔV is the excess over the nominal supply voltage of the sensor."""

    id, kind, follows, natural = "accel_scale_supply", "accel", Follows.SUPPLY, 1e-4
    about = _about(kind, "scale factor", follows)


class GyroBiasPressure(_Bias):
    """Adds c·Δp to the bias of each axis, where Δp is the excess over the standard atmosphere of 1013.25 hPa."""

    id, kind, follows, natural = "gyro_bias_pressure", "gyro", Follows.PRESSURE, 1e-5
    about = _about(kind, "bias", follows)


class GyroScalePressure(_ScaleFactor):
    """Multiplies the scale factor of each axis by 1 + k·Δp, where Δp is the excess over the standard atmosphere of 1013.25 hPa."""

    id, kind, follows, natural = "gyro_scale_pressure", "gyro", Follows.PRESSURE, 1e-6
    about = _about(kind, "scale factor", follows, ", for example because the air damps a vibrating structure")


class AccelBiasPressure(_Bias):
    """Adds c·Δp to the bias of each axis, where Δp is the excess over the standard atmosphere of 1013.25 hPa."""

    id, kind, follows, natural = "accel_bias_pressure", "accel", Follows.PRESSURE, 1.0
    about = _about(kind, "bias", follows)


class AccelScalePressure(_ScaleFactor):
    """Multiplies the scale factor of each axis by 1 + k·Δp, where Δp is the excess over the standard atmosphere of 1013.25 hPa."""

    id, kind, follows, natural = "accel_scale_pressure", "accel", Follows.PRESSURE, 1e-6
    about = _about(kind, "scale factor", follows)
