"""Copies runs to and from archives on object storage or on another remote file system. It uses fsspec, with URLs such as
`s3://bucket/archive`, `gs://…` or `ftp://…`.

A remote folder is first copied to a private folder of this user (`fetched`). The copy is then read like any other folder: through
`base.guarded_folder`, and with every file checked against its digest. Only files of limited size with plain names are copied, so
that no remote name can lead to a file outside the copy. A verification copies everything again, because it must not check an older
copy.

Sealed runs are written once (`push_run`): an existing file is never replaced, and every written file is read back and compared. The
seal is written last. An interrupted push therefore leaves a run that is not sealed, and the next push completes it. On a file
system that writes files piece by piece, a file has a temporary name until it is complete.

A command that has copied a remote folder holds a lock on the copies of that archive until the command ends. Otherwise another
command could remove an analysis that has not yet been written to the remote run.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic, sleep
from types import MethodType
from typing import TYPE_CHECKING

from planrunner.archive import live, pausing
from planrunner.archive import seal as seals
from planrunner.archive.analyses import FOLDER as ANALYSES
from planrunner.archive.finding_runs import DEEPEST, find_runs
from planrunner.archive.journal import MOST_BYTES
from planrunner.archive.lock import NAME as LOCK
from planrunner.archive.lock import FolderLock
from planrunner.archive.origin import NAME as ORIGIN
from planrunner.archive.segment_file import FOLDER as SEGMENTS
from planrunner.archive.stamp_files import FOLDER as STAMPS
from planrunner.archive.storage import ASIDE, digest
from planrunner.archive.verifying import FILES, SIGNATURES, SIGNS, examine, open_run
from planrunner.base.exclusive import COMMAND
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import MOST_ENTRIES, GuardedFolder
from planrunner.base.progress import Announce, Pace
from planrunner.base.trusted_folders import make_private, trusted, user_cache

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

CACHE = "PLANRUNNER_CACHE"
"""Environment variable for another folder of the copies."""
_URL = re.compile(r"[a-z][a-z0-9+.-]*://.+", re.IGNORECASE)
_LOCAL = {LOCK, pausing.NAME, live.NAME, live.ANSWER, ORIGIN}
"""Files of a run that concern only the computer that writes it."""
_BLOCK = 2**20
_MOST_OF_URL = 2**12
_PATIENCE = 60.0
"""Longest time [s] to wait while another command uses the copies of the same archive."""
_HELD: set[Path] = set()
"""Folders that the running command has locked."""
_TAKES_ANY_SERVER = re.compile(r"(^|::)(sftp|ssh)://", re.IGNORECASE)
"""Matches the addresses of SSH servers. fsspec accepts any host key of such a server without asking the user."""
_Place = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Pushed:
    """The result of `push_run`. `written`: number of files that were written. `present`: number of files that already existed in
    the archive with the same content."""

    written: int
    present: int


@dataclass(frozen=True, slots=True)
class _RemoteFile:
    """A file of a remote folder.

    `path`: path in the remote file system. `size`: number of bytes. `changed`: time of the last change in ns since 1970; None if
    the file system does not report it.
    """

    path: str
    size: int
    changed: int | None


def is_url(text: str) -> bool:
    return _URL.fullmatch(text) is not None


# -- reading -------------------------------------------------------------------------------------------------------------


def fetched(url: str, *, anew: bool = False, notice: Announce | None = None) -> Path:
    """Makes a private copy of a remote folder, and returns the path of the copy. Unless `anew` is True, files that have not changed
    since an earlier copy are not read again.

    The copy contains exactly the files of the remote folder. Raises `InputError` if the folder cannot be read, or has entries that
    are not accepted.
    """
    files, root = _opened(url)
    parent, _, name = url.rstrip("/").rpartition("/")
    _require_plain(name, url)
    place = user_cache(CACHE, "archives") / hashlib.sha256(parent.encode()).hexdigest()[:16]
    with _told(url):
        make_private(place / name)
        _hold(place, url)
        folder = GuardedFolder.open(trusted(place / name))
        if not files.exists(root):
            raise FileNotFoundError(errno.ENOENT, "there is no such folder", url)
        _copy(_Copying(files, url, anew, notice), root, folder, ())
        with GuardedFolder.open(place).open_new(_source(name)) as source:
            source.write(url.rstrip("/").encode())
    return place / name


def _hold(place: Path, url: str) -> None:
    """Locks the copies of an archive until the command ends. Raises `InputError` if another process holds them for too long."""
    until = monotonic() + _PATIENCE
    while place not in _HELD:
        try:
            lock = FolderLock(GuardedFolder.open(place))
        except InputError:
            if monotonic() > until:
                message = "another planrunner command is using this archive on this computer"
                hint = f"wait until it ends, or set {CACHE} to another folder"
                raise InputError.at(Mark(url), "remote-in-use", message, hint) from None
            sleep(0.1)
        else:
            _HELD.add(place)
            COMMAND.callback(_HELD.discard, place)
            COMMAND.callback(lock.release)


class _Copying:
    """Copies a remote folder. `anew`: True to copy unchanged files again."""

    def __init__(self, files: AbstractFileSystem, url: str, anew: bool, notice: Announce | None):
        self.files, self.url, self.anew, self.notice = files, url, anew, notice


def _copy(copying: _Copying, root: str, folder: GuardedFolder, place: _Place) -> None:
    """Makes a local folder equal to the remote folder."""
    if len(place) > DEEPEST:
        raise _refused(copying.url, f"{'/'.join(place)}: more than {DEEPEST} folders inside one another")
    listed = {
        _name(one, root): one
        for one in copying.files.ls(root, detail=True)
        if _stripped(str(one["name"])) != _stripped(root) and _counts(one)
    }
    if not listed.keys().isdisjoint(SIGNS):
        found = {
            _parts(one, root, copying.url): one
            for one in copying.files.find(root, detail=True).values()
            if _counts(one)
        }
        _copy_files(copying, {parts: _file(one) for parts, one in found.items() if parts}, folder, place)
        return
    pace = Pace(f"copying {copying.url}", len(listed), copying.notice if not place else None)
    inner = [name for name, one in listed.items() if one["type"] == "directory"]
    direct: dict[_Place, _RemoteFile] = {
        (name,): _file(one) for name, one in listed.items() if one["type"] != "directory"
    }
    for number, name in enumerate(sorted(inner), start=1):
        _require_plain(name, copying.url)
        entry = folder.entry(name)
        if entry is not None and entry.kind != "folder":
            folder.remove(name)
            entry = None
        below = folder.make_folder(name) if entry is None else folder.folder(name)
        try:
            _copy(copying, str(listed[name]["name"]), below, (*place, name))
        finally:
            below.close()
        pace.reached(number)
    _copy_files(copying, direct, folder, place, but=set(inner))


def _copy_files(
    copying: _Copying,
    wanted: Mapping[_Place, _RemoteFile],
    folder: GuardedFolder,
    place: _Place,
    but: set[str] | None = None,
) -> None:
    """Makes a local folder contain exactly the wanted files. `wanted`: maps the path of each file in the local folder to the remote
    file. `but`: entries of the local folder that are left as they are."""
    below: dict[str, dict[_Place, _RemoteFile]] = {}
    own: dict[str, _RemoteFile] = {}
    for parts, file in wanted.items():
        _require_plain(parts[0], copying.url)
        if len(parts) == 1:
            own[parts[0]] = file
        else:
            below.setdefault(parts[0], {})[parts[1:]] = file
    if len(own) + len(below) > MOST_ENTRIES:
        raise _refused(copying.url, f"{'/'.join(place)}: it has more than {MOST_ENTRIES} entries")
    there = folder.entries()
    for name, entry in there.items():
        if name in (but or ()) or (name in own and entry.kind == "file") or (name in below and entry.kind == "folder"):
            continue
        if entry.kind == "folder":
            folder.remove_folder(name)
        else:
            folder.remove(name)
    for name, file in own.items():
        known = there.get(name)
        same = known is not None and known.kind == "file" and (known.size, known.modified) == (file.size, file.changed)
        if copying.anew or not same:
            _copy_file(copying, file, folder, name)
    for name, files in below.items():
        present = name in there and there[name].kind == "folder"
        inner = folder.folder(name) if present else folder.make_folder(name)
        try:
            _copy_files(copying, files, inner, (*place, name))
        finally:
            inner.close()


def _copy_file(copying: _Copying, file: _RemoteFile, folder: GuardedFolder, name: str) -> None:
    if file.size > MOST_BYTES:
        raise _refused(copying.url, f"{file.path}: it has {file.size} bytes; at most {MOST_BYTES} are allowed")
    aside = f".{os.getpid()}{ASIDE}"
    with copying.files.open(file.path, "rb") as source, folder.open_new(aside) as target:
        left = file.size
        while data := source.read(min(_BLOCK, left + 1)):
            left -= len(data)
            if left < 0:
                break
            target.write(data)
        if left:
            raise _refused(copying.url, f"{file.path}: it changed while it was being copied")
        if file.changed is not None and os.utime in os.supports_fd:
            os.utime(target.fileno(), ns=(file.changed, file.changed))
    folder.replace(aside, name)


def _counts(info: Mapping[str, object]) -> bool:
    """Returns True if an entry belongs to the archive. Returns False for the empty objects that storage consoles make for folders,
    and for files that are being written."""
    name = str(info["name"])
    return not (name.endswith("/") and info["type"] != "directory" and not info["size"]) and not name.endswith(ASIDE)


def _file(info: Mapping[str, object]) -> _RemoteFile:
    return _RemoteFile(str(info["name"]), int(str(info["size"] or 0)), _changed(info))


def _changed(info: Mapping[str, object]) -> int | None:
    """Returns the time when an object was last changed, in ns since 1970; None if the file system does not state it. Each
    implementation of fsspec has its own name for this attribute."""
    for key in ("LastModified", "last_modified", "mtime", "modified", "updated", "created"):
        value = info.get(key)
        if isinstance(value, str):
            with contextlib.suppress(ValueError):
                value = datetime.fromisoformat(value)
        if isinstance(value, datetime):
            value = (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()
        if isinstance(value, int | float):
            return round(value * 1e6) * 1000
    return None


def _name(info: Mapping[str, object], root: str) -> str:
    return _stripped(str(info["name"])).removeprefix(_stripped(root)).strip("/")


def _parts(info: Mapping[str, object], root: str, url: str) -> _Place:
    """Returns the names on the path from the root to an object. Raises `InputError` for an object whose name would lead outside the
    folder."""
    inner = str(info["name"]).strip("/").removeprefix(root.strip("/")).removeprefix("/")
    parts = tuple(inner.split("/")) if inner else ()
    for part in parts:
        _require_plain(part, url)
    return parts


def _stripped(path: str) -> str:
    return path.strip("/")


def _require_plain(name: str, url: str) -> None:
    if name in ("", ".", "..") or any(letter in name for letter in '/\\\0:*?"<>|') or not name.isprintable():
        raise _refused(url, f"an entry has the name {name[:80]!r}, which is not the name of a file of a run")


def _refused(url: str, what: str) -> InputError:
    hint = "planrunner never writes such an archive: restore it from a backup"
    return InputError.at(Mark(url), "remote-refused", what, hint)


@dataclass(frozen=True, slots=True)
class Pulled:
    """The result of `pull_runs`. `runs`: the runs that were copied. `present`: number of runs that already existed."""

    runs: tuple[Path, ...]
    present: int


def pull_runs(copy: Path, folder: Path) -> Pulled:
    """Verifies the runs in the local copy of a remote archive, and copies them into another folder. Existing runs with the same
    name stay as they are. Raises `IntegrityError` for a run that was changed; in this case no run is copied."""
    found = [one for one in find_runs(copy) if not one.fault]
    for one in found:
        examine(open_run(one.path), samples="digests").require_whole()
    runs, present = [], 0
    folder.mkdir(parents=True, exist_ok=True)
    for one in found:
        target = folder / one.path.name
        if target.exists():
            present += 1
            continue
        aside = folder / f".{one.path.name}{ASIDE}"
        shutil.rmtree(aside, ignore_errors=True)
        shutil.copytree(one.path, aside, symlinks=True)
        aside.rename(target)
        runs.append(target)
    return Pulled(tuple(runs), present)


# -- writing -------------------------------------------------------------------------------------------------------------


def push_run(run: Path, archive: str, *, including: str = "") -> Pushed:
    """Writes a sealed run to a remote archive. If the archive already has the run, only the files that the archive lacks are
    written, such as a new analysis.

    `including`: a folder within the run; afterwards, the remote run must contain at least one file of this folder. Raises
    `IntegrityError` for a run that was changed. Raises `InputError` if the run is not sealed, if the run has no file in
    `including`, if the archive has another run of this name, or if the archive cannot be written.
    """
    found = examine(open_run(run), samples="digests")
    found.require_whole()
    if found.seal is None:
        message = "only a finished, sealed run can be pushed"
        raise InputError.at(Mark(str(run)), "sign-not-sealed", message, "finish the run with `planrunner resume`")
    files, root = _opened(archive)
    target = f"{root.rstrip('/')}/{run.resolve().name}"
    written = present = 0
    included = not including
    with _told(archive):
        for place, data in _content(found.folder):
            if _written(files, f"{target}/{place}", data, archive):
                written += 1
            else:
                present += 1
            included = included or place.startswith(f"{including}/")
    if not included:
        message = f"{including} is no longer in {run}, and was not written to the archive"
        raise InputError.at(Mark(archive), "remote-not-written", message, "repeat the command")
    return Pushed(written, present)


def _content(folder: GuardedFolder) -> Iterator[tuple[str, bytes]]:
    """Yields the files of a run, each with its path in the remote run. The seal comes last."""
    entries = folder.entries()
    for name, entry in entries.items():
        if entry.kind == "file" and name in FILES and name not in _LOCAL and name != seals.NAME:
            yield name, folder.read(name, MOST_BYTES)
        elif entry.kind == "folder" and name in (SEGMENTS, ANALYSES, SIGNATURES, STAMPS):
            yield from _below(folder.folder(name), name)
    yield seals.NAME, folder.read(seals.NAME, MOST_BYTES)


def _below(folder: GuardedFolder, place: str) -> Iterator[tuple[str, bytes]]:
    for name, entry in folder.entries().items():
        if name.endswith(ASIDE):
            continue
        if entry.kind == "folder":
            yield from _below(folder.folder(name), f"{place}/{name}")
        else:
            yield f"{place}/{name}", folder.read(name, MOST_BYTES)


def push_back(run: Path, analysis: Path) -> None:
    """Writes to a remote run everything that was added to its local copy, including the given new analysis. Does nothing if the run
    is not a copy. Raises the same errors as `push_run`."""
    source = source_of_copy(run)
    if source is not None:
        push_run(run, source.rpartition("/")[0], including=f"{ANALYSES}/{analysis.name}")


def source_of_copy(run: Path) -> str | None:
    """Returns the URL of the remote folder from which this folder was copied; None if it is not a copy."""
    inner, cache = run.resolve(), user_cache(CACHE, "archives").resolve()
    if not inner.is_relative_to(cache) or len(inner.relative_to(cache).parts) < 2:
        return None
    place, name, *rest = inner.relative_to(cache).parts
    source = GuardedFolder.open(cache / place).read(_source(name), _MOST_OF_URL).decode()
    return "/".join([source, *rest])


def _source(name: str) -> str:
    """Returns the name of the file, next to a copy, that contains the URL from which the copy was made."""
    return f".{name}.url"


def _written(files: AbstractFileSystem, path: str, data: bytes, archive: str) -> bool:
    """Writes a file to the remote archive if it is not there yet; returns True if it was written. Raises `InputError` if the file
    exists with different content."""
    new = not files.exists(path)
    if new:
        files.makedirs(path.rpartition("/")[0], exist_ok=True)
        try:
            _write(files, path, data)
        except FileExistsError:  # somebody was first
            new = False
    if digest(files.cat_file(path)) != digest(data):
        message = f"{path}: it exists with different content, and is not replaced"
        if new:
            message = f"{path}: what was read back differs from what was written"
        raise InputError.at(Mark(archive), "remote-differs", message, "compare both runs with `planrunner verify`")
    return new


def _write(files: AbstractFileSystem, path: str, data: bytes) -> None:
    """Writes a new file completely or not at all. Raises `FileExistsError` if the file already exists in the storage."""
    from fsspec import AbstractFileSystem

    write = files.pipe_file
    in_pieces = isinstance(write, MethodType) and write.__func__ is AbstractFileSystem.pipe_file
    if not in_pieces:
        write(path, data, mode="create")
        return
    folder, _, name = path.rpartition("/")
    aside = f"{folder}/.{name}{ASIDE}"  # the same name after an interruption, so that nothing is left
    write(aside, data)
    files.mv(aside, path)


# -- the file system -----------------------------------------------------------------------------------------------------


def _opened(url: str) -> tuple[AbstractFileSystem, str]:
    """Returns the file system of a URL, and the path within this file system. Raises `InputError` if the file system cannot be
    used."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise _missing(url, "fsspec is not installed") from None
    if _TAKES_ANY_SERVER.search(url):
        message = "SFTP is not supported: its library does not verify the identity of the server"
        raise InputError.at(Mark(url), "remote-refused", message, "mount the folder, for example with sshfs")
    with _told(url):
        try:
            files, root = url_to_fs(url, use_listings_cache=False)
        except ImportError as error:
            raise _missing(url, str(error)) from None
        files.invalidate_cache()
    return files, str(root)


def _missing(url: str, why: str) -> InputError:
    hint = "run `pip install planrunner[s3]`, or install the package that fsspec names"
    return InputError.at(Mark(url), "remote-missing", why, hint)


@contextlib.contextmanager
def _told(url: str) -> Iterator[None]:
    """Converts the exceptions of file systems, which differ from library to library, to `InputError`."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        message = f"the archive cannot be used: {said.splitlines()[0][:200] if said else type(error).__name__}"
        hint = "check the address, the network and your access; S3 reads AWS_PROFILE and FSSPEC_S3_ENDPOINT_URL, for example"
        raise InputError.at(Mark(url), "remote-unreachable", message, hint) from None
