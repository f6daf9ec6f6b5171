"""The key `time_stamps` of a bench: the authority that stamps the journal and the seal of its runs (RFC 3161)."""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.plan.kinds import QuantityOf, Record, Text, key
from planrunner.plan.quantity import Quantity, parse_quantity


class TimeStampsSpec(Record):
    """A time stamp authority."""

    url: str = key(
        Text(r"https?://[^\x00-\x20]{1,300}", "an address that begins with http:// or https://"),
        "Address of the authority. It receives digests only.",
        "https://tsa.example.org/tsr",
    )
    every: Quantity = key(
        QuantityOf("time", "positive"),
        "Shortest time between two stamps of the journal, in real time. The first events and the end of a run are always stamped.",
        "10 min",
        default=parse_quantity("10 min"),
    )
    certificate: str = key(
        Text(r"[^\x00]{1,10000}", "a certificate in PEM"),
        "Certificate of the authority, or of its root with those in between, in PEM.",
        "-----BEGIN CERTIFICATE----- …",
    )


def check_stamps(spec: TimeStampsSpec, log: Findings) -> None:
    """Adds an error for a certificate that cannot be read."""
    from cryptography.x509 import load_pem_x509_certificates

    try:
        load_pem_x509_certificates(spec.certificate.encode())
    except ValueError:
        message = "this is not a certificate in PEM"
        hint = "copy the whole certificate, with its first and last line, as a block that begins with `|`"
        log.error("bench-stamp-certificate", spec.at("certificate"), message, hint)
