"""What is known of an instrument without connecting to it: the frozen models that checker, schedule, design and estimators use.

SI units with radians throughout, except a sensor's outputs, which have a unit of their own, always named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from planrunner.physics.kinematics import TableAxis

__all__ = ["ChamberModel", "NoiseModel", "Origin", "OutputModel", "SensorModel", "TableAxis", "TableModel"]

Origin = Literal["measured", "simulated", "replayed"]
"""Where the samples of a run come from: real instruments; instruments of which at least one is simulated; a recording made before."""


@dataclass(frozen=True, slots=True)
class TableModel:
    """A position/rate table. axes: outermost first. position_uncertainty: standard, rad; rate_stability: relative, standard;
    orthogonality: standard uncertainty of the angles between its axes, rad."""

    axes: tuple[TableAxis, ...]
    position_uncertainty: float = 0.0
    rate_stability: float = 0.0
    orthogonality: float = 0.0


@dataclass(frozen=True, slots=True)
class ChamberModel:
    """A temperature chamber. lowest, highest: K; ramp: K/s; ambient: K, where it is left.

    lag: time constant [s] with which the air follows the ramp; tolerance: K, within which a temperature counts as reached;
    temperature_uncertainty: standard, K, of the chamber's own thermometer.
    """

    lowest: float
    highest: float
    ramp: float
    ambient: float = 298.15
    lag: float = 0.0
    tolerance: float = 0.5
    temperature_uncertainty: float = 0.0

    def seconds_to_change(self, kelvin: float) -> float:
        """Time until the air is within tolerance of a setpoint `kelvin` away.

        A first-order lag τ behind a ramp r that lasts t is r·τ·(1 − e^(−t/τ)) behind when the ramp ends, and decays with τ from there.
        """
        if abs(kelvin) <= self.tolerance:
            return 0.0
        ramping = abs(kelvin) / self.ramp
        if self.lag == 0.0:
            return ramping
        behind = self.ramp * self.lag * -math.expm1(-ramping / self.lag)
        return ramping + self.lag * max(0.0, math.log(behind / self.tolerance))


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of one output, in output units.

    white: random-walk coefficient N [unit·√s]: the mean over T seconds has variance N²/T.
    bias_instability: flicker floor [unit]; resolution: one count [unit]. counted: what a sample leaves of a count goes into the next, so
    that only the two ends of a mean are rounded.
    """

    white: float = 0.0
    bias_instability: float = 0.0
    resolution: float = 0.0
    counted: bool = False

    def standard_error(self, seconds: float, rate_hz: float) -> float:
        """Standard uncertainty of the mean over `seconds` of samples at `rate_hz`."""
        samples = max(1.0, seconds * rate_hz)
        white = self.white**2 / max(seconds, 1.0 / rate_hz)
        per_sample = self.white**2 * rate_hz
        dithered = per_sample > (self.resolution / 2) ** 2
        rounding = self.resolution**2 / 12 / (samples if dithered else 1.0)
        if self.counted:
            rounding = self.resolution**2 / 6 / samples**2
        return math.sqrt(white + rounding + self.bias_instability**2)


@dataclass(frozen=True, slots=True)
class OutputModel:
    """One output channel: its name, the unit it is recorded in, full scale (either sign) in that unit, and noise."""

    name: str
    unit: str
    full_scale: float = math.inf
    noise: NoiseModel = field(default_factory=NoiseModel)


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The sensor under test. `nominal` holds declared coefficients (name → SI value) that predictions are linearised at.

    modes: operating modes that the driver can set (such as caged, navigation); empty for a sensor that only has one.
    """

    kind: str
    outputs: tuple[OutputModel, ...]
    sample_rate: float
    nominal: Mapping[str, float] = field(default_factory=dict)
    modes: tuple[str, ...] = ()

    def output(self, name: str) -> OutputModel | None:
        return next((item for item in self.outputs if item.name == name), None)
