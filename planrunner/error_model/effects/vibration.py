"""Effects of vibration rectification: an oscillation shifts the bias in proportion to the mean square of the oscillation."""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Variant, per_axis, single
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

DEG = np.pi / 180
_TWO = 1.2  # ratio of two intensities; with a single intensity, the shift looks like an offset of the rocking segments
_SHOWN_BY = "segments at rest, and rocking segments of two intensities"


class GyroVibrationRectification:
    """Adds k·⟨|ω'|²⟩ to the bias of each axis, where ω' is the oscillating part of the angular rate of the table, and ⟨ ⟩ is the
    mean over time (IEEE Std 528, vibration rectification error, here due to angular vibration). Unlike a term in ω², this effect
    does not act at steady rates."""

    id, stage = "gyro_vibration_rectification", "sensor"
    about = About(
        "gyro bias shifts under vibration",
        "Oscillation of the table shifts the mean output of the gyros in proportion to the mean square of its angular rate.",
        Actor.SENSOR,
        "Isolate the gyros from the oscillation, or subtract the shift predicted from the mean square of the angular rate: {found}.",
    )
    shown_by = _SHOWN_BY

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.pulsation.any():
            return []
        unit = "deg/s/(deg/s)^2"
        return single(per_axis(observed, "gyro", "k", unit, 1 / DEG, 1e-5 / DEG, observed.mean_square_rate))

    def shown_in(self, observed: Observed) -> bool:
        return _two_intensities(observed.mean_square_rate)


class AccelVibrationRectification:
    """Adds k·⟨|α'|²⟩ to the bias of each axis, where α' is the oscillating part of the angular acceleration of the table, and ⟨ ⟩ is the
    mean over time. The linear acceleration of the vibration is proportional to α'. IEEE Std 1293 calls this effect vibration
    rectification error. The coefficient of this standard, which refers to g², is k divided by the square of the distance from the
    axis."""

    id, stage = "accel_vibration_rectification", "sensor"
    about = About(
        "accelerometer bias shifts under vibration",
        "Vibration of the table shifts the mean output of the accelerometers in proportion to its mean square acceleration.",
        Actor.SENSOR,
        "Isolate the accelerometers from the vibration, or subtract the shift predicted from the mean square acceleration: {found}.",
    )
    shown_by, explains_turning = _SHOWN_BY, True

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.pulsation.any():
            return []
        unit, factor = "ug/(rad/s^2)^2", 1e-6 * G
        return single(per_axis(observed, "accel", "k", unit, factor, 10 * factor, observed.mean_square_acceleration))

    def shown_in(self, observed: Observed) -> bool:
        return _two_intensities(observed.mean_square_acceleration)


def _two_intensities(mean_square: Array) -> bool:
    """Returns True if the rocking segments have at least two intensities: their largest mean square is more than `_TWO` times their
    smallest. `mean_square`: array of shape (N,), zero at samples of other segments."""
    rocks = mean_square[mean_square > 0]
    return bool(len(rocks) and rocks.max() > _TWO * rocks.min())
