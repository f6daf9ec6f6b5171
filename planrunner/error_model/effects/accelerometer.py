"""Effects within an accelerometer."""

from __future__ import annotations

from planrunner.error_model.effects.interface import Variant, per_axis, single
from planrunner.error_model.observed import Observed

G = 9.80665  # m/s²


class AccelBiasTemperature:
    """Bias + c·ΔT per axis, ΔT from 25 degC."""

    id, stage = "accel_bias_temperature", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "c", "ug/K", 1e-6 * G, 1e-4 * G, observed.warmth))


class AccelScaleTemperature:
    """Scale factor × (1 + k·ΔT) per axis."""

    id, stage = "accel_scale_temperature", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        product = observed.force * observed.warmth[:, None]
        return single(per_axis(observed, "accel", "k", "ppm/K", 1e-6, 1e-4, product))


class AccelSecondOrder:
    """Output + k·f² per axis."""

    id, stage = "accel_second_order", "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        return single(per_axis(observed, "accel", "k", "ug/g^2", 1e-6 / G, 1e-4 / G, observed.force**2))
