"""Effects of line interference: the electric supply or a vibration causes a sine of one frequency in the outputs of a triad.

Interference and its aliases are a single effect. The sine is evaluated at the times of the samples. Therefore, a line above half of
the sampling rate f_s appears at its folded frequency |f − n·f_s| (Oppenheim and Schafer, Discrete-Time Signal Processing, sampling
theorem). The samples alone do not show which of these frequencies is the true one.
"""

from __future__ import annotations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Shaped, Variant, per_axis
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

_SCALES = {"gyro": ("deg/s", np.pi / 180, 1e-2), "accel": ("mg", 1e-3 * G, 1.0)}
"""For each kind of triad: the unit of the amplitude, the SI value of this unit, and the usual size of the amplitude in this
unit."""
_LINE = 60.0  # Hz, default of a simulation: frequency of an electric supply


def _about(triad: str) -> About:
    return About(
        f"{triad} output contains interference of one frequency",
        f"The electric supply or a vibration adds a sine to the outputs of the {triad}s; a sine above half of the sampling rate "
        "appears at a lower (aliased) frequency.",
        Actor.BENCH,
        "Look for a supply, a motor or a resonance at this frequency; because of aliasing, the true frequency may also be a multiple of "
        "the sampling rate plus or minus this frequency. Shield the cables, or filter the output before it is sampled: {found}.",
    )


class _LineInterference(Shaped):
    """Adds a·cos 2πft + b·sin 2πft to the output of each axis, where t is the time of a sample since power-on."""

    stage, outside, shape_name, shape_unit = "output", "line", "frequency", "Hz"
    kind: str

    def grid(self, observed: Observed) -> Array:
        return np.array([_LINE]) if observed.of_kind(self.kind) and observed.along is None else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        unit, factor, natural = _SCALES[self.kind]
        phase = 2 * np.pi * value * observed.time
        cosine, sine = (
            per_axis(observed, self.kind, name, unit, factor, natural * factor, wave(phase))
            for name, wave in (("cos", np.cos), ("sin", np.sin))
        )
        return Variant((*cosine, *sine), value)


class GyroLineInterference(_LineInterference):
    """Adds a·cos 2πft + b·sin 2πft to the output of each gyro, with one frequency f for all gyros."""

    id, kind, about = "gyro_line_interference", "gyro", _about("gyro")


class AccelLineInterference(_LineInterference):
    """Adds a·cos 2πft + b·sin 2πft to the output of each accelerometer, with one frequency f for all accelerometers."""

    id, of_accelerometers, kind, about = "accel_line_interference", True, "accel", _about("accelerometer")
