"""Effects of the supply voltage and of the ambient pressure: on the bias and on the scale factor, in proportion."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.about import About, Actor
from planrunner.error_model.effects.interface import Follows, Variant, per_axis, single
from planrunner.error_model.observed import Observed

DEG = np.pi / 180
G = 9.80665  # m/s²
HPA = 100.0  # Pa

_VOLTAGES = "two supply voltages, stated by `supply_voltage` of the segments or recorded in `supply_channel`"
_PRESSURES = "two ambient pressures, stated by `ambient_pressure` of the segments or recorded in `pressure_channel`"
_TURNS = "rates about the axis at "
_FLIPS = "the axis up and down at "
_REGULATE = "Regulate the supply more closely, or compensate with the measured voltage: {found}."
_SEAL = "Seal the sensor, or compensate with the measured pressure: {found}."


class GyroBiasSupply:
    """Bias + c·ΔV per axis, ΔV above the nominal supply voltage of the sensor."""

    id, stage, hypothesis, follows = "gyro_bias_supply", "sensor", False, Follows.SUPPLY
    about = About(
        "gyro bias depends on the supply voltage",
        "The bias of each gyro changes in proportion to the voltage that supplies the sensor.",
        Actor.SENSOR,
        _REGULATE,
    )
    shown_by = _VOLTAGES

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "c", "deg/s/V", DEG, 1e-3 * DEG, observed.overvoltage))


class GyroScaleSupply:
    """Scale factor × (1 + k·ΔV) per axis."""

    id, stage, hypothesis, follows = "gyro_scale_supply", "sensor", False, Follows.SUPPLY
    about = About(
        "gyro scale factor depends on the supply voltage",
        "The scale factor of each gyro changes in proportion to the voltage that supplies the sensor.",
        Actor.SENSOR,
        _REGULATE,
    )
    shown_by = _TURNS + _VOLTAGES

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.omega * observed.overvoltage[:, None]
        return single(per_axis(observed, "gyro", "k", "ppm/V", 1e-6, 1e-4, product))


class AccelBiasSupply:
    """Bias + c·ΔV per axis."""

    id, stage, hypothesis, follows = "accel_bias_supply", "sensor", False, Follows.SUPPLY
    about = About(
        "accelerometer bias depends on the supply voltage",
        "The bias of each accelerometer changes in proportion to the voltage that supplies the sensor.",
        Actor.SENSOR,
        _REGULATE,
    )
    shown_by = _VOLTAGES

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "c", "ug/V", 1e-6 * G, 1e-4 * G, observed.overvoltage))


class AccelScaleSupply:
    """Scale factor × (1 + k·ΔV) per axis."""

    id, stage, hypothesis, follows = "accel_scale_supply", "sensor", False, Follows.SUPPLY
    about = About(
        "accelerometer scale factor depends on the supply voltage",
        "The scale factor of each accelerometer changes in proportion to the voltage that supplies the sensor.",
        Actor.SENSOR,
        _REGULATE,
    )
    shown_by = _FLIPS + _VOLTAGES

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.force * observed.overvoltage[:, None]
        return single(per_axis(observed, "accel", "k", "ppm/V", 1e-6, 1e-4, product))


class GyroBiasPressure:
    """Bias + c·Δp per axis, Δp above the standard atmosphere of 1013.25 hPa."""

    id, stage, hypothesis, follows = "gyro_bias_pressure", "sensor", False, Follows.PRESSURE
    about = About(
        "gyro bias depends on the ambient pressure",
        "The bias of each gyro changes in proportion to the pressure of the air about the sensor.",
        Actor.SENSOR,
        _SEAL,
    )
    shown_by = _PRESSURES

    def variants(self, observed: Observed) -> list[Variant]:
        magnitude = 1e-5 * DEG / HPA
        return single(per_axis(observed, "gyro", "c", "deg/s/hPa", DEG / HPA, magnitude, observed.overpressure))


class GyroScalePressure:
    """Scale factor × (1 + k·Δp) per axis."""

    id, stage, hypothesis, follows = "gyro_scale_pressure", "sensor", False, Follows.PRESSURE
    about = About(
        "gyro scale factor depends on the ambient pressure",
        "The scale factor of each gyro changes in proportion to the pressure of the air about the sensor, "
        "for example because the air damps a vibrating structure.",
        Actor.SENSOR,
        _SEAL,
    )
    shown_by = _TURNS + _PRESSURES

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.omega * observed.overpressure[:, None]
        return single(per_axis(observed, "gyro", "k", "ppm/hPa", 1e-6 / HPA, 1e-6 / HPA, product))


class AccelBiasPressure:
    """Bias + c·Δp per axis."""

    id, stage, hypothesis, follows = "accel_bias_pressure", "sensor", False, Follows.PRESSURE
    about = About(
        "accelerometer bias depends on the ambient pressure",
        "The bias of each accelerometer changes in proportion to the pressure of the air about the sensor.",
        Actor.SENSOR,
        _SEAL,
    )
    shown_by = _PRESSURES

    def variants(self, observed: Observed) -> list[Variant]:
        magnitude = 1e-6 * G / HPA
        return single(per_axis(observed, "accel", "c", "ug/hPa", 1e-6 * G / HPA, magnitude, observed.overpressure))


class AccelScalePressure:
    """Scale factor × (1 + k·Δp) per axis."""

    id, stage, hypothesis, follows = "accel_scale_pressure", "sensor", False, Follows.PRESSURE
    about = About(
        "accelerometer scale factor depends on the ambient pressure",
        "The scale factor of each accelerometer changes in proportion to the pressure of the air about the sensor.",
        Actor.SENSOR,
        _SEAL,
    )
    shown_by = _FLIPS + _PRESSURES

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.force * observed.overpressure[:, None]
        return single(per_axis(observed, "accel", "k", "ppm/hPa", 1e-6 / HPA, 1e-6 / HPA, product))
