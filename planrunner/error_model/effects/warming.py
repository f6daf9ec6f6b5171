"""Effects of the warm-up of a triad: an error that decays exponentially after power-on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Shaped, Variant, per_axis
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

_SCALES = {"gyro": ("deg/s", np.pi / 180, 1e-2 * np.pi / 180), "accel": ("mg", 1e-3 * G, 1e-3 * G)}
"""For each kind of triad: the unit of the amplitude, the SI value of this unit, and the prior scale of the amplitude in SI."""


def _time_to_settle(tau: float) -> Mapping[str, str]:
    """Returns the time after which less than one per cent of a warm-up remains. `tau`: time constant, s."""
    return {"wait": f"{tau * np.log(100.0) / 60:.2g} min"}


def _about(triad: str) -> About:
    return About(
        f"{triad} bias changes while the sensor warms up",
        f"After power-on, the bias of each {triad} approaches its final value exponentially.",
        Actor.PLAN,
        "Begin the first segment {wait} or more after power-on, or compensate the warm-up: {found}.",
        _time_to_settle,
    )


class _WarmUp(Shaped):
    """Adds a·exp(−t/τ) to the output of each axis, where t is the time since power-on."""

    stage, shape_name, shape_unit = "sensor", "tau", "s"
    shown_by, over_segments = "the same state at several times after power-on, the first of them early", True
    kind: str

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(60.0, 7200.0, 13) if observed.of_kind(self.kind) else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        """Returns the variant for the time constant `value`. Its columns are scaled so that an amplitude is the error at the start of the
        recording, which may be long after power-on."""
        unit, factor, magnitude = _SCALES[self.kind]
        decay = np.exp(-(observed.time - observed.time[0]) / value)
        left = max(float(np.exp(-observed.time[0] / value)), 1e-300)
        return Variant(tuple(per_axis(observed, self.kind, "a", unit, factor * left, magnitude, decay)), value)


class GyroWarmUp(_WarmUp):
    """Adds a·exp(−t/τ) to the bias of each gyro, where t is the time since power-on."""

    id, kind, about = "gyro_warm_up", "gyro", _about("gyro")


class AccelWarmUp(_WarmUp):
    """Adds a·exp(−t/τ) to the bias of each accelerometer, where t is the time since power-on."""

    id, hypothesis, kind, about = "accel_warm_up", False, "accel", _about("accelerometer")
