"""The warm-up of a triad: an exponential decay since power-on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planrunner.error_model.effects.interface import Column, per_axis
from planrunner.error_model.observed import Observed


def time_to_settle(tau: float) -> Mapping[str, str]:
    """The time after which less than a hundredth of a warm-up with a time constant in s remains."""
    return {"wait": f"{tau * np.log(100.0) / 60:.2g} min"}


def decaying(observed: Observed, kind: str, unit: str, factor: float, magnitude: float, tau: float) -> list[Column]:
    """a·exp(−t/τ) per axis, a in `unit` at power-on. The columns are those of the amplitude when the recording begins, which may be long
    after power-on."""
    decay = np.exp(-(observed.time - observed.time[0]) / tau)
    left = max(float(np.exp(-observed.time[0] / tau)), 1e-300)
    return per_axis(observed, kind, "a", unit, factor * left, magnitude, decay)
