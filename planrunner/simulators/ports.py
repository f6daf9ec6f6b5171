"""Where a simulated sensor's line ends: a pseudo-terminal under a stated name, or a socket on loopback.

Neither ever waits: what the other side has no room for is dropped, as a UART drops what nobody fetches.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from planrunner.instruments.interfaces import InstrumentError

_HELD = 65536  # bytes that a socket keeps for a slow reader


class PortError(InstrumentError):
    """An address cannot be served. The message says which and why."""


class Port(Protocol):
    def attend(self) -> None: ...

    def write(self, data: bytes) -> int:
        """How many bytes were taken."""

    def unplug(self) -> None: ...

    def plug(self) -> None:
        """Come back under the same name."""

    def close(self) -> None: ...


class PseudoTerminal:
    """A pseudo-terminal whose other end is found at `link`. heard: called by `attend` with what has come in.

    While nobody has the other end open, what is written is gone, as on a line without a listener."""

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
        """Look whether somebody is there, and take what has come in."""
        if self.master < 0:
            return
        seen = dict(self.watch.poll(0)).get(self.master, 0)
        opened = not seen & select.POLLHUP
        if self.open and not opened:
            import termios

            termios.tcflush(self.master, termios.TCOFLUSH)  # what was not fetched is not for the next one
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
    """A port on loopback. All who connect get the same bytes."""

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
        """What comes in is taken as it comes."""

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
