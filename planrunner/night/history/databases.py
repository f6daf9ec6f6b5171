"""Provides the databases that store an index: SQLite in a file of this user, or PostgreSQL by its URL.

Both databases use the SQL of `planrunner.night.history.index`. This module contains only their differences: how to open the
database, how a transaction waits for other writers, and what the errors mean for a user.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from urllib.parse import urlsplit

from planrunner.archive.origin import OriginUnknownError, state_folder
from planrunner.base.findings import InputError, Mark
from planrunner.base.trusted_folders import UntrustedFolderError, make_private, trusted

if TYPE_CHECKING:
    import psycopg

SqlValue = str | int | float | None
SqlRow = tuple[SqlValue, ...]
INDEX = "PLANRUNNER_INDEX"
"""Environment variable that contains the file or URL of the index. The variable is used if no option states the index."""
_WAIT = 60.0
"""Longest time [s] to wait for another writer."""
_CONNECT = 10
"""Longest time [s] to wait for the answer of a server."""


class Database(Protocol):
    """An open database. Parameters in statements are written as `?`."""

    name: str
    """Name of the database for messages, without a password."""

    identity: str
    """SQL type of the numbers that the database assigns to new rows."""

    clustered: str
    """Text at the end of the definition of a table whose rows are stored in the order of the primary key."""

    def query(self, statement: str, values: Sequence[SqlValue] = ()) -> list[SqlRow]: ...

    def write_many(self, statement: str, rows: Iterable[Sequence[SqlValue]]) -> None: ...

    def transaction(self) -> contextlib.AbstractContextManager[None]:
        """Returns a transaction: either all statements in it take effect, or none. There is only one writer at a time."""
        ...

    def close(self) -> None: ...


def open_database(index: str | None, archive: Path) -> Database:
    """Opens the database of an archive's index. `index`: a file, or the URL of a PostgreSQL database. If it is None, an environment
    variable names the index; without this variable, the index is a file in this user's state folder. Raises `InputError` if the
    database cannot be opened."""
    named = index or os.environ.get(INDEX) or ""
    if re.match(r"postgres(ql)?://", named):
        return Postgres(named)
    if "://" in named:
        message = f"'{named.partition('://')[0]}://' is not a kind of index"
        raise InputError.at(
            Mark("--index"), "index-kind", message, "give a file, or a URL that begins with postgresql://"
        )
    return Sqlite(Path(named)) if named else Sqlite(_own_file(archive), own=True)


def _own_file(archive: Path) -> Path:
    """Returns the path of the index as a file next to the user's key. The index is not in the archive for two reasons: a file that
    comes with an archive is not trusted, and an SQLite file must not be shared over a network file system."""
    try:
        folder = state_folder() / "index"
        make_private(folder)
        folder = trusted(folder)
    except (OriginUnknownError, UntrustedFolderError, OSError) as error:
        message = f"there is no place for the index: {error}"
        raise InputError.at(Mark(str(archive)), "index-place", message, "name a file with --index") from None
    whole = os.path.abspath(archive)
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(whole).name)[:40].strip("-") or "archive"
    return folder / f"{name}-{hashlib.sha256(whole.encode('utf-8', 'surrogateescape')).hexdigest()[:12]}.sqlite"


_APPLICATION = int.from_bytes(b"plnr", "big")
"""Mark of planrunner in the header of an SQLite file."""


class Sqlite:
    """Uses an SQLite file in write-ahead mode: readers never wait, and writers wait for each other.

    `own`: True if planrunner chose the name of the file. If such a file is not a database, it is renamed to `….unreadable`, because
    an index can always be made again. A file that the user named is never replaced. The database of another program is never used.
    """

    identity = "INTEGER PRIMARY KEY"
    clustered = " WITHOUT ROWID"

    def __init__(self, path: Path, *, own: bool = False):
        self.name = str(path)
        try:
            try:
                self._connection = self._open(path)
            except sqlite3.DatabaseError as error:
                if not own or isinstance(error, sqlite3.OperationalError):
                    raise
                self._set_aside(path)
                self._connection = self._open(path)
        except (sqlite3.Error, OSError) as error:
            raise self._refused(error) from None

    @staticmethod
    def _open(path: Path) -> sqlite3.Connection:
        connection = sqlite3.connect(path, timeout=_WAIT, isolation_level=None, check_same_thread=False)
        try:
            (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            (made_by,) = connection.execute("PRAGMA application_id").fetchone()
            if made_by != _APPLICATION:
                if tables:
                    raise sqlite3.DatabaseError("it is the database of another program")
                connection.execute(f"PRAGMA application_id={_APPLICATION}")
            connection.execute("PRAGMA journal_mode=WAL").fetchall()
            connection.execute(
                "PRAGMA synchronous=NORMAL"
            )  # a power failure may lose the last refresh, never the whole
            connection.execute("PRAGMA trusted_schema=OFF")
            connection.execute("PRAGMA cache_size=-65536")  # KiB
        except BaseException:
            connection.close()
            raise
        return connection

    @staticmethod
    def _set_aside(path: Path) -> None:
        for end in ("-wal", "-shm"):
            Path(f"{path}{end}").unlink(missing_ok=True)
        with contextlib.suppress(FileNotFoundError):  # another process was first
            path.replace(f"{path}.unreadable")

    def query(self, statement: str, values: Sequence[SqlValue] = ()) -> list[SqlRow]:
        try:
            return self._connection.execute(statement, values).fetchall()
        except sqlite3.Error as error:
            raise self._refused(error) from None

    def write_many(self, statement: str, rows: Iterable[Sequence[SqlValue]]) -> None:
        try:
            self._connection.executemany(statement, rows)
        except sqlite3.Error as error:
            raise self._refused(error) from None

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        self.query("BEGIN IMMEDIATE")
        try:
            yield
            self.query("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                self._connection.execute("ROLLBACK")
            raise

    def close(self) -> None:
        self._connection.close()

    def _refused(self, error: Exception) -> InputError:
        return _refusal(self.name, str(error), "check the place and its permissions; name another file with --index")


class Postgres:
    """Uses a PostgreSQL database on a server, which several computers can use. PostgreSQL needs planrunner's extra `postgresql`."""

    identity = "BIGINT GENERATED BY DEFAULT AS IDENTITY PRIMARY KEY"
    clustered = ""

    def __init__(self, url: str):
        parts = urlsplit(url)
        self.name = f"postgresql://{parts.hostname or ''}{parts.path}"
        try:
            import psycopg
        except ImportError:
            hint = "install planrunner with the extra: pip install 'planrunner[postgresql]'"
            raise InputError.at(Mark(self.name), "index-kind", "the driver of PostgreSQL is missing", hint) from None
        self._error = psycopg.Error
        try:
            self._connection: psycopg.Connection = psycopg.connect(url, autocommit=True, connect_timeout=_CONNECT)
            self._connection.execute(f"SET lock_timeout = {int(_WAIT * 1000)}")
        except psycopg.Error as error:
            raise self._refused(error) from None

    def query(self, statement: str, values: Sequence[SqlValue] = ()) -> list[SqlRow]:
        try:
            found = self._connection.execute(_marked(statement), values)
            return found.fetchall() if found.description is not None else []
        except self._error as error:
            raise self._refused(error) from None

    def write_many(self, statement: str, rows: Iterable[Sequence[SqlValue]]) -> None:
        try:
            with self._connection.cursor() as cursor:
                cursor.executemany(_marked(statement), rows)
        except self._error as error:
            raise self._refused(error) from None

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        try:
            with self._connection.transaction():
                self._connection.execute("SELECT pg_advisory_xact_lock(%s)", (_LOCK,))
                yield
        except self._error as error:
            raise self._refused(error) from None

    def close(self) -> None:
        self._connection.close()

    def _refused(self, error: Exception) -> InputError:
        first = next(iter(str(error).strip().splitlines()), type(error).__name__)
        return _refusal(self.name, first, "check that the server runs and the URL is right, then repeat the command")


_LOCK = int.from_bytes(b"planrunr", "big") >> 1
"""Key of the lock that lets only one process write at a time."""


def _marked(statement: str) -> bytes:
    return statement.replace("?", "%s").encode()


def _refusal(name: str, why: str, hint: str) -> InputError:
    message = f"the index cannot be used: {why}; the run folders are not affected"
    return InputError.at(Mark(name), "index-unavailable", message, hint)
