"""Drives the VectorNav VN-100. The sensor sends binary outputs of the common group, or lines of text such as $VNYMR.

A binary message consists of the byte FA, a byte that selects groups, a word for each group that selects fields of the group, the
fields (low byte first), and a CRC-16 (high byte first). A line of text ends with `*` and, in hexadecimal, the exclusive-or of all
bytes between `$` and `*`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planrunner.base.findings import InputError
from planrunner.instruments.interfaces import Clock, InstrumentError
from planrunner.instruments.models import SensorModel
from planrunner.instruments.sensors.keys import SerialSensorParameters, sensor_model
from planrunner.instruments.sensors.samples import Decoder, FrameLayout, Samples
from planrunner.instruments.sensors.serial_sensor import SerialSensor
from planrunner.instruments.wire.checksums import CRC16_XMODEM, XOR8
from planrunner.instruments.wire.codes import FLOAT, LINE, UNSIGNED
from planrunner.instruments.wire.columns import Field
from planrunner.instruments.wire.framing import Frames, Framing
from planrunner.instruments.wire.host_clock import FrameCounter
from planrunner.instruments.wire.serial_stream import SerialStream
from planrunner.plan.kinds import Choice, ListOf, key, optional

BASE_RATE = 800.0  # Hz, of which binary output takes every n-th
COMMON_GROUP = 1
LINE_LONGEST = 256
MODEL, SERIAL = 1, 3  # registers


def _axes(name: str, unit: str) -> dict[str, str]:
    return {f"{name}_{axis}": unit for axis in "xyz"}


YAW_PITCH_ROLL = {"yaw": "deg", "pitch": "deg", "roll": "deg"}
FIELDS: Mapping[str, tuple[int, Mapping[str, str]]] = {
    "time_startup": (0, {}),
    "yaw_pitch_roll": (3, YAW_PITCH_ROLL),
    "quaternion": (4, {f"quaternion_{axis}": "1" for axis in "xyzw"}),
    "angular_rate": (5, _axes("gyro", "rad/s")),
    "acceleration": (8, _axes("accel", "m/s^2")),
    "imu": (9, _axes("accel", "m/s^2") | _axes("gyro", "rad/s")),
    "mag_pres": (10, _axes("magnetometer", "1") | {"sensor_temperature": "degC", "pressure": "kPa"}),
}
"""For each field of the common group: its bit, and its contents in order. The time since start-up serves as the counter."""
LINES: Mapping[str, Mapping[str, str]] = {
    "VNYMR": YAW_PITCH_ROLL | _axes("magnetometer", "1") | _axes("accel", "m/s^2") | _axes("gyro", "rad/s"),
    "VNYPR": YAW_PITCH_ROLL,
    "VNACC": _axes("accel", "m/s^2"),
    "VNGYR": _axes("gyro", "rad/s"),
}
"""For each line of text: its values in order, with their units."""


class VectorNavParameters(SerialSensorParameters):
    """Declares the bench-file keys of a VectorNav VN-100 on a serial line."""

    output: str = key(
        Choice(("binary", *LINES)),
        "Format of the output: binary messages, or one of the text messages.",
        "binary",
        default="binary",
    )
    fields: tuple[str, ...] = key(
        ListOf(Choice(tuple(FIELDS)), minimum=1),
        "Fields of the common group in the binary messages. Without time_startup, lost messages are detected only as "
        "silences longer than 0.1 s.",
        ["time_startup", "imu", "mag_pres"],
        default=("time_startup", "imu", "mag_pres"),
    )
    configure: str | None = optional(
        Choice(("port_1", "port_2")),
        "Port of the sensor whose binary output is set when connecting; by default the sensor must already have these settings.",
        "port_1",
    )


class VectorNav(SerialSensor[VectorNavParameters]):
    """A VectorNav VN-100 on a serial line."""

    Parameters = VectorNavParameters
    manufacturer = "VectorNav"
    product = "VN-100"

    @classmethod
    def model(cls, parameters: VectorNavParameters) -> SensorModel:
        channels = cls.decoder_of(parameters).channels()
        if not channels:
            message = "messages with these fields contain no samples"
            raise InputError.at(parameters.at("fields"), "form-size", message, "add for example imu")
        fields = set(parameters.fields)
        if parameters.output == "binary" and "imu" in fields and fields & {"acceleration", "angular_rate"}:
            message = "imu already contains accelerations and angular rates"
            raise InputError.at(parameters.at("fields"), "meaning-range", message, "leave one of them out")
        return sensor_model(parameters, channels, {})

    @classmethod
    def decoder_of(cls, parameters: VectorNavParameters) -> Decoder:
        rate = parameters.sample_rate.value
        return (
            binary(parameters.fields, rate) if parameters.output == "binary" else LineDecoder(parameters.output, rate)
        )

    @classmethod
    def configure(cls, parameters: VectorNavParameters, link: SerialStream, clock: Clock) -> Mapping[str, str]:
        if parameters.configure is None or parameters.output != "binary":
            return {}
        divisor = BASE_RATE / parameters.sample_rate.value
        if divisor < 1 or abs(divisor - round(divisor)) > 1e-9:
            raise InstrumentError(
                f"a VN-100 sends at 800 Hz divided by a whole number, not at {parameters.sample_rate.value:g} Hz"
            )
        model, serial = (ask(link, clock, f"VNRRG,{register}").rpartition(",")[2] for register in (MODEL, SERIAL))
        if not model.startswith("VN-"):
            raise InstrumentError(
                f"the sensor on {parameters.port} identifies itself as '{model[:40]}', which is not a VectorNav"
            )
        port = parameters.configure.removeprefix("port_")
        ask(link, clock, f"VNWRG,75,{port},{round(divisor)},{COMMON_GROUP:02X},{word(parameters.fields):04X}")
        return {"model": model, "serial": serial, "configured": ", ".join(parameters.fields)}


# -- commands ----------------------------------------------------------------------------------------------------------


def line(body: str) -> bytes:
    """Returns the bytes that send a command such as `VNRRG,8`."""
    return f"${body}*{XOR8.of(body.encode('ascii')):02X}\r\n".encode("ascii")


def body_of(reply: bytes) -> str:
    """Returns the text of a line between `$` and `*`. Raises `InstrumentError` if the checksum is wrong or if the sensor reports an
    error."""
    body, star, check = reply.strip(b"\r\n").removeprefix(b"$").partition(b"*")
    if not star or not body or check.upper() != f"{XOR8.of(body):02X}".encode("ascii"):
        raise InstrumentError(f"the VN-100 answers with an incomplete line: {reply[:60]!r}")
    text = body.decode("ascii", "replace")
    if text.startswith("VNERR"):
        raise InstrumentError(
            f"the VN-100 refuses the command with error {text[6:20]}: check the fields and the rate in the bench file"
        )
    return text


def ask(link: SerialStream, clock: Clock, body: str, patience: float = 1.0) -> str:
    """Sends a command and waits for its echo. Raises `InstrumentError` if the sensor does not echo the command. `patience`: longest
    time to wait, s."""
    head, heard = body.partition(",")[0].encode("ascii"), b""
    link.write(line(body))
    until = clock.now() + patience
    while clock.now() < until:
        clock.sleep(0.01)
        heard = (heard + b"".join(piece.data for piece in link.take()))[-2 * LINE_LONGEST :]
        for wanted in (b"$" + head, b"$VNERR"):
            begin = heard.find(wanted)
            end = heard.find(b"\n", begin)
            if 0 <= begin < end:
                return body_of(heard[begin : end + 1])
    raise InstrumentError(f"the VN-100 does not answer {body}: check its port and `baud`, and whether it is a VN-100")


# -- measurements ------------------------------------------------------------------------------------------------------


def word(fields: tuple[str, ...]) -> int:
    """Returns the field word that selects these fields of the common group."""
    return sum(1 << FIELDS[name][0] for name in set(fields))


def binary(fields: tuple[str, ...], rate: float) -> FrameLayout:
    """Returns the layout of a binary message that contains these fields of the common group. `rate`: sample rate, Hz."""
    found: dict[str, Field] = {}
    units: dict[str, str] = {}
    counts, counter = None, FrameCounter(1 / rate)
    place = 4
    for name in sorted(set(fields), key=lambda item: FIELDS[item][0]):
        if name == "time_startup":
            counts, counter = Field(place, 8, UNSIGNED, little=True), FrameCounter(1e-9, 1e9 / rate, 1 << 62)
            place += 8
            continue
        for channel, unit in FIELDS[name][1].items():
            found[channel], units[channel] = Field(place, 4, FLOAT, little=True), unit
            place += 4
    sync = bytes([0xFA, COMMON_GROUP]) + word(fields).to_bytes(2, "little")
    framing = Framing(sync, place + 2, checksum=CRC16_XMODEM, check_bytes=2, covered_from=1)
    return FrameLayout(framing, found, units, counter, counts)


@dataclass(frozen=True)
class LineDecoder:
    """Decodes lines of text of one kind. `rate`: sample rate, Hz."""

    name: str
    rate: float

    @property
    def framing(self) -> Framing:
        return Framing(f"${self.name},".encode("ascii"), LINE_LONGEST, LINE, XOR8)

    @property
    def counter(self) -> FrameCounter:
        return FrameCounter(1 / self.rate)

    def channels(self) -> Mapping[str, str]:
        return LINES[self.name]

    def decode(self, frames: Frames) -> Samples:
        from planrunner.instruments.wire.kernels import decimals

        rows = np.empty((len(LINES[self.name]), len(frames)))
        good = decimals(frames.data, frames.starts, frames.lengths, rows)
        received = frames.received
        if not good.all():
            received, rows = received[good], rows[:, good]
        nothing = np.zeros(received.size)
        channels = dict(zip(LINES[self.name], rows, strict=True))
        refused = len(frames) - received.size
        return Samples(received, nothing.astype(np.int64), nothing, channels, nothing.astype(bool), refused=refused)
