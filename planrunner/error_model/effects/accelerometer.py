"""Effects within an accelerometer: terms of its output beyond a 3×3 matrix and a bias (the model equation of IEEE Std 1293 names K2, K3,
cross-coupling and asymmetry)."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.interface import About, Actor, Variant, WithoutColumns, per_axis, products, single
from planrunner.error_model.effects.nominal import towards_others
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G


class AccelBiasTemperature:
    """Adds c·ΔT to the bias of each axis, where ΔT is the temperature minus 25 degC."""

    id, stage, with_temperature = "accel_bias_temperature", "sensor", "c"
    about = About(
        "accelerometer bias depends on temperature",
        "The bias of each accelerometer changes in proportion to the temperature.",
        Actor.SENSOR,
        "Compensate the bias over temperature, or hold the temperature of the sensor constant: {found}.",
    )
    shown_by = "two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "c", "ug/K", 1e-6 * G, 1e-4 * G, observed.warmth))


class AccelScaleTemperature:
    """Multiplies the scale factor of each axis by 1 + k·ΔT, where ΔT is the temperature minus 25 degC."""

    id, stage = "accel_scale_temperature", "sensor"
    about = About(
        "accelerometer scale factor depends on temperature",
        "The scale factor of each accelerometer changes in proportion to the temperature.",
        Actor.SENSOR,
        "Compensate the scale factor over temperature, or calibrate at the temperature of use: {found}.",
    )
    shown_by = "the axis up and down at two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.force * observed.warmth[:, None]
        return single(per_axis(observed, "accel", "k", "ppm/K", 1e-6, 1e-4, product))


class AccelSecondOrder:
    """Adds k·f² to the output of each axis, where f is the specific force along the axis (K2)."""

    id, stage = "accel_second_order", "sensor"
    about = About(
        "accelerometer output has a quadratic term",
        "The output of each accelerometer contains a term that grows with the square of the specific force.",
        Actor.SENSOR,
        "Compensate the quadratic term (K2): {found}.",
    )
    shown_by = "the axis up, level and down"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ug/g^2", 1e-6 / G, 1e-4 / G, observed.force**2))


class AccelThirdOrder:
    """Adds k·f³ to the output of each axis, where f is the specific force along the axis (K3)."""

    id, stage, hypothesis = "accel_third_order", "sensor", False
    about = About(
        "accelerometer output has a cubic term",
        "The output of each accelerometer contains a term that grows with the cube of the specific force.",
        Actor.SENSOR,
        "Compensate the cubic term (K3): {found}.",
    )
    shown_by = "the axis at four inclinations, some of them oblique"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ug/g^3", 1e-6 / G**2, 1e-4 / G**2, observed.force**3))


class AccelAsymmetry:
    """Adds k·|f| to the output of each axis, where f is the specific force along the axis: the scale factor differs between the two
    senses of f."""

    id, stage, hypothesis = "accel_asymmetry", "sensor", False
    about = About(
        "accelerometer scale factor differs between the signs of specific force",
        "Each accelerometer has one scale factor for positive and another for negative specific force.",
        Actor.SENSOR,
        "Use a separate scale factor for each sign: {found}.",
    )
    shown_by = "the axis up, level and down"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ppm", 1e-6, 1e-4, np.abs(observed.force)))


class AccelCrossCoupling:
    """Adds K·[f_x·f_y, f_y·f_z, f_z·f_x] to the outputs, where f is the specific force in sensor axes and K is a 3×3 matrix."""

    id, stage, hypothesis = "accel_cross_coupling", "sensor", False
    about = About(
        "accelerometer responds to products of two axes",
        "The product of the specific forces along two axes appears in the output of the accelerometers.",
        Actor.SENSOR,
        "Compensate the cross-coupling: {found}.",
    )
    shown_by = "orientations in which gravity lies between two axes of the sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        columns = []
        for name, product in products(observed.force)[3:]:
            columns += per_axis(observed, "accel", f"K_{name}", "ug/g^2", 1e-6 / G, 1e-4 / G, product)
        return single(columns)


class AccelMisalignmentTemperature:
    """Adds m·ΔT·f to the output of each axis, where f is the specific force along another sensor axis, and ΔT is the temperature minus 25
    degC. A triad has six amplitudes m."""

    id, stage, hypothesis = "accel_misalignment_temperature", "sensor", False
    about = About(
        "accelerometer axes move with temperature",
        "The input axes of the accelerometers tilt in proportion to the temperature.",
        Actor.SENSOR,
        "Compensate the misalignment over temperature: {found}.",
    )
    shown_by = "the other axes up and down at two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(towards_others(observed, "accel", "arcsec/K", 1e-5, observed.warmth))


class AccelThermalGradient:
    """Adds k·dT/dt to the output of each axis, where T is the temperature of the sensor."""

    id, stage, hypothesis = "accel_thermal_gradient", "sensor", False
    about = About(
        "accelerometer bias depends on the rate of temperature change",
        "While the temperature changes, gradients within the sensor shift the bias of each accelerometer.",
        Actor.PLAN,
        "Record at constant temperature after a longer soak, or compensate with the rate of temperature "
        "change: {found}.",
    )
    shown_by = "a recorded temperature ramp and, in addition, a segment at constant temperature"

    def variants(self, observed: Observed) -> list[Variant]:
        rate = observed.temperature_rate
        return single(per_axis(observed, "accel", "k", "ug/(K/min)", 60e-6 * G, 60e-5 * G, rate))


class AccelBiasDrift:
    """Adds d·t to the bias of each axis, where t is the time since power-on."""

    id, stage, hypothesis = "accel_bias_drift", "sensor", False
    about = About(
        "accelerometer bias drifts with time",
        "The bias of each accelerometer changes in proportion to the time since power-on.",
        Actor.PLAN,
        "Repeat a reference state during the run and fit the drift, or warm the sensor up for longer: {found}.",
    )
    shown_by = "the same orientation, rate and temperature early in the run and again late"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "d", "ug/h", 1e-6 * G / 3600, 1e-4 * G / 3600, observed.time))


class AccelThermalHysteresis:
    """Adds h·s to the output of each axis, where s is the sign of the last temperature change (0 before the first change)."""

    id, stage, hypothesis = "accel_thermal_hysteresis", "sensor", False
    about = About(
        "accelerometer bias depends on how the temperature was reached",
        "At the same temperature, the bias of each accelerometer differs after heating and after cooling.",
        Actor.PLAN,
        "Approach every temperature from the same side, or include the difference in the uncertainty: {found}.",
    )
    shown_by = "the same temperature reached from below and from above"

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.last_change.any():
            return []
        sign = observed.last_change[observed.owner]
        return single(per_axis(observed, "accel", "h", "mg", 1e-3 * G, 1e-3 * G, sign))


class AccelNoiseExcess(WithoutColumns):
    """Raises the white noise density of the accelerometers above the declared density."""

    id, outside, of_accelerometers = "accel_noise_excess", "white", True
    about = About(
        "accelerometer noise is larger than declared",
        "The white noise of the accelerometers is stronger than the bench file declares.",
        Actor.BOOKKEEPING,
        "Correct the noise in the bench file, or look for vibration and electrical interference: {found}.",
    )


class AccelQuantization(WithoutColumns):
    """Makes the resolution of the accelerometers coarser than declared: every output value is a multiple of a larger count."""

    id, outside, of_accelerometers = "accel_quantization", "resolution", True
    about = About(
        "accelerometer counts are coarser than declared",
        "The output of the accelerometers is rounded to multiples of a count that is larger than the bench file declares.",
        Actor.BOOKKEEPING,
        "Correct the resolution in the bench file, or set a finer resolution in the sensor: {found}.",
    )
