"""Simulates an Xsens MTi and a VectorNav VN-100 on a line: their messages with the configured outputs of the virtual sensor, and
their configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import Block
from planrunner.simulators import vectornav, xsens
from planrunner.simulators.frames import Bytes
from planrunner.simulators.live_world import LiveWorld, SensorFeed
from planrunner.simulators.sensor_units import Outputs, SampleNumber, SensorUnit

_GO_TO_CONFIG, _GO_TO_MEASUREMENT, _DEVICE, _OUTPUTS, _ERROR = 0x30, 0x10, 0x00, 0xC0, 0x42
_UNKNOWN_MESSAGE = b"\x04"
_FINE, _CLIPPED_GYRO_X = 0x3, 1 << 11  # of the status word: self-test passed, filter valid


def _vectors(outputs: Outputs, block: Block) -> tuple[Array, Array]:
    """Returns the rates [rad/s] and the specific forces [m/s^2] of the sensor's axes, (n, 3) each."""
    gyro, force = outputs.triad(block, "gyro", 1.0), outputs.triad(block, "accel", 1.0)
    return np.stack(list(gyro.values()), axis=1), np.stack(list(force.values()), axis=1)


@dataclass(slots=True)
class XsensUnit:
    """A simulated Xsens MTi. `rate`: number of packets per second. `silent`: True while the sensor is being configured; it then
    sends no measurements."""

    outputs: Outputs
    form: xsens.Xsens
    rate: float
    counting: SampleNumber = field(default_factory=SampleNumber)
    silent: bool = False
    heard: bytes = b""
    ails: frozenset[str] = frozenset()

    def frames(self, block: Block) -> Bytes:
        count = block.time.size
        if self.silent:
            return np.zeros((0, self.form.length()), dtype=np.uint8)
        rates, forces = _vectors(self.outputs, block)
        status = (_FINE & ~1 if "self-test" in self.ails else _FINE) | (
            _CLIPPED_GYRO_X if "overload" in self.ails else 0
        )
        columns = {
            xsens.PACKET_COUNTER: self.counting.take(count),
            xsens.SAMPLE_TIME_FINE: xsens.fine_time(block.time),
            xsens.STATUS_WORD: np.full(count, float(status)),
            0x4020: forces,
            0x4010: forces / self.rate,
            0x8020: rates,
            0x8030: _turns(rates / self.rate),
            xsens.TEMPERATURE: self.outputs.celsius(block),
        }
        return self.form.frames(columns)

    def hear(self, data: bytes) -> bytes:
        """Receives messages and returns the replies. Messages about configuration, outputs and measurement are acknowledged with
        the next higher identifier; other messages are refused as unknown."""
        self.heard += data
        replies = b""
        while (start := self.heard.find(b"\xfa\xff")) >= 0 and len(self.heard) >= start + 5:
            end = start + 5 + self.heard[start + 3]
            if len(self.heard) < end:
                break
            message, self.heard = self.heard[start:end], self.heard[end:]
            if sum(message[1:]) % 256 == 0:
                replies += self._answer(message[2], message[4:-1])
        self.heard = self.heard[-600:]
        return replies

    def _answer(self, identifier: int, payload: bytes) -> bytes:
        if identifier == _DEVICE:
            return xsens.short_message(identifier + 1, b"\x00\x00\x00\x01")
        if identifier == _OUTPUTS and self.silent:
            wanted = [int.from_bytes(payload[at : at + 2], "big") for at in range(0, len(payload), 4)]
            if not wanted or not all(map(xsens.known, wanted)):
                return xsens.short_message(_ERROR, _UNKNOWN_MESSAGE)
            self.form = replace(self.form, items=tuple(wanted))
            return xsens.short_message(identifier + 1, payload)
        if identifier not in (_GO_TO_CONFIG, _GO_TO_MEASUREMENT):
            return xsens.short_message(_ERROR, _UNKNOWN_MESSAGE)
        self.silent = identifier == _GO_TO_CONFIG
        return xsens.short_message(identifier + 1)


