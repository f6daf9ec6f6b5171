"""Drives the STIM300 (Safran TS1524). The sensor sends the data of its gyros, accelerometers and inclinometers in datagrams of
normal mode.

A datagram begins with its identifier. For each cluster, the values of three axes, with 24 bits each, and a status byte follow. The
next fields are the temperatures of the clusters, the PPS or AUX input, a counter of internal samples at 2000 Hz, and the latency in
µs. The datagram ends with a CRC-32. The CRC covers all of these bytes, padded with zeros to whole words.
"""

from __future__ import annotations

from collections.abc import Mapping

from planrunner.base.findings import Findings, InputError
from planrunner.instruments.models import SensorModel
from planrunner.instruments.sensors.keys import SerialSensorParameters, sensor_model
from planrunner.instruments.sensors.samples import FrameLayout, Status, byte
from planrunner.instruments.sensors.serial_sensor import SerialSensor
from planrunner.instruments.wire.checksums import CRC32_MPEG2
from planrunner.instruments.wire.codes import UNSIGNED
from planrunner.instruments.wire.columns import Field
from planrunner.instruments.wire.framing import Framing
from planrunner.instruments.wire.host_clock import FrameCounter
from planrunner.plan.kinds import Choice, Schema, key
from planrunner.plan.source import Node, Scalar

INTERNAL_RATE = 2000.0  # Hz
CONTENTS = ("", "a", "i", "ai", "t", "at", "it", "ait")
"""Contents of a datagram in addition to the gyros: `a` means accelerometers, `i` inclinometers, and `t` temperatures."""
DATAGRAMS: Mapping[int, str] = {
    **dict(zip((0x90, 0x91, 0x92, 0x93, 0x94, 0xA5, 0xA6, 0xA7), CONTENTS, strict=True)),
    **dict(zip(range(0xF0, 0xF8), (text + "p" for text in CONTENTS), strict=True)),
    **dict(zip((0x98, 0x99, 0x9A, 0x9B, 0x9C, 0xAD, 0xAE, 0xAF), (text + "x" for text in CONTENTS), strict=True)),
}
"""Contents of each datagram, by its identifier. In addition to the letters of `CONTENTS`, `p` means PPS and `x` means AUX."""
ACCELERATION_SCALES = {"5 g": 2.0**-20, "10 g": 2.0**-19, "30 g": 2.0**-18, "80 g": 2.0**-16}
STATUS = {
    7: "system integrity error",
    6: "starting up",
    5: "outside of its operating conditions",
    4: "overload",
    3: "error of a channel",
    2: "z axis",
    1: "y axis",
    0: "x axis",
}
AXES = ("x", "y", "z")
INCLINOMETERS = tuple(f"inclination_{axis}" for axis in AXES)


class Datagram:
    """The identifier of a datagram, written as a hexadecimal number."""

    def read(self, node: Node, log: Findings) -> int | None:
        value = node.value if isinstance(node, Scalar) else None
        if isinstance(value, int) and value in DATAGRAMS:
            return value
        text = node.text[:20] if isinstance(node, Scalar) else "this"
        known = ", ".join(f"0x{item:X}" for item in DATAGRAMS)
        log.error("form-choice", node.mark, f"'{text}' is not an identifier of a STIM300 datagram", f"one of {known}")
        return None

    def schema(self) -> Schema:
        return {"enum": list(DATAGRAMS)}


class Stim300Parameters(SerialSensorParameters):
    """Declares the bench-file keys of a STIM300 on a serial line."""

    datagram: int = key(Datagram(), "Identifier of the datagram that the sensor is set to send.", 0xA7, default=0xA7)
    acceleration_range: str = key(
        Choice(tuple(ACCELERATION_SCALES)),
        "Range of the accelerometers, which determines their scale.",
        "10 g",
        default="10 g",
    )
    gyro_output: str = key(
        Choice(("rate", "increment")),
        "Kind of gyro data that the sensor is set to send. Increments are recorded as the mean rate over the frame.",
        "rate",
        default="rate",
    )


