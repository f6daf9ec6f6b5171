"""Defines the interface for effects that a simulation adds to the declared errors of a virtual sensor.

The virtual sensor provides the conditions at its samples, and its outputs without noise. The object in `World.added` changes these
outputs and their noise. The sensor does not depend on effects, and an effect does not depend on the error model of the sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.plan.schedule import Segment


@dataclass(frozen=True, slots=True)
class Moments:
    """The conditions at some samples, from which effects compute their changes of the outputs.

    `time`: array of shape (n,), middle of each sampling interval, s since the start of the run. `power_on`: time at which the
    sensor was switched on, s, by the same clock. `angle`: array of shape (n,) in rad, rotation of the table since it reached the
    orientation. `rate`: rate of this rotation, rad/s. `acceleration`: angular acceleration of the table, rad/s². Angle, rate and
    acceleration are means over each sampling interval, like the outputs of the sensor. `kelvin`: temperature of the sensor, K.
    `overvoltage`: supply voltage minus its nominal value, V. `overpressure`: ambient pressure minus the standard atmosphere, Pa.
    """

    segment: Segment
    time: Array
    power_on: float
    sample_rate: float
    angle: Array
    rate: Array
    acceleration: Array
    kelvin: Array
    overvoltage: Array
    overpressure: Array


@dataclass(frozen=True, slots=True)
class Gives:
    """States the unit and the noise of one output of the sensor.

    `unit`: unit of the output. `white`: coefficient N of the white noise, unit·√s. `step`: smallest step of a sample, unit.
    """

    unit: str
    white: float
    step: float


class Added(Protocol):
    """Changes the outputs of a virtual sensor and their noise by effects."""

    def levels(self, moments: Moments, levels: Mapping[str, Array], gives: Mapping[str, Gives]) -> Mapping[str, Array]:
        """Returns the outputs (n,) without noise, each in its unit, after the effects have been added. `levels`: the outputs (n,)
        before the effects are added. `gives`: unit and noise of each output."""

    def noise(self, output: str, gives: Gives) -> Gives:
        """Returns the noise of an output after the effects have been added."""

    def readings(self, moments: Moments, samples: Mapping[str, Array]) -> Mapping[str, Array]:
        """Returns the outputs (n,) with noise, each in its unit, as they are recorded. `samples`: the outputs (n,) with noise,
        before the effects on readings are added."""
