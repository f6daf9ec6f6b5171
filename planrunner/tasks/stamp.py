"""Adds time stamps to runs. `stamper_of` makes the object that obtains time stamps for a bench. `after_sealing` stamps a seal
immediately after it is written, and `stamp_run` stamps it later."""

from __future__ import annotations

from pathlib import Path

from planrunner.archive import seal as seals
from planrunner.archive.lock import FolderLock
from planrunner.archive.origin import foreign
from planrunner.archive.run_reader import RunReader
from planrunner.archive.stamp_files import DIGITS, keep_stamp
from planrunner.archive.storage import Storage, digest
from planrunner.archive.verifying import BENCH, examine, open_run
from planrunner.base.findings import Finding, InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.bench.model import Bench, bench_of
from planrunner.bench.signatures import TimeStampsSpec
from planrunner.signing.run_stamps import stamped_seals
from planrunner.signing.stamping import Stamper
from planrunner.signing.time_stamps import StampAuthority, StampError, parse_authority, request_stamp


def authority_of(spec: TimeStampsSpec) -> StampAuthority:
    """Returns the certificates of the authority that a bench names. The check of the bench has already verified these
    certificates."""
    return parse_authority(spec.certificate.encode())


def stamper_of(bench: Bench) -> Stamper | None:
    """Returns the object that obtains time stamps for a run on a bench; None if the bench names no authority."""
    spec = bench.time_stamps
    return None if spec is None else Stamper(spec.url, authority_of(spec), spec.every.value)


def stamp_seal(folder: GuardedFolder, url: str, authority: StampAuthority) -> str:
    """Stamps the present seal of a run. The caller must hold the lock of the run folder. Returns the time that the stamp states.
    Raises `StampError` if no valid time stamp is obtained, and `OSError` if the stamp cannot be written."""
    seal = folder.read(seals.NAME, seals.MOST_BYTES)
    token, at = request_stamp(url, seal, digest(seal), authority)
    keep_stamp(folder, Storage(), f"seal-{digest(token)[:DIGITS]}", token)
    return at.isoformat()


def after_sealing(folder: GuardedFolder, bench: Bench, stamper: Stamper | None) -> tuple[Finding, ...]:
    """Stamps the seal of a run that has just been sealed. Returns messages to the user about missing time stamps. A failure to
    stamp never damages the run."""
    spec, mark = bench.time_stamps, Mark(str(folder.path))
    if spec is None:
        return ()
    found = []
    if stamper is not None and stamper.missed:
        hint = "check the address of the authority; `planrunner verify` lists what has no stamp"
        message = f"{len(stamper.missed)} time stamps of the journal are missing: {stamper.missed[-1]}"
        found.append(Finding(mark, "run-unstamped", "warning", message, hint))
    try:
        stamp_seal(folder, spec.url, authority_of(spec))
    except (StampError, OSError) as error:
        hint = f"`planrunner stamp {folder.path}` tries again"
        message = f"the seal has no time stamp yet: {error}"
        found.append(Finding(mark, "run-seal-unstamped", "warning", message, hint))
    return tuple(found)


def stamp_run(run: Path, url: str | None = None) -> str:
    """Stamps the seal of a run if it has no time stamp yet; returns the time of the new stamp, or an empty text if there was a
    stamp already.

    `url`: address of the authority; it must be given for a folder that was not made on this computer. Raises `InputError` if the
    seal cannot be stamped, and `IntegrityError` for a run that was changed.
    """
    folder, mark = open_run(run), Mark(str(run))
    try:
        lock = FolderLock(folder)
    except OSError as error:
        message = f"the run folder cannot be written: {error.strerror or error}"
        raise InputError.at(mark, "run-unwritable", message, "change its permissions") from None
    try:
        found = examine(folder, samples="digests")
        reader = RunReader.of(found)
        if not reader.sealed or found.seal_digest is None:
            message = "only a finished, sealed run can be stamped"
            raise InputError.at(mark, "sign-not-sealed", message, "finish the run with `planrunner resume`")
        bench = bench_of(reader.bench_bytes, str(run / BENCH))
        if bench.time_stamps is None:
            hint = "add `time_stamps` to the bench file before a run"
            raise InputError.at(mark, "stamp-none", "the bench of this run has no time stamp authority", hint)
        if url is None:
            _require_origin(reader, bench.time_stamps.url)
        if found.seal_digest in stamped_seals(folder):
            return ""
        return stamp_seal(folder, url or bench.time_stamps.url, authority_of(bench.time_stamps))
    except StampError as error:
        raise InputError.at(mark, "stamp-failed", str(error), "try again later; the run is not affected") from None
    except OSError as error:
        message = f"the stamp cannot be written: {error.strerror or error}"
        raise InputError.at(mark, "run-unwritable", message, "free disk space") from None
    finally:
        lock.release()


def _require_origin(reader: RunReader, url: str) -> None:
    """Raises `InputError` for a run folder of unknown origin, because the bench file in it must not decide to which address
    planrunner connects."""
    why = foreign(reader.folder, reader.first)
    if not why:
        return
    message = f"{why}; its bench file names the authority {url}"
    raise InputError.at(Mark(str(reader.path)), "run-not-made-here", message, "if you trust it, give it with --url")
