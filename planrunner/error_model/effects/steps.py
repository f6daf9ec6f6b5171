"""Steps of a bias at one moment, as after a shock or where a part slips."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.effects.about import About, Actor
from planrunner.error_model.effects.interface import Array, Shaped, Variant, per_axis
from planrunner.error_model.observed import Observed

_SCALES = {"gyro": ("deg/s", np.pi / 180, 1e-2), "accel": ("mg", 9.80665e-3, 1.0)}


def _about(triad: str) -> About:
    return About(
        f"{triad} bias makes a step",
        f"At one moment the bias of the {triad}s changes to another value, as after a shock.",
        Actor.SENSOR,
        "Look for a shock or a change of mode at this time, and evaluate the segments before and after it separately: {found}.",
    )


class _BiasStep(Shaped):
    """Bias + s per axis from a moment on, which is the shape."""

    stage, shape_name, shape_unit = "sensor", "time", "s"
    kind: str

    def grid(self, observed: Observed) -> Array:
        """Beginnings of segments and the middles of the first and the last, between which a diagnosis looks further. Every interval has
        the same prior, so that the evidence is averaged over the moment."""
        if not observed.of_kind(self.kind):
            return np.empty(0)
        bounds = observed.bounds
        middles = observed.time[[bounds[1] // 2, (bounds[-2] + bounds[-1]) // 2]]
        return np.unique(np.maximum([middles[0], *observed.time[bounds[1:-1]], middles[1]], 1e-9))

    def at(self, observed: Observed, value: float) -> Variant:
        unit, factor, natural = _SCALES[self.kind]
        after = (observed.time >= value).astype(float)
        return Variant(tuple(per_axis(observed, self.kind, "s", unit, factor, natural * factor, after)), value)


class GyroBiasStep(_BiasStep):
    """Bias of each gyro + s from a time since power-on on."""

    id, kind, about = "gyro_bias_step", "gyro", _about("gyro")


class AccelBiasStep(_BiasStep):
    """Bias of each accelerometer + s from a time since power-on on."""

    id, kind, about = "accel_bias_step", "accel", _about("accelerometer")
