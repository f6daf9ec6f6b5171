"""Maintains an index of the run folders in an archive. The index contains the runs with their coefficients and verdicts.

The run folders are the original data; the index is a copy for quick answers. The index can be made again from the folders at any
time. Each run is replaced in one transaction, so that a reader sees every run in a consistent state, even while the index is
refreshed or rebuilt. Several processes may refresh an index at the same time; each of them writes the runs that it has read. If a
folder changed in the meantime, the next refresh reads it again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import TypeVar, cast

from planrunner.archive.finding_runs import find_runs
from planrunner.archive.schema_check import FIRST_YEAR, LAST_YEAR
from planrunner.base.findings import InputError, Mark
from planrunner.base.progress import Announce, Pace
from planrunner.base.workers import Workers, results_in_order
from planrunner.estimators.interface import CoefficientRole
from planrunner.night.history.databases import Database, SqlRow, SqlValue, open_database
from planrunner.night.history.reading import fingerprint, read_run
from planrunner.night.history.rows import (
    Circumstance,
    CircumstanceKind,
    CoefficientRow,
    FaultRow,
    HistoryPoint,
    IndexedRun,
    IndexedVerdict,
    LimitRow,
    RecordedAs,
    RunFilter,
    RunRow,
    RunState,
)
from planrunner.plan.parameters import variant_name

_Row = TypeVar("_Row", CoefficientRow, LimitRow)

FORMAT = 2
"""Version of the tables. An index with another version is created again."""
_BATCH = 500
"""Number of runs that are read before they are written together."""
_TABLES = ("faults", "limits", "coefficients", "runs", "formats")
_RUN = (
    "folder, run, created, plan, title, device, bench, laboratory, operator, origin, state, verdict, analysis, warnings, "
    "circumstances, info"
)
_COEFFICIENT = "quantity, value, unit, standard_uncertainty, degrees_of_freedom, role, period"
_LIMIT = "quantity, requirement, verdict, unit, lower, upper, probability"
_SCHEMA = (
    "CREATE TABLE IF NOT EXISTS formats (format INTEGER PRIMARY KEY)",
    """CREATE TABLE IF NOT EXISTS runs (id {identity}, archive TEXT NOT NULL, fingerprint TEXT NOT NULL, folder TEXT NOT NULL,
       run TEXT NOT NULL, created TEXT NOT NULL, plan TEXT NOT NULL, title TEXT NOT NULL, device TEXT NOT NULL, bench TEXT NOT NULL,
       laboratory TEXT NOT NULL, operator TEXT NOT NULL, origin TEXT NOT NULL, state TEXT NOT NULL, verdict TEXT NOT NULL,
       analysis INTEGER NOT NULL, warnings INTEGER NOT NULL, circumstances TEXT NOT NULL, info TEXT NOT NULL, UNIQUE (archive, folder))""",
    "CREATE INDEX IF NOT EXISTS runs_of_device ON runs (archive, device, created, folder)",
    "CREATE INDEX IF NOT EXISTS runs_in_time ON runs (archive, created)",
    """CREATE TABLE IF NOT EXISTS coefficients (run_id BIGINT NOT NULL, quantity TEXT NOT NULL, value DOUBLE PRECISION, unit TEXT NOT NULL,
       standard_uncertainty DOUBLE PRECISION, degrees_of_freedom DOUBLE PRECISION, role TEXT NOT NULL, period DOUBLE PRECISION,
       PRIMARY KEY (run_id, quantity)){clustered}""",
    """CREATE TABLE IF NOT EXISTS limits (run_id BIGINT NOT NULL, quantity TEXT NOT NULL, requirement TEXT NOT NULL, verdict TEXT NOT NULL,
       unit TEXT NOT NULL, lower DOUBLE PRECISION, upper DOUBLE PRECISION, probability DOUBLE PRECISION)""",
    "CREATE INDEX IF NOT EXISTS limits_of_run ON limits (run_id, quantity)",
    """CREATE TABLE IF NOT EXISTS faults (archive TEXT NOT NULL, folder TEXT NOT NULL, message TEXT NOT NULL,
       bench TEXT, plan TEXT, device TEXT, PRIMARY KEY (archive, folder))""",
)


@dataclass(frozen=True, slots=True)
class Refreshed:
    """Result of refreshing an index.

    `read`: number of runs that were read. `removed`: number of runs that no longer exist. `faults`: folders that could not be read
    and are therefore not in the index.
    """

    read: int
    removed: int
    faults: tuple[FaultRow, ...]


@dataclass(frozen=True, slots=True)
class DeviceSummary:
    """Summary of a device. `runs`: number of the device's runs. `last`: time of the newest of these runs."""

    device: str
    runs: int
    last: str


