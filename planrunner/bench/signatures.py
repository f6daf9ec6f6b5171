"""Declares the entries of a bench file that concern signatures: the required approvals, the key with which the bench signs, and the
authority that issues its time stamps (RFC 3161)."""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.plan.kinds import Boolean, ListOf, Number, QuantityOf, Record, RecordOf, Text, key
from planrunner.plan.model import PERSON
from planrunner.plan.quantity import Quantity, parse_quantity

ROLE = r"[a-z][a-z0-9_-]{0,39}"
_PART = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,79}"
MOST = 20
"""Largest number of approvals that a bench can require."""


class ApprovalRule(Record):
    """Approvals that a plan needs before it may run on this bench. No other approvals are needed."""

    keys: str = key(
        Text(rf"{_PART}(/{_PART}){{0,4}}", "a file in the folder of the bench file or in a folder of it"),
        "Key ring of the laboratory, relative to the bench file.",
        "lab-keys.yaml",
    )
    required: int = key(
        Number(1, MOST, integer=True), "Number of persons who must have approved the plan.", 2, default=1
    )
    by: tuple[str, ...] = key(
        ListOf(Text(PERSON, "a name in the key ring"), minimum=1),
        "Persons whose approvals count, by their names in the key ring; by default all.",
        ["anna", "ben"],
        default_factory=tuple,
    )
    roles: tuple[str, ...] = key(
        ListOf(Text(ROLE, "a role"), minimum=1),
        "An approval counts only if its key has one of these roles in the key ring; by default any key counts.",
        ["reviewer"],
        default_factory=tuple,
    )
    author_may_approve: bool = key(
        Boolean(), "Whether approvals by an `author` of the plan count.", False, default=False
    )
    withdrawn: tuple[str, ...] = key(
        ListOf(Text(r"[0-9a-f]{64}", "a SHA-256 digest")),
        "Approvals that do not count on this bench, by the digests that `planrunner approve --list` prints. "
        "A withdrawal that is stored beside the plan can be deleted; an entry in this list remains.",
        ["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"],
        default_factory=tuple,
    )


def _check(rule: ApprovalRule, log: Findings) -> None:
    if rule.by and len(set(rule.by)) < rule.required:
        message = f"{rule.required} approvals are required, but only {len(set(rule.by))} persons are named in `by`"
        log.error("meaning-approvals", rule.at("required"), message, "require fewer approvals, or name more persons")


APPROVALS = RecordOf(ApprovalRule, _check)


class SigningSpec(Record):
    """Declares the key with which the bench signs. The bench file contains only its public part."""

    key: str = key(
        Text(r"ssh-ed25519 [A-Za-z0-9+/=]{20,200}( [^\x00-\x1f]{0,200})?", "a public key of OpenSSH"),
        "Public key of the bench, as `planrunner key new --for-bench` prints it. The private key stays on the computer of the bench.",
        "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIGLkQmCXDi/PQZJZziZo7k97osN1kINhk5QiG1kpfDFm",
    )


class TimeStampsSpec(Record):
    """Describes the authority that issues the time stamps of the bench."""

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
        "Certificate of the authority in PEM, or its root certificate together with the intermediate ones.",
        "-----BEGIN CERTIFICATE----- …",
    )


def check_stamps(spec: TimeStampsSpec, log: Findings) -> None:
    """Adds an error if the authority's certificate cannot be read."""
    from cryptography.x509 import load_pem_x509_certificates

    try:
        load_pem_x509_certificates(spec.certificate.encode())
    except ValueError:
        message = "this is not a certificate in PEM"
        hint = "copy the whole certificate, including its first and last lines, as a block that begins with `|`"
        log.error("bench-stamp-certificate", spec.at("certificate"), message, hint)
