"""Scripted instruments for tests of drivers and links: one that plays a transcript, one that does what a function says, on loopback TCP."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import WallClock
from planrunner.instruments.interfaces import Clock, Surroundings
from planrunner.instruments.wire.links import MessageLink
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import rotation_about
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf

TRANSCRIPTS = Path(__file__).parent / "transcripts"
ENDS = {"LF": b"\n", "CR": b"\r", "CRLF": b"\r\n"}


@dataclass
class Transcript:
    header: dict[str, str] = field(default_factory=dict)
    exchanges: list[tuple[str, str | None]] = field(default_factory=list)
    """What is sent, and the reply or None."""

    @classmethod
    def read(cls, name: str) -> Transcript:
        made, in_header = cls(), True
        for line in (TRANSCRIPTS / f"{name}.txt").read_text(encoding="utf-8").splitlines():
            if in_header and not line:
                in_header = False
            elif line.startswith("#") or not line or line.startswith("%"):
                continue
            elif in_header:
                key, _, value = line.partition(": ")
                made.header[key] = value
            elif line.startswith("> "):
                made.exchanges.append((line[2:], None))
            else:
                mark, _, reply = line.partition(" ")
                shown = reply.replace("*", "0") if mark == "<~" else reply
                made.exchanges[-1] = (made.exchanges[-1][0], shown)
        return made

    def framed(self, reply: str) -> bytes:
        data = reply.encode() + ENDS[self.header["replies-end"]]
        match self.header["framing"]:
            case "words":
                return struct.pack(">II", 0, len(data)) + data
            case "ascii":
                return b"%04d%04d" % (0, len(data)) + data
            case "prompt":
                return data + b">" + ENDS[self.header["replies-end"]]
        return data


class Listener:
    """A server on loopback that serves one connection after the other with `talk`, on a thread of its own."""

    def __init__(self, talk: Callable[[socket.socket], None]):
        self._talk = talk
        self._server = socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = []
        self.connections = 0
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        return f"TCPIP::127.0.0.1::{self._server.getsockname()[1]}::SOCKET"

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._server.accept()
                self.connections += 1
                self._open.append(connection)
                threading.Thread(target=self._attend, args=(connection,), daemon=True).start()

    def _attend(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection:
            self._talk(connection)

    def hang_up(self) -> None:
        """On everybody who is connected."""
        for connection in self._open:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self.hang_up()
        self._thread.join(2)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def messages(connection: socket.socket, end: bytes) -> Iterator[str]:
    """What comes in, message by message."""
    rest = b""
    while data := connection.recv(4096):
        rest += data
        while end in rest:
            message, _, rest = rest.partition(end)
            yield message.decode()


class Player(Listener):
    """Plays a transcript: what is sent must be its next line, and is answered as it says. `heard` is what came."""

    def __init__(self, name: str):
        self.transcript = Transcript.read(name)
        self.heard: list[str] = []
        super().__init__(self._play)

    def _play(self, connection: socket.socket) -> None:
        for message in messages(connection, ENDS[self.transcript.header["sent-ends"]]):
            place = len(self.heard)
            self.heard.append(message)
            expected = self.transcript.exchanges[place] if place < len(self.transcript.exchanges) else ("the end", None)
            if message != expected[0]:
                return
            if expected[1] is not None:
                connection.sendall(self.transcript.framed(expected[1]))

    def check(self) -> None:
        """Everything was said as the transcript has it, to its end."""
        expected = [sent for sent, _ in self.transcript.exchanges]
        end = time.monotonic() + 60  # what is not answered may still be on its way
        while len(self.heard) < len(expected) and time.monotonic() < end:
            time.sleep(0.005)
        assert self.heard == expected


class SerialPlayer(Player):
    """The same on a pseudo-terminal."""

    def __init__(self, name: str):
        self.transcript = Transcript.read(name)
        self.heard = []
        tty = pytest.importorskip("tty", reason="this system has no pseudo-terminals")
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        self._thread = threading.Thread(target=self._attend_line, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        return f"ASRL{os.ttyname(self._far)}::INSTR"

    def _attend_line(self) -> None:
        line: Any = _Line(self._near)
        with contextlib.suppress(OSError):
            self._play(line)

    def close(self) -> None:
        os.close(self._far)  # reading the near end then fails
        self._thread.join(2)
        os.close(self._near)


@dataclass
class _Line:
    """A pseudo-terminal with the two methods of a socket that are used here."""

    file: int

    def recv(self, count: int) -> bytes:
        return os.read(self.file, count)

    def sendall(self, data: bytes) -> None:
        os.write(self.file, data)


def answering(answer: Callable[[str], bytes | None], end: bytes = b"\n") -> Listener:
    """Answers every message with what `answer` returns; None: hangs up."""

    def talk(connection: socket.socket) -> None:
        for message in messages(connection, end):
            reply = answer(message)
            if reply is None:
                return
            connection.sendall(reply)

    return Listener(talk)


@contextlib.contextmanager
def closed_port() -> Iterator[int]:
    """A port of loopback that refuses connections; nobody else can open it meanwhile."""
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        yield held.getsockname()[1]


def parameters(record: type, address: str, *more: str, timeout: str = "1 min") -> Any:
    """Keys of a bench file as a driver is given them. timeout: short only where no answer is expected; a busy machine answers late."""
    log = Findings()
    text = "\n".join([f"address: {address}", f"timeout: {timeout}", *more])
    made = RecordOf(record).read(source.parse(text, "bench.yaml"), log)
    assert list(log) == []
    return made


def silent_at_first(link: MessageLink, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next exchange waits briefly for an answer that does not come; from its failure on the link is as patient as before."""
    patient, give_up = link.settings, link._give_up

    def patient_again() -> None:
        give_up()
        link.settings = patient

    monkeypatch.setattr(link, "_give_up", patient_again)
    link.settings = replace(patient, timeout=0.2)


def surroundings(clock: Clock | None = None) -> Surroundings:
    return Surroundings(clock or WallClock(), Site(math.radians(40), 9.8), real_time=True)


def turned(degrees: float) -> Any:
    """The attitude of a table turned about the vertical: the sensor's axes as rows."""
    return rotation_about((0.0, 0.0, 1.0), math.radians(degrees)).T
