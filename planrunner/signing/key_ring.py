"""Reads the key ring of a laboratory: a YAML file with the public keys of its members and benches.

planrunner_keys: 1
keys:
  anna:
    public: ssh-ed25519 AAAA…
    roles: [reviewer]
    until: "2028-12-31"
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path

from planrunner.base.findings import Findings, InputError
from planrunner.bench.signatures import ROLE
from planrunner.plan import source
from planrunner.plan.kinds import ListOf, MapOf, Number, Record, RecordOf, Text, key, optional
from planrunner.plan.model import PERSON
from planrunner.signing.keys import PublicKey, parse_public

NAME = PERSON
_DATE = r"[0-9]{4}-[0-9]{2}-[0-9]{2}"
_DAY = Text(_DATE, "a date", "write for example 2026-03-01")


class KeyEntry(Record):
    """One public key."""

    public: str = key(
        Text(r"ssh-ed25519 [A-Za-z0-9+/=]{20,200}( [^\x00-\x1f]{0,200})?", "a public key of OpenSSH"),
        "The public key, as in a file id_ed25519.pub.",
        "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIA…",
    )
    roles: tuple[str, ...] = key(
        ListOf(Text(ROLE, "a role")), "Roles of the owner.", ["reviewer"], default_factory=tuple
    )
    person: str | None = optional(
        Text(NAME, "a name in the key ring"),
        "Name of the person, if the person has several keys; by default the name of the entry.",
        "anna",
    )
    from_: str | None = optional(_DAY, "First day on which the key is valid.", "2026-01-01", name="from")
    until: str | None = optional(_DAY, "Last day on which the key is valid.", "2028-12-31")
    revoked: str | None = optional(
        _DAY,
        "Day on which the key was revoked. As soon as it is stated, no signature of the key counts, whatever its date.",
        "2027-05-04",
    )


class KeyRingFile(Record):
    """A key ring."""

    planrunner_keys: int = key(Number(1, 1, integer=True), "Version of the format.", 1)
    keys: dict[str, KeyEntry] = key(
        MapOf(RecordOf(KeyEntry), pattern=NAME), "The keys by the names of their owners.", {}
    )


@dataclass(frozen=True, slots=True)
class KnownKey:
    """A key in the key ring, with its owner. Dates that the ring does not state are None. `owner`: the person who owns the key;
    empty if the name of the key is the person's name."""

    name: str
    public: PublicKey
    roles: tuple[str, ...] = ()
    begins: date | None = None
    ends: date | None = None
    revoked: date | None = None
    owner: str = ""

    @property
    def person(self) -> str:
        """Returns the owner of the key. Several keys may belong to one person."""
        return self.owner or self.name

    def objection(self, day: date) -> str:
        """Returns the reason why a signature made on this date does not count; empty if it counts.

        No signature of a revoked key counts. The date of a signature comes from the signer's clock, so it cannot prove that the
        signature was made before the key was revoked.
        """
        if self.revoked is not None:
            return f"the key was revoked on {self.revoked}"
        if self.begins is not None and day < self.begins:
            return f"the key is valid from {self.begins}"
        if self.ends is not None and day > self.ends:
            return f"the key was valid until {self.ends}"
        return ""


@dataclass(frozen=True, slots=True)
class KeyRing:
    """The keys of a key ring by fingerprint."""

    keys: dict[str, KnownKey]

    def find(self, fingerprint: str) -> KnownKey | None:
        return self.keys.get(fingerprint)

    def person(self, name: str) -> str | None:
        """Returns the person who has this name, or whose key has this name; None if the ring has no such person."""
        named = {one.name: one.person for one in self.keys.values()}
        return named.get(name, name if name in named.values() else None)


def read_ring(path: Path) -> KeyRing:
    """Reads a key ring from a file. Raises `InputError` with all faults, including keys that occur twice."""
    return parse_ring(source.read_text(path), str(path))


def parse_ring(text: str, shown: str) -> KeyRing:
    """Reads a key ring from a text. `shown`: file name that findings state. Raises `InputError` with all faults of the text."""
    log = Findings()
    file = RecordOf(KeyRingFile).read(source.parse(text, shown), log)
    if file is None or log.errors:
        raise InputError(log)
    found: dict[str, KnownKey] = {}
    for name, entry in file.keys.items():
        begins, ends, revoked = (_day(entry, stated, log) for stated in ("from", "until", "revoked"))
        try:
            public = parse_public(entry.public)
        except ValueError as error:
            log.error("key-unreadable", entry.at("public"), str(error), "copy the line from the file of the key")
            continue
        if public.fingerprint in found:
            other = found[public.fingerprint].name
            message = f"this is the key of '{other}' too"
            log.error("key-twice", entry.at("public"), message, "each key has one owner: remove one of them")
        found[public.fingerprint] = KnownKey(name, public, entry.roles, begins, ends, revoked, entry.person or "")
    if log.errors:
        raise InputError(log)
    return KeyRing(found)


def _day(entry: KeyEntry, name: str, log: Findings) -> date | None:
    text = {"from": entry.from_, "until": entry.until, "revoked": entry.revoked}[name]
    if text is None:
        return None
    try:
        return date.fromisoformat(text)
    except ValueError:
        message = f"'{text}' is not a calendar date"
        log.error("meaning-date", entry.at(name), message, "write year-month-day, such as 2026-03-01")
        return None


def entry_text(name: str, public: PublicKey, roles: tuple[str, ...], until: str | None) -> str:
    """Returns the entry of a key as YAML text, to be inserted under `keys:` in the file of a key ring."""
    lines = [f"  {name}:", f"    public: {public.line}"]
    if roles:
        lines.append(f"    roles: [{', '.join(roles)}]")
    if until is not None:
        lines.append(f'    until: "{until}"')
    return "\n".join(lines) + "\n"
