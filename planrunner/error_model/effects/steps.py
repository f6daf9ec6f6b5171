"""Steps of a bias at one moment, as after a shock or where a part slips."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.about import About, Actor
from planrunner.error_model.effects.interface import Array, Shaped, Variant, per_axis
from planrunner.error_model.observed import Observed

_SCALES = {"gyro": ("deg/s", np.pi / 180, 1e-2), "accel": ("mg", 9.80665e-3, 1.0)}


class _BiasStep(Shaped):
    """Bias + s per axis from a moment on, which is the shape."""

    stage, shape_name, shape_unit = "sensor", "time", "s"
    kind: str

    def grid(self, observed: Observed) -> Array:
        """Beginnings of segments, between which a diagnosis looks further."""
        if not observed.of_kind(self.kind):
            return np.empty(0)
        starts = observed.time[observed.bounds[:-1]]
        return starts[1:] if len(starts) > 1 else np.maximum(starts, 1e-9)

    def at(self, observed: Observed, value: float) -> Variant:
        unit, factor, natural = _SCALES[self.kind]
        after = (observed.time >= value).astype(float)
        return Variant(tuple(per_axis(observed, self.kind, "s", unit, factor, natural * factor, after)), value)


class GyroBiasStep(_BiasStep):
    """Bias of each gyro + s from a time since power-on on."""

    id, hypothesis, kind = "gyro_bias_step", False, "gyro"
    about = About(
        "gyro bias makes a step",
        "At one moment the bias of the gyros changes to another value, as after a shock.",
        Actor.SENSOR,
        "Look for a shock or a change of mode at this time, and evaluate the segments before and after it separately: {found}.",
    )


class AccelBiasStep(_BiasStep):
    """Bias of each accelerometer + s from a time since power-on on."""

    id, hypothesis, kind = "accel_bias_step", False, "accel"
    about = About(
        "accelerometer bias makes a step",
        "At one moment the bias of the accelerometers changes to another value, as after a shock.",
        Actor.SENSOR,
        "Look for a shock or a change of mode at this time, and evaluate the segments before and after it separately: {found}.",
    )
