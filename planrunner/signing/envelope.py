"""Makes and reads DSSE envelopes, which are signed payloads with a type (https://github.com/secure-systems-lab/dsse, v1).

The signature covers the pre-authentication encoding (PAE) of the type and the payload, so that nobody can present the payload as
having another type. One envelope has exactly one signature.
"""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass

from planrunner.archive.formats import from_bytes, to_bytes
from planrunner.base.documents import Json
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
        raise EnvelopeError(f"its payload is of another type than {kind}")
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