def _turns(angles: Array) -> Array:
    """Returns the unit quaternions (n, 4), real part first, that belong to the rotation vectors `angles` (n, 3), rad."""
    size = np.linalg.norm(angles, axis=1)
    part = 0.5 * np.sinc(size / (2 * np.pi))  # sin(a/2)/a
    return np.column_stack([np.cos(size / 2), angles * part[:, None]])


@dataclass(slots=True)
class VectorNavUnit:
    """A simulated VectorNav VN-100. `form`: its binary messages. `text`: the kind of text line that the sensor sends instead of
    binary messages; empty if it sends binary messages. Neither binary messages nor text lines contain a status."""

    outputs: Outputs
    form: vectornav.VectorNav
    text: str = ""
    heard: bytes = b""
    ails: frozenset[str] = frozenset()

    def frames(self, block: Block) -> Bytes:
        count = block.time.size
        rates, forces = _vectors(self.outputs, block)
        if self.text:
            return self._lines(rates, forces)
        celsius, nothing = self.outputs.celsius(block), np.zeros((count, 3))
        columns = {
            "time_startup": np.rint(block.time * 1e9),
            "yaw_pitch_roll": nothing,
            "quaternion": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            "angular_rate": rates,
            "acceleration": forces,
            "imu": np.concatenate([forces, rates], axis=1),
            "mag_pres": np.concatenate([nothing, celsius[:, None], np.full((count, 1), 101.3)], axis=1),
        }
        return self.form.frames({name: columns[name] for name in self.form.fields})

    def _lines(self, rates: Array, forces: Array) -> Bytes:
        """Makes text lines of equal length. To this end, the numbers have leading zeros. `rates`, `forces`: arrays of shape (n, 3),
        rad/s and m/s²."""
        sent = [
            vectornav.measurement((0, 0, 0), f, w, (0, 0, 0), self.text) for f, w in zip(forces, rates, strict=True)
        ]
        return np.frombuffer(b"".join(sent), dtype=np.uint8).reshape(len(sent), -1)

    def hear(self, data: bytes) -> bytes:
        """Receives commands and returns the replies. Register 1 (the model) and register 3 (the serial number) can be read; reading
        any other register is refused with error 8. The reply to a command that writes a register repeats the command."""
        self.heard += data
        replies = b""
        while b"\n" in self.heard:
            text, _, self.heard = self.heard.partition(b"\n")
            replies += self._answer(text.decode("ascii", "replace").strip().lstrip("$").partition("*")[0])
        self.heard = self.heard[-200:]
        return replies

    def _answer(self, command: str) -> bytes:
        words: Sequence[str] = command.split(",")
        if words[0] == "VNRRG" and len(words) > 1 and words[1].isdigit():
            known = {1: "VN-100S-SIMULATED", 3: "0100000000"}.get(int(words[1]))
            return vectornav.line(f"VNRRG,{int(words[1]):02d},{known}" if known else "VNERR,08")
        return vectornav.line(command) if words[0] == "VNWRG" else b""


class XsensKeys(Protocol):
    outputs: Sequence[str]


def simulated_xsens(keys: XsensKeys, live: LiveWorld, feed: SensorFeed) -> SensorUnit:
    """Makes the simulated Xsens MTi for a bench file."""
    names = {"acceleration": 0x4020, "delta_v": 0x4010, "rate": 0x8020, "delta_q": 0x8030, "temperature": 0x0810}
    items = (0x1020, *(names[name] for name in keys.outputs), 0xE020)
    return XsensUnit(Outputs(feed.sensor.channels()), xsens.Xsens(items), feed.rate)


class VectorNavKeys(Protocol):
    fields: Sequence[str]
    output: str


def simulated_vectornav(keys: VectorNavKeys, live: LiveWorld, feed: SensorFeed) -> SensorUnit:
    """Makes the simulated VectorNav VN-100 for a bench file."""
    return VectorNavUnit(
        Outputs(feed.sensor.channels()),
        vectornav.VectorNav(keys.fields),
        "" if keys.output == "binary" else keys.output,
    )
