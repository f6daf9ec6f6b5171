"""Time stamps of an authority (RFC 3161): requests, replies, and their verification with the certificate of the authority, offline."""

from __future__ import annotations

import urllib.error
import urllib.request
from dataclasses import dataclass
from datetime import UTC, datetime
from http.client import HTTPException

from cryptography import x509
from rfc3161_client import (
    HashAlgorithm,
    TimestampRequestBuilder,
    TimeStampResponse,
    VerificationError,
    VerifierBuilder,
    decode_timestamp_response,
)

from planrunner.archive.stamp_files import MOST_BYTES

SHA256 = x509.ObjectIdentifier("2.16.840.1.101.3.4.2.1")
QUERY = "application/timestamp-query"
PATIENCE = 10.0
"""Seconds to wait for each step of an exchange with an authority."""


class StampError(ValueError):
    """There is no time stamp, or it is not valid. The message says why."""


@dataclass(frozen=True, slots=True)
class StampAuthority:
    """Certificates that stamps are verified with: of the authority, or of its root and of those in between."""

    certificates: tuple[x509.Certificate, ...]


def parse_authority(pem: bytes) -> StampAuthority:
    """The certificates in a text in PEM. Raises ValueError."""
    try:
        found = x509.load_pem_x509_certificates(pem)
    except ValueError:
        raise ValueError("this is not a certificate in PEM") from None
    return StampAuthority(tuple(found))


def stamp_time(token: bytes, digest: str, authority: StampAuthority) -> datetime:
    """The time, UTC, at which the authority stamped a SHA-256 digest (64 hexadecimal digits). Raises `StampError`."""
    reply = _decoded(token)
    _verify(VerifierBuilder(roots=list(authority.certificates)), reply, digest)
    return reply.tst_info.gen_time.astimezone(UTC)


def stamped_digest(token: bytes) -> str:
    """The SHA-256 digest that a reply claims to stamp. Raises `StampError`."""
    imprint = _decoded(token).tst_info.message_imprint
    if imprint.hash_algorithm != SHA256:
        raise StampError("it is not a stamp of a SHA-256 digest")
    return imprint.message.hex()


def request_stamp(url: str, data: bytes, digest: str, authority: StampAuthority) -> tuple[bytes, datetime]:
    """A new time stamp of some data with this SHA-256 digest: the reply of the authority, verified, and its time. Raises `StampError`."""
    query = TimestampRequestBuilder().data(data).hash_algorithm(HashAlgorithm.SHA256).build()
    request = urllib.request.Request(url, data=query.as_bytes(), headers={"Content-Type": QUERY})
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            token: bytes = answer.read(MOST_BYTES + 1)
    except (OSError, ValueError, HTTPException) as error:
        reason = error.reason if isinstance(error, urllib.error.URLError) else error
        raise StampError(f"the time stamp authority does not answer: {str(reason)[:200]}") from None
    if len(token) > MOST_BYTES:
        raise StampError("the reply of the time stamp authority is too long")
    reply = _decoded(token)
    builder = VerifierBuilder(roots=list(authority.certificates))
    _verify(builder if query.nonce is None else builder.nonce(query.nonce), reply, digest)
    return token, reply.tst_info.gen_time.astimezone(UTC)


def _decoded(token: bytes) -> TimeStampResponse:
    try:
        reply = decode_timestamp_response(token)
        if reply.status not in (0, 1):
            raise StampError(f"the time stamp authority refused: status {reply.status}")
        _ = reply.tst_info
    except StampError:
        raise
    except Exception as error:  # the library has no class of its own for malformed replies
        raise StampError(f"it is not a reply of a time stamp authority: {str(error)[:100]}") from None
    return reply


def _verify(builder: VerifierBuilder, reply: TimeStampResponse, digest: str) -> None:
    if reply.tst_info.message_imprint.hash_algorithm != SHA256:
        raise StampError("it is not a stamp of a SHA-256 digest")
    if reply.tst_info.message_imprint.message.hex() != digest:
        raise StampError("it stamps another digest")
    try:
        builder.build().verify(reply, bytes.fromhex(digest))
    except (VerificationError, ValueError) as error:
        raise StampError(f"it is not verified by the certificate of the authority: {str(error)[:200]}") from None
