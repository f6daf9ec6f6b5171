"""Effects within a gyro: terms of its output beyond a 3×3 matrix and a bias."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.interface import Array, Shaped, Variant, per_axis, single
from planrunner.error_model.observed import Observed

DEG = np.pi / 180
G = 9.80665  # m/s²


def _products(force: Array) -> list[tuple[str, Array]]:
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]
    return [("xyz"[i] + "xyz"[j], force[:, i] * force[:, j]) for i, j in pairs]


class GyroBiasTemperature:
    """Bias + c1·ΔT + c2·ΔT² per axis, ΔT from 25 degC."""

    id, stage = "gyro_bias_temperature", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        warm = observed.warmth
        linear = per_axis(observed, "gyro", "c1", "deg/s/K", DEG, 1e-3 * DEG, warm)
        return single(linear + per_axis(observed, "gyro", "c2", "deg/s/K^2", DEG, 2e-5 * DEG, warm**2))


class GyroScaleTemperature:
    """Scale factor × (1 + k·ΔT) per axis."""

    id, stage = "gyro_scale_temperature", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.omega * observed.warmth[:, None]
        return single(per_axis(observed, "gyro", "k", "ppm/K", 1e-6, 1e-4, product))


class GyroScaleNonlinearity:
    """Output + k·ω³ per axis: the lowest odd term beyond a scale factor."""

    id, stage = "gyro_scale_nonlinearity", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "1/(deg/s)^2", DEG**-2, 1e-8 * DEG**-2, observed.omega**3))


class GyroScaleAsymmetry:
    """Output + k·|ω| per axis: a scale factor that differs between the senses of rotation."""

    id, stage = "gyro_scale_asymmetry", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "ppm", 1e-6, 1e-4, np.abs(observed.omega)))


class GyroGSensitivity:
    """Output + K·f, K a 3×3 matrix (mass unbalance and its cross axes)."""

    id, stage = "gyro_g_sensitivity", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        columns = []
        for i, name in enumerate("xyz"):
            columns += per_axis(observed, "gyro", f"K_{name}", "deg/s/g", DEG / G, 1e-3 * DEG / G, observed.force[:, i])
        return single(columns)


class GyroG2Sensitivity:
    """Output + K·[f_x², f_y², f_z², f_x·f_y, f_y·f_z, f_z·f_x], K a 3×6 matrix (anisoelasticity)."""

    id, stage = "gyro_g2_sensitivity", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        columns = []
        for name, product in _products(observed.force):
            columns += per_axis(observed, "gyro", f"K_{name}", "deg/s/g^2", DEG / G**2, 1e-3 * DEG / G**2, product)
        return single(columns)


class GyroWarmUp(Shaped):
    """Output + a·exp(−t/τ) per axis, t since power-on."""

    id, stage, shape_name, shape_unit = "gyro_warm_up", "sensor", "tau", "s"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(60.0, 7200.0, 13) if observed.of_kind("gyro") else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        decay = np.exp(-(observed.time - observed.time[0]) / value)
        left = max(
            float(np.exp(-observed.time[0] / value)), 1e-300
        )  # of the amplitude at power-on, when the recording begins
        columns = per_axis(observed, "gyro", "a", "deg/s", DEG * left, 1e-2 * DEG, decay)
        return Variant(tuple(columns), value)


class GyroThermalHysteresis:
    """Output + h·(sign of the last temperature change; 0 before the first) per axis."""

    id, stage = "gyro_thermal_hysteresis", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.last_change.any():
            return []
        sign = observed.last_change[observed.owner]
        return single(per_axis(observed, "gyro", "h", "deg/s", DEG, 1e-2 * DEG, sign))


class GyroThermalGradient:
    """Output + k·dT/dt per axis."""

    id, stage = "gyro_thermal_gradient", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "gyro", "k", "deg/s/(K/s)", DEG, 1e-1 * DEG, observed.temperature_rate))
