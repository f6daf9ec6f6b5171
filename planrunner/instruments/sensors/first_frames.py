"""The first frames after connecting: whether any are good, and come as often as the bench file says."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.sensors.samples import Decoder
from planrunner.instruments.wire.framing import Framer, Piece

TOLERANCE = math.log(1.4)
ENOUGH = 20
"""Frames that a rate can be judged by."""
BACKLOG = 0.1
"""Seconds in which frames may come that had waited in buffers."""


class FirstFrames:
    """seconds: between the first good frame and the last, but for what had waited in buffers. haste: seconds of the bench's clock in one
    of the wall, which buffers keep to."""

    def __init__(self, decoder: Decoder, rate: float, haste: float = 1.0):
        self._decoder, self._rate, self._backlog = decoder, rate, BACKLOG * haste
        self._framer = Framer(decoder.framing)
        self._begun = self._first = self._last = math.nan
        self._bytes = self._good = self._counted = 0

    @property
    def seconds(self) -> float:
        return self._last - self._first if self._counted else 0.0

    def push(self, pieces: Sequence[Piece]) -> None:
        self._bytes += sum(len(piece.data) for piece in pieces)
        received = self._decoder.decode(self._framer.push(pieces)).received
        if not received.size:
            return
        self._good += received.size
        self._begun = float(received[0]) if math.isnan(self._begun) else self._begun
        fresh = received[received > self._begun + self._backlog]
        if fresh.size:
            self._first = float(fresh[0]) if self._counted == 0 else self._first
            self._last = float(fresh[-1])
            self._counted += fresh.size

    def judge(self, port: str, baud: int) -> None:
        """Raises `InstrumentError` for silence, bytes that are no frames, frames without what is announced, and another rate."""
        if self._bytes == 0:
            raise InstrumentError(
                f"no data arrive from {port}: check that the sensor is switched on and connected to this port"
            )
        sync = self._decoder.framing.sync.hex(" ").upper()
        if self._framer.good == 0:
            raise InstrumentError(
                f"{self._bytes} bytes came from {port} at {baud} baud, but no frame that begins with {sync} and has "
                f"a correct checksum: check `baud` and the sensor's output format"
            )
        if self._good == 0:
            wanted = ", ".join(self._decoder.channels())
            raise InstrumentError(
                f"the frames from {port} do not contain all of {wanted}: check the output format of the sensor"
            )
        if self._counted < ENOUGH or self.seconds == 0.0:
            return
        rate = (self._counted - 1) / self.seconds
        if abs(math.log(rate / self._rate)) > TOLERANCE:
            message = (
                f"about {rate:.4g} good frames per second arrive from {port}, but the bench file says {self._rate:g} Hz"
            )
            raise InstrumentError(f"{message}: correct `sample_rate`, the sensor's setting, or `baud`")
