"""A sensor's serial line: so many bytes a second, a buffer that holds a little, and frames that are dropped when it is full."""

from __future__ import annotations

from dataclasses import dataclass

from planrunner.simulators.columns import Bytes
from planrunner.simulators.ports import Port

BITS_A_BYTE = 10.0  # start, eight, stop
_BUFFERED = 0.25  # s of the wall that the sensor's own buffer holds


@dataclass(slots=True)
class LineCounts:
    """Frames offered; frames dropped whole by the sensor because the line is too slow; bytes dropped because nobody fetched them."""

    frames: int = 0
    frames_dropped: int = 0
    bytes_sent: int = 0
    bytes_dropped: int = 0


class SerialLine:
    """baud: bits a second of the simulated line; speed: seconds of the bench in one of the wall, by which its bytes hasten too."""

    def __init__(self, port: Port, baud: float, speed: float, now: float):
        self.port = port
        self.bytes_a_second = baud / BITS_A_BYTE * speed
        self.capacity = max(4096, int(self.bytes_a_second * _BUFFERED))
        self.waiting = bytearray()
        self.credit = 0.0
        self.last = now
        self.counts = LineCounts()

    def offer(self, frames: Bytes) -> None:
        """Frames (n, length) to send."""
        if not len(frames):
            return
        room = (self.capacity - len(self.waiting)) // frames.shape[1]
        self.counts.frames += len(frames)
        self.counts.frames_dropped += max(0, len(frames) - max(0, room))
        self.waiting += frames[: max(0, room)].tobytes()

    def reply(self, data: bytes) -> None:
        """Other bytes, such as the answer to a command."""
        self.waiting += data

    def pump(self, now: float) -> None:
        """Send what the line has had time for. now: s on the wall."""
        self.credit = min(self.credit + (now - self.last) * self.bytes_a_second, float(self.capacity))
        self.last = now
        length = min(len(self.waiting), int(self.credit))
        if not length:
            return
        self.credit -= length
        taken = self.port.write(bytes(self.waiting[:length]))
        del self.waiting[:length]
        self.counts.bytes_sent += taken
        self.counts.bytes_dropped += length - taken