class Index:
    """An open index. The caller must close the index, or use it as a context manager.

    All methods raise `InputError` if the database cannot be used, for example because a server stopped, a disk is full, or another
    process keeps a lock. The index keeps the data that were written before the error, and the next refresh continues from there.
    """

    def __init__(self, archive: Path, database: Database):
        self.archive = archive
        self._database = database
        self._name = str(archive.absolute())
        self._make_tables()

    @classmethod
    def open(cls, archive: Path, index: str | None = None) -> Index:
        """Opens the index of an archive. `index`: a file or a URL; by default, a file of this user. Raises `InputError` if the
        index cannot be opened."""
        if not archive.is_dir():
            hint = "give the folder that contains the runs, such as runs/"
            raise InputError.at(Mark(str(archive)), "index-no-archive", "there is no such folder", hint)
        return cls(archive, open_database(index, archive))

    def close(self) -> None:
        self._database.close()

    def __enter__(self) -> Index:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def database(self) -> str:
        """Returns the name of the database for messages. The name contains no password."""
        return self._database.name

    def _make_tables(self) -> None:
        database = self._database
        with database.transaction():
            self._database.query(_SCHEMA[0])
            known = self._database.query("SELECT format FROM formats")
            if known == [(FORMAT,)]:
                return
            for table in _TABLES:
                self._database.query(f"DROP TABLE IF EXISTS {table}")
            for statement in _SCHEMA:
                self._database.query(
                    statement.replace("{identity}", database.identity).replace("{clustered}", database.clustered)
                )
            self._database.query("INSERT INTO formats VALUES (?)", (FORMAT,))

    # -- keeping it up to date ---------------------------------------------------------------------------------------

    def refresh(
        self, *, rebuild: bool = False, notice: Announce | None = None, workers: Workers | None = None
    ) -> Refreshed:
        """Reads the runs that are new or changed, and removes those that no longer exist.

        `rebuild`: True to read all runs again. `notice`: receives the progress. `workers`: the processes that read the runs; by
        default, processes on this machine, whose number depends on the amount of work. Raises `InputError` if the archive cannot be
        read.
        """
        query = self._database.query
        rows = query("SELECT folder, fingerprint FROM runs WHERE archive = ?", (self._name,))
        known = {str(place): mark for place, mark in rows}
        faulty = {str(folder) for (folder,) in query("SELECT folder FROM faults WHERE archive = ?", (self._name,))}
        unread: list[IndexedRun] = []
        changed: list[str] = []
        there: set[str] = set()
        try:
            for one in find_runs(self.archive):
                there.add(one.place)
                if one.fault:
                    unread.append(IndexedRun(one.place, "", None, fault=one.fault))
                elif rebuild or not (mark := fingerprint(one.entries)) or known.get(one.place) != mark:
                    changed.append(one.place)
        except OSError as error:
            message = f"the archive cannot be read: {error.strerror or error}"
            raise InputError.at(Mark(str(self.archive)), "index-no-archive", message, "check its permissions") from None
        self._write(unread)
        pace = Pace("reading runs", len(changed), notice)
        batch: list[IndexedRun] = []
        # Each item has the folder of the archive, so that a worker that does not see it is found.
        items = [(self.archive, place) for place in changed]
        for done, read in enumerate(results_in_order(_read, items, workers or Workers()), start=1):
            batch.append(read)
            if len(batch) == _BATCH or done == len(items):
                self._write(batch)
                batch = []
                pace.reached(done)
        # Only what was known before the search: another process may have added runs since.
        gone = sorted(place for place in {*known, *faulty} - there if not (self.archive / place).is_dir())
        self._forget(gone)
        return Refreshed(len(changed), len(gone), tuple(self.faults()))

    def _write(self, runs: Sequence[IndexedRun]) -> None:
        if not runs:
            return
        database = self._database
        columns = f"archive, fingerprint, {_RUN}"
        marks = ", ".join("?" * len(columns.split(",")))
        changes = ", ".join(f"{name.strip()} = excluded.{name.strip()}" for name in columns.split(","))
        upsert = f"INSERT INTO runs ({columns}) VALUES ({marks}) ON CONFLICT (archive, folder) DO UPDATE SET {changes} RETURNING id"
        with database.transaction():
            self._remove([one.folder for one in runs if one.run is None])
            faults = [
                (self._name, one.folder, one.fault, *((None,) * 3 if one.recorded is None else _values(one.recorded)))
                for one in runs
                if one.run is None
            ]
            database.write_many(
                "DELETE FROM faults WHERE archive = ? AND folder = ?", [(self._name, one.folder) for one in runs]
            )
            database.write_many(
                "INSERT INTO faults (archive, folder, message, bench, plan, device) VALUES (?, ?, ?, ?, ?, ?)", faults
            )
            ids: list[tuple[SqlValue]] = []
            coefficients: list[SqlRow] = []
            limits: list[SqlRow] = []
            for one in runs:
                if one.run is None:
                    continue
                ((number,),) = database.query(upsert, (self._name, one.fingerprint, *_run_values(one.run)))
                ids.append((number,))
                coefficients += [(number, *_values(_apart(row, one.parameters))) for row in one.coefficients]
                limits += [(number, *_values(_apart(row, one.parameters))) for row in one.limits]
            for table in ("coefficients", "limits"):
                database.write_many(f"DELETE FROM {table} WHERE run_id = ?", ids)
            database.write_many(
                f"INSERT INTO coefficients (run_id, {_COEFFICIENT}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)", coefficients
            )
            database.write_many(f"INSERT INTO limits (run_id, {_LIMIT}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)", limits)

    def _forget(self, folders: Sequence[str]) -> None:
        if folders:
            with self._database.transaction():
                self._remove(folders)
                self._database.write_many(
                    "DELETE FROM faults WHERE archive = ? AND folder = ?", [(self._name, folder) for folder in folders]
                )

    def _remove(self, folders: Sequence[str]) -> None:
        """Removes runs within a transaction."""
        keys = [(self._name, folder) for folder in folders]
        for table in ("coefficients", "limits"):
            self._database.write_many(
                f"DELETE FROM {table} WHERE run_id IN (SELECT id FROM runs WHERE archive = ? AND folder = ?)", keys
            )
        self._database.write_many("DELETE FROM runs WHERE archive = ? AND folder = ?", keys)

    # -- asking ------------------------------------------------------------------------------------------------------

    def runs(self, wanted: RunFilter = RunFilter()) -> list[RunRow]:  # noqa: B008 - frozen
        """Returns the runs that pass a filter, the newest first."""
        where, values = self._where(wanted)
        most = "" if wanted.limit is None else f" LIMIT {int(wanted.limit)}"
        found = self._database.query(
            f"SELECT {_named(_RUN, 'runs')} FROM runs WHERE {where} ORDER BY created DESC, folder DESC{most}", values
        )
        return [_run_row(row) for row in found]

    def count(self, wanted: RunFilter = RunFilter()) -> int:  # noqa: B008 - frozen
        """Returns the number of runs that pass a filter. The filter's limit on the number of runs is ignored."""
        where, values = self._where(wanted)
        return cast(int, self._database.query(f"SELECT count(*) FROM runs WHERE {where}", values)[0][0])

    def run(self, folder: str) -> RunRow | None:
        """Returns the run in a folder; None if it is not in the index. `folder`: path relative to the archive, with slashes."""
        found = self._database.query(f"SELECT {_RUN} FROM runs WHERE archive = ? AND folder = ?", (self._name, folder))
        return _run_row(found[0]) if found else None

    def coefficients(self, folder: str) -> tuple[CoefficientRow, ...]:
        """Returns the coefficients of the run in a folder, by name."""
        found = self._database.query(
            f"SELECT {_named(_COEFFICIENT, 'c')} FROM runs JOIN coefficients c ON c.run_id = runs.id "
            "WHERE archive = ? AND folder = ? ORDER BY quantity",
            (self._name, folder),
        )
        return tuple(map(_coefficient_row, found))

    def limits(self, folder: str) -> tuple[LimitRow, ...]:
        """Returns the verdicts on the limits of the run in a folder."""
        found = self._database.query(
            f"SELECT {_named(_LIMIT, 'l')} FROM runs JOIN limits l ON l.run_id = runs.id "
            "WHERE archive = ? AND folder = ? ORDER BY quantity, requirement",
            (self._name, folder),
        )
        return tuple(map(_limit_row, found))

    def all_coefficients(self) -> list[tuple[str, CoefficientRow]]:
        """Returns all coefficients of all runs, each with the folder of its run, sorted by folder and name."""
        found = self._database.query(
            f"SELECT folder, {_named(_COEFFICIENT, 'c')} FROM runs JOIN coefficients c ON c.run_id = runs.id "
            "WHERE archive = ? ORDER BY folder, quantity",
            (self._name,),
        )
        return [(str(folder), _coefficient_row(tuple(row))) for folder, *row in found]

    def all_limits(self) -> list[tuple[str, LimitRow]]:
        """Returns all limits of all runs, each with the folder of its run, sorted by folder and quantity."""
        found = self._database.query(
            f"SELECT folder, {_named(_LIMIT, 'l')} FROM runs JOIN limits l ON l.run_id = runs.id "
            "WHERE archive = ? ORDER BY folder, quantity, requirement",
            (self._name,),
        )
        return [(str(folder), _limit_row(tuple(row))) for folder, *row in found]

    def devices(self) -> list[DeviceSummary]:
        """Returns the devices, sorted by serial number. Runs without a serial number belong to one device with an empty serial
        number."""
        found = self._database.query(
            "SELECT device, count(*), max(created) FROM runs WHERE archive = ? GROUP BY device ORDER BY device",
            (self._name,),
        )
        return [DeviceSummary(str(device), cast(int, runs), str(last)) for device, runs, last in found]

    def quantities(self, device: str) -> list[str]:
        """Returns the names `estimate.coefficient` of all coefficients in the runs of a device."""
        found = self._database.query(
            "SELECT DISTINCT quantity FROM runs JOIN coefficients c ON c.run_id = runs.id "
            "WHERE archive = ? AND device = ? ORDER BY quantity",
            (self._name, device),
        )
        return [str(quantity) for (quantity,) in found]

    def points(self, quantity: str, wanted: RunFilter = RunFilter()) -> list[HistoryPoint]:  # noqa: B008 - frozen
        """Returns the values of a coefficient in the runs that pass a filter, the oldest first."""
        where, values = self._where(wanted)
        tail = f"WHERE {where} AND quantity = ? ORDER BY created, folder"
        found = self._database.query(
            f"SELECT {_named(_RUN, 'runs')}, {_named(_COEFFICIENT, 'c')} FROM runs JOIN coefficients c ON c.run_id = runs.id {tail}",
            (*values, quantity),
        )
        held = self._database.query(
            f"SELECT folder, {_named(_LIMIT, 'l')} FROM runs JOIN limits l ON l.run_id = runs.id {tail}",
            (*values, quantity),
        )
        limits: dict[str, list[LimitRow]] = {}
        for folder, *row in held:
            limits.setdefault(str(folder), []).append(_limit_row(tuple(row)))
        points = []
        for one in found[-wanted.limit :] if wanted.limit is not None else found:
            run = _run_row(one[:_RUN_COLUMNS])
            points.append(HistoryPoint(run, _coefficient_row(one[_RUN_COLUMNS:]), tuple(limits.get(run.folder, ()))))
        return points

    def history(self, device: str, quantity: str, since: str = "") -> list[HistoryPoint]:
        """Returns the values of a coefficient of a device over time, the oldest first. `since`: first day or moment to include;
        empty for the whole history."""
        return self.points(quantity, RunFilter(device=literal(device), since=since))

    def faults(self) -> list[FaultRow]:
        """Returns the folders that could not be read and are therefore not in the index, sorted by name."""
        found = self._database.query(
            "SELECT folder, message, bench, plan, device FROM faults WHERE archive = ? ORDER BY folder", (self._name,)
        )
        return [
            FaultRow(
                str(folder),
                str(message),
                None if bench is None else RecordedAs(str(bench), str(plan), str(device)),
            )
            for folder, message, bench, plan, device in found
        ]

    def _where(self, wanted: RunFilter) -> tuple[str, tuple[SqlValue, ...]]:
        terms, values = ["runs.archive = ?"], [self._name]
        for name in ("device", "plan", "bench", "operator", "verdict"):
            text = str(getattr(wanted, name))
            if not text:
                continue
            plain, like = _pattern(text)
            terms.append(f"runs.{name} = ?" if like is None else f"LOWER(runs.{name}) LIKE ? ESCAPE '!'")
            values.append(plain if like is None else like)
        if wanted.since:
            terms.append("runs.created >= ?")
            values.append(_moment(wanted.since).isoformat(timespec="microseconds"))
        if wanted.until:
            whole = timedelta(days=1) if len(wanted.until) == len("2026-01-01") else timedelta(microseconds=1)
            terms.append("runs.created < ?")
            values.append((_moment(wanted.until) + whole).isoformat(timespec="microseconds"))
        return " AND ".join(terms), tuple(values)


