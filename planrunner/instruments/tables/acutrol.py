"""Drives tables with an ACUTROL 3000 or ACT2000 controller. The link is GPIB or raw TCP (port 9878), and the command language is
ACL.

A command has the form `:Main:Sub axis,argument;Sub axis,argument`; the controller does not reply to it. The status byte shows
whether a command was accepted; the query `:status:stb?` reads the byte without clearing it. Communication over GPIB follows the
manual. The framing of replies over TCP has not been confirmed on hardware. Sources: ACUTROL 3000 manual; open-source drivers of a
BD125 table.

According to public sources, eight bytes with an error code and a length precede each reply over TCP. The sources disagree on the
form of these bytes: two 32-bit words, or eight characters. The first reply shows which form is right, because the stated length
must agree with the data that follow. In later replies, exactly the stated number of bytes is read. Plain lines of text, as a
gateway sends them, are also accepted.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.tables.axis_commands import AxisBounds, AxisCommands, AxisState, Sine
from planrunner.instruments.tables.axis_table import LinkedTableKeys, TableDriver
from planrunner.instruments.tables.wired_axes import counted
from planrunner.instruments.wire.links import (
    LONGEST,
    Incoming,
    LineAnswers,
    LinkedCommands,
    LinkFailure,
    LinkSettings,
    MessageLink,
    shown,
)
from planrunner.instruments.wire.replies import identification, number, numbers, written

HEADER = 8
QUIET = 0.1
"""The first reply counts as complete if no data arrive for this time, s."""

Header = Callable[[bytes], tuple[int, int]]


def _words(order: str) -> Header:
    return lambda head: struct.unpack(f"{order}II", head)


def _characters(base: int) -> Header:
    return lambda head: (int(head[:4], base), int(head[4:], base))


KINDS: dict[str, Header] = {
    "words, high byte first": _words(">"),
    "words, low byte first": _words("<"),
    "characters, decimal": _characters(10),
    "characters, hexadecimal": _characters(16),
}


def kind_of(reply: bytes) -> str | None:
    """Returns the form of the header of a complete reply, as a key of `KINDS`; None if the reply is a plain line. Raises
    `LinkFailure` if the reply has neither a header nor the form of a line."""
    for name, header in KINDS.items():
        try:
            _, length = header(reply[:HEADER])
        except (ValueError, struct.error):
            continue
        if length == len(reply) - HEADER:
            return name
    if reply.endswith(b"\n") and reply.strip().isascii():
        return None
    raise LinkFailure(f"answers with {shown(reply)}, which is neither a line nor framed by error code and length")


class AcutrolFraming:
    """Reads the replies of an ACUTROL controller. The first reply shows how replies are framed."""

    def __init__(self) -> None:
        self._known = False
        self._kind: str | None = None

    def read(self, incoming: Incoming) -> bytes:
        if not self._known:
            reply = incoming.until_quiet(QUIET)
            self._kind, self._known = kind_of(reply), True
            if self._kind is None:
                return reply
            return self._checked(KINDS[self._kind](reply[:HEADER])[0], reply[HEADER:])
        if self._kind is None:
            return incoming.until(b"\n")
        while True:
            head = incoming.exactly(HEADER)
            try:
                error, length = KINDS[self._kind](head)
            except ValueError:
                raise LinkFailure(f"sends {shown(head)} instead of error code and length") from None
            if length > LONGEST:
                raise LinkFailure(f"announces an answer of {length} bytes ({shown(head)})")
            body = self._checked(error, incoming.exactly(length))
            if body:  # a command may be acknowledged by a header alone
                return body

    def _checked(self, error: int, body: bytes) -> bytes:
        if error:
            raise InstrumentError(f"the ACUTROL reports error {error}" + (f": {shown(body)}" if body else ""))
        return body


PACE = {"GPIB": 0.04, "TCPIP": 0.002}
"""Minimum time between two messages, s."""
INTERLOCK, PROCESSOR, SUPERVISOR, REFUSED = 1, 2, 4, 8
"""Bits of the status byte."""
SERVICES = ("pos", "rate", "synt")
"""Modes that have separate limits."""
TRIP = 1.1
"""Rate at which the over-rate protection trips, as a multiple of the highest rate."""
MODES = {"p": "pos", "r": "rate", "s": "synt"}


class AcutrolParameters(LinkedTableKeys):
    """Declares the bench-file keys of a table with an ACUTROL controller."""


class Acutrol(TableDriver[AcutrolParameters]):
    """A table with an ACUTROL 3000 or ACT2000 controller, over GPIB or TCP."""

    Parameters = AcutrolParameters

    @classmethod
    def commands_of(cls, parameters: AcutrolParameters) -> AxisCommands:
        return AcutrolCommands(parameters)


class AcutrolCommands(LinkedCommands):
    """Translates the operations of `AxisCommands` to commands of an ACUTROL controller."""

    rocks = True

    def __init__(self, parameters: AcutrolParameters):
        address = parameters.address.upper()
        pace = next((seconds for bus, seconds in PACE.items() if address.startswith(bus)), 0.0)
        settings = LinkSettings(parameters.address, parameters.timeout.value, "\n", pace, parameters.baud)
        self.link = MessageLink(settings, AcutrolFraming() if address.endswith("::SOCKET") else LineAnswers())
        self.parameters = parameters
        self.axes = [axis.number for axis in counted(parameters)]
        self._modes: dict[int, str] = {}

    def identify(self) -> Mapping[str, str]:
        said = self.link.query("*IDN?")
        self.parameters.check_identity(said, "ACUT")
        return identification(said)

    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        # Earlier status is irrelevant; a fault that persists is reported again at once.
        self.link.query("*STB?", after=[":interlock:reset"], again=False)
        reach = numbers(self.link, f":limit:absolute? {axis}", 6)
        if bounds.rate > reach[0] or bounds.acceleration > reach[1]:
            able = f"{reach[0]:g} deg/s and {reach[1]:g} deg/s^2"
            raise InstrumentError(
                f"axis {axis} of the ACUTROL reaches {able}, less than declared in the bench file ({bounds.rate:g}, "
                f"{bounds.acceleration:g}): correct max_rate and max_acceleration"
            )
        low = reach[3] if bounds.lowest is None else bounds.lowest
        high = reach[4] if bounds.highest is None else bounds.highest
        trip = min(reach[5], TRIP * bounds.rate)
        wanted = {"rate": bounds.rate, "acc": bounds.acceleration}
        ends = ",".join(map(written, (low, high, trip, bounds.tracking_error)))
        self._do(
            *(f":lim:{what} {mode},{axis},{written(value)}" for what, value in wanted.items() for mode in SERVICES),
            f":limit:global {axis},{ends}",
        )
        for what, value in wanted.items():
            kept = number(self.link, f":limit:{what}? rate,{axis}")
            if abs(kept - value) > 1e-3 * value:
                raise InstrumentError(
                    f"axis {axis} of the ACUTROL keeps {kept:g} as its {what} limit instead of the commanded {value:g}"
                )
        ends_told = "" if bounds.lowest is None else f", beyond {written(low)} to {written(high)} deg"
        return [
            f"axis {axis}: at most {bounds.rate:g} deg/s and {bounds.acceleration:g} deg/s^2; it trips at {trip:g} deg/s, "
            f"{bounds.tracking_error:g} deg of tracking error{ends_told}"
        ]

    def energise(self) -> None:
        off = ";".join(f"off {axis}" for axis in self.axes)
        close = ";".join(f"close {axis}" for axis in self.axes)
        self._do(":interlock:reset", f":mode:{off}", f":int:{close}")
        for axis in self.axes:
            if self.link.query(f":interlock? {axis}").casefold().startswith("fault"):
                raise InstrumentError(
                    f"the interlock of axis {axis} does not close: check doors, emergency stops and drives, then try "
                    "again"
                )
        self._modes = dict.fromkeys(self.axes, "off")

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        # An axis in another mode first holds its position, so that no earlier demand takes effect with the new mode.
        entering = {axis: here[axis] for axis in positions if self._modes.get(axis) != "pos"}
        hold = [_joined("dem", "pos", entering), _joined("mode", "pos", entering)] if entering else []
        self._enter("pos", positions, *hold, _joined("dem", "pos", positions))

    def turn(self, axis: int, rate: float) -> None:
        hold = [] if self._modes.get(axis) == "rate" else [f":dem:rate {axis},0", f":mode:rate {axis}"]
        self._enter("rate", [axis], *hold, f":dem:rate {axis},{written(rate)}")

    def rock(self, sines: Mapping[int, Sine]) -> None:
        still = {axis: Sine(0.0, sine.frequency, sine.phase) for axis, sine in sines.items()}
        entering = any(self._modes.get(axis) != "synt" for axis in sines)
        enter = [_oscillation(still), ":mode:" + ";".join(f"synt {axis}" for axis in sines)] if entering else []
        self._enter("synt", sines, *enter, _oscillation(sines))

    def _enter(self, mode: str, axes: Iterable[int], *commands: str) -> None:
        """Changes the operating mode of axes. During the change, no mode is stored for these axes, so that a query from another
        thread does not report a wrong mode."""
        for axis in axes:
            self._modes.pop(axis, None)
        self._do(*commands)
        self._modes.update(dict.fromkeys(axes, mode))

    def state(self, axis: int) -> AxisState:
        position, rate = numbers(self.link, f":read:pos? {axis};rate? {axis}", 2)
        return AxisState(position, rate)

    def faults(self) -> Sequence[str]:
        found = self._reported()
        strayed = []
        for axis, mode in list(self._modes.items()):
            said = self.link.query(f":mode? {axis}")
            if MODES.get(said[:1].casefold(), said.casefold()) != mode and self._modes.get(axis) == mode:
                strayed.append(f"axis {axis} went into the mode '{said}' by itself")
        if strayed and not found:  # it happened between the two questions
            found = self._reported()
        return found + strayed

    def _reported(self) -> list[str]:
        status = _byte(self.link.query(":status:stb?"))
        return [
            f"{what}: check the controller's display"
            for bit, what in (
                (INTERLOCK, "an interlock is open or a trip has opened it"),
                (PROCESSOR, "the axis control processor reports a fault"),
                (SUPERVISOR, "the supervisor reports a fault"),
            )
            if status & bit
        ]

    def stop(self) -> None:
        self._modes = {}
        self.link.query(":status:stb?", after=[":mode:off all"])

    def switch_off(self) -> None:
        self._modes = {}
        self.link.write(":int:open all")

    def _do(self, *commands: str) -> None:
        """Sends commands. Raises `InstrumentError` if the controller rejected one of them."""
        if not _byte(self.link.query(":status:stb?", after=commands)) & REFUSED:
            return
        self.link.query("*STB?", again=False)
        raise InstrumentError(f"the ACUTROL rejects one of these commands: {', '.join(commands)}")


def _byte(text: str) -> int:
    if not text.isdecimal() or int(text) > 255:
        raise InstrumentError(f"the ACUTROL gives '{text[:40]}' as its status byte, which is not a valid status byte")
    return int(text)


def _joined(main: str, sub: str, values: Mapping[int, float]) -> str:
    """Joins commands for several axes, such as `:dem:pos 1,90;pos 2,45` or `:mode:pos 1;pos 2`."""
    parts = [f"{sub} {axis}" + (f",{written(value)}" if main == "dem" else "") for axis, value in values.items()]
    return f":{main}:" + ";".join(parts)


def _oscillation(sines: Mapping[int, Sine]) -> str:
    parts = [
        f"osc {axis},{','.join(map(written, (sine.amplitude, sine.frequency, sine.phase)))}"
        for axis, sine in sines.items()
    ]
    return ":dem:" + ";".join(parts)
