"""Defines the operations of a table controller. Each driver of a real table implements these operations with commands of its
controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from planrunner.instruments.wire.links import Commands


@dataclass(frozen=True, slots=True)
class AxisState:
    """Contains the position [deg] and the rate [deg/s] of an axis, as the controller measures them."""

    position: float
    rate: float


@dataclass(frozen=True, slots=True)
class AxisBounds:
    """Contains the limits that an axis must enforce by itself, in the units of its controller: deg/s, deg/s² and deg. `lowest` and
    `highest` are None if the axis has no stops."""

    rate: float
    acceleration: float
    tracking_error: float
    lowest: float | None = None
    highest: float | None = None


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine motion about the present position: amplitude·sin(2π·frequency·t + phase). The amplitude and the phase are in deg, the
    frequency is in Hz."""

    amplitude: float
    frequency: float
    phase: float


class AxisCommands(Commands, Protocol):
    """Commands of a table controller. Axes are numbered as in the controller; angles are readings of the controller, in degrees.
    Every failure is an `InstrumentError`."""

    rocks: bool
    """True if the controller supports a sine motion."""

    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        """Sets the limits that the axis enforces by itself; returns one line of text for each limit that was set."""

    def energise(self) -> None:
        """Makes the axes ready to move. The method is called before the first move, and again after `switch_off`."""

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        """Moves axes to positions and holds them there. `here`: the present positions of the axes. The positions are necessary
        because an axis that changes to its position mode is first commanded to hold its present position."""

    def turn(self, axis: int, rate: float) -> None: ...
    def rock(self, sines: Mapping[int, Sine]) -> None: ...
    def state(self, axis: int) -> AxisState: ...
    def faults(self) -> Sequence[str]:
        """Returns the reasons why the table cannot continue, in words; empty if there is no fault."""

    def stop(self) -> None:
        """Brings every axis to rest in a controlled way."""

    def switch_off(self) -> None: ...
