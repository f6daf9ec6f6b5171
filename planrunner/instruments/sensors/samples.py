"""Contains the decoded frames of a sensor: samples in columns, the counter, the latency that the sensor reports, and doubts about
the samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.instruments.wire.codes import UNSIGNED
from planrunner.instruments.wire.columns import Field, numbers, whole_numbers
from planrunner.instruments.wire.framing import Frames, Framing
from planrunner.instruments.wire.host_clock import FrameCounter

Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of several frames. Every array has one element per frame.

    `received`: time of reception, s. `counter`: counter of the frame, as the sensor sent it. `latency`: latency that the sensor
    reports, s. `channels`: values (n,) of each channel, by name. `doubtful`: True for frames that a status bit marks as doubtful.
    `doubts`: meanings of the status bits that mark frames as doubtful. `refused`: number of frames that cannot be decoded although
    their checksum is correct.
    """

    received: Array
    counter: Whole
    latency: Array
    channels: Mapping[str, Array]
    doubtful: NDArray[np.bool_]
    doubts: tuple[str, ...] = ()
    refused: int = 0

    def __len__(self) -> int:
        return int(self.received.size)

    def part(self, chosen: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Samples:
        """Returns the selected frames. `doubts` and `refused`, which describe all frames together, are left out."""
        channels = {name: values[chosen] for name, values in self.channels.items()}
        return Samples(
            self.received[chosen], self.counter[chosen], self.latency[chosen], channels, self.doubtful[chosen]
        )

    def and_then(self, later: Samples) -> Samples:
        """Returns these samples followed by later samples; `doubts` and `refused` are left out."""
        channels = {name: np.concatenate([values, later.channels[name]]) for name, values in self.channels.items()}
        columns = ("received", "counter", "latency", "doubtful")
        received, counter, latency, doubtful = (
            np.concatenate([getattr(self, name), getattr(later, name)]) for name in columns
        )
        return Samples(received, counter, latency, channels, doubtful)


class Decoder(Protocol):
    """Decodes the frames of one sensor."""

    @property
    def framing(self) -> Framing: ...
    @property
    def counter(self) -> FrameCounter: ...
    def channels(self) -> Mapping[str, str]:
        """Maps the name of each channel to its unit."""

    def decode(self, frames: Frames) -> Samples: ...


@dataclass(frozen=True)
class Status:
    """Status bits of a frame, in the field `item`. `words`: meaning of each bit that can mark a frame as doubtful. `set_is_good`:
    False if a set bit makes the frame doubtful, True if a bit that is not set makes the frame doubtful."""

    item: Field
    name: str
    words: Mapping[int, str]
    set_is_good: bool = False


@dataclass(frozen=True)
class FrameLayout:
    """Decodes frames with a fixed layout.

    `fields`: position of each number, by channel. `units`: unit of each channel. `counts`: position of the counter, None if there
    is none. `latency`: position of the latency in the frame; its `scale` converts the latency to seconds. `means`: channels that
    are computed as the mean of other channels, each with the names of these other channels. `zeros`: for each of the named
    channels, the offset that is added to it.
    """

    framing: Framing
    fields: Mapping[str, Field]
    units: Mapping[str, str]
    counter: FrameCounter
    counts: Field | None = None
    latency: Field | None = None
    statuses: tuple[Status, ...] = ()
    means: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    zeros: Mapping[str, float] = field(default_factory=dict)

    def channels(self) -> Mapping[str, str]:
        return self.units

    def decode(self, frames: Frames) -> Samples:
        """Decodes frames. Frames that contain a NaN or an infinite number are refused."""
        rows = numbers(frames, list(self.fields.values()))
        finite: NDArray[np.bool_] = np.isfinite(rows.sum(axis=0)) if rows.size else np.ones(len(frames), bool)
        refused = int(finite.size - np.count_nonzero(finite))
        if refused:
            frames, rows = frames.of(finite), rows[:, finite]
        channels = dict(zip(self.fields, rows, strict=True))
        for name, zero in self.zeros.items():
            channels[name] = channels[name] + zero
        for name, parts in self.means.items():
            channels[name] = np.mean([channels[part] for part in parts], axis=0)
        counter = np.zeros(len(frames), np.int64) if self.counts is None else whole_numbers(frames, self.counts)
        latency = np.zeros(len(frames)) if self.latency is None else numbers(frames, [self.latency])[0]
        doubtful, doubts = self._doubts(frames)
        ordered = {name: channels[name] for name in self.units}
        return Samples(frames.received, counter, latency, ordered, doubtful, doubts, refused)

    def _doubts(self, frames: Frames) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
        doubtful = np.zeros(len(frames), bool)
        said: list[str] = []
        read: dict[Field, NDArray[np.int64]] = {}  # words of several statuses may stand in one item
        for status in self.statuses:
            if status.item not in read:
                read[status.item] = whole_numbers(frames, status.item)
            watched = sum(1 << bit for bit in status.words)
            bits = read[status.item] & watched
            if status.set_is_good:
                bits ^= watched
            together = int(np.bitwise_or.reduce(bits)) if bits.size else 0
            if together:
                doubtful |= bits != 0
            said += [f"{status.name}: {word}" for bit, word in status.words.items() if together >> bit & 1]
        return doubtful, tuple(said)


def byte(offset: int) -> Field:
    """Returns the position `offset` of an unsigned byte, such as a counter or a status word, as a `Field`."""
    return Field(offset, 1, UNSIGNED)
