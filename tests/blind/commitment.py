"""Sealed labels: the SHA-256 of a secret salt followed by the label's canonical JSON is published before anything is answered."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping


class BrokenSealError(ValueError):
    """A label is missing, was changed after the commitment, or was never committed to."""


def canonical(label: Mapping) -> str:
    """JSON with sorted keys and no spaces."""
    return json.dumps(label, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def salt(seed: int, case: str) -> str:
    """A case's salt: unknown to who does not know the seed, and the same however the work is shared."""
    return hashlib.sha256(f"salt:{seed}:{case}".encode()).hexdigest()


def commitment(secret: str, label: Mapping) -> str:
    return hashlib.sha256((secret + canonical(label)).encode()).hexdigest()


def written(commitments: Mapping[str, str]) -> str:
    """The text of `commitments.txt`: a digest and a case a line."""
    return "".join(f"{digest}  {case}\n" for case, digest in sorted(commitments.items()))


def read(text: str) -> dict[str, str]:
    """Case → digest, from the text of `commitments.txt`."""
    rows = [line.split() for line in text.splitlines() if line.strip()]
    if any(len(row) != 2 or len(row[0]) != 64 for row in rows):
        raise BrokenSealError("commitments.txt: every line holds a SHA-256 digest and a case")
    return {case: digest for digest, case in rows}


def verify(commitments: Mapping[str, str], sealed: Mapping[str, Mapping]) -> None:
    """Every sealed label, given as {"salt", "label"} by case, against the digests; raises BrokenSealError naming the cases."""
    missing = sorted(commitments.keys() ^ sealed.keys())
    if missing:
        raise BrokenSealError(f"commitments and sealed labels name different cases: {', '.join(missing[:5])}")
    wrong = [
        case
        for case, digest in sorted(commitments.items())
        if commitment(sealed[case]["salt"], sealed[case]["label"]) != digest or sealed[case]["label"]["case"] != case
    ]
    if wrong:
        raise BrokenSealError(f"{len(wrong)} labels are not those committed to: {', '.join(wrong[:5])}")
