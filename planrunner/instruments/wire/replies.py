"""Converts texts in replies to numbers, and numbers to texts in commands. A reply that does not contain the expected numbers raises
`InstrumentError`."""

from __future__ import annotations

import math
import re

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire.links import AnswerFraming, MessageLink

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def numbers(link: MessageLink, request: str, count: int, framing: AnswerFraming | None = None) -> list[float]:
    """Returns the numbers in the answer to a request, which are separated by commas or semicolons. Raises `InstrumentError` if
    there are too few numbers, or if a number is not finite. After this error, the link discards data that still arrive, so that
    they are not mistaken for the answer to the next request."""
    reply = link.query(request, framing=framing)
    try:
        return parsed(reply, request, count, link.settings.address)
    except InstrumentError:
        link.doubt()
        raise


def number(link: MessageLink, request: str, framing: AnswerFraming | None = None) -> float:
    """Returns the number in the answer to a request, under the conditions of `numbers`."""
    return numbers(link, request, 1, framing)[0]


def parsed(reply: str, request: str, count: int, address: str) -> list[float]:
    """Returns the first `count` numbers in a reply. Raises `InstrumentError` if there are fewer numbers, or if a number is not
    finite."""
    parts = [part.strip() for part in re.split(r"[,;]", reply)[:count]]
    found = [float(part) for part in parts if NUMBER.fullmatch(part)]
    if len(found) < count or not all(map(math.isfinite, found)):
        wanted = "a number is" if count == 1 else f"{count} numbers are"
        raise InstrumentError(
            f"{address} answers '{request}' with '{reply[:60]}', but {wanted} expected: check that it is the instrument in the bench file"
        )
    return found


def identification(said: str) -> dict[str, str]:
    """Returns the four fields of an answer to `*IDN?` (IEEE 488.2, 10.14), or fewer if the answer contains fewer."""
    return dict(zip(("manufacturer", "model", "serial", "firmware"), map(str.strip, said.split(",")), strict=False))


def written(value: float) -> str:
    """Writes a number in the form that instruments read: without exponent, with at most six decimals, without trailing zeros."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