class Stim300(SerialSensor[Stim300Parameters]):
    """A STIM300 on a serial line."""

    Parameters = Stim300Parameters
    manufacturer = "Safran Sensing Technologies"
    product = "STIM300"

    @classmethod
    def model(cls, parameters: Stim300Parameters) -> SensorModel:
        step = INTERNAL_RATE / parameters.sample_rate.value
        if step < 1 or abs(step - round(step)) > 1e-9:
            message = f"a STIM300 does not send {parameters.sample_rate.value:g} datagrams per second"
            hint = "set 2000 Hz, or 2000 Hz divided by a whole number, such as 1000 Hz, 500 Hz, 250 Hz or 125 Hz"
            raise InputError.at(parameters.at("sample_rate"), "meaning-range", message, hint)
        layout = cls.decoder_of(parameters)
        resolutions = {name: item.scale for name, item in layout.fields.items()}
        return sensor_model(parameters, layout.units, resolutions, INCLINOMETERS)

    @classmethod
    def decoder_of(cls, parameters: Stim300Parameters) -> FrameLayout:
        rate = parameters.sample_rate.value
        gyro_scale = 2.0**-14 if parameters.gyro_output == "rate" else 2.0**-21 * rate
        return layout(parameters.datagram, ACCELERATION_SCALES[parameters.acceleration_range], gyro_scale, rate)


def layout(datagram: int, acceleration_scale: float, gyro_scale: float, rate: float) -> FrameLayout:
    """Returns the positions of the fields in a datagram. `datagram`: identifier of the datagram. `acceleration_scale`,
    `gyro_scale`: g per count and deg/s per count. `rate`: sample rate, Hz."""
    contents = DATAGRAMS[datagram]
    clusters = [("gyro", gyro_scale, "deg/s")]
    clusters += [("accel", acceleration_scale, "g")] if "a" in contents else []
    clusters += [("inclination", 2.0**-22, "g")] if "i" in contents else []
    fields: dict[str, Field] = {}
    units: dict[str, str] = {}
    statuses = []
    place = 1
    for name, scale, unit in clusters:
        for number, axis in enumerate(AXES):
            fields[f"{name}_{axis}"], units[f"{name}_{axis}"] = Field(place + 3 * number, 3, scale=scale), unit
        statuses.append(Status(byte(place + 9), name, STATUS))
        place += 10
    means = {}
    if "t" in contents:
        for name, _, _ in clusters:
            for number, axis in enumerate(AXES):
                channel = f"{name}_temperature_{axis}"
                fields[channel], units[channel] = Field(place + 2 * number, 2, scale=2.0**-8), "degC"
            statuses.append(Status(byte(place + 6), f"{name} temperature", STATUS))
            place += 7
        means["sensor_temperature"] = tuple(f"gyro_temperature_{axis}" for axis in AXES)
        units["sensor_temperature"] = "degC"
    if "x" in contents:
        fields["aux"], units["aux"] = Field(place, 3, scale=5.0 * 2.0**-24), "V"
    elif "p" in contents:
        fields["pps"], units["pps"] = Field(place, 3, UNSIGNED), "count"
    if contents[-1:] in ("x", "p"):
        statuses.append(Status(byte(place + 3), "AUX" if "x" in contents else "PPS", STATUS))
        place += 4
    length = place + 7
    framing = Framing(
        bytes([datagram]), length, checksum=CRC32_MPEG2, check_bytes=4, padding=-(length - 4) % 4, trailer=b"\r\n"
    )
    counter = FrameCounter(1 / INTERNAL_RATE, INTERNAL_RATE / rate, 256)
    latency = Field(place + 1, 2, UNSIGNED, 1e-6)
    return FrameLayout(framing, fields, units, counter, byte(place), latency, tuple(statuses), means)
