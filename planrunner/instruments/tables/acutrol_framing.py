"""How an ACUTROL delimits its replies over TCP.

Public sources agree that eight bytes come before each reply, an error code and a length, and disagree on what the bytes are: two
32-bit words, or eight characters. Which it is shows in the first reply, whose length must equal what follows; from then on exactly
so many bytes are read. A controller behind a gateway that sends bare lines is understood too.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.links import LONGEST, Incoming, LinkFailure, shown

HEADER = 8
QUIET = 0.1
"""s without a byte after which the first reply is complete."""

Header = Callable[[bytes], tuple[int, int]]


def _words(order: str) -> Header:
    return lambda head: struct.unpack(f"{order}II", head)


def _characters(base: int) -> Header:
    return lambda head: (int(head[:4], base), int(head[4:], base))


KINDS: dict[str, Header] = {
    "words, high byte first": _words(">"),
    "words, low byte first": _words("<"),
    "characters, decimal": _characters(10),
    "characters, hexadecimal": _characters(16),
}


def kind_of(reply: bytes) -> str | None:
    """How the header of a complete reply is written, a key of `KINDS`; None for a bare line. Raises `LinkFailure` when it is neither."""
    for name, header in KINDS.items():
        try:
            _, length = header(reply[:HEADER])
        except (ValueError, struct.error):
            continue
        if length == len(reply) - HEADER:
            return name
    if reply.endswith(b"\n") and reply.strip().isascii():
        return None
    raise LinkFailure(f"answers with {shown(reply)}, which is neither a line nor framed by error code and length")


class AcutrolFraming:
    """Reads replies; knows after the first one how they are framed."""

    def __init__(self) -> None:
        self._known = False
        self._kind: str | None = None

    def read(self, incoming: Incoming) -> bytes:
        if not self._known:
            reply = incoming.until_quiet(QUIET)
            self._kind, self._known = kind_of(reply), True
            if self._kind is None:
                return reply
            return self._checked(KINDS[self._kind](reply[:HEADER])[0], reply[HEADER:])
        if self._kind is None:
            return incoming.until(b"\n")
        while True:
            head = incoming.exactly(HEADER)
            try:
                error, length = KINDS[self._kind](head)
            except ValueError:
                raise LinkFailure(f"sends {shown(head)} where error code and length belong") from None
            if length > LONGEST:
                raise LinkFailure(f"announces an answer of {length} bytes ({shown(head)})")
            body = self._checked(error, incoming.exactly(length))
            if body:  # a command may be acknowledged by a header alone
                return body

    def _checked(self, error: int, body: bytes) -> bytes:
        if error:
            raise InstrumentError(f"the ACUTROL reports error {error}" + (f": {shown(body)}" if body else ""))
        return body
