"""Streams bytes from a serial port. A thread reads large pieces into a ring buffer of limited size, from which consumers take the
bytes.

pyserial reads large pieces a thousand times faster than single bytes. Without a consumer, the ring buffer keeps only the newest
bytes. With a consumer, it keeps all bytes until it is full; after that, further bytes are dropped and counted.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.framing import Piece

CAPACITY = 8 * 2**20
"""Size of the buffer in bytes. It can store the data of the fastest sensor for one minute."""
NEWEST = 2**16
"""Number of bytes that are kept while the buffer has no consumer."""
PAUSE = 0.004
"""Time between two reads, s. Reading at this interval needs little computing time. The interval is short compared with the time in
which the buffer of the operating system fills up (22 ms for 4 kB at 1.8 Mbit/s)."""
TIMEOUT = 0.05
MOST = 2**16


class SerialPort(Protocol):
    """The part of a pyserial port that this module uses."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int) -> bytes: ...
    def write(self, data: bytes) -> object: ...
    def close(self) -> None: ...


class Ring:
    """Buffers the pieces of a stream, between the thread that reads them and the thread that takes them. `dropped`: number of bytes
    that were dropped because the buffer was full."""

    def __init__(self, capacity: int = CAPACITY):
        self.capacity = capacity
        self.dropped = 0
        self._pieces: deque[Piece] = deque()
        self._held = 0
        self._following = False
        self._lock = threading.Lock()

    @property
    def held(self) -> int:
        """Returns the number of bytes in the buffer."""
        return self._held

    def put(self, piece: Piece) -> None:
        with self._lock:
            if self._following and self._held + len(piece.data) > self.capacity:
                self.dropped += len(piece.data)
                return
            self._pieces.append(piece)
            self._held += len(piece.data)
            while not self._following and self._held > NEWEST:
                self._held -= len(self._pieces.popleft().data)

    def take(self) -> Sequence[Piece]:
        """Takes all bytes out of the buffer, the oldest first."""
        with self._lock:
            pieces, self._pieces, self._held = self._pieces, deque(), 0
        return pieces

    def follow(self, following: bool) -> None:
        """Starts (`following` is True) or ends the use of the buffer by a consumer. During this use, the buffer keeps all bytes. At
        the start and at the end, the bytes in the buffer are discarded; at the start, the number of dropped bytes is also set to
        zero."""
        with self._lock:
            self._pieces, self._held, self._following = deque(), 0, following
            if following:
                self.dropped = 0


class SerialStream:
    """A serial port and the thread that reads it. `name`: name of the port, used in messages. `now`: function that returns the
    present time [s by the bench's clock]."""

    def __init__(
        self, port: SerialPort, name: str, now: Callable[[], float], capacity: int = CAPACITY, bulk: bool = False
    ):
        self.ring = Ring(capacity)
        self._port, self._name, self._now, self._bulk = port, name, now, bulk
        self._failure: str | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"reader of {name}", daemon=True)
        self._thread.start()

    @classmethod
    def open(cls, name: str, baud: int, now: Callable[[], float], capacity: int = CAPACITY) -> SerialStream:
        """Opens a port. `name`: name of the port, such as /dev/ttyUSB0 or COM3, or a URL that pyserial supports, such as
        socket://host:port. Raises `InstrumentError` if the port cannot be opened. `baud`: bit rate, in bits per second. `now`: the
        same as in the class. `capacity`: size of the buffer in bytes."""
        import serial

        url = "://" in name
        try:
            port = serial.serial_for_url(
                name, baudrate=baud, timeout=PAUSE if url else TIMEOUT, **({} if url else {"exclusive": True})
            )
        except (serial.SerialException, OSError, ValueError) as error:
            message = f"{name} cannot be opened ({error}): check that it is plugged in and switched on, and that no other program uses it"
            raise InstrumentError(message) from None
        if hasattr(port, "set_buffer_size"):  # Windows
            port.set_buffer_size(rx_size=MOST)
        if not url:
            port.reset_input_buffer()
        return cls(port, name, now, capacity, bulk=url)

    def take(self) -> Sequence[Piece]:
        """Returns the bytes received since the last call. Raises `InstrumentError` if the port no longer exists and all bytes
        received before have been returned."""
        pieces = self.ring.take()
        if not pieces and self._failure is not None:
            raise InstrumentError(self._failure)
        return pieces

    def write(self, data: bytes) -> None:
        """Sends a command. Raises `InstrumentError` if the port does not accept it."""
        try:
            self._port.write(data)
        except Exception as error:  # pyserial raises what the operating system does
            raise InstrumentError(
                f"{self._name} does not accept commands ({error}): check its cable and power"
            ) from None

    def close(self) -> None:
        """Ends the thread that reads, and closes the port. The method may be called twice."""
        self._closing.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=2.0)
        try:
            self._port.close()
        except Exception as error:  # a port that was pulled out cannot be closed and need not be
            self._failure = self._failure or f"{self._name} is no longer available ({error})"

    def _read(self) -> None:
        try:
            while not self._closing.is_set():
                # A URL's port says only whether something is there; its read returns what came within the time-out.
                data = self._port.read(MOST if self._bulk else max(1, min(self._port.in_waiting, MOST)))
                if data:
                    self.ring.put(Piece(self._now(), bytes(data)))
                    if not self._bulk:
                        time.sleep(PAUSE)
        except Exception as error:  # unplugged: pyserial raises SerialException, OSError or TypeError
            if not self._closing.is_set():
                self._failure = (
                    f"{self._name} is no longer available ({error}): check whether it was unplugged or switched off; reconnect it, "
                    "then resume the run"
                )
