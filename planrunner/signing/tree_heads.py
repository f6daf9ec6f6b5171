"""Makes and reads the signed tree head of the log of an archive: `.log/head.dsse.json`, a DSSE envelope with the tree head in
canonical JSON."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from planrunner.archive import formats
from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_log import MOST_HEAD, RunLog, TreeHead, parse_head, require_growth
from planrunner.signing.envelope import EnvelopeError, parse_envelope, seal_envelope
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.keys import Signer

PAYLOAD = "application/vnd.planrunner.tree-head+json"
SIGNED = "head.dsse.json"


@dataclass(frozen=True, slots=True)
class RememberedHead:
    """A tree head of a log, as read from a file.

    `key`: fingerprint of the key that, according to the file, signed the head; empty if the head is not signed. `owner`: the name
    that the key ring gives this key, if the signature is valid. `why`: the fault of the signature; empty if none is known.
    """

    head: TreeHead
    key: str = ""
    owner: str = ""
    why: str = ""


def sign_head(log: RunLog, signer: Signer) -> bytes:
    """Signs the present tree head of a log and stores the signature in the log; returns the signature. Raises `IntegrityError` if
    the log was changed, and `OSError` if the signature cannot be written."""
    import rfc8785

    with log.locked():
        content = log.read()
        require_growth(content, log.path)
        envelope = seal_envelope(PAYLOAD, rfc8785.dumps(content.head().to_json()), signer).to_bytes()
        log.write_beside(SIGNED, envelope)
    return envelope


def signed_head(log: RunLog, ring: KeyRing | None) -> RememberedHead | None:
    """Returns the signed tree head in a log; None if there is none. Raises `IntegrityError` if the file of the signed tree head was
    changed, and `OSError` if it cannot be read."""
    if log.folder.entry(SIGNED) is None:
        return None
    return remembered_head(log.folder.read(SIGNED, MOST_HEAD), log.path / SIGNED, ring)


def remembered_head(data: bytes, path: Path, ring: KeyRing | None) -> RememberedHead:
    """Reads the tree head in a file; the head can be signed or unsigned. Raises `IntegrityError` if the file does not contain a
    tree head."""
    if b'"payloadType"' not in data:
        return RememberedHead(parse_head(data, path))
    try:
        envelope = parse_envelope(data, PAYLOAD)
        value = formats.from_bytes(envelope.payload)
        head = TreeHead(value["size"], value["root"], value["at"])
        import rfc8785

        if rfc8785.dumps(head.to_json()) != envelope.payload:
            raise ValueError("it is not a tree head in canonical JSON")
        day = datetime.fromisoformat(head.at).date()
        parse_head(head.to_bytes(), path)  # its values match the schema
    except (EnvelopeError, ValueError, KeyError, TypeError) as error:
        message = f"{path}: this is not a signed tree head: {error}; {formats.FROM_BACKUP}"
        raise IntegrityError(message, "log-signature") from None
    known = None if ring is None else ring.find(envelope.key)
    if known is None:
        return RememberedHead(head, envelope.key)
    if not envelope.signed_by(known.public):
        return RememberedHead(head, envelope.key, why="the signature does not match its content")
    return RememberedHead(head, envelope.key, known.name, known.objection(day))
