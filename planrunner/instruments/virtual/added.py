"""Interface for effects that a simulation adds to a virtual sensor beyond its declared errors.

The virtual sensor provides the conditions at its samples and its outputs without noise; the object in `World.added` changes these and the
noise. The sensor does not depend on effects, and an effect does not depend on the error model of the sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.plan.schedule import Segment


@dataclass(frozen=True, slots=True)
class Moments:
    """Conditions at some samples. time: middle of each sampling interval, (n,), s since the run began; power_on: time at which the
    sensor was switched on, s, by the same clock. angle: (n,), rad, rotation of the table since it reached the orientation; rate:
    rad/s; kelvin: temperature of the sensor; overvoltage: V above its nominal supply; overpressure: Pa above the standard
    atmosphere."""

    segment: Segment
    time: Array
    power_on: float
    sample_rate: float
    angle: Array
    rate: Array
    kelvin: Array
    overvoltage: Array
    overpressure: Array


@dataclass(frozen=True, slots=True)
class Gives:
    """One output of the sensor. unit: unit of the output; white: N, unit·√s; step: size of a step of one sample, unit."""

    unit: str
    white: float
    step: float


class Added(Protocol):
    def levels(self, moments: Moments, levels: Mapping[str, Array], gives: Mapping[str, Gives]) -> Mapping[str, Array]:
        """The outputs without noise, each (n,) in its unit, including the added effects."""

    def noise(self, output: str, gives: Gives) -> Gives:
        """The noise of an output, including the added effects."""

    def readings(self, moments: Moments, samples: Mapping[str, Array]) -> Mapping[str, Array]:
        """The outputs with noise, each (n,) in its unit, as the recording gets them."""
