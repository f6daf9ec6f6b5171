"""Drives the sensors KVH 1775 and DSP-1760. The sensors send rotations and accelerations as floating-point numbers in the binary
output formats A, B and C.

In all formats, a frame consists of a sync, six numbers, a status, a sequence number and a CRC-32. In format B, a time stamp
precedes the status. In format C, the sequence number determines whether a frame contains the temperature or a component of the
magnetic field.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import field as data_field

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import Clock, InstrumentError
from planrunner.instruments.sensors.keys import SerialSensorParameters
from planrunner.instruments.sensors.samples import Decoder, FrameLayout, Samples, Status, byte
from planrunner.instruments.sensors.serial_sensor import SerialSensor
from planrunner.instruments.wire.checksums import CRC32_MPEG2, SUM8
from planrunner.instruments.wire.codes import FLOAT
from planrunner.instruments.wire.columns import Field
from planrunner.instruments.wire.framing import Frames, Framing
from planrunner.instruments.wire.host_clock import FrameCounter
from planrunner.instruments.wire.serial_stream import SerialStream
from planrunner.plan.kinds import Boolean, Choice, key

LENGTHS = {"A": 36, "B": 40, "C": 38}
LAST = {"A": 0x55, "B": 0x56, "C": 0x57}
AXES = ("x", "y", "z")
SETTLE = 0.5
"""Time until a change of configuration takes effect, s. During this time, about two invalid frames arrive."""
PATIENCE = 1.0
"""Maximum time until the result of the built-in test arrives, s."""
BIT_SYNC, BIT_LENGTH = bytes.fromhex("fe8100aa"), 11


class Kvh1775Parameters(SerialSensorParameters):
    """Declares the bench-file keys of a KVH 1775 or DSP-1760 on a serial line."""

    format: str = key(Choice(("A", "B", "C")), "Output format.", "A", default="A")
    rotation: str = key(
        Choice(("rate", "delta")),
        "Gyro data that the sensor sends. Deltas are recorded as the mean rate over the frame.",
        "rate",
        default="rate",
    )
    angle_unit: str = key(Choice(("rad", "deg")), "Unit of the sensor's angles.", "rad", default="rad")
    temperature_unit: str = key(
        Choice(("C", "C_100")),
        "Resolution of the temperature in formats A and B: whole degrees or hundredths.",
        "C",
        default="C",
    )
    configure: bool = key(
        Boolean(),
        "True to set rate, rotation and temperature unit when connecting; otherwise the sensor must already have these settings.",
        True,
        default=False,
    )


class Kvh1775(SerialSensor[Kvh1775Parameters]):
    """A KVH 1775 or DSP-1760 on a serial line."""

    Parameters = Kvh1775Parameters
    manufacturer = "KVH Industries"
    product = "1775"

    @classmethod
    def decoder_of(cls, parameters: Kvh1775Parameters) -> Decoder:
        plain = layout(parameters)
        return MultiplexedTemperature(plain) if parameters.format == "C" else plain

    @classmethod
    def configure(cls, parameters: Kvh1775Parameters, link: SerialStream, clock: Clock) -> Mapping[str, str]:
        if not parameters.configure:
            return {}
        rotation, temperature = parameters.rotation, parameters.temperature_unit
        commands = [
            "=config,1",
            f"=dr,{parameters.sample_rate.value:.0f}",
            f"=rotfmt,{rotation}",
            f"=tempunits,{temperature}",
        ]
        for command in [*commands, "=config,0"]:
            link.write(f"{command}\r\n".encode("ascii"))
            clock.sleep(SETTLE / 5)
        clock.sleep(SETTLE)
        return {"configured": ", ".join(commands[1:]), **ask_built_in_test(link, clock)}

    @classmethod
    def lasting_doubts(cls, identity: Mapping[str, str]) -> tuple[str, ...]:
        results = bytes.fromhex(identity.get("built_in_test", ""))
        failed = [f"{place}.{bit}" for place, byte_ in enumerate(results) for bit in range(7) if not byte_ >> bit & 1]
        return (f"its built-in test failed (byte.bit {', '.join(failed)})",) if failed else ()


def layout(parameters: Kvh1775Parameters) -> FrameLayout:
    """Returns the positions of the fields in a frame."""
    rate, name = parameters.sample_rate.value, parameters.format
    scale = 1.0 if parameters.rotation == "rate" else rate
    fields = {f"gyro_{axis}": Field(4 + 4 * place, 4, FLOAT, scale) for place, axis in enumerate(AXES)}
    fields |= {f"accel_{axis}": Field(16 + 4 * place, 4, FLOAT) for place, axis in enumerate(AXES)}
    units = {f"gyro_{axis}": f"{parameters.angle_unit}/s" for axis in AXES} | {f"accel_{axis}": "g" for axis in AXES}
    status = 28 if name == "A" else 32
    if name == "C":
        fields["sensor_temperature"] = Field(28, 4, FLOAT)
    else:
        hundredths = parameters.temperature_unit == "C_100"
        fields["sensor_temperature"] = Field(status + 2, 2, scale=0.01 if hundredths else 1.0)
    units["sensor_temperature"] = "degC"
    statuses = (
        Status(byte(status), "gyro", {place: f"{axis} invalid" for place, axis in enumerate(AXES)}, set_is_good=True),
        Status(
            byte(status), "accel", {4 + place: f"{axis} invalid" for place, axis in enumerate(AXES)}, set_is_good=True
        ),
    )
    sync = bytes([0xFE, 0x81, 0xFF, LAST[name]])
    framing = Framing(sync, LENGTHS[name], checksum=CRC32_MPEG2, check_bytes=4)
    return FrameLayout(framing, fields, units, FrameCounter(1 / rate, 1, 128), byte(status + 1), statuses=statuses)


@dataclass
class MultiplexedTemperature:
    """Decodes format C, in which the sequence number determines the content of a frame: only every fourth frame contains the
    temperature. The other frames get the last temperature that was received."""

    plain: FrameLayout
    _last: float = data_field(default=np.nan)

    @property
    def framing(self) -> Framing:
        return self.plain.framing

    @property
    def counter(self) -> FrameCounter:
        return self.plain.counter

    def channels(self) -> Mapping[str, str]:
        return self.plain.units

    def decode(self, frames: Frames) -> Samples:
        samples = self.plain.decode(frames)
        told = np.concatenate([[self._last], samples.channels["sensor_temperature"]])
        holds = np.concatenate([[not np.isnan(self._last)], samples.counter % 4 == 0])
        if not holds.any():
            return samples.part(slice(0, 0))
        latest = np.maximum.accumulate(np.where(holds, np.arange(holds.size), int(np.argmax(holds))))
        temperature: Array = told[latest][1:]
        self._last = float(told[latest][-1])
        return replace(samples, channels={**samples.channels, "sensor_temperature": temperature})


def ask_built_in_test(link: SerialStream, clock: Clock) -> Mapping[str, str]:
    """Requests the result of the built-in test, and returns this result as text for the journal. The returned mapping is empty if
    the sensor does not answer."""
    link.write(b"?bit\r\n")
    heard, until = b"", clock.now() + PATIENCE
    while clock.now() < until:
        clock.sleep(0.01)
        heard += b"".join(piece.data for piece in link.take())
        place = heard.find(BIT_SYNC)
        if 0 <= place <= len(heard) - BIT_LENGTH:
            return {"built_in_test": bytes(built_in_test(heard[place : place + BIT_LENGTH])).hex(" ")}
    return {}


def built_in_test(reply: bytes) -> tuple[int, ...]:
    """Decodes the six status bytes of a reply to `?bit`. Seven bits of each byte are used; a cleared bit means a fault. Raises
    `InstrumentError` if the reply is not valid."""
    if len(reply) != BIT_LENGTH or not reply.startswith(BIT_SYNC) or SUM8.of(reply[:-1]) != reply[-1]:
        raise InstrumentError(f"no result of a built-in test: {reply[:16].hex(' ')}")
    return tuple(reply[4:10])
