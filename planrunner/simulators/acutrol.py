"""Simulates an ACUTROL 3000 / ACT2000 controller: messages in the language ACL, a mode and demands for each axis, a status byte,
and an interlock.

A message has the form `:Main:Sub axis,argument`, with further commands after `;`. Every word can be abbreviated. Only the commands
that a bench uses are implemented. Any other command sets the remote-interface bit in the status byte and has no reply.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import NotUnderstoodError, first_with, number, shown
from planrunner.simulators.table_plant import TablePlant

MODES = ("off", "position", "rate", "arate", "synthesis", "track", "abort")
_READINGS = ("position", "rate", "acceleration")
_MAINS = ("interlock", "mode", "limit", "demand", "read", "status")
_LIMITS = ("rate", "acceleration", "absolute", "global")
_DEMANDS = ("position", "rate", "acceleration", "oscillator")
_INTERLOCK = ("reset", "open", "close")
_JERK = 40000.0  # deg/s^3, told among the absolute limits
INTERLOCKS, AXIS_CONTROL, REMOTE, SERVICE = 1, 2, 8, 64
_COMMAND = re.compile(r"(?P<head>[:\w*]+)(?P<query>\?)?\s*(?P<arguments>.*)", re.DOTALL)


@dataclass(slots=True)
class _Held:
    """Contains what the controller stores for one axis: its mode, its demands, and its limits in each mode. Angles are in
    degrees."""

    mode: str = "off"
    position: float = 0.0
    rate: float = 0.0
    sine: tuple[float, float, float] = (0.0, 1.0, 0.0)
    rates: dict[str, float] = field(default_factory=dict)
    accelerations: dict[str, float] = field(default_factory=dict)


class Acutrol:
    """Simulates the controller of a table's axes; the axes are numbered from 1."""

    identity = "ACUTRONIC,ACUTROL3000,simulated,1.0"

    def __init__(self, plant: TablePlant):
        self.plant = plant
        self.held = [_Held() for _ in plant.axes]
        self.latched = 0

    # -- messages ----------------------------------------------------------------------------------------------------

    def answer(self, message: str) -> str | None:
        replies: list[str] = []
        main = ""
        for command in filter(None, (part.strip() for part in message.split(";"))):
            try:
                main, reply = self._command(command, main)
            except NotUnderstoodError:
                self.latched |= REMOTE
                continue
            if reply is not None:
                replies.append(reply)
        return ";".join(replies) if replies else None

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        for index in range(len(self.held)):
            self.plant.state(index)

    def _command(self, command: str, main: str) -> tuple[str, str | None]:
        found = _COMMAND.fullmatch(command)
        if found is None:
            raise NotUnderstoodError(command)
        head, asked = found["head"], found["query"] is not None
        arguments = [word for word in re.split(r"[,\s]+", found["arguments"]) if word]
        if head.startswith("*"):
            return main, self._common(head.lower() + ("?" if asked else ""))
        words = [word for word in head.split(":") if word]
        if head.startswith(":"):
            main, words = first_with(words[0] if words else "", _MAINS), words[1:]
        if not main or len(words) > 1:
            raise NotUnderstoodError(command)
        sub = words[0] if words else ""
        if asked:
            return main, self._ask(main, sub, arguments)
        self._tell(main, sub, arguments)
        return main, None

    def _common(self, command: str) -> str | None:
        if command == "*idn?":
            return self.identity
        if command == "*stb?":
            status, self.latched = self._status(), 0
            return str(status)
        if command == "*cls":
            self.latched = 0
            return None
        raise NotUnderstoodError(command)

    # -- questions -----------------------------------------------------------------------------------------------------

    def _ask(self, main: str, sub: str, arguments: list[str]) -> str:
        if main == "status":
            return self._status_word(sub.lower())
        if main == "limit":
            return self._ask_limit(first_with(sub, _LIMITS), arguments)
        index = self._axis(arguments)
        if main == "read":
            return self._read(index, first_with(sub, _READINGS))
        if main == "mode":
            return self._mode(index).capitalize()
        if main == "interlock":
            axis = self.plant.axes[index]
            if self.plant.interlock_fault or axis.faults:
                return "Fault"
            return "Closed" if axis.powered else "Open"
        if main == "demand":
            held = self.held[index]
            return shown(held.rate if first_with(sub, _DEMANDS) == "rate" else held.position)
        raise NotUnderstoodError(sub)

    def _read(self, index: int, what: str) -> str:
        degrees = [math.degrees(value) for value in self.plant.state(index)]
        value = degrees[_READINGS.index(what)]
        if what == "position" and self.plant.axes[index].model.continuous:
            value = round(value, 6) % 360.0
        return shown(value)

    def _ask_limit(self, sub: str, arguments: list[str]) -> str:
        axis = self._axis(arguments[-1:])
        model, held = self.plant.axes[axis].model, self.held[axis]
        if sub == "absolute":
            low = math.degrees(model.lowest) if math.isfinite(model.lowest) else -1e6
            high = math.degrees(model.highest) if math.isfinite(model.highest) else 1e6
            fastest, acceleration = math.degrees(model.max_rate), math.degrees(model.max_acceleration)
            return ",".join(map(shown, (fastest, acceleration, _JERK, low, high, 1.1 * fastest)))
        if sub == "global":
            limits = self.plant.axes[axis]
            tracking = limits.tracking if math.isfinite(limits.tracking) else math.pi
            return ",".join(shown(math.degrees(v)) for v in (limits.lowest, limits.highest, limits.trip, tracking))
        mode = first_with(arguments[0], MODES)
        if sub == "rate":
            return shown(held.rates.get(mode, math.degrees(model.max_rate)))
        return shown(held.accelerations.get(mode, math.degrees(model.max_acceleration)))

    def _status(self) -> int:
        bits = self.latched
        bits |= INTERLOCKS if self.plant.interlock_fault else 0
        bits |= AXIS_CONTROL if any(axis.faults for axis in self.plant.axes) else 0
        return bits | (SERVICE if bits else 0)

    def _status_word(self, sub: str) -> str:
        """Returns the status word with this name. `stb` is the status byte. For axis n, `a<n>dyn` describes the motion and
        `a<n>sft` the software faults."""
        if sub == "stb":
            return str(self._status())
        found = re.fullmatch(r"a(\d+)(dyn|sft)", sub)
        if found is None:
            raise NotUnderstoodError(sub)
        index = self._axis([found[1]])
        axis = self.plant.axes[index]
        if found[2] == "sft":
            bits = {"axis fault": 1, "over-rate": 2, "tracking error": 4}
            return str(sum(bits.get(fault, 0) for fault in set(axis.faults)))
        arrived, mode = self.plant.arrived(index), self._mode(index)
        limited = {"rate": 16, "position": 64}.get(axis.limited, 0)
        return str(
            limited + (256 if arrived and mode == "position" else 0) + (512 if arrived and mode == "rate" else 0)
        )

    # -- commands ------------------------------------------------------------------------------------------------------

    def _tell(self, main: str, sub: str, arguments: list[str]) -> None:
        if main == "interlock":
            self._interlock(first_with(sub, _INTERLOCK), arguments)
        elif main == "mode":
            mode = first_with(sub, MODES)
            for index in self._axes(arguments):
                self._enter(index, mode)
        elif main == "limit":
            self._limit(first_with(sub, _LIMITS), arguments)
        elif main == "demand":
            self._demand(first_with(sub, _DEMANDS), self._axis(arguments), [number(word) for word in arguments[1:]])
        else:
            raise NotUnderstoodError(sub)

    def _interlock(self, action: str, arguments: list[str]) -> None:
        if action == "reset":
            self.plant.reset()
            return
        for index in self._axes(arguments):
            axis = self.plant.axes[index]
            if action == "close":
                if self.plant.interlock_fault or axis.faults:
                    raise NotUnderstoodError("the interlock is open")
                axis.powered = True
                continue
            if axis.powered:
                self.plant.stop(index)
            axis.powered, self.held[index].mode = False, "off"

    def _limit(self, sub: str, arguments: list[str]) -> None:
        if sub == "global":
            index, values = self._axis(arguments), [number(word) for word in arguments[1:]]
            if len(values) != 4 or values[0] >= values[1] or min(values[2:]) <= 0:
                raise NotUnderstoodError("limit:global")
            axis = self.plant.axes[index]
            low, high, trip, tracking = map(math.radians, values)
            axis.lowest, axis.highest = max(low, axis.model.lowest), min(high, axis.model.highest)
            axis.trip, axis.tracking = trip, tracking
            return
        if sub == "absolute" or len(arguments) != 3:
            raise NotUnderstoodError(sub)
        mode, index, value = first_with(arguments[0], MODES), self._axis(arguments[1:]), number(arguments[2])
        model, held = self.plant.axes[index].model, self.held[index]
        most = math.degrees(model.max_rate if sub == "rate" else model.max_acceleration)
        if not 0 < value <= most * (1 + 1e-9):
            raise NotUnderstoodError(f"{sub} limit {value}")
        (held.rates if sub == "rate" else held.accelerations)[mode] = value

    def _demand(self, sub: str, index: int, values: list[float]) -> None:
        held = self.held[index]
        if len(values) != (3 if sub == "oscillator" else 1) or not all(map(math.isfinite, values)):
            raise NotUnderstoodError(sub)
        if sub == "position":
            held.position = values[0]
        elif sub == "rate":
            held.rate = values[0]
        elif sub == "oscillator" and values[0] >= 0 < values[1]:
            held.sine = (values[0], values[1], values[2])
        else:
            raise NotUnderstoodError(sub)
        if self._mode(index) == {"oscillator": "synthesis"}.get(sub, sub):
            self._pursue(index)

    def _enter(self, index: int, mode: str) -> None:
        axis, held = self.plant.axes[index], self.held[index]
        if mode not in ("off", "abort") and not axis.powered:
            raise NotUnderstoodError("the axis is open")
        held.mode = mode
        if mode == "off":
            slowing = held.accelerations.get("rate")
            self.plant.stop(index, None if slowing is None else math.radians(slowing))
        elif mode == "abort":
            self.plant.stop(index)
        else:
            self._pursue(index)

    def _pursue(self, index: int) -> None:
        """Executes the demand that belongs to the present mode."""
        held, model = self.held[index], self.plant.axes[index].model
        rate = math.radians(held.rates.get(held.mode, math.degrees(model.max_rate)))
        acceleration = math.radians(held.accelerations.get(held.mode, math.degrees(model.max_acceleration)))
        if held.mode == "position":
            self.plant.go(index, math.radians(held.position), rate, acceleration)
        elif held.mode == "rate":
            self.plant.turn(index, math.radians(held.rate), rate, acceleration)
        elif held.mode == "synthesis":
            amplitude, frequency, phase = held.sine
            self.plant.swing(index, math.radians(amplitude), frequency, math.radians(phase), rate, acceleration)

    # -- axes ----------------------------------------------------------------------------------------------------------

    def _mode(self, index: int) -> str:
        """Returns the actual mode of an axis. The actual mode can differ from the commanded mode, because an axis that a fault has
        stopped has no mode."""
        axis = self.plant.axes[index]
        if axis.faults:
            return "abort"
        return self.held[index].mode if axis.powered else "off"

    def _axis(self, arguments: list[str]) -> int:
        place = int(arguments[0]) - 1 if arguments and arguments[0].isdigit() else -1
        if not 0 <= place < len(self.held):
            raise NotUnderstoodError("axis")
        return place

    def _axes(self, arguments: list[str]) -> list[int]:
        """Returns all axes if the argument is `all` or absent, otherwise the axis with this number."""
        if not arguments or arguments[0].lower() == "all":
            return list(range(len(self.held)))
        return [self._axis(arguments)]


def simulated(keys: object, live: LiveWorld) -> Conversation:
    """Makes the simulated instrument for a bench file."""
    return Conversation(Acutrol(TablePlant(live)), framed=True)
