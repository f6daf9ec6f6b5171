"""Stores the time stamps in a run folder. `stamps/<number>-<what>.tsr` contains the reply of an authority in DER (RFC 3161).

`0001-after-12.tsr` stamps the journal after 12 events: it contains the digest of line 12. `0004-seal-<digest>.tsr` stamps the seal.
When the seal is stamped, the journal has ended and cannot contain the digest of the stamp. The name of the stamp's file therefore
contains the first digits of the SHA-256 of this file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from planrunner.archive.storage import Storage
from planrunner.base.guarded_folder import GuardedFolder

FOLDER = "stamps"
MOST_BYTES = 2**16
"""Maximum size in bytes of a stamp."""
DIGITS = 16
"""Number of hexadecimal digits of a digest in the name of a file."""
_FILE = re.compile(r"(?P<number>[0-9]{4,})-(?:after-(?P<events>[1-9][0-9]*)|seal-(?P<own>[0-9a-f]{16}))\.tsr\Z")


@dataclass(frozen=True, slots=True)
class StampName:
    """Contains the parts of the name of a time stamp. `events`: for a stamp of the journal, the number of events; otherwise None.
    `own`: for a stamp of the seal, the first digits of the SHA-256 of the stamp's file; otherwise None."""

    file: str
    number: int
    events: int | None
    own: str | None


def stamp_names(folder: GuardedFolder) -> tuple[StampName, ...]:
    """Returns the names of the stamps of a run in the order of their numbers. Raises `OSError` if the folder of the stamps cannot
    be read."""
    if folder.entry(FOLDER) is None:
        return ()
    matches = [match for match in map(_FILE.match, folder.folder(FOLDER).entries()) if match is not None]
    found = [
        StampName(one[0], int(one["number"]), None if one["events"] is None else int(one["events"]), one["own"])
        for one in matches
    ]
    return tuple(sorted(found, key=lambda one: one.number))


def keep_stamp(folder: GuardedFolder, storage: Storage, what: str, token: bytes) -> str:
    """Writes a stamp into a run folder; returns the name of the file in `stamps/`. Raises `OSError` if the stamp cannot be written."""
    if folder.entry(FOLDER) is None:
        storage.make_folder(folder, FOLDER)
        storage.sync_folder(folder)
    number = 1 + max((one.number for one in stamp_names(folder)), default=0)
    file = f"{number:04d}-{what}.tsr"
    storage.write_whole(folder.folder(FOLDER), file, token)
    return file