def _read(item: tuple[Path, str]) -> IndexedRun:
    return read_run(*item)


def _pattern(text: str) -> tuple[str, str | None]:
    """Interprets the text of a filter, in which a backslash makes the next character literal. Returns the text without these
    backslashes, and a pattern for LIKE if the text contains `*` or `?`; otherwise the pattern is None."""
    plain, like, wild = [], [], False
    letters: Iterator[str] = iter(text)
    for letter in letters:
        escaped = letter == "\\"
        letter = next(letters, letter) if escaped else letter
        plain.append(letter)
        if letter in "*?" and not escaped:
            wild = True
            like.append("%" if letter == "*" else "_")
        else:
            like.append(f"!{letter}" if letter in "!%_" else letter.lower())
    return "".join(plain), "".join(like) if wild else None


def literal(text: str) -> str:
    """Escapes a text so that a `RunFilter` with this text matches only equal values."""
    return "".join(f"\\{letter}" if letter in "*?\\" else letter for letter in text)


def _moment(text: str) -> datetime:
    """Converts a text to a moment in UTC. No run has a year outside `FIRST_YEAR` to `LAST_YEAR`. A moment far outside this range is
    therefore replaced by a moment slightly outside the range. Days can then be added to the moment without leaving the range of the
    calendar."""
    try:
        moment = datetime.fromisoformat(text)
        if not FIRST_YEAR <= moment.year <= LAST_YEAR:
            return datetime(FIRST_YEAR - 1 if moment.year < FIRST_YEAR else LAST_YEAR + 1, 1, 1, tzinfo=UTC)
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except ValueError:
        raise InputError.of_usage(f"'{text[:40]}' is not a date", "write for example 2026-03-01") from None


