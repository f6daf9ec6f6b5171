"""Contains the parts that simulated message-based instruments share: the exchange of messages with replies and delayed replies, and
the connection to a port. The port divides received bytes into messages at their terminators, adds terminators and framing to
replies, and applies faults."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from planrunner.simulators.faults import FaultBoard
from planrunner.simulators.ports import PortError, PseudoTerminal

_LONGEST = 4096  # bytes of a message
Writer = Callable[[bytes], None]


@dataclass(frozen=True, slots=True)
class Manner:
    """States how messages and replies are separated. `sent_ends`: each of these bytes ends a message. `framing`: `none`; `words` or
    `ascii`, which are two forms of an error code and a length before a reply; or `prompt`, a separate line with `>` after a
    reply."""

    sent_ends: bytes = b"\n"
    reply_ends: bytes = b"\n"
    framing: str = "none"

    def framed(self, reply: str) -> bytes:
        body = reply.encode("ascii", "replace") + self.reply_ends
        if self.framing == "words":
            return (0).to_bytes(4, "big") + len(body).to_bytes(4, "big") + body
        if self.framing == "ascii":
            return f"0000{len(body):04d}".encode("ascii") + body
        return body + (b">" + self.reply_ends if self.framing == "prompt" else b"")


class MessagePort:
    """Exchanges messages between one simulated instrument and its clients. `now`: function that returns the time on the bench's
    clock."""

    def __init__(self, name: str, controller: Controller, manner: Manner, board: FaultBoard, now: Callable[[], float]):
        self.name, self.controller, self.manner, self.board, self.now = name, controller, manner, board, now
        self.tasks: set[asyncio.Task[None]] = set()
        self.last_speaker: Writer | None = None

    def heard(self, held: bytearray, data: bytes, write: Writer, hang_up: Callable[[], None]) -> None:
        """Receives bytes, and answers complete messages in the order in which they arrived."""
        held += data
        pieces = re.split(b"[" + re.escape(self.manner.sent_ends) + b"]", held)
        held[:] = pieces.pop()[-_LONGEST:]
        for piece in pieces:
            if piece.strip():
                self._answer(piece.decode("ascii", "replace"), write, hang_up)

    def say_later(self) -> None:
        """Sends delayed replies that have become due. The replies go to the client that sent the last message."""
        for reply in self.controller.later():
            if self.last_speaker is not None:
                self.last_speaker(self.manner.framed(reply))

    def _answer(self, message: str, write: Writer, hang_up: Callable[[], None]) -> None:
        self.last_speaker = write
        reply = self.controller.answer(message)
        if reply is None:
            return
        data = self.manner.framed(reply)
        fault = self.board.of_reply(self.name, message, self.now())
        if fault is None:
            write(data)
            return
        match fault.fault:
            case "silent":
                return
            case "late":
                self._later(fault.delay.value, data, write)
            case "partial":
                write(data[: max(1, len(data) // 2)])
            case "garbage":
                write(bytes(255 - byte for byte in data[:-1]) + data[-1:])
            case "drop link":
                hang_up()
            case "wrong model":
                same = reply == self.controller.identity
                write(self.manner.framed("Somebody Else,Model X,0,0") if same else data)

    def _later(self, seconds: float, data: bytes, write: Writer) -> None:
        async def wait() -> None:
            await asyncio.sleep(seconds)
            write(data)

        task = asyncio.get_running_loop().create_task(wait())
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)


class TcpMessages:
    """Opens a message port on loopback TCP, to which several clients may be connected."""

    def __init__(self, messages: MessagePort, host: str, port: int):
        self.messages, self.host, self.port = messages, host, port
        self.server: asyncio.Server | None = None
        self.connected: set[asyncio.StreamWriter] = set()

    async def listen(self) -> None:
        if self.server is not None:
            return
        try:
            self.server = await asyncio.start_server(self._meet, self.host, self.port)
        except OSError as error:
            raise PortError(f"{self.host}:{self.port}: {error.strerror or error}") from None
        self.port = self.server.sockets[0].getsockname()[1]

    def attend(self) -> None:
        """Does nothing: connections are handled when they send data."""

    def refuse(self) -> None:
        """Closes the port and every connection."""
        if self.server is not None:
            self.server.close()
            self.server = None
        for writer in list(self.connected):
            writer.transport.abort()

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        held = bytearray()
        self.connected.add(writer)

        def write(data: bytes) -> None:
            if not writer.is_closing():
                writer.write(data)

        try:
            while data := await reader.read(_LONGEST):
                self.messages.heard(held, data, write, writer.close)
        except OSError:
            pass
        finally:
            self.connected.discard(writer)
            writer.close()


class TerminalMessages:
    """A message port on a pseudo-terminal."""

    def __init__(self, messages: MessagePort, link: Path):
        self.messages = messages
        self.held = bytearray()
        self.terminal = PseudoTerminal(link, self._heard)

    async def listen(self) -> None:
        self.terminal.plug()

    def attend(self) -> None:
        self.terminal.attend()

    def refuse(self) -> None:
        self.terminal.unplug()

    def _heard(self, data: bytes) -> None:
        self.messages.heard(self.held, data, self._write, self._hang_up)

    def _write(self, data: bytes) -> None:
        if self.terminal.master >= 0:
            self.terminal.write(data)

    def _hang_up(self) -> None:
        """Disconnects and connects again, like a cable that is unplugged and plugged in again."""
        self.terminal.unplug()
        self.terminal.plug()


class NotUnderstoodError(ValueError):
    """Reports a message that the instrument does not understand, or a value that it refuses."""


class Controller(Protocol):
    identity: str
    """Reply to an identity query."""

    def answer(self, message: str) -> str | None:
        """Returns the reply to a message, both without terminators; None if there is no reply."""

    def later(self) -> list[str]:
        """Returns delayed replies that have become due since the last call; empty for instruments that reply at once."""

    def watch(self) -> None:
        """Checks the limits of the instrument. The method is called many times per second."""


def first_with(word: str, options: tuple[str, ...]) -> str:
    """Returns the first option that begins with `word`; upper and lower case count as equal. Raises `NotUnderstoodError` if there
    is none."""
    found = next((option for option in options if word and option.startswith(word.lower())), None)
    if found is None:
        raise NotUnderstoodError(word)
    return found


def number(word: str) -> float:
    """Converts a word of a message to a number. Raises `NotUnderstoodError` if the text is not a number."""
    try:
        return float(word)
    except ValueError:
        raise NotUnderstoodError(word) from None


def shown(value: float, digits: int = 6) -> str:
    """Writes a number as instruments do, without trailing zeros, and with a zero that has no sign."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
