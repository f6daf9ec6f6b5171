"""Supervises the bench during every wait of a run. The lookout checks links, faults, limits of the bench, the watchdog, and
requests of the operator.

About once a second by the bench's clock, every instrument that can report its state is queried. Unusual events are entered in the
journal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from planrunner.execution.connected_bench import ConnectedBench
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import (
    Alive,
    Condition,
    InstrumentError,
    OwnLimits,
    Remarking,
    Watched,
)
from planrunner.plan.units import ZERO_CELSIUS

EVERY = 1.0
"""Time between two checks, s."""
Notice = Callable[[str, str], None]


class StoppedAtOnceError(Exception):
    """The error that ends a run because the operator requested an immediate stop."""


class Lookout:
    """Watches the instruments during a run. `notice`: a function that is called with the name of an instrument and a description of
    an unusual event."""

    def __init__(self, bench: ConnectedBench, stop: StopRequest, notice: Notice):
        self._clock = bench.clock
        self._stop = stop
        self._notice = notice
        self._limits: OwnLimits = bench.limits
        self._sign_of_life: Callable[[], None] = bench.sign_of_life
        items = bench.instruments.items()
        self._watched: dict[str, Watched] = {name: item for name, item in items if isinstance(item, Watched)}
        self._alive = {name: item for name, item in items if isinstance(item, Alive) and name not in self._watched}
        self._remarking = {name: item for name, item in items if isinstance(item, Remarking)}
        self._last = -math.inf
        self._doubts: set[tuple[str, str]] = set()
        self._lost: InstrumentError | None = None
        self.conditions: Mapping[str, Condition] = {}
        self.looks = 0
        """Number of queries of the instruments."""

    @property
    def sees(self) -> bool:
        """Returns True if at least one instrument has live readings."""
        return bool(self._watched)

    def pause(self, seconds: float) -> None:
        """Sleeps on the bench's clock and supervises the bench. Raises the errors of `look`."""
        if not (self._watched or self._alive):
            if seconds > 0:
                self._clock.sleep(seconds)
            self.look()
            return
        end = self._clock.now() + seconds
        while (left := end - self._clock.now()) > 0:
            self._clock.sleep(min(left, EVERY))
            self.look()
        self.look()

    def look(self, fresh: bool = False) -> None:
        """Queries the instruments if a check is due, or immediately on request. Raises `StoppedAtOnceError` if the operator
        requested an immediate stop, and `InstrumentError` if an instrument has a fault. `fresh`: True for an immediate check."""
        if self._stop.at_once:
            raise StoppedAtOnceError
        if self._lost is not None:
            raise self._lost
        self._sign_of_life()
        if not fresh and self._clock.now() - self._last < EVERY:
            return
        self._last = self._clock.now()
        conditions = {}
        for item in self._alive.values():
            self._sign_of_life()  # each one may wait for its time-outs
            item.heartbeat()
        for name, watched in self._watched.items():
            self._sign_of_life()
            conditions[name] = watched.watch()
        self.conditions = conditions
        self.looks += 1
        self.hear()
        for name, condition in self.conditions.items():
            self._judge(name, condition)

    def idle(self) -> None:
        """Keeps the links alive while the bench waits in its safe state. In this state an open interlock or a lost link is not a
        fault."""
        self._sign_of_life()
        if self._clock.now() - self._last < EVERY:
            return
        self._last = self._clock.now()
        for name, ask in [(name, item.watch) for name, item in self._watched.items()] + [
            (name, item.heartbeat) for name, item in self._alive.items()
        ]:
            try:
                ask()
            except InstrumentError as error:
                self._once(name, str(error))

    def hear(self) -> None:
        """Adds an event to the journal for each command that a driver had to repeat."""
        for name, item in self._remarking.items():
            for text in item.remarks():
                self._notice(name, text)

    def tick(self) -> bool:
        """A real-time clock calls this method while it sleeps, even within a driver. Returns True if the sleep must end."""
        try:
            self._sign_of_life()
        except InstrumentError as error:
            self._lost = error
        return self._stop.at_once or self._lost is not None

    def begin_segment(self) -> None:
        """Resets the supervision at the beginning of a segment, so that doubtful states are reported again."""
        self._doubts.clear()
        self._last = -math.inf

    def _once(self, name: str, text: str) -> None:
        if (name, text) not in self._doubts:
            self._doubts.add((name, text))
            self._notice(name, text)

    def _judge(self, name: str, condition: Condition) -> None:
        for doubt in condition.doubts:
            self._once(name, doubt)
        if condition.faults:
            raise InstrumentError(f"'{name}' cannot continue: {'; '.join(condition.faults)}")
        values, limits = condition.values, self._limits
        kelvin = values.get("temperature")
        if kelvin is not None and limits.hottest is not None and kelvin > limits.hottest:
            raise InstrumentError(_beyond(name, "hotter", kelvin, limits.hottest))
        if kelvin is not None and limits.coldest is not None and kelvin < limits.coldest:
            raise InstrumentError(_beyond(name, "colder", kelvin, limits.coldest))
        error = abs(values.get("position_error", 0.0))
        if limits.position_error is not None and error > limits.position_error:
            raise InstrumentError(
                f"'{name}' has a following error of {error:.3g} rad, more than the {limits.position_error:.3g} rad "
                f"that the bench's protection allows: check "
                "for an obstruction or an unbalanced load"
            )


def _beyond(name: str, what: str, kelvin: float, limit: float) -> str:
    return (
        f"'{name}' reads {kelvin - ZERO_CELSIUS:.1f} degC, {what} than the {limit - ZERO_CELSIUS:.1f} degC that the "
        f"bench's protection allows: check the chamber and its setpoint"
    )
