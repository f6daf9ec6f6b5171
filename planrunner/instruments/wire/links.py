"""Exchanges requests and replies with a message-based instrument over GPIB, USB, TCP or a serial line, by means of PyVISA.

Each resource has only one exchange at a time. After a failure, a link is closed and opened again. Unread data are discarded before
each request. A late reply is therefore never mistaken for the reply to the next request. No operation waits longer than its
time-out. PyVISA is imported when the first link is opened. The environment variable `PYVISA_LIBRARY` selects its backend.

This module also declares the keys in the bench file for the connection and the identification of such an instrument, and the base
classes of instruments and drivers that use the commands of a controller.
"""

from __future__ import annotations

import contextlib
import functools
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Generic, Protocol, TypeVar

from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Number, QuantityOf, Record, Text, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity

LONGEST = 4096
"""Maximum size of a reply in bytes. A longer reply is invalid."""
GLANCE = 0.001
"""Time to wait for unread data, s."""
QUIET = 0.02
"""Unread data are assumed to be complete if no byte arrives for this time, s."""

MOST_REMARKS = 100
"""Maximum number of remarks kept between queries."""

_locks: dict[str, threading.RLock] = {}
_making = threading.Lock()


def lock_of(address: str) -> threading.RLock:
    """Returns the lock of a resource. All links to the resource in this process share this lock."""
    with _making:
        return _locks.setdefault(address, threading.RLock())


class AnswerFraming(Protocol):
    """Detects the end of an answer."""

    def read(self, incoming: Incoming) -> bytes:
        """Reads the next answer; returns it without its framing."""