def _named(columns: str, table: str) -> str:
    return ", ".join(f"{table}.{name.strip()}" for name in columns.split(","))


_RUN_COLUMNS = len(_RUN.split(","))


def _values(row: CoefficientRow | LimitRow | RecordedAs) -> SqlRow:
    """Converts values to the form in which the database stores them. nan becomes NULL, because SQLite would do this conversion
    anyway."""
    found = []
    for item in fields(row):
        value = getattr(row, item.name)
        value = value.value if isinstance(value, CoefficientRole) else value
        found.append(None if isinstance(value, float) and math.isnan(value) else value)
    return tuple(found)


def _apart(row: _Row, parameters: Mapping[str, str]) -> _Row:
    """Returns the row of a run for which values of plan parameters were given. The quantities of such a run get different names,
    because its results must not be mixed with the history for other parameter values."""
    return replace(row, quantity=variant_name(row.quantity, parameters)) if parameters else row


def _run_values(run: RunRow) -> SqlRow:
    circumstances = json.dumps([(one.kind.value, one.name, one.value) for one in run.circumstances], ensure_ascii=False)
    info = json.dumps(dict(run.info), ensure_ascii=False)
    return (*(cast(SqlValue, getattr(run, name.strip())) for name in _RUN.split(",")[:-2]), circumstances, info)


