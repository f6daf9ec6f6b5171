"""Represents faults as data: the kind of fault, the simulated instrument, the time at which the fault begins, its duration and its
extent.

A fault script is a YAML file that lists faults. The control channel accepts single faults while the bench runs.

The frames of a sensor can be corrupted, lost, doubled, out of order, read at a wrong baud rate, or replaced by frames of another
instrument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings, InputError, closest
from planrunner.plan import source
from planrunner.plan.kinds import Choice, ListOf, Number, QuantityOf, Record, RecordOf, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.simulators.frames import Bytes

WORDS = {
    "late": "each reply arrives `delay` later",
    "partial": "only half of each reply arrives",
    "garbage": "each reply consists of wrong bytes",
    "silent": "no reply arrives",
    "drop link": "the connection is closed in place of a reply",
    "refuse": "the port is closed, with all its connections",
    "wrong model": "the instrument identifies itself as another one",
}
LINE = {
    "silent": "no frame arrives",
    "corrupt": "a `share` of the frames has a wrong byte",
    "lose": "a `share` of the frames is missing",
    "duplicate": "a `share` of the frames arrives twice",
    "reorder": "a `share` of the frames arrives after the next frame",
    "unplug": "the line disappears, and returns after the fault",
    "wrong baud": "every byte arrives as if at another baud rate",
    "wrong model": "the frames are those of another instrument",
    "overload": "the status reports that the x gyro is beyond its range",
    "self-test": "the status reports a failed self-test",
}
AILMENTS = frozenset({"overload", "self-test"})
"""Faults that the status of a sensor reports."""
TABLE = {
    "interlock open": "a door or a button opens the interlock chain",
    "over-rate": "an axis trips because of its rate",
    "tracking error": "an axis trips because of its following error",
    "axis fault": "an axis fails",
}
CHAMBER = {
    "stuck": "the air temperature stays constant",
    "overshoot": "the air temperature goes beyond every setpoint by `overshoot`",
    "alarm": "the chamber alarms and stops",
}
OF_ROLE: Mapping[str, Mapping[str, str]] = {
    "table": {**WORDS, **TABLE},
    "chamber": {**WORDS, **CHAMBER},
    "sensor": LINE,
}
"""Names of the possible faults for each role."""
_ALL = tuple(dict.fromkeys([*WORDS, *LINE, *TABLE, *CHAMBER]))


class Fault(Record):
    """Declares the keys of one fault."""

    instrument: str = key(Text(), "Instrument of the bench that has the fault.", "table")
    fault: str = key(Choice(_ALL), "Kind of fault.", "late")
    begins: Quantity = key(
        QuantityOf("time", "not negative"),
        "Time at which the fault begins, on the bench's clock, counted from the start of the simulated bench or from the injection.",
        "20 s",
        default=parse_quantity("0 s"),
        name="at",
    )
    lasts: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Duration on the bench's clock; by default the fault does not end.",
        "5 s",
        name="for",
    )
    count: int | None = optional(
        Number(1, 10**9, integer=True), "Number of replies that the fault affects before it ends.", 1
    )
    message: str | None = optional(Text(), "Only replies to messages that contain this text.", "PVAL")
    delay: Quantity = key(
        QuantityOf("time", "positive"),
        "For `late`: the delay, in real time.",
        "3 s",
        default=parse_quantity("3 s"),
    )
    share: Quantity = key(
        QuantityOf("ratio", "positive"),
        "For faults of frames: the share of the frames that are affected.",
        "1 %",
        default=parse_quantity("100 %"),
    )
    overshoot: Quantity = key(
        QuantityOf("temperature"),
        "For `overshoot`: the temperature difference beyond the setpoint.",
        "15 K",
        default=parse_quantity("15 K"),
    )
    axis: int = key(Number(1, 3, integer=True), "For faults of an axis: the number of the axis, from 1.", 1, default=1)


class FaultScript(Record):
    """Declares the keys of a fault script."""

    planrunner_faults: int = key(Number(1, 1, integer=True), "Version of the language of fault scripts.", 1)
    faults: tuple[Fault, ...] = key(
        ListOf(RecordOf(Fault)), "The faults.", [{"instrument": "table", "fault": "late", "delay": "3 s", "count": 1}]
    )


def read_script(path: Path, roles: Mapping[str, str]) -> tuple[Fault, ...]:
    """Reads the faults of a script. `roles`: maps the name of each instrument of the bench to its role. Raises `InputError` with
    all findings if the script is not valid."""
    data = source.read_bytes(path, str(path))
    log = Findings()
    script: FaultScript | None = RecordOf(FaultScript).read(
        source.parse(source.decode(data, str(path)), str(path)), log
    )
    for fault in script.faults if script else ():
        _check(fault, roles, log)
    if script is None or log.errors:
        raise InputError(log)
    return script.faults


def read_fault(text: str, roles: Mapping[str, str]) -> Fault:
    """Reads one fault, as YAML or JSON, such as `{instrument: table, fault: silent, for: 5 s}`. Raises `InputError` if the fault is
    not valid."""
    log = Findings()
    fault: Fault | None = RecordOf(Fault).read(source.parse(text, "<fault>"), log)
    if fault is not None:
        _check(fault, roles, log)
    if fault is None or log.errors:
        raise InputError(log)
    return fault


def _check(fault: Fault, roles: Mapping[str, str], log: Findings) -> None:
    if fault.instrument not in roles:
        message = f"'{fault.instrument}' is not an instrument of this bench"
        log.error("meaning-fault", fault.at("instrument"), message, closest(fault.instrument, roles))
        return
    possible = OF_ROLE[roles[fault.instrument]]
    if fault.fault not in possible:
        message = f"a {roles[fault.instrument]} cannot have the fault '{fault.fault}'"
        log.error("meaning-fault", fault.at("fault"), message, "one of " + ", ".join(possible))


@dataclass(slots=True)
class DeclaredFault:
    """Describes a fault, with the times at which it begins and ends.

    `begins`, `ends`: s on the bench's clock. `begun`: True if the fault has taken effect. `left`: number of replies that the fault
    still affects, None if there is no limit.
    """

    number: int
    fault: Fault
    begins: float
    ends: float
    left: int | None
    begun: bool = False


@dataclass(slots=True)
class FaultBoard:
    """Manages the faults of a simulated bench, in the order in which they were declared."""

    standing: dict[int, DeclaredFault] = field(default_factory=dict)
    declared: int = 0

    def declare(self, fault: Fault, now: float) -> int:
        """Declares a fault; returns its number, with which it can be cleared."""
        self.declared += 1
        begins = now + fault.begins.value
        ends = begins + (fault.lasts.value if fault.lasts else float("inf"))
        self.standing[self.declared] = DeclaredFault(self.declared, fault, begins, ends, fault.count)
        return self.declared

    def clear(self, number: int | None = None) -> None:
        """Ends the fault with this number or, if no number is given, all faults. The faults end immediately, even before their
        planned end."""
        for item in self.standing.values():
            if number in (None, item.number):
                item.ends = float("-inf")

    def changes(self, now: float) -> tuple[list[Fault], list[Fault]]:
        """Returns the faults that have begun since the last call, and the faults that have ended since then."""
        begun = [item for item in self.standing.values() if not item.begun and item.begins <= now < item.ends]
        over = [item for item in self.standing.values() if now >= item.ends or item.left == 0]
        for item in begun:
            item.begun = True
        for item in over:
            del self.standing[item.number]
        return [item.fault for item in begun if item not in over], [item.fault for item in over if item.begun]

    def active(self, instrument: str, now: float) -> list[Fault]:
        """Returns the faults that an instrument has at the time `now`."""
        return [item.fault for item in self._active(instrument, now)]

    def of_reply(self, instrument: str, message: str, now: float) -> Fault | None:
        """Returns the fault that affects the reply to a message; None if there is no such fault. The reply is counted if the fault
        affects a limited number of replies."""
        for item in self._active(instrument, now):
            if item.fault.fault in WORDS and (item.fault.message or "") in message:
                if item.left is not None:
                    item.left -= 1
                return item.fault
        return None

    def _active(self, instrument: str, now: float) -> list[DeclaredFault]:
        mine = (item for item in self.standing.values() if item.fault.instrument == instrument)
        return [item for item in mine if item.begins <= now < item.ends and item.left != 0]

    def told(self) -> list[JsonObject]:
        """Returns all declared faults that have not ended, as JSON data."""
        return [
            {"number": item.number, "instrument": item.fault.instrument, "fault": item.fault.fault, "begun": item.begun}
            for item in self.standing.values()
        ]


_COMPASS = b"$HEHDT,274.07,T*03\r\n"
"""Line of a heading sensor."""


def struck(frames: Bytes, faults: Sequence[Fault], draw: np.random.Generator) -> Bytes:
    """Applies faults to frames (n, length)."""
    for fault in faults:
        if not len(frames):
            return frames
        chosen = draw.random(len(frames)) < fault.share.value
        if fault.fault == "silent":
            return frames[:0]
        if fault.fault == "lose":
            frames = frames[~chosen]
        elif fault.fault == "duplicate":
            frames = np.repeat(frames, 1 + chosen, axis=0)
        elif fault.fault == "reorder":
            frames = frames[np.argsort(np.arange(len(frames)) + 1.5 * chosen, kind="stable")]
        elif fault.fault == "corrupt":
            frames = _corrupted(frames, np.flatnonzero(chosen), draw)
        elif fault.fault == "wrong baud":
            frames = _misread(frames)
        elif fault.fault == "wrong model":
            frames = np.tile(np.frombuffer(_COMPASS, np.uint8), (len(frames), 1))
    return frames


def _corrupted(frames: Bytes, rows: np.ndarray, draw: np.random.Generator) -> Bytes:
    """Changes one byte in each of the selected frames."""
    changed = frames.copy()
    places = draw.integers(0, frames.shape[1], rows.size)
    changed[rows, places] ^= draw.integers(1, 256, rows.size).astype(np.uint8)
    return changed


def _misread(frames: Bytes) -> Bytes:
    """Returns the frames as a receiver reads them at twice the bit rate: each byte becomes two bytes, in which every bit is
    doubled."""
    bits = np.unpackbits(frames, axis=1, bitorder="little")
    return np.packbits(np.repeat(bits, 2, axis=1), axis=1, bitorder="little")