@dataclass(frozen=True, slots=True)
class LineAnswers:
    """The framing in which every answer is one line. `end`: terminator of the line."""

    end: bytes = b"\n"

    def read(self, incoming: Incoming) -> bytes:
        return incoming.until(self.end)


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Settings of a link.

    `address`: VISA name of the resource. `timeout`: longest time to open the link and to wait for an answer, s. `sent_end`: text
    appended to every message. `pace`: minimum time between two messages, s. `baud`: baud rate of a serial line. `tries`: number of
    attempts for a request that may be repeated. `idle`: characters, such as a prompt, that may arrive without a request and are
    then discarded without a remark.
    """

    address: str
    timeout: float = 2.0
    sent_end: str = "\n"
    pace: float = 0.0
    baud: int = 9600
    tries: int = 2
    idle: bytes = b"\r\n "


class LinkFailure(Exception):  # noqa: N818 - reported to users as an InstrumentError
    """Reports that an exchange failed. In messages, the text of this exception follows the name of the resource."""


class Wire(Protocol):
    """The part of a PyVISA resource that this module uses. `timeout`: longest time to wait for data, ms. `baud_rate`,
    `bytes_in_buffer`: attributes that only a serial line has."""

    timeout: float
    read_termination: str | None
    baud_rate: int
    bytes_in_buffer: int

    def read_raw(self) -> bytes: ...
    def read_bytes(self, count: int, *, break_on_termchar: bool) -> bytes: ...
    def write_raw(self, message: bytes) -> int: ...
    def clear(self) -> None: ...
    def close(self) -> None: ...


@dataclass(slots=True)
class Incoming:
    """The data that a resource sends until the time `deadline` [s, monotonic clock]. `got`: data received so far."""

    resource: Wire
    deadline: float
    whole: bool
    """True if the bus marks the end of a message (GPIB, USB), so that a message can be read in one call."""
    got: bytearray = field(default_factory=bytearray)

    def until(self, end: bytes) -> bytes:
        """Reads until `end`; returns the bytes before it."""
        if self.whole:
            self.got += self.resource.read_raw()
            return bytes(self.got).removesuffix(end)
        start = len(self.got)
        while not (self.got.endswith(end) and len(self.got) >= start + len(end)):
            self._byte()
        return bytes(self.got[start : -len(end)])

    def exactly(self, count: int) -> bytes:
        """Reads the next `count` bytes."""
        start = len(self.got)
        while len(self.got) < start + count:
            self._byte()
        return bytes(self.got[start:])

    def until_quiet(self, seconds: float) -> bytes:
        """Reads until no data arrive for the given time. Waits for the first byte until the deadline."""
        self._byte()
        _wait_at_most(self.resource, seconds)
        with contextlib.suppress(_nothing_came()):
            while True:
                self._byte()
        return bytes(self.got)

    def _byte(self) -> None:
        if len(self.got) >= LONGEST:
            raise LinkFailure(f"sends continuously ({shown(self.got[:40])}…): {_GARBAGE}")
        if self.got and time.monotonic() > self.deadline:
            raise LinkFailure(f"stopped in the middle of its answer ({shown(self.got)} so far): {_LOOK}")
        self.got += self.resource.read_bytes(1, break_on_termchar=False)


_LOOK = "check its power, its cable and its address"
_GARBAGE = "check that it is the instrument in the bench file, and that baud rate and terminators are correct"
_REFUSED = (
    "refuses the connection: check that the instrument is on, that the network address and port are correct, and that "
    "no other program uses the instrument"
)


class MessageLink:
    """Exchanges requests and replies with an instrument. Every failure is an `InstrumentError` that names the resource, the request
    and what to check.

    The link is opened when it is first used, and again after a failure.
    """

    def __init__(self, settings: LinkSettings, framing: AnswerFraming | None = None):
        self.settings = settings
        self.framing: AnswerFraming = framing or LineAnswers()
        self._resource: Wire | None = None
        self._lock = lock_of(settings.address)
        self._last = 0.0
        self._disturbed = False
        self._remarks: deque[str] = deque(maxlen=MOST_REMARKS)

    def write(self, *texts: str) -> None:
        """Sends messages that have no reply. A message is not repeated, because it is unknown which part of the message has
        arrived."""
        with self._held(f"'{texts[-1]}'"):
            self._once(texts, None)

    def query(
        self, text: str, *, after: Sequence[str] = (), again: bool = True, framing: AnswerFraming | None = None
    ) -> str:
        """Sends `text` and returns the answer, without its terminator and without blanks at its ends.

        `after`: commands that are sent immediately before `text`. `again`: True if the request may be repeated on a new connection
        when there is no answer. `again` must be False for commands that change the instrument. `framing`: framing of this answer,
        if it differs from the framing of other answers.
        """
        tries = self.settings.tries if again and not after else 1
        with self._held(f"'{text}'"):
            for left in reversed(range(tries)):
                try:
                    answer = self._once((*after, text), framing or self.framing)
                    return self._text(answer)
                except LinkFailure as failure:
                    if not left:
                        raise
                    self._remarks.append(f"{self.settings.address} {failure}; '{text}' is sent again")
        raise AssertionError("unreachable")

    def remarks(self) -> list[str]:
        """Returns descriptions of unusual events since the last call."""
        told = list(self._remarks)
        self._remarks.clear()
        return told

    def doubt(self) -> None:
        """Closes the link, as after a failure; the next request opens it again. Call this method if the received data are not the
        reply to the request, because the true reply may still arrive."""
        with self._lock:
            self._give_up()

    def close(self) -> None:
        """Releases the resource. The method may be called twice."""
        resource, self._resource = self._resource, None
        if resource is not None:
            with contextlib.suppress(Exception):  # a dead link cannot be closed politely
                resource.close()

    # -- one exchange --------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _held(self, asked: str) -> Iterator[None]:
        """Reserves the link for one exchange. Raises `InstrumentError` if the exchange fails or the resource stays busy."""
        address = self.settings.address
        patience = self.settings.tries * 3 * self.settings.timeout
        if not self._lock.acquire(timeout=patience):
            raise InstrumentError(f"{address} is busy with another request for {patience:g} s: {_LOOK}")
        try:
            yield
        except LinkFailure as failure:
            raise InstrumentError(f"{address}, when asked {asked}, {failure}") from None
        finally:
            self._lock.release()

    def _once(self, texts: Sequence[str], framing: AnswerFraming | None) -> bytes:
        """Sends a request; if `framing` is given, also reads one answer. On a failure, closes the link and raises `LinkFailure`."""
        incoming: Incoming | None = None
        settings = self.settings
        try:
            resource = self._opened()
            message_based = _marks_ends(settings.address)
            if not message_based:
                self._drop_rests(resource)
            # Before anything is sent, because opening a serial port may lose incoming data.
            _wait_at_most(resource, settings.timeout)
            ended = [(text + settings.sent_end).encode("ascii") for text in texts]
            for message in ended if message_based else [b"".join(ended)]:
                self._keep_pace()
                resource.write_raw(message)
            if framing is None:
                return b""
            incoming = Incoming(resource, time.monotonic() + settings.timeout, message_based)
            return framing.read(incoming)
        except LinkFailure:
            self._give_up()
            raise
        except InstrumentError:  # the instrument's own words, read to their end
            raise
        except Exception as error:  # backends raise errors of many kinds
            got = b"" if incoming is None else bytes(incoming.got)
            failure = LinkFailure(_in_words(error, settings, got))
            self._give_up()
            raise failure from None
        except BaseException:  # interrupted: the answer may still come
            self._give_up()
            raise
        finally:
            self._last = time.monotonic()

    def _opened(self) -> Wire:
        if self._resource is None:
            settings = self.settings
            patience = round(settings.timeout * 1000)
            resource: Wire = _manager().open_resource(settings.address, open_timeout=patience)
            self._resource = resource
            resource.timeout = patience
            resource.read_termination = None
            if settings.address.startswith("ASRL"):
                resource.baud_rate = settings.baud
            if self._disturbed and not _marks_ends(settings.address):
                self._await_silence(resource)
            self._disturbed = False
        return self._resource

    def _give_up(self) -> None:
        """Closes the link, so that data that are still being transmitted are not read later."""
        resource, self._disturbed = self._resource, True
        if resource is not None and _marks_ends(self.settings.address):
            with contextlib.suppress(Exception):
                resource.clear()
        self.close()

    def _drop_rests(self, resource: Wire) -> None:
        """Discards unread data that were not requested."""
        if self.settings.address.startswith("ASRL") and not resource.bytes_in_buffer:
            return
        _wait_at_most(resource, GLANCE)
        rests = bytearray()
        with contextlib.suppress(_nothing_came()):
            while len(rests) < LONGEST:
                rests += resource.read_bytes(1, break_on_termchar=False)
                _wait_at_most(resource, QUIET)
        if rests.strip(self.settings.idle):
            self._remarks.append(
                f"{self.settings.address} sent {shown(rests)} without a request; this text was discarded"
            )
        if len(rests) >= LONGEST:
            raise LinkFailure(f"sends data without a request ({shown(rests[:40])}…): {_GARBAGE}")

    def _await_silence(self, resource: Wire) -> None:
        """Waits until a serial line has been silent for one time-out, but not longer than three time-outs. After a failure, this is
        necessary because late data may still arrive."""
        if not self.settings.address.startswith("ASRL"):
            return
        end = time.monotonic() + 3 * self.settings.timeout
        with contextlib.suppress(_nothing_came()):
            while time.monotonic() < end:
                resource.read_bytes(1, break_on_termchar=False)

    def _keep_pace(self) -> None:
        wait = self._last + self.settings.pace - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        self._last = time.monotonic()

    def _text(self, answer: bytes) -> str:
        try:
            text = answer.decode("ascii").strip()
        except UnicodeDecodeError:
            text = "\0"
        if not text.isprintable():
            self._give_up()
            raise LinkFailure(f"answers with {shown(answer)}, which is not text: {_GARBAGE}")
        return text


class LinkedCommands:
    """Base class for the commands of a controller that has one link."""

    link: MessageLink

    def remarks(self) -> Sequence[str]:
        return self.link.remarks()

    def close(self) -> None:
        self.link.close()


def shown(data: bytes | bytearray) -> str:
    """Shows bytes as text in a message."""
    cut = bytes(data[:60])
    text = repr(cut)[1:]
    return text if len(data) <= len(cut) else f"{text}…"


def _wait_at_most(resource: Wire, seconds: float) -> None:
    """Sets the time-out of the next read to `seconds`, unless it already has this value."""
    if abs(resource.timeout - seconds * 1000) > 0.5:
        resource.timeout = seconds * 1000


def _marks_ends(address: str) -> bool:
    """Returns True if the bus marks the end of a message. A TCP stream and a serial line do not."""
    upper = address.upper()
    return not (upper.startswith("ASRL") or upper.endswith("::SOCKET"))


@functools.cache
def _manager() -> Any:
    import pyvisa

    manager = pyvisa.ResourceManager()
    _count_steadily()
    return manager


def _count_steadily() -> None:
    """Makes PyVISA-py use the monotonic clock for its time-outs. By default, it uses the computer's clock; if this clock is set
    back during a request, the time-out becomes longer."""
    steady = SimpleNamespace(time=time.monotonic, sleep=time.sleep, perf_counter=time.perf_counter)
    for name in ("sessions", "tcpip", "protocols.rpc"):
        module = sys.modules.get(f"pyvisa_py.{name}")
        if module is not None:
            module.time = steady  # type: ignore[attr-defined]


def _nothing_came() -> type[Exception]:
    """Returns the exception with which the backends report a time-out."""
    from pyvisa.errors import VisaIOError

    return VisaIOError


def _in_words(error: Exception, settings: LinkSettings, got: bytes) -> str:
    from pyvisa import constants, errors

    if isinstance(error, ConnectionRefusedError):
        return _REFUSED
    if isinstance(error, BrokenPipeError | ConnectionResetError | ConnectionAbortedError):
        return f"closed the connection: {_LOOK}"
    if isinstance(error, errors.VisaIOError) and error.error_code == constants.StatusCode.error_timeout:
        if got:
            return f"stopped in the middle of its answer ({shown(got)} so far): {_LOOK}"
        return f"did not answer within {settings.timeout:g} s, or closed the line: {_LOOK}"
    text = " ".join(str(error).split()) or type(error).__name__
    return f"cannot be reached ({text}): {_LOOK}"


RESOURCE = (
    r"(GPIB\d*::\d+(::\d+)?::INSTR|TCPIP\d*::[^:\s]+::\d+::SOCKET|TCPIP\d*::[^:\s]+(::[^:\s]+)?::INSTR"
    r"|USB\d*::\S+::INSTR|ASRL\S+::INSTR)"
)


class LinkKeys(Record):
    """Declares the bench-file keys for the connection to an instrument."""

    address: str = key(
        Text(
            RESOURCE, "a VISA resource name such as TCPIP::192.168.0.5::5025::SOCKET, GPIB0::3::INSTR or ASRL3::INSTR"
        ),
        "VISA resource name: network address and port, GPIB address or serial port.",
        "TCPIP::192.168.0.5::5025::SOCKET",
    )
    timeout: Quantity = key(
        QuantityOf("time", "positive"),
        "Longest time until the instrument answers.",
        "2 s",
        default=parse_quantity("2 s"),
    )
    baud: int = key(
        Number(50, 4_000_000, integer=True), "Bit rate of a serial line, in bits per second.", 9600, default=9600
    )
    model_contains: str | None = optional(
        Text(r"\S.{0,60}", "some text"),
        "Text that the identification of the instrument must contain (case does not matter); by default the "
        "text that the driver expects.",
        "ACUTROL",
    )

    def check_identity(self, said: str, expected: str) -> None:
        """Raises `InstrumentError` if the instrument at this address is not the instrument that the driver or the bench file
        expects."""
        wanted = self.model_contains or expected
        if wanted.casefold() not in said.casefold():
            raise InstrumentError(
                f"{self.address} identifies itself as '{said[:80]}', which does not contain '{wanted}': check the address, "
                "or set "
                "model_contains in the bench file if this is the right instrument"
            )


class Commands(Protocol):
    """Commands that every controller has. Every failure is an `InstrumentError`."""

    def identify(self) -> Mapping[str, str]: ...
    def remarks(self) -> Sequence[str]: ...
    def close(self) -> None: ...


C = TypeVar("C", bound=Commands)
K = TypeVar("K", bound=LinkKeys)


class Commanded(Generic[C]):
    """Base class for real instruments that are operated through the commands `C` of a controller."""

    def __init__(self, commands: C):
        self.commands = commands

    def identify(self) -> Mapping[str, str]:
        return self.commands.identify()

    def remarks(self) -> Sequence[str]:
        return self.commands.remarks()

    def close(self) -> None:
        self.commands.close()


class CommandedDriver(Generic[K, C]):
    """Base class for drivers of instruments that are operated through the commands `C` of a controller.

    K is the record with the keys of the instrument. Derived drivers define `Parameters` and `commands_of`."""

    @classmethod
    def commands_of(cls, parameters: K) -> C:
        """Returns the commands of an instrument with these keys."""
        raise NotImplementedError

    @classmethod
    def address(cls, parameters: K) -> str:
        return parameters.address

    @classmethod
    def identified(cls, parameters: K) -> C:
        """Returns the commands of an instrument after its controller has identified itself. If the controller does not identify
        itself, the link is released. A fault that the instrument reports does not prevent the connection, because an instrument
        with a fault can still be made safe."""
        commands = cls.commands_of(parameters)
        try:
            commands.identify()
        except BaseException:
            commands.close()
            raise
        return commands
