"""Analyses of a run: numbered folders, each written whole, each with its own list of digests, none ever changed
afterwards."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from planrunner.archive import formats
from planrunner.archive.integrity import IntegrityError
from planrunner.archive.journal import utc_now
from planrunner.archive.storage import ASIDE, Storage, digest, digest_file
from planrunner.plan.findings import InputError, Mark

FOLDER = "analyses"
DIGESTS = "digests.json"


def analyses(run: Path) -> tuple[Path, ...]:
    """The folders of a run's analyses, oldest first."""
    folder = run / FOLDER
    found = [path for path in folder.iterdir() if path.name.isdecimal() and path.is_dir()] if folder.is_dir() else []
    return tuple(sorted(found, key=lambda path: int(path.name)))


def add_analysis(run: Path, files: Mapping[str, bytes], *, storage: Storage | None = None) -> Path:
    """Add an analysis: `files` are its contents by name. Returns its folder, `analyses/<n>`.

    Written beside its name and renamed, so it is there whole or not at all; two at the same time get two numbers.
    Raises `InputError` when it cannot be written.
    """
    storage = storage or Storage()
    for name in files:
        if name == DIGESTS or Path(name).name != name or name in ("", ".", ".."):
            raise ValueError(f"not a file name for an analysis: {name!r}")
    folder = run / FOLDER
    aside = folder / f".{os.getpid()}-{os.urandom(4).hex()}{ASIDE}"
    try:
        if not folder.exists():
            with contextlib.suppress(FileExistsError):
                storage.make_folder(folder)
            storage.sync_folder(run)
        storage.make_folder(aside)
        for name, data in files.items():
            storage.write_whole(aside / name, data)
        digests = {
            "planrunner_digests": formats.DIGESTS_FORMAT,
            "made": utc_now(),
            "files": {name: digest(data) for name, data in sorted(files.items())},
        }
        storage.write_whole(aside / DIGESTS, formats.to_bytes(digests))
        return _take_number(run, aside, storage)
    except OSError as error:
        shutil.rmtree(aside, ignore_errors=True)
        message = f"the analysis cannot be written: {error.strerror or error}"
        raise InputError.at(
            Mark(str(folder)), "analysis-unwritable", message, "make room or change permissions, then estimate again"
        ) from None


def _take_number(run: Path, aside: Path, storage: Storage) -> Path:
    while True:
        standing = analyses(run)
        target = run / FOLDER / str(int(standing[-1].name) + 1 if standing else 1)
        try:
            os.rename(aside, target)  # refused when another process took the number: its folder is not empty
        except OSError:
            if not target.exists():
                raise
            continue
        storage.sync_folder(target.parent)
        return target


def check_analysis(folder: Path) -> None:
    """Hold an analysis against its digests. Raises `IntegrityError` for a file that is missing, changed or added."""
    listed = formats.read_json(folder / DIGESTS, "digests", "planrunner_digests", formats.DIGESTS_FORMAT)["files"]
    standing = {path.name for path in folder.iterdir()} - {DIGESTS}
    for name in sorted(standing | set(listed)):
        if name not in standing:
            raise IntegrityError(f"{folder / name}: missing from the analysis; estimate again for a new one")
        if name not in listed:
            raise IntegrityError(f"{folder / name}: added after the analysis was made; remove it")
        if digest_file(folder / name) != listed[name]:
            raise IntegrityError(f"{folder / name}: changed after the analysis was made; estimate again for a new one")