def _run_row(row: SqlRow) -> RunRow:
    *texts, state, verdict, analysis, warnings, circumstances, info = row
    folder, run, created, plan, title, device, bench, laboratory, operator, origin = map(str, texts)
    return RunRow(
        folder,
        run,
        created,
        plan,
        title,
        device,
        bench,
        laboratory,
        operator,
        origin,
        cast(RunState, state),
        cast(IndexedVerdict, verdict),
        cast(int, analysis),
        cast(int, warnings),
        _circumstances(str(circumstances)),
        dict(_info(str(info))),
    )


@lru_cache(maxsize=4096)
def _info(text: str) -> Mapping[str, str]:
    found: dict[str, str] = json.loads(text)
    return found


@lru_cache(maxsize=4096)  # the runs of a device mostly share them
def _circumstances(text: str) -> tuple[Circumstance, ...]:
    return tuple(Circumstance(CircumstanceKind(kind), name, value) for kind, name, value in json.loads(text))


_ROLES = {role.value: role for role in CoefficientRole}


def _coefficient_row(row: SqlRow) -> CoefficientRow:
    quantity, value, unit, u, freedom, role, period = row
    return CoefficientRow(
        str(quantity),
        _number(value),
        str(unit),
        _number(u),
        _number(freedom),
        _ROLES[str(role)],
        _number(period),
    )


def _limit_row(row: SqlRow) -> LimitRow:
    quantity, requirement, verdict, unit, lower, upper, probability = row
    numbers = (_number(lower), _number(upper), _number(probability))
    return LimitRow(str(quantity), str(requirement), str(verdict), str(unit), *numbers)


def _number(value: SqlValue) -> float:
    return math.nan if value is None else float(value)
