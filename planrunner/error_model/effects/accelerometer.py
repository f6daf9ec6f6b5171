"""Effects within an accelerometer: terms of its output beyond a 3×3 matrix and a bias (the model equation of IEEE Std 1293 names K2, K3,
cross-coupling and asymmetry)."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.interface import Variant, per_axis, single
from planrunner.error_model.effects.nominal import towards_others
from planrunner.error_model.effects.products import products
from planrunner.error_model.observed import Observed

G = 9.80665  # m/s²


class AccelBiasTemperature:
    """Bias + c·ΔT per axis, ΔT from 25 degC."""

    id, stage = "accel_bias_temperature", "sensor"
    shown_by = "two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "c", "ug/K", 1e-6 * G, 1e-4 * G, observed.warmth))


class AccelScaleTemperature:
    """Scale factor × (1 + k·ΔT) per axis."""

    id, stage = "accel_scale_temperature", "sensor"
    shown_by = "the axis up and down at two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.force * observed.warmth[:, None]
        return single(per_axis(observed, "accel", "k", "ppm/K", 1e-6, 1e-4, product))


class AccelSecondOrder:
    """Output + k·f² per axis."""

    id, stage = "accel_second_order", "sensor"
    shown_by = "the axis up, level and down"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ug/g^2", 1e-6 / G, 1e-4 / G, observed.force**2))


class AccelThirdOrder:
    """Output + k·f³ per axis (K3)."""

    id, stage, hypothesis = "accel_third_order", "sensor", False
    shown_by = "the axis at four inclinations, some of them oblique"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ug/g^3", 1e-6 / G**2, 1e-4 / G**2, observed.force**3))


class AccelAsymmetry:
    """Output + k·|f| per axis: a scale factor that differs between the senses of specific force."""

    id, stage, hypothesis = "accel_asymmetry", "sensor", False
    shown_by = "the axis up, level and down"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ppm", 1e-6, 1e-4, np.abs(observed.force)))


class AccelCrossCoupling:
    """Output + K·[f_x·f_y, f_y·f_z, f_z·f_x], K a 3×3 matrix."""

    id, stage, hypothesis = "accel_cross_coupling", "sensor", False
    shown_by = "orientations in which gravity lies between two axes of the sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        columns = []
        for name, product in products(observed.force)[3:]:
            columns += per_axis(observed, "accel", f"K_{name}", "ug/g^2", 1e-6 / G, 1e-4 / G, product)
        return single(columns)


class AccelMisalignmentTemperature:
    """Output + m·ΔT·(specific force along another axis of the sensor), six per triad."""

    id, stage, hypothesis = "accel_misalignment_temperature", "sensor", False
    shown_by = "the other axes up and down at two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(towards_others(observed, "accel", "arcsec/K", 1e-5, observed.warmth))


class AccelThermalGradient:
    """Output + k·dT/dt per axis."""

    id, stage, hypothesis = "accel_thermal_gradient", "sensor", False
    shown_by = "a recorded temperature ramp and, in addition, a segment at constant temperature"

    def variants(self, observed: Observed) -> list[Variant]:
        rate = observed.temperature_rate
        return single(per_axis(observed, "accel", "k", "ug/(K/min)", 60e-6 * G, 60e-5 * G, rate))


class AccelBiasDrift:
    """Bias + d·t per axis, t since power-on."""

    id, stage, hypothesis = "accel_bias_drift", "sensor", False
    shown_by = "the same orientation, rate and temperature early in the run and again late"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "d", "ug/h", 1e-6 * G / 3600, 1e-4 * G / 3600, observed.time))
