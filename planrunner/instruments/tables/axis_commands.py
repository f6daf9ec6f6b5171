"""Interface of the commands of a real table's controller, which each driver implements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class AxisState:
    """Position and rate of an axis as measured by the controller, in the controller's angles: deg and deg/s."""

    position: float
    rate: float


@dataclass(frozen=True, slots=True)
class AxisBounds:
    """Limits that an axis must enforce itself, in the controller's units: deg/s, deg/s², deg. `lowest` and `highest` are None for
    an axis without stops."""

    rate: float
    acceleration: float
    tracking_error: float
    lowest: float | None = None
    highest: float | None = None


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine motion about the present position: amplitude·sin(2π·frequency·t + phase), with amplitude and phase in deg and
    frequency in Hz."""

    amplitude: float
    frequency: float
    phase: float


class AxisCommands(Protocol):
    """Commands of a controller. Axes are named by the controller's numbers; angles are those of the controller, in degrees. Every
    failure is an `InstrumentError`."""

    rocks: bool
    """Whether the controller has a sine motion."""

    def identify(self) -> Mapping[str, str]: ...
    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        """Sets the limits that the axis enforces itself; returns a line for each limit that is now set."""

    def energise(self) -> None:
        """Makes the axes ready to move. Called before the first move, and after `switch_off`."""

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        """Moves axes to positions, where they stay. here: the present positions. An axis that enters its position mode first holds
        its present position."""

    def turn(self, axis: int, rate: float) -> None: ...
    def rock(self, sines: Mapping[int, Sine]) -> None: ...
    def state(self, axis: int) -> AxisState: ...
    def faults(self) -> Sequence[str]:
        """The reasons why the table cannot continue, in words; empty without a fault."""

    def stop(self) -> None:
        """Brings every axis to rest under control."""

    def switch_off(self) -> None: ...
    def remarks(self) -> Sequence[str]: ...
    def close(self) -> None: ...
