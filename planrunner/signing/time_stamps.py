"""Requests time stamps from an authority (RFC 3161), and verifies the replies offline with the certificate of the authority."""

from __future__ import annotations

import itertools
import re
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from http.client import HTTPException
from typing import cast, get_args

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.types import CertificateIssuerPublicKeyTypes
from cryptography.hazmat.primitives.serialization import Encoding
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
"""Time to wait for each step of an exchange with a time stamp authority, s."""


class StampError(ValueError):
    """Reports that a time stamp is missing or not valid. The message gives the reason."""


@dataclass(frozen=True, slots=True)
class StampAuthority:
    """Contains the certificates that verify time stamps: the certificate of the authority itself, or the certificates of the root
    and intermediate authorities above it. `revocations`: lists of revoked certificates; each list is signed with one of these
    certificates."""

    certificates: tuple[x509.Certificate, ...]
    revocations: tuple[x509.CertificateRevocationList, ...] = ()

    def __reduce__(self) -> tuple[Callable[[bytes, bytes], StampAuthority], tuple[bytes, bytes]]:
        """Makes the object picklable by writing the certificates as PEM, because the library's certificate objects cannot be sent
        to another process."""
        certificates, lists = (
            b"".join(one.public_bytes(Encoding.PEM) for one in some) for some in (self.certificates, self.revocations)
        )
        return parse_authority, (certificates, lists)


def parse_authority(pem: bytes, revocations: bytes = b"") -> StampAuthority:
    """Reads certificates in PEM, and lists of revoked certificates (RFC 5280) in PEM or DER. Raises ValueError for other data, and
    for a list that none of the certificates has signed."""
    try:
        found = tuple(x509.load_pem_x509_certificates(pem))
    except ValueError:
        raise ValueError("this is not a certificate in PEM") from None
    lists = tuple(_revocation_lists(revocations))
    for one in lists:
        if not any(by.subject == one.issuer and one.is_signature_valid(_issuer_key(by)) for by in found):
            raise ValueError("this list of revoked certificates is not signed by a certificate of the authority")
    return StampAuthority(found, lists)


def _issuer_key(certificate: x509.Certificate) -> CertificateIssuerPublicKeyTypes:
    key = certificate.public_key()
    if not isinstance(key, get_args(CertificateIssuerPublicKeyTypes)):
        raise ValueError("the certificate of the authority has a key that cannot sign")
    return cast(CertificateIssuerPublicKeyTypes, key)


def _revocation_lists(data: bytes) -> Iterator[x509.CertificateRevocationList]:
    try:
        blocks = re.findall(rb"-----BEGIN X509 CRL-----.*?-----END X509 CRL-----\n?", data, re.DOTALL)
        if data and not blocks:
            yield x509.load_der_x509_crl(data)
        for block in blocks:
            yield x509.load_pem_x509_crl(block)
    except ValueError:
        raise ValueError("this is not a list of revoked certificates (CRL) in PEM or DER") from None


_NOT_COMPROMISED = (
    x509.ReasonFlags.unspecified,
    x509.ReasonFlags.affiliation_changed,
    x509.ReasonFlags.superseded,
    x509.ReasonFlags.cessation_of_operation,
)
"""Reasons of a revocation after which time stamps from before the revocation remain valid (RFC 3161, 4, item 1). With any other
reason, or without a reason, these time stamps are not valid."""


def _require_not_revoked(reply: TimeStampResponse, moment: datetime, authority: StampAuthority) -> None:
    """Raises `StampError` if the certificate of the signer, or a certificate above it in the chain, was revoked and the revocation
    makes a stamp of this time invalid."""
    known = {*authority.certificates, *map(x509.load_der_x509_certificate, reply.signed_data.certificates)}
    signers = {(one.issuer, one.serial_number) for one in reply.signed_data.signer_infos}
    chain = [one for one in known if (one.issuer, one.serial_number) in signers]
    for one in chain:
        chain += [other for other in known if other.subject == one.issuer and other not in chain]
    for listed, one in itertools.product(authority.revocations, chain):
        entry = (
            listed.get_revoked_certificate_by_serial_number(one.serial_number) if listed.issuer == one.issuer else None
        )
        if entry is None:
            continue
        try:
            reason = entry.extensions.get_extension_for_class(x509.CRLReason).value.reason
        except x509.ExtensionNotFound:
            reason = None
        if reason in _NOT_COMPROMISED and moment < entry.revocation_date_utc:
            continue
        why = "no reason stated" if reason is None else reason.value
        message = (
            f"the certificate '{one.subject.rfc4514_string()[:100]}' was revoked on {entry.revocation_date_utc}: {why}"
        )
        raise StampError(message)


def stamp_time(token: bytes, digest: str, authority: StampAuthority) -> datetime:
    """Returns the time (UTC) at which the authority stamped a SHA-256 digest (64 hexadecimal digits). Raises `StampError` if the
    reply is not a valid stamp of this digest."""
    reply = _decoded(token)
    _verify(VerifierBuilder(roots=list(authority.certificates)), reply, digest)
    moment = reply.tst_info.gen_time.astimezone(UTC)
    _require_not_revoked(reply, moment, authority)
    return moment


def stamped_digest(token: bytes) -> str:
    """Returns the SHA-256 digest that a reply claims to stamp. Raises `StampError` if the reply cannot be read."""
    imprint = _decoded(token).tst_info.message_imprint
    if imprint.hash_algorithm != SHA256:
        raise StampError("it is not a stamp of a SHA-256 digest")
    return imprint.message.hex()


def request_stamp(url: str, data: bytes, digest: str, authority: StampAuthority) -> tuple[bytes, datetime]:
    """Requests a new time stamp of `data`, whose SHA-256 digest is `digest`. Returns the verified reply of the authority, and the
    time of the stamp. Raises `StampError` if no valid time stamp is obtained."""
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
