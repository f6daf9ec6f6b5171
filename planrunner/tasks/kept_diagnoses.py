"""Stores the results of diagnoses of sealed runs on this computer. After the next night, only the new runs need to be diagnosed.

The diagnosis of a run depends on the run, on the program with its libraries and plug-ins, and on the options. The name of a
result file is a digest of all three, so a change to any of them leads to a different file. The files are in a folder that only
the user can change. They can be deleted at any time.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import time
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points

from planrunner.archive.formats import from_bytes, to_bytes
from planrunner.archive.storage import Storage
from planrunner.base import plugins
from planrunner.base.cluster import versions
from planrunner.base.documents import Json
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.trusted_folders import UntrustedFolderError, make_private, trusted, user_cache

FOLDER = "PLANRUNNER_DIAGNOSES"
"""Environment variable for another folder."""
_MOST = 2**22
_LIFE = 180 * 86400.0
"""Time after which a result is removed, s."""
_KEY = re.compile("[0-9a-f]{64}")
"""Form of the names of results. Other files in the folder do not belong to planrunner."""


@dataclass(frozen=True, slots=True)
class KeptDiagnoses:
    """Represents the folder of stored results. `folder`: path of the folder; None if there is no folder that only the user can
    change. If `folder` is None, no results are stored."""

    folder: GuardedFolder | None

    @classmethod
    def of_user(cls) -> KeptDiagnoses:
        """Opens the user's folder of stored results. Removes results that are too old."""
        place = user_cache(FOLDER, "diagnoses")
        try:
            make_private(place)
            folder = GuardedFolder.open(trusted(place))
            for name, entry in folder.entries().items():
                if _KEY.fullmatch(name) and time.time() - entry.modified / 1e9 > _LIFE:
                    folder.remove(name)
        except (OSError, UntrustedFolderError):
            return cls(None)
        return cls(folder)

    def get(self, key: str) -> Json:
        """Returns the stored result for a key; None if there is none."""
        if self.folder is None:
            return None
        try:
            return from_bytes(self.folder.read(key, _MOST))
        except (OSError, ValueError):
            return None

    def put(self, key: str, result: Json) -> None:
        """Stores a result. If the result cannot be written, it is not stored, and no error is raised."""
        if self.folder is not None:
            with contextlib.suppress(OSError, ValueError):
                Storage("flushed").write_whole(self.folder, key, to_bytes(result))


def key_of(kind: str, run: str, asked: Json) -> str:
    """Returns the key under which a result is stored. `run`: SHA-256 of the seal of the run. `asked`: all options that the result
    depends on, as JSON data."""
    return hashlib.sha256(to_bytes([kind, run, asked, _program()])).hexdigest()


@cache
def _program() -> Json:
    """Returns a text that identifies the versions of the program, of its libraries, and of the packages with plug-ins."""
    found = dict(versions())
    for group in (plugins.EFFECTS, plugins.ESTIMATORS, plugins.INSTRUMENTS):
        for entry in entry_points(group=group):
            if entry.dist is not None and entry.dist.name != "planrunner":
                found[entry.dist.name] = entry.dist.version
    return dict(sorted(found.items()))
