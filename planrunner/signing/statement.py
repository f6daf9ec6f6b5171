"""Makes and reads in-toto Statements v1 (https://in-toto.io/Statement/v1) in canonical JSON (RFC 8785). These statements are the
content of signatures and approvals."""

from __future__ import annotations

from planrunner.archive.formats import from_bytes
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import MISLEADING, InputError, Mark

PAYLOAD = "application/vnd.in-toto+json"
STATEMENT = "https://in-toto.io/Statement/v1"
MOST_BYTES = 2**20
"""Maximum size in bytes of a file with a statement."""
MOST_LETTERS = 200
"""Maximum length of the name of a signer and of a comment."""


def payload_of(value: Json) -> bytes:
    """Returns the statement as a payload, in canonical JSON (RFC 8785)."""
    import rfc8785

    return rfc8785.dumps(value)


def read_statement(payload: bytes, predicate: str) -> JsonObject:
    """Reads the statement in a payload. `predicate`: the only type of predicate that is accepted. Raises ValueError or KeyError for
    any other content, and for a statement that is not in canonical form."""
    value = from_bytes(payload)
    if not isinstance(value, dict) or payload_of(value) != payload:
        raise ValueError
    if value["_type"] != STATEMENT or value["predicateType"] != predicate:
        raise ValueError
    found: JsonObject = value
    return found


def printable_line(text: str) -> bool:
    """Returns True if a text can be printed as one line without misleading characters."""
    return text.isprintable() and not MISLEADING.search(text)


def require_line(where: str, what: str, text: str, least: int = 0) -> None:
    """Raises `InputError` for a text that cannot be printed as one line or has a wrong length. `where`: the file to be signed, for
    the message. `least`: the smallest permitted number of characters."""
    if not least <= len(text.strip()) or len(text) > MOST_LETTERS or not printable_line(text):
        message = f"the {what} must be one line of printable text with at most {MOST_LETTERS} characters"
        raise InputError.at(Mark(where), "sign-text", message, "shorten it, or correct it")
