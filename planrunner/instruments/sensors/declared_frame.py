"""Drives sensors for which there is no separate driver. The bench file describes the frames field by field.

imu:
  driver: declared_frame
  port: /dev/ttyUSB0
  sample_rate: 200 Hz
  sync: A5 5A
  length: 20
  fields:
    gyro_x: {at: 2, type: i16, scale: 0.02, unit: deg/s}
  counter: {at: 14, type: u8}
  checksum: {type: crc16_modbus, from: 2}
"""

from __future__ import annotations

from dataclasses import replace

from planrunner.base.findings import InputError
from planrunner.instruments.frame_keys import (
    CHECKSUMS,
    LONGEST,
    SYNC,
    TYPES,
    WHOLE,
    ChecksumOfFrame,
    ScaledNumber,
    field_of,
    framing_of,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.models import SensorModel
from planrunner.instruments.recording_keys import NAME, UnitText
from planrunner.instruments.sensors.keys import SerialSensorParameters, sensor_model
from planrunner.instruments.sensors.samples import FrameLayout, Status
from planrunner.instruments.sensors.serial_sensor import SerialSensor
from planrunner.instruments.wire.codes import FLOAT
from planrunner.instruments.wire.columns import Field
from planrunner.instruments.wire.host_clock import FrameCounter
from planrunner.plan.kinds import Boolean, Choice, MapOf, Number, Record, RecordOf, Text, key, optional


class FieldOfFrame(ScaledNumber):
    """Declares the bench-file keys of a number in a frame that becomes a channel."""

    unit: str = key(UnitText(), "Unit of the result.", "deg/s")


class CounterOfFrame(Record):
    """Declares the bench-file keys of the counter in a frame. The counter counts through all values of its type, or up to `modulus`
    − 1, and then starts again from zero."""

    place: int = key(Number(0, LONGEST - 1, integer=True), "Position of its first byte.", 14, name="at")
    type: str = key(Choice(WHOLE), "Its type.", "u8", default="u8")
    step: int = key(
        Number(1, 2**31, integer=True), "Increment of the counter from one frame to the next.", 1, default=1
    )
    modulus: int | None = optional(
        Number(2, 2**32, integer=True), "The counter restarts at zero when it reaches this value.", 128
    )
    little_endian: bool = key(Boolean(), "True if the low byte comes first.", True, default=False)


class StatusOfFrame(Record):
    """Declares the bench-file keys of a status word in a frame; its set bits mark the frame as doubtful."""

    place: int = key(Number(0, LONGEST - 1, integer=True), "Position of its first byte.", 15, name="at")
    type: str = key(Choice(WHOLE), "Its type.", "u8", default="u8")
    bits: dict[str, int] = key(
        MapOf(Number(0, 31, integer=True)),
        "Meaning of a set bit → number of the bit, from 0 for the lowest.",
        {"overload": 4},
    )
    set_is_good: bool = key(
        Boolean(), "True if a cleared bit, instead of a set bit, marks the frame as doubtful.", True, default=False
    )
    little_endian: bool = key(Boolean(), "True if the low byte comes first.", True, default=False)


PartOfFrame = FieldOfFrame | CounterOfFrame | StatusOfFrame


class DeclaredFrameParameters(SerialSensorParameters):
    """Declares the bench-file keys of a sensor whose frames the bench file describes."""

    sync: str = key(
        SYNC,
        "The bytes that every frame begins with.",
        "A5 5A",
    )
    length: int = key(Number(2, LONGEST, integer=True), "Length of a frame in bytes, including sync and checksum.", 20)
    fields: dict[str, FieldOfFrame] = key(
        MapOf(RecordOf(FieldOfFrame), pattern=NAME),
        "Channel → its position in the frame.",
        {"gyro_x": {"at": 2, "type": "i16", "scale": 0.02, "unit": "deg/s"}},
    )
    checksum: ChecksumOfFrame | None = optional(
        RecordOf(ChecksumOfFrame),
        "Checksum of the frame. Without it, corrupt frames cannot be distinguished from good ones.",
        {"type": "crc16_modbus", "from": 2},
    )
    counter: CounterOfFrame | None = optional(
        RecordOf(CounterOfFrame),
        "Counter in the frame. Without it, lost frames are detected only as silences longer than 0.1 s.",
        {"at": 14},
    )
    status: StatusOfFrame | None = optional(
        RecordOf(StatusOfFrame), "Status word in the frame.", {"at": 15, "bits": {"overload": 4}}
    )
    modes: dict[str, str] = key(
        MapOf(Text(r"[\x20-\x7e]{1,60}", "a line of text"), pattern=NAME),
        "Operating mode → the command line (CR is added) that switches to this mode; the sensor sends frames in every mode.",
        {"powered": "POWER ON", "unpowered": "POWER OFF"},
        default_factory=dict,
    )


class DeclaredFrame(SerialSensor[DeclaredFrameParameters]):
    """A sensor on a serial line whose frames the bench file describes."""

    Parameters = DeclaredFrameParameters
    manufacturer = "declared in the bench file"
    product = "sensor"

    @classmethod
    def model(cls, parameters: DeclaredFrameParameters) -> SensorModel:
        _check(parameters)
        layout = cls.decoder_of(parameters)
        resolutions = {name: abs(item.scale) for name, item in layout.fields.items() if item.kind != FLOAT}
        return replace(sensor_model(parameters, layout.units, resolutions), modes=tuple(parameters.modes))

    def set_mode(self, mode: str) -> float:
        modes = self.parameters.modes
        if mode not in modes:
            raise InstrumentError(
                f"the bench file declares no mode '{mode}'; declared modes: {', '.join(modes) or 'none'}"
            )
        self.link.write(modes[mode].encode("ascii") + b"\r")
        return 0.0

    @classmethod
    def decoder_of(cls, parameters: DeclaredFrameParameters) -> FrameLayout:
        rate = parameters.sample_rate.value
        fields = {name: field_of(item, item.scale) for name, item in parameters.fields.items()}
        units = {name: item.unit for name, item in parameters.fields.items()}
        zeros = {name: item.zero for name, item in parameters.fields.items() if item.zero}
        counts: Field | None = None
        statuses: tuple[Status, ...] = ()
        counter = FrameCounter(1 / rate)
        if parameters.counter is not None:
            counts, step = field_of(parameters.counter), parameters.counter.step
            counter = FrameCounter(1 / rate / step, step, parameters.counter.modulus or 1 << 8 * counts.width)
        if parameters.status is not None:
            words = {bit: text for text, bit in parameters.status.bits.items()}
            statuses = (Status(field_of(parameters.status), "status", words, parameters.status.set_is_good),)
        return FrameLayout(
            framing_of(parameters.sync, parameters.length, parameters.checksum),
            fields,
            units,
            counter,
            counts,
            statuses=statuses,
            zeros=zeros,
        )


def _check(parameters: DeclaredFrameParameters) -> None:
    """Checks that all fields are between the sync and the checksum of the frame, and that the checksum covers some bytes. Raises
    `InputError` if this is not the case."""
    check = CHECKSUMS[parameters.checksum.type].width // 8 if parameters.checksum is not None else 0
    places: dict[str, tuple[PartOfFrame, int]] = {
        name: (item, TYPES[item.type][0]) for name, item in parameters.fields.items()
    }
    for name, other in (("counter", parameters.counter), ("status", parameters.status)):
        if other is not None:
            places[name] = (other, TYPES[other.type][0])
    sync = len(bytes.fromhex(parameters.sync))
    for name, (item, width) in places.items():
        if item.place < sync or item.place + width > parameters.length - check:
            message = f"'{name}' is not between the sync and the checksum of a frame of {parameters.length} bytes"
            hint = f"`at` is counted from 0 and can be from {sync} to {parameters.length - check - width}"
            raise InputError.at(item.origin.at("at"), "meaning-range", message, hint)
    if not parameters.fields:
        hint = "add for example `fields: {gyro_x: {at: 2, type: i16, scale: 0.02, unit: deg/s}}`"
        raise InputError.at(parameters.at("fields"), "form-size", "a frame without fields gives no samples", hint)
    if parameters.checksum is not None and parameters.checksum.start >= parameters.length - check:
        message = f"the checksum of a frame of {parameters.length} bytes covers no bytes"
        raise InputError.at(
            parameters.checksum.origin.at("from"), "meaning-range", message, "make the covered part begin earlier"
        )
