"""Simulates sensors on a line: their frames, which contain the outputs of the virtual sensor, and their replies to commands.

STIM300 and KVH are in this module; Xsens and VectorNav are in `navigation_units.py`; sensors with declared frames are in
`declared_frame.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from planrunner.base.arrays import Array
from planrunner.instruments.interfaces import Block
from planrunner.plan.units import STANDARD_GRAVITY, unit
from planrunner.simulators.frames import CRC_8, Bytes
from planrunner.simulators.kvh1775 import ALL_VALID, Kvh1775, built_in_test
from planrunner.simulators.live_world import LiveWorld, SensorFeed
from planrunner.simulators.stim300 import INTERNAL_RATE, Stim300

_DOUBTFUL = 2  # frames of a KVH after its configuration was changed
_LATENCY = 500.0  # µs between a sample and its datagram
_INTEGRITY, _OVERLOAD_X = 0x80, 0x11  # status of a STIM300's cluster


class SensorUnit(Protocol):
    """Simulates the electronics of a sensor, between its samples and its line. `ails`: faults of the sensor (`overload`,
    `self-test`). The status in the frames reports a fault if it has a bit for this fault."""

    ails: frozenset[str]

    def frames(self, block: Block) -> Bytes:
        """Returns the frames of consecutive samples, shape (n, length)."""

    def hear(self, data: bytes) -> bytes:
        """Receives bytes from the line; returns the reply, which is empty if the command is unknown."""


@dataclass(slots=True)
class Outputs:
    """Converts the outputs of a virtual sensor to the units of a frame. `units`: maps the name of each channel of the sensor to its
    unit."""

    units: Mapping[str, str]

    def triad(self, block: Block, name: str, in_unit: float) -> dict[str, Array]:
        """Returns the outputs of the `gyro` or the `accel` triad by axis, in a unit whose SI value is `in_unit`; zero for an axis
        that the sensor does not have."""
        found = {}
        for axis in "xyz":
            channel = f"{name}_{axis}"
            if channel in block.channels:
                found[axis] = block.channels[channel] * (unit(self.units[channel]).factor / in_unit)
            else:
                found[axis] = np.zeros(block.time.size)
        return found

    def celsius(self, block: Block) -> Array:
        return block.channels["sensor_temperature"]


@dataclass(slots=True)
class SampleNumber:
    """The running number of the next sample."""

    next: int = 0

    def take(self, count: int) -> Array:
        numbers = np.arange(self.next, self.next + count, dtype=float)
        self.next += count
        return numbers


@dataclass(slots=True)
class Stim300Unit:
    """A simulated STIM300. `rate`: number of datagrams per second, which determines the step of the counter."""

    outputs: Outputs
    form: Stim300
    rate: float
    serial: str = "N00000000000000"
    counting: SampleNumber = field(default_factory=SampleNumber)
    service: bool = False
    heard: bytes = b""
    ails: frozenset[str] = frozenset()

    def frames(self, block: Block) -> Bytes:
        count = block.time.size
        per_sample = 1 / self.rate if self.form.increments else 1.0
        gyro = self.outputs.triad(block, "gyro", np.deg2rad(1.0))
        force = self.outputs.triad(block, "accel", STANDARD_GRAVITY)
        celsius = self.outputs.celsius(block)
        columns: dict[str, Array] = {}
        for axis in "xyz":
            columns[f"gyro_{axis}"] = gyro[axis] * per_sample
            columns[f"acc_{axis}"] = columns[f"incl_{axis}"] = force[axis]
            columns |= {f"{cluster}_T_{axis}": celsius for cluster in ("gyro", "acc", "incl")}
        broken = _INTEGRITY if "self-test" in self.ails else 0
        columns |= {f"{cluster}_status": np.full(count, float(broken)) for cluster in ("gyro", "acc", "incl")}
        if "overload" in self.ails:
            columns["gyro_status"] += _OVERLOAD_X
        numbers = self.counting.take(count)
        sent = self.form.frames(columns, np.floor(numbers * (INTERNAL_RATE / self.rate)), np.full(count, _LATENCY))
        return sent[:0] if self.service else sent

    def hear(self, data: bytes) -> bytes:
        """Receives commands, each of which ends with CR. `R` resets the sensor, `SERVICEMODE` and `UTILITYMODE` end the datagrams,
        and `$isn,` requests the identification."""
        self.heard += data
        replies = b""
        while b"\r" in self.heard:
            line, _, self.heard = self.heard.partition(b"\r")
            replies += self._answer(line.decode("ascii", "replace").strip())
        self.heard = self.heard[-200:]
        return replies

    def _answer(self, word: str) -> bytes:
        if word == "R":
            self.counting.next, self.service = 0, False
        elif word == "SERVICEMODE":
            self.service = True
            return b"STIM300\r\n>"
        elif word == "UTILITYMODE":
            self.service = True
            return _with_check("#UTILITYMODE,")
        elif self.service and word.startswith("$isn,"):
            return _with_check(f"#isn,0,{self.serial},")
        elif self.service and word in ("x", "$xn,"):
            self.service = False
        return b""


def _with_check(text: str) -> bytes:
    return f"{text}{CRC_8.of_text(text)}\r".encode("ascii")


@dataclass(slots=True)
class KvhUnit:
    """A simulated KVH 1775 or DSP-1760.

    `degrees`: True if gyro outputs are in deg instead of rad. `increments`: True if outputs are angles instead of rates.
    `hundredths`: True if temperatures are in hundredths of a degree.
    """

    outputs: Outputs
    form: Kvh1775
    rate: float
    degrees: bool = False
    increments: bool = False
    hundredths: bool = False
    counting: SampleNumber = field(default_factory=SampleNumber)
    heard: bytes = b""
    doubtful: int = 0
    ails: frozenset[str] = frozenset()

    def frames(self, block: Block) -> Bytes:
        per_sample = 1 / self.rate if self.increments else 1.0
        gyro = self.outputs.triad(block, "gyro", np.deg2rad(1.0) if self.degrees else 1.0)
        force = self.outputs.triad(block, "accel", STANDARD_GRAVITY)
        numbers = self.counting.take(block.time.size)
        columns = {
            "temperature": self.outputs.celsius(block) * (100.0 if self.hundredths else 1.0),
            "time_stamp": np.floor(numbers * 1e6 / self.rate) % 2**32,
        }
        for axis in "xyz":
            columns |= {f"gyro_{axis}": gyro[axis] * per_sample, f"acc_{axis}": force[axis]}
        valid = 0 if "self-test" in self.ails else ALL_VALID & ~1 if "overload" in self.ails else ALL_VALID
        columns["status"] = np.where(np.arange(numbers.size) < self.doubtful, 0.0, float(valid))
        self.doubtful = max(0, self.doubtful - numbers.size)
        return self.form.frames(columns, numbers)

    def hear(self, data: bytes) -> bytes:
        """Receives lines, each of which ends with CR or LF. The reply to `?bit` is the result of the built-in test; `=rotfmt,…` and
        similar commands change the format. The first frames after a change are marked as invalid."""
        self.heard += data.replace(b"\r", b"\n")
        replies = b""
        while b"\n" in self.heard:
            line, _, self.heard = self.heard.partition(b"\n")
            word = line.decode("ascii", "replace").strip().lower()
            self.doubtful = _DOUBTFUL if word.startswith("=") else self.doubtful
            if word == "?bit":
                replies += built_in_test(b"\x7f\x7f\x7e\x7f\x7f\x7f" if "self-test" in self.ails else b"\x7f" * 6)
            elif word in ("=rotfmt,delta", "=rotfmt,rate"):
                self.increments = word.endswith("delta")
            elif word in ("=rotunits,deg", "=rotunits,rad"):
                self.degrees = word.endswith("deg")
            elif word in ("=tempunits,c", "=tempunits,c_100"):
                self.hundredths = word.endswith("100")
        self.heard = self.heard[-200:]
        return replies


class Stim300Keys(Protocol):
    datagram: int
    acceleration_range: str
    gyro_output: str


def simulated_stim300(keys: Stim300Keys, live: LiveWorld, feed: SensorFeed) -> SensorUnit:
    """Makes the simulated STIM300 for a bench file."""
    form = Stim300(keys.datagram, int(keys.acceleration_range.split()[0]), keys.gyro_output == "increment")
    return Stim300Unit(Outputs(feed.sensor.channels()), form, feed.rate)


class Kvh1775Keys(Protocol):
    format: str
    angle_unit: str
    rotation: str
    temperature_unit: str


def simulated_kvh1775(keys: Kvh1775Keys, live: LiveWorld, feed: SensorFeed) -> SensorUnit:
    """Makes the simulated KVH 1775 for a bench file."""
    form, degrees, increments = Kvh1775(keys.format), keys.angle_unit == "deg", keys.rotation == "delta"
    return KvhUnit(
        Outputs(feed.sensor.channels()), form, feed.rate, degrees, increments, keys.temperature_unit == "C_100"
    )
