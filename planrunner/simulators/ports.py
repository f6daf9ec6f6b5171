"""Provides the connections of simulated instruments: addresses as in bench files, pseudo-terminals and sockets on loopback, and a
serial line with a bit rate and a buffer.

The kind of the address determines what is opened. Only programs on the same computer can connect. The serial line of a sensor has a
limited bit rate and a small buffer; it drops frames when the buffer is full.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import select
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from planrunner.instruments.interfaces import InstrumentError
from planrunner.simulators.frames import Bytes

_HELD = 65536  # bytes that a socket keeps for a slow reader


class PortError(InstrumentError):
    """Reports that an address cannot be served. The message names the address and the reason."""


class Port(Protocol):
    def attend(self) -> None: ...

    def write(self, data: bytes) -> int:
        """Sends data; returns the number of bytes that were accepted."""

    def unplug(self) -> None: ...

    def plug(self) -> None:
        """Makes the port appear again under the same name."""

    def close(self) -> None: ...


class PseudoTerminal:
    """Opens a pseudo-terminal; a program opens its other end at the path `link`. `heard`: function that `attend` calls with the
    data that it has received.

    While the other end is not open, data that are written are lost, as on a line to which nobody listens."""

    def __init__(self, link: Path, heard: Callable[[bytes], None]):
        self.link = link
        self.heard = heard
        self.master = -1
        self.open = False
        self.plug()

    def plug(self) -> None:
        if self.master >= 0:
            return
        try:
            import tty
        except ImportError:
            raise PortError(
                f"{self.link}: this system has no pseudo-terminals; serve the sensor on socket://"
            ) from None
        if self.link.exists() and not self.link.is_symlink():
            raise PortError(f"{self.link} is an existing file or device: choose another name for the simulated port")
        self.master, other = os.openpty()
        tty.setraw(other)
        os.set_blocking(self.master, False)
        try:
            self.link.parent.mkdir(parents=True, exist_ok=True)
            self.link.unlink(missing_ok=True)
            self.link.symlink_to(os.ttyname(other))
        except OSError as error:
            self.unplug()
            raise PortError(f"{self.link}: {error.strerror or error}") from None
        finally:
            os.close(other)  # so that it shows whether somebody else has it open
        self.watch = select.poll()
        self.watch.register(self.master, select.POLLIN)

    def attend(self) -> None:
        """Checks whether the other end is open, and reads incoming data."""
        if self.master < 0:
            return
        seen = dict(self.watch.poll(0)).get(self.master, 0)
        opened = not seen & select.POLLHUP
        if self.open and not opened:
            import termios

            termios.tcflush(self.master, termios.TCOFLUSH)  # unread data are not for the next program
        self.open = opened
        if opened and seen & select.POLLIN:
            with contextlib.suppress(OSError):
                self.heard(os.read(self.master, 4096))

    def write(self, data: bytes) -> int:
        if not self.open or self.master < 0 or not data:
            return 0
        try:
            return os.write(self.master, data)
        except OSError:  # full
            return 0

    def unplug(self) -> None:
        if self.master < 0:
            return
        os.close(self.master)
        self.master, self.open = -1, False
        with contextlib.suppress(OSError):
            self.link.unlink()

    def close(self) -> None:
        self.unplug()


class Socket:
    """A socket port on loopback. All clients receive the same bytes."""

    def __init__(self, host: str, port: int, heard: Callable[[bytes], None]):
        self.host, self.port, self.heard = host, port, heard
        self.writers: set[asyncio.StreamWriter] = set()
        self.server: asyncio.Server | None = None
        self._task: asyncio.Task[None] | None = None

    async def listen(self) -> None:
        try:
            self.server = await asyncio.start_server(self._meet, self.host, self.port)
        except OSError as error:
            raise PortError(f"{self.host}:{self.port}: {error.strerror or error}") from None
        self.port = self.server.sockets[0].getsockname()[1]

    def attend(self) -> None:
        """Does nothing: incoming data are processed as they arrive."""

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.add(writer)
        try:
            while data := await reader.read(4096):
                self.heard(data)
        except OSError:
            pass
        finally:
            self.writers.discard(writer)
            writer.close()

    def write(self, data: bytes) -> int:
        taken = 0
        for writer in self.writers:
            if writer.transport.get_write_buffer_size() < _HELD:
                writer.write(data)
                taken = len(data)
        return taken

    def unplug(self) -> None:
        for writer in list(self.writers):
            writer.transport.abort()
        if self.server is not None:
            self.server.close()
            self.server = None

    def plug(self) -> None:
        if self.server is None:
            self._task = asyncio.get_running_loop().create_task(self.listen())

    def close(self) -> None:
        self.unplug()


_VISA_SOCKET = re.compile(r"(TCPIP\d*::)([^:]+)::(\d+)(::SOCKET)", re.IGNORECASE)
_URL = re.compile(r"((?:ASRL)?socket://)([^:/]+):(\d+)((?:::INSTR)?)", re.IGNORECASE)
_VISA_SERIAL = re.compile(r"(ASRL)(.*?)((?:::INSTR)?)", re.IGNORECASE)
_HERE = ("127.0.0.1", "localhost")


@dataclass(frozen=True, slots=True)
class Address:
    """The address of a simulated instrument.

    `host`, `port`: parts of a TCP address. `link`: path of a pseudo-terminal, None for TCP. `before`, `after`: text before and
    after the address in the bench file.
    """

    before: str
    after: str
    host: str = ""
    port: int = 0
    link: Path | None = None

    @classmethod
    def of(cls, text: str) -> Address:
        """Parses an address. Raises `PortError` if the address cannot be simulated."""
        for form, between in ((_VISA_SOCKET, "::"), (_URL, ":")):
            if found := form.fullmatch(text):
                if found[2].lower() not in _HERE:
                    message = f"{text} is on another computer, but a simulated bench serves only loopback addresses"
                    raise PortError(f"{message}: write 127.0.0.1 in place of {found[2]}")
                return cls(found[1] + found[2] + between, found[4], found[2], int(found[3]))
        if re.match(r"(GPIB|USB|TCPIP|VXI|PXI)\d*::", text, re.IGNORECASE):
            raise PortError(
                f"{text} cannot be simulated: use TCPIP::127.0.0.1::PORT::SOCKET, or ASRL and the name of a port"
            )
        found = _VISA_SERIAL.fullmatch(text) if text.upper().startswith("ASRL") else None
        before, name, after = (found[1], found[2], found[3]) if found else ("", text, "")
        return cls(before, after, link=Path(name))

    def elsewhere(self, folder: Path, name: str) -> Address:
        """Returns the same address with a free port. For a pseudo-terminal, returns an address whose link is in the given folder
        and is named after the instrument."""
        link = None if self.link is None else folder / f"{name}.port"
        return Address(self.before, self.after, self.host, 0, link)

    def written(self, port: int | None = None) -> str:
        """Returns the address as it is written in a bench file. `port`: number of the port if the system chose it."""
        return f"{self.before}{self.link or port or self.port}{self.after}"


BITS_A_BYTE = 10.0  # start, eight, stop
_BUFFERED = 0.25  # s of real time for which the buffer of the sensor holds data


@dataclass(slots=True)
class LineCounts:
    """Counts on a serial line: the frames that the sensor offered; the complete frames that the line dropped because it is too
    slow; and the bytes that were dropped because nobody read them."""

    frames: int = 0
    frames_dropped: int = 0
    bytes_sent: int = 0
    bytes_dropped: int = 0


class SerialLine:
    """A simulated serial line. `baud`: bit rate of the line, bits per second. `speed`: seconds of the bench per second of real
    time; the bytes are transmitted faster by the same factor."""

    def __init__(self, port: Port, baud: float, speed: float, now: float):
        self.port = port
        self.bytes_a_second = baud / BITS_A_BYTE * speed
        self.capacity = max(4096, int(self.bytes_a_second * _BUFFERED))
        self.waiting = bytearray()
        self.credit = 0.0
        self.last = now
        self.counts = LineCounts()

    def offer(self, frames: Bytes) -> None:
        """Accepts frames (n, length) for sending."""
        if not len(frames):
            return
        room = (self.capacity - len(self.waiting)) // frames.shape[1]
        self.counts.frames += len(frames)
        self.counts.frames_dropped += max(0, len(frames) - max(0, room))
        self.waiting += frames[: max(0, room)].tobytes()

    def reply(self, data: bytes) -> None:
        """Sends bytes that are not frames, such as the reply to a command."""
        self.waiting += data

    def pump(self, now: float) -> None:
        """Sends the number of bytes that the line can have transmitted until now. `now`: real time, s."""
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
