"""Effects within a gyro: terms of its output beyond a 3×3 matrix and a bias."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.interface import About, Actor, Variant, per_axis, products, single
from planrunner.error_model.effects.nominal import towards_others
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

DEG = np.pi / 180


class GyroBiasTemperature:
    """Adds c1·ΔT + c2·ΔT² to the bias of each axis, where ΔT is the temperature minus 25 degC."""

    id, stage, with_temperature = "gyro_bias_temperature", "sensor", "c1"
    about = About(
        "gyro bias depends on temperature",
        "The bias of each gyro follows the temperature as a parabola.",
        Actor.SENSOR,
        "Compensate the bias over temperature, or hold the temperature of the sensor constant: {found}.",
    )
    shown_by = "three temperatures, or two if only `.c1` is fitted"

    def variants(self, observed: Observed) -> list[Variant]:
        warm = observed.warmth
        linear = per_axis(observed, "gyro", "c1", "deg/s/K", DEG, 1e-3 * DEG, warm)
        return single(linear + per_axis(observed, "gyro", "c2", "deg/s/K^2", DEG, 2e-5 * DEG, warm**2))


class GyroScaleTemperature:
    """Multiplies the scale factor of each axis by 1 + k·ΔT, where ΔT is the temperature minus 25 degC."""

    id, stage = "gyro_scale_temperature", "sensor"
    about = About(
        "gyro scale factor depends on temperature",
        "The scale factor of each gyro changes in proportion to the temperature.",
        Actor.SENSOR,
        "Compensate the scale factor over temperature, or calibrate at the temperature of use: {found}.",
    )
    shown_by = "rates about the axis at two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.omega * observed.warmth[:, None]
        return single(per_axis(observed, "gyro", "k", "ppm/K", 1e-6, 1e-4, product))


class GyroScaleNonlinearity:
    """Adds k·ω³ to the output of each axis, where ω is the rate about the axis: the lowest odd term beyond a scale factor."""

    id, stage = "gyro_scale_nonlinearity", "sensor"
    about = About(
        "gyro scale factor is not linear",
        "The output of each gyro contains a term that grows with the cube of the rate.",
        Actor.SENSOR,
        "Compensate the cubic term, or use the sensor at lower rates: {found}.",
    )
    shown_by = "three rates about the axis, in both directions"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "1/(deg/s)^2", DEG**-2, 1e-8 * DEG**-2, observed.omega**3))


class GyroScaleAsymmetry:
    """Adds k·|ω| to the output of each axis, where ω is the rate about the axis: the scale factor differs between the senses of
    rotation."""

    id, stage = "gyro_scale_asymmetry", "sensor"
    about = About(
        "gyro scale factor differs between the directions of rotation",
        "Each gyro has one scale factor for positive rates and another for negative rates.",
        Actor.SENSOR,
        "Use a separate scale factor for each direction of rotation: {found}.",
    )
    shown_by = "rates about the axis in both directions, and a segment at rest or a second rate"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "ppm", 1e-6, 1e-4, np.abs(observed.omega)))


class GyroGSensitivity:
    """Adds K·f to the outputs, where f is the specific force in sensor axes and K is a 3×3 matrix (sensitivity to mass unbalance
    along each axis and across the axes)."""

    id, stage = "gyro_g_sensitivity", "sensor"
    about = About(
        "gyro bias depends on gravity",
        "Specific force shifts the output of the gyros, for example because a mass is not balanced.",
        Actor.SENSOR,
        "Compensate the g-sensitivity with the measured specific force: {found}.",
    )
    shown_by = "each axis of the sensor up and down"

    def variants(self, observed: Observed) -> list[Variant]:
        columns = []
        for i, name in enumerate("xyz"):
            columns += per_axis(observed, "gyro", f"K_{name}", "deg/s/g", DEG / G, 1e-3 * DEG / G, observed.force[:, i])
        return single(columns)


class GyroG2Sensitivity:
    """Adds K·[f_x², f_y², f_z², f_x·f_y, f_y·f_z, f_z·f_x] to the outputs, where f is the specific force in sensor axes and K is a
    3×6 matrix (anisoelasticity)."""

    id, stage = "gyro_g2_sensitivity", "sensor"
    about = About(
        "gyro bias depends on the square of gravity",
        "Products of two components of specific force shift the output of the gyros, because their "
        "suspension is not equally stiff along all axes.",
        Actor.SENSOR,
        "Compensate the g²-sensitivity with the measured specific force, or isolate the sensor from "
        "vibration: {found}.",
    )
    shown_by = (
        "each axis level, upright and oblique; cardinal orientations excite only the squares, and the sum of the squares cannot be "
        "separated from a bias"
    )

    def variants(self, observed: Observed) -> list[Variant]:
        columns = []
        for name, product in products(observed.force):
            columns += per_axis(observed, "gyro", f"K_{name}", "deg/s/g^2", DEG / G**2, 1e-3 * DEG / G**2, product)
        return single(columns)


class GyroThermalHysteresis:
    """Adds h·s to the output of each axis, where s is the sign of the last temperature change (0 before the first change)."""

    id, stage = "gyro_thermal_hysteresis", "sensor"
    about = About(
        "gyro bias depends on how the temperature was reached",
        "At the same temperature, the bias of each gyro differs after heating and after cooling.",
        Actor.PLAN,
        "Approach every temperature from the same side, or include the difference in the uncertainty: {found}.",
    )
    shown_by = "the same temperature reached from below and from above"

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.last_change.any():
            return []
        sign = observed.last_change[observed.owner]
        return single(per_axis(observed, "gyro", "h", "deg/s", DEG, 1e-2 * DEG, sign))


class GyroThermalGradient:
    """Adds k·dT/dt to the output of each axis, where T is the temperature of the sensor."""

    id, stage = "gyro_thermal_gradient", "sensor"
    about = About(
        "gyro bias depends on the rate of temperature change",
        "While the temperature changes, gradients within the sensor shift the bias of each gyro.",
        Actor.PLAN,
        "Record at constant temperature after a longer soak, or compensate with the rate of temperature "
        "change: {found}.",
    )
    shown_by = "a recorded temperature ramp and, in addition, a segment at rest at constant temperature"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "deg/s/(K/s)", DEG, 1e-1 * DEG, observed.temperature_rate))


class GyroScaleQuadratic:
    """Adds k·ω² to the output of each axis, where ω is the rate about the axis: the lowest even term that is smooth at zero rate."""

    id, stage, hypothesis = "gyro_scale_quadratic", "sensor", False
    about = About(
        "gyro output has a quadratic term",
        "The output of each gyro contains a term that grows with the square of the rate.",
        Actor.SENSOR,
        "Compensate the quadratic term: {found}.",
    )
    shown_by = "rates about the axis in both directions, and a segment at rest or a second rate"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "ppm/(deg/s)", 1e-6 / DEG, 1e-7 / DEG, observed.omega**2))


class GyroBiasTemperatureCubic:
    """Adds c3·ΔT³ to the bias of each axis, where ΔT is the temperature minus 25 degC."""

    id, stage, hypothesis = "gyro_bias_temperature_cubic", "sensor", False
    about = About(
        "gyro bias follows a cubic of temperature",
        "The bias of each gyro contains a term that grows with the cube of the temperature difference.",
        Actor.SENSOR,
        "Compensate the bias over temperature with a polynomial of third degree: {found}.",
    )
    shown_by = "four temperatures, if fitted together with `gyro_bias_temperature`"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "c3", "deg/s/K^3", DEG, 4e-7 * DEG, observed.warmth**3))


class GyroMisalignmentTemperature:
    """Adds m·ΔT·ω to the output of each axis, where ω is the rate about another sensor axis, and ΔT is the temperature minus 25 degC. A
    triad has six amplitudes m."""

    id, stage, hypothesis = "gyro_misalignment_temperature", "sensor", False
    about = About(
        "gyro axes move with temperature",
        "The input axes of the gyros tilt in proportion to the temperature.",
        Actor.SENSOR,
        "Compensate the misalignment over temperature: {found}.",
    )
    shown_by = "turns about the other axes at two temperatures"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(towards_others(observed, "gyro", "arcsec/K", 1e-5, observed.warmth))


class GyroBiasDrift:
    """Adds d·t to the bias of each axis, where t is the time since power-on."""

    id, stage, hypothesis = "gyro_bias_drift", "sensor", False
    about = About(
        "gyro bias drifts with time",
        "The bias of each gyro changes in proportion to the time since power-on.",
        Actor.PLAN,
        "Repeat a reference state during the run and fit the drift, or warm the sensor up for longer: {found}.",
    )
    shown_by = "the same orientation, rate and temperature early in the run and again late"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "d", "deg/h/h", DEG / 3600**2, 1e-1 * DEG / 3600**2, observed.time))


class GyroAngularAcceleration:
    """Adds k·dω/dt to the output of each axis, where ω is the rate about the axis. To first order, a delay d of the output of one
    axis has the same effect, with k = −d."""

    id, stage, hypothesis = "gyro_angular_acceleration", "sensor", False
    about = About(
        "gyro output depends on the angular acceleration",
        "The output of each gyro contains a term proportional to the angular acceleration; a delay of single axes has the same effect.",
        Actor.SENSOR,
        "Compensate with the derivative of the rate, or with the delay of the axis: {found}.",
    )
    shown_by = "rocking segments, or a recorded motion whose rate changes"

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.swing.any():
            return []
        return single(per_axis(observed, "gyro", "k", "ms", 1e-3, 1e-3, observed.swing))
