"""Defines the interface of a connected bench that the executor uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from planrunner.instruments.interfaces import Instrument, OwnLimits, RunClock


class ConnectedBench(Protocol):
    """A bench with connected instruments. `instruments`: all instruments by name, including those with a role. `limits`: the limits
    that the instruments must enforce themselves."""

    @property
    def clock(self) -> RunClock: ...

    @property
    def table(self) -> Instrument | None: ...

    @property
    def chamber(self) -> Instrument | None: ...

    @property
    def sensor(self) -> Instrument | None: ...

    @property
    def instruments(self) -> Mapping[str, Instrument]: ...

    @property
    def limits(self) -> OwnLimits: ...

    def take_control(self, *names: str) -> None:
        """Announces that these instruments (by default all) are commanded from now on and must be made safe. The method is called
        before the first command. Raises `InstrumentError` if no watchdog guards the bench."""

    @property
    def untouched(self) -> Sequence[str]:
        """Returns the names of the instruments that were never controlled."""

    def make_safe(self) -> Sequence[object]:
        """Brings every controlled instrument to its safe state; returns the failures, whose texts name the instruments."""

    def sign_of_life(self) -> None:
        """Informs the watchdog that planrunner is at work. The method is called often. Raises `InstrumentError` if no watchdog
        guards the bench any more."""
