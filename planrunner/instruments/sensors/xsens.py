"""Drives the Xsens MTi, which sends messages of the Xbus protocol. The packets of the message MTData2 can differ from frame to
frame.

A message consists of the bytes FA FF, its identifier, the length of its data, the data, and a last byte that makes the sum of all
bytes after FA zero. The data of an MTData2 message are packets. Each packet consists of an identifier, a length
and its content. The low bits of the identifier encode the number format.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import Clock, InstrumentError
from planrunner.instruments.sensors.keys import SerialSensorParameters
from planrunner.instruments.sensors.samples import FrameLayout, Samples, Status, Whole
from planrunner.instruments.sensors.serial_sensor import SerialSensor
from planrunner.instruments.wire.checksums import ZERO_SUM8
from planrunner.instruments.wire.codes import FLOAT, FRACTION_FIRST, SIGNED, UNSIGNED, XBUS
from planrunner.instruments.wire.columns import Field, alike
from planrunner.instruments.wire.framing import Framer, Frames, Framing
from planrunner.instruments.wire.host_clock import FrameCounter
from planrunner.instruments.wire.serial_stream import SerialStream
from planrunner.plan.kinds import Boolean, Choice, ListOf, key

LONGEST = 2048 + 7
MT_DATA_2, DEVICE, GO_TO_CONFIG, GO_TO_MEASUREMENT, SET_OUTPUTS, ERROR = 0x36, 0x00, 0x30, 0x10, 0xC0, 0x42
PACKET_COUNTER, SAMPLE_TIME_FINE, STATUS_WORD = 0x1020, 0x1060, 0xE020
OUTPUTS = {
    "acceleration": (0x4020, 3),
    "delta_v": (0x4010, 3),
    "rate": (0x8020, 3),
    "delta_q": (0x8030, 4),
    "temperature": (0x0810, 1),
}
CHANNELS = {
    "acceleration": {f"accel_{axis}": "m/s^2" for axis in "xyz"},
    "delta_v": {f"accel_{axis}": "m/s^2" for axis in "xyz"},
    "rate": {f"gyro_{axis}": "rad/s" for axis in "xyz"},
    "delta_q": {f"gyro_{axis}": "rad/s" for axis in "xyz"},
    "temperature": {"sensor_temperature": "degC"},
}
NUMBERS = {0: (4, FLOAT, 1.0), 1: (4, SIGNED, 2.0**-20), 2: (6, FRACTION_FIRST, 1.0), 3: (8, FLOAT, 1.0)}
"""Number formats, by the low bits of an identifier: single precision, fixed point 12.20, fixed point 16.32, double precision. Each
entry states the width, the kind and the scale."""
CLIPPED = {
    8 + place: f"{name} {axis} clipped"
    for place, (name, axis) in enumerate((n, a) for n in ("accel", "gyro") for a in "xyz")
}
MOST_SHAPES = 64
ATTEMPTS, PATIENCE = 3, 0.5


class XsensParameters(SerialSensorParameters):
    """Declares the bench-file keys of an Xsens MTi on a serial line."""

    outputs: tuple[str, ...] = key(
        ListOf(Choice(tuple(OUTPUTS)), minimum=1),
        "Contents of every frame. delta_v and delta_q are recorded as the means over the frame, instead of "
        "acceleration and rate.",
        ["rate", "acceleration", "temperature"],
        default=("rate", "acceleration"),
    )
    configure: bool = key(
        Boolean(),
        "True to set the outputs (with packet counter and status word) and the rate when connecting; "
        "otherwise the sensor must already have these settings.",
        True,
        default=False,
    )


class XsensMti(SerialSensor[XsensParameters]):
    """An Xsens MTi on a serial line (MTData2)."""

    Parameters = XsensParameters
    manufacturer = "Xsens"
    product = "MTi"

    @classmethod
    def decoder_of(cls, parameters: XsensParameters) -> MtData2:
        return MtData2(parameters.outputs, parameters.sample_rate.value)

    @classmethod
    def configure(cls, parameters: XsensParameters, link: SerialStream, clock: Clock) -> Mapping[str, str]:
        if not parameters.configure:
            return {}
        rate = round(parameters.sample_rate.value)
        wanted = [
            (PACKET_COUNTER, 0xFFFF),
            (STATUS_WORD, 0xFFFF),
            *((OUTPUTS[name][0], rate) for name in parameters.outputs),
        ]
        settings = b"".join(number.to_bytes(2, "big") for item in wanted for number in item)
        ask(link, clock, GO_TO_CONFIG)
        serial = ask(link, clock, DEVICE)[4:-1].hex().upper()
        ask(link, clock, SET_OUTPUTS, settings)
        ask(link, clock, GO_TO_MEASUREMENT)
        return {"serial": serial, "configured": ", ".join(parameters.outputs)}


# -- messages ----------------------------------------------------------------------------------------------------------


def message(identifier: int, data: bytes = b"") -> bytes:
    """Returns the bytes of a message to the sensor. `data`: data of the message, at most 254 bytes."""
    body = bytes([0xFF, identifier, len(data)]) + data
    return b"\xfa" + body + bytes([ZERO_SUM8.of(body)])


def error_of(found: bytes) -> int | None:
    """Returns the error code in a message from the sensor; None if it is not an error message."""
    return found[4] if len(found) > 5 and found[2] == ERROR else None


def ask(link: SerialStream, clock: Clock, identifier: int, data: bytes = b"") -> bytes:
    """Sends a message and waits for the reply, which has the next higher identifier; other messages are skipped. Raises
    `InstrumentError` if the sensor reports an error or does not reply."""
    for _ in range(ATTEMPTS):
        framer = Framer(Framing(b"\xfa\xff", LONGEST, XBUS, ZERO_SUM8, 1, 1))
        link.write(message(identifier, data))
        until = clock.now() + PATIENCE
        while clock.now() < until:
            clock.sleep(0.01)
            frames = framer.push(link.take())
            for start, length in zip(frames.starts, frames.lengths, strict=True):
                found = frames.data[start : start + length].tobytes()
                if found[2] == identifier + 1:
                    return found
                if (code := error_of(found)) is not None:
                    raise InstrumentError(
                        f"the MTi refuses message {identifier:02X} with error {code:02X}: check its outputs and rate"
                    )
    raise InstrumentError(
        f"the MTi does not answer message {identifier:02X}: check its port and `baud`, and whether it is an MTi"
    )


# -- measurements ------------------------------------------------------------------------------------------------------


@dataclass
class MtData2:
    """Decodes frames that contain at least the declared outputs; other frames are refused. Frames with the same sequence of packets
    (the same shape) are decoded together."""

    outputs: tuple[str, ...]
    rate: float
    framing: Framing = field(
        default=Framing(bytes([0xFA, 0xFF, MT_DATA_2]), LONGEST, XBUS, ZERO_SUM8, 1, 1), init=False
    )
    _shapes: dict[bytes, tuple[Whole, FrameLayout | None]] = field(default_factory=dict, init=False)

    @property
    def counter(self) -> FrameCounter:
        return FrameCounter(1 / self.rate, 1, 1 << 16)

    def channels(self) -> Mapping[str, str]:
        return {name: unit for output in self.outputs for name, unit in CHANNELS[output].items()}

    def decode(self, frames: Frames) -> Samples:
        left = np.arange(len(frames))
        parts: list[Samples] = []
        refused = 0
        while left.size:
            first, length = int(frames.starts[left[0]]), int(frames.lengths[left[0]])
            heads, layout = self._shape(frames.data[first : first + length].tobytes())
            same = frames.lengths[left] == length
            same[same] = alike(frames.of(left[same]), heads)
            if layout is None:
                refused += int(np.count_nonzero(same))
            else:
                # In place of times the frames' numbers, by which the shapes are put in order again.
                chosen = replace(frames.of(left[same]), received=left[same].astype(float))
                parts.append(layout.decode(chosen))
            left = left[~same]
        return self._joined(parts, refused, frames.received)

    def _joined(self, parts: list[Samples], refused: int, received: Array) -> Samples:
        """Joins the samples of frames with different shapes, in the order in which the frames arrived. `refused`: number of frames
        that cannot be decoded. `received`: time of reception of each frame, s."""
        if not parts:
            empty = np.empty(0)
            channels = dict.fromkeys(self.channels(), empty)
            return Samples(empty, np.empty(0, np.int64), empty, channels, np.empty(0, bool), refused=refused)
        whole = reduce(Samples.and_then, parts)
        whole = whole.part(np.argsort(whole.received))
        return replace(
            whole,
            received=received[whole.received.astype(int)],
            channels=self._as_recorded(whole.channels),
            doubts=tuple(dict.fromkeys(text for samples in parts for text in samples.doubts)),
            refused=refused + sum(samples.refused for samples in parts),
        )

    def _as_recorded(self, channels: Mapping[str, Array]) -> Mapping[str, Array]:
        """Converts increments of the attitude to mean rates over the interval of a frame. A quaternion increment (w, v) is a
        rotation by 2·atan2(|v|, w) about v. `channels`: the values (n,) of each channel."""
        made = dict(channels)
        if "delta_q" in self.outputs:
            w, *vector = (made.pop(f"q{place}") for place in range(4))
            length = np.sqrt(sum(part * part for part in vector))
            angle = 2 * np.arctan2(length, np.abs(w)) * np.where(w < 0, -1.0, 1.0)
            factor = np.where(length > 0, angle / np.where(length > 0, length, 1.0), 2.0) * self.rate
            made |= {f"gyro_{axis}": factor * part for axis, part in zip("xyz", vector, strict=True)}
        return {name: made[name] for name in self.channels()}

    def _shape(self, frame: bytes) -> tuple[Whole, FrameLayout | None]:
        """Returns the positions of the packet headers in frames of this shape, and the layout that decodes such frames; the layout
        is None if they cannot be decoded."""
        start = 4 if frame[3] != 255 else 6
        packets: dict[int, tuple[int, int, int]] = {}
        heads: list[int] = []
        place, whole = start, True
        while place < len(frame) - 1:
            if place + 3 > len(frame) - 1 or place + 3 + frame[place + 2] > len(frame) - 1:
                whole = False
                break
            heads += [place, place + 1, place + 2]
            identifier = int.from_bytes(frame[place : place + 2], "big")
            packets.setdefault(identifier & 0xFFF0, (identifier & 3, place + 3, frame[place + 2]))
            place += 3 + frame[place + 2]
        signature = (
            bytes([frame[3]]) + b"".join(frame[head : head + 1] for head in heads) + len(heads).to_bytes(2, "big")
        )
        if signature not in self._shapes:
            if len(self._shapes) >= MOST_SHAPES:
                self._shapes.clear()
            self._shapes[signature] = (np.array(heads, np.int64), self._layout(packets) if whole else None)
        return self._shapes[signature]

    def _layout(self, packets: Mapping[int, tuple[int, int, int]]) -> FrameLayout | None:
        fields: dict[str, Field] = {}
        for output in self.outputs:
            identifier, count = OUTPUTS[output]
            precision, place, length = packets.get(identifier, (0, 0, 0))
            width, kind, scale = NUMBERS[precision]
            if length != width * count:
                return None
            names = [f"q{item}" for item in range(4)] if output == "delta_q" else list(CHANNELS[output])
            scale *= self.rate if output == "delta_v" else 1.0
            fields |= {name: Field(place + width * item, width, kind, scale) for item, name in enumerate(names)}
        if packets.get(PACKET_COUNTER, (0, 0, 0))[2] != 2:
            return None
        statuses: tuple[Status, ...] = ()
        if packets.get(STATUS_WORD, (0, 0, 0))[2] == 4:
            word = Field(packets[STATUS_WORD][1], 4, UNSIGNED)
            statuses = (Status(word, "MTi", CLIPPED), Status(word, "MTi", {0: "self-test failed"}, set_is_good=True))
        counts = Field(packets[PACKET_COUNTER][1], 2, UNSIGNED)
        return FrameLayout(self.framing, fields, dict.fromkeys(fields, ""), self.counter, counts, statuses=statuses)
