"""Makes and reads signed statements: DSSE envelopes, and the in-toto statements in them.

A DSSE envelope is a signed payload with a type (https://github.com/secure-systems-lab/dsse, v1). The signature covers the
pre-authentication encoding (PAE) of the type and the payload, so that nobody can present the payload as having another type. One
envelope has exactly one signature. The payloads of signatures and approvals are in-toto Statements v1
(https://in-toto.io/Statement/v1) in canonical JSON (RFC 8785).
"""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass

from planrunner.archive.formats import from_bytes, to_bytes
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import MISLEADING, InputError, Mark
from planrunner.signing.keys import PublicKey, Signer


class EnvelopeError(ValueError):
    """Reports that a text is not an envelope as planrunner writes it. The message gives the reason."""


def pae(kind: str, payload: bytes) -> bytes:
    """Returns the pre-authentication encoding, which is signed: `DSSEv1 <length> <type> <length> <payload>`."""
    name = kind.encode()
    return b"DSSEv1 %d %b %d %b" % (len(name), name, len(payload), payload)


@dataclass(frozen=True, slots=True)
class Envelope:
    """An envelope with its payload and its signature. `key`: fingerprint of the key that, according to the envelope, made the
    signature; `signed_by` checks this."""

    kind: str
    payload: bytes
    key: str
    signature: bytes

    def signed_by(self, key: PublicKey) -> bool:
        """Returns True if this key made the signature of the envelope's payload and type."""
        return self.key == key.fingerprint and key.signed(self.signature, pae(self.kind, self.payload))

    def to_bytes(self) -> bytes:
        """Returns the envelope as JSON."""
        signature = {"keyid": self.key, "sig": _encoded(self.signature)}
        return to_bytes({"payload": _encoded(self.payload), "payloadType": self.kind, "signatures": [signature]})


def seal_envelope(kind: str, payload: bytes, signer: Signer) -> Envelope:
    """Signs a payload of the given type."""
    return Envelope(kind, payload, signer.public.fingerprint, signer.sign(pae(kind, payload)))


def parse_envelope(data: bytes, kind: str) -> Envelope:
    """Reads the envelope in a file. `kind`: the only type of payload that is accepted. Raises `EnvelopeError` for a file that is
    not such an envelope."""
    try:
        value = from_bytes(data)
    except ValueError:
        raise EnvelopeError("it is not JSON") from None
    if not isinstance(value, dict) or set(value) != {"payload", "payloadType", "signatures"}:
        raise EnvelopeError("it is not an envelope with payload, payloadType and signatures")
    if value["payloadType"] != kind:
        raise EnvelopeError(f"its payload is of a type other than {kind}")
    signatures = value["signatures"]
    if not isinstance(signatures, list) or len(signatures) != 1:
        raise EnvelopeError("it does not have exactly one signature")
    (one,) = signatures
    if not isinstance(one, dict) or set(one) != {"keyid", "sig"} or not isinstance(one["keyid"], str):
        raise EnvelopeError("its signature does not consist of keyid and sig")
    found = Envelope(kind, _decoded(value["payload"]), one["keyid"], _decoded(one["sig"]))
    if found.to_bytes() != data:
        raise EnvelopeError("it is not written as planrunner writes envelopes")
    return found


def _encoded(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _decoded(value: Json) -> bytes:
    if not isinstance(value, str):
        raise EnvelopeError("payload and signature must be texts in base64")
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        raise EnvelopeError("payload and signature must be texts in base64") from None


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
