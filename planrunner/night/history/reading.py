"""Reads a run folder for the index. Because the folder may come from another person, it is opened with the same precautions as in
all other commands, and its faults do not affect other folders."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from planrunner.archive import analyses as stored
from planrunner.archive import seal as seals
from planrunner.archive.analyses import StoredAnalysis
from planrunner.archive.formats import IntegrityError, from_bytes
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import BENCH, PLAN, RUN, Examined, examine
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError
from planrunner.base.guarded_folder import Entry, GuardedFolder
from planrunner.estimators.limits import verdict_kind
from planrunner.estimators.results import NAME as RESULTS
from planrunner.estimators.results import Results
from planrunner.night.history.rows import (
    Circumstance,
    CircumstanceKind,
    CoefficientRow,
    IndexedRun,
    LimitRow,
    RecordedAs,
    RunRow,
)
from planrunner.plan import source
from planrunner.plan.run_information import device_of

OPERATOR, FIRMWARE = "operator", "firmware"
MOUNTING = ("mounting", "fixture")
_READ = (RUN, PLAN, BENCH, JOURNAL, seals.NAME, stored.FOLDER)
_SETTLED = 3.0
"""Age [s] of a change after which a further change certainly has a different time. The coarsest common file system has a resolution
of 2 s."""
_MOST_TEXT = 2000


def fingerprint(entries: Mapping[str, Entry]) -> str:
    """Returns a value that changes whenever planrunner writes to a run folder. `entries`: entries of the run folder, by name. The
    value is empty if the last change is so recent that a further change might give the same value."""
    known = [(name, entries[name]) for name in _READ if name in entries]
    if known and abs(time.time() - max(entry.modified for _, entry in known) / 1e9) < _SETTLED:
        return ""
    text = repr([(name, entry.kind, entry.size, entry.modified) for name, entry in known])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def read_run(archive: Path, place: str) -> IndexedRun:
    """Reads a run folder of an archive. `place`: path relative to the archive, with slashes. Faults in the folder never raise an
    exception; they are part of the result."""
    mark = ""
    found: Examined | None = None
    try:
        folder = GuardedFolder.open(archive)
        for name in () if place == "." else place.split("/"):
            folder = folder.folder(name)  # no component is a link
        mark = fingerprint(folder.entries())
        try:
            reader = RunReader.of(examine(folder))
        except IntegrityError:  # it may have been written meanwhile
            mark = fingerprint(folder.entries())
            found = examine(folder)
            reader = RunReader.of(found)
        return _indexed(place, mark, reader)
    except (IntegrityError, InputError) as error:
        return IndexedRun(place, mark, None, fault=_short(str(error)), recorded=_recorded(found))
    except OSError as error:
        return IndexedRun(place, mark, None, fault=f"it cannot be read: {error.strerror or error}")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        return IndexedRun(place, mark, None, fault=_short(f"it is not as planrunner writes it ({error!r})"))


def _recorded(found: Examined | None) -> RecordedAs | None:
    """Returns the identity of a damaged run if it can be trusted. Returns None if the chain of its journal is broken, or if
    run.json or the bench file differ from their digests in the journal."""
    if found is None or found.state is None or not found.run or BENCH not in found.given:
        return None
    try:
        info = {name: _text(value) for name, value in found.run["info"].items()}
        return RecordedAs(_bench_facts(found.given[BENCH])["name"], _short(str(found.run["plan"])), device_of(info))
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def _indexed(place: str, mark: str, reader: RunReader) -> IndexedRun:
    results = _results(reader.analyses[-1]) if reader.analyses else None
    info = {name: _text(value) for name, value in reader.run["info"].items()}
    bench, plan = _bench_facts(reader.bench_bytes), _plan_facts(reader.plan_bytes)
    notices = reader.warnings()
    if results is not None:
        notices += [text for estimate in results.estimates.values() for text in estimate.warnings]
    run = RunRow(
        folder=place,
        run=str(reader.run["run"]),
        created=datetime.fromisoformat(reader.run["created"]).astimezone(UTC).isoformat(timespec="microseconds"),
        plan=str(reader.run["plan"]),
        title=plan["title"],
        device=device_of(info),
        bench=bench["name"],
        laboratory=bench["laboratory"],
        operator=info.get(OPERATOR, ""),
        origin="" if results is None or results.origin is None else results.origin,
        state="sealed" if reader.sealed else "open",
        verdict="not analysed" if results is None else verdict_kind(results.limits, results.failures, len(notices)),
        analysis=reader.analyses[-1].number if reader.analyses else 0,
        warnings=len(notices),
        circumstances=tuple(_circumstances(reader, info, bench, plan)),
        info=info,
    )
    if results is None:
        return IndexedRun(place, mark, run)
    coefficients = tuple(
        CoefficientRow(
            f"{estimate.name}.{one.name}",
            one.value,
            one.unit,
            one.standard_uncertainty,
            one.degrees_of_freedom,
            one.role,
            one.period,
        )
        for estimate in results.estimates.values()
        for one in estimate.coefficients
    )
    limits = tuple(
        LimitRow(one.quantity, one.requirement, one.verdict, one.unit, one.lower, one.upper, one.probability)
        for one in results.limits
    )
    return IndexedRun(place, mark, run, coefficients, limits, parameters=reader.run.get("parameters", {}))


def _results(analysis: StoredAnalysis) -> Results:
    """Returns the results of a run without tables, plots, budgets and statistics of segments, which the index does not need."""
    data = from_bytes(analysis.read(RESULTS))
    lean: JsonObject = {"tables": [], "plots": [], "budgets": [], "notes": [], "extra": {}, "settings": {}}
    if isinstance(data, dict):
        data = {**data, "segments": [], "estimates": [{**one, **lean} for one in data["estimates"]]}
    return Results.from_json(data, str(analysis.path / RESULTS))


def _circumstances(
    reader: RunReader, info: Mapping[str, str], bench: Mapping[str, str], plan: Mapping[str, str]
) -> Iterator[Circumstance]:
    kinds = CircumstanceKind
    yield Circumstance(kinds.BENCH, "", bench["name"])
    yield Circumstance(kinds.BENCH, "file", bench["digest"])
    if bench["laboratory"]:
        yield Circumstance(kinds.LABORATORY, "", bench["laboratory"])
    if info.get(OPERATOR):
        yield Circumstance(kinds.OPERATOR, "", info[OPERATOR])
    for name in MOUNTING:
        if info.get(name):
            yield Circumstance(kinds.MOUNTING, name, info[name])
    if plan["mounting"]:
        yield Circumstance(kinds.MOUNTING, "in the plan", plan["mounting"])
    if bench["fixture"]:
        yield Circumstance(kinds.MOUNTING, "fixture of the bench", bench["fixture"])
    if info.get(FIRMWARE):
        yield Circumstance(kinds.FIRMWARE, "", info[FIRMWARE])
    for instrument, identity in sorted(reader.instruments.items()):
        for key, value in sorted(identity.items()):
            kind = kinds.FIRMWARE if key == FIRMWARE else kinds.INSTRUMENT
            yield Circumstance(kind, instrument if key == FIRMWARE else f"{instrument}.{key}", _short(value))
    yield Circumstance(kinds.PLAN, "", plan["digest"])
    yield Circumstance(kinds.SOFTWARE, "", str(reader.run["versions"]["planrunner"]))


@lru_cache(maxsize=256)
def _bench_facts(data: bytes) -> JsonObject:
    """Returns facts from a bench file. The drivers that the file names need not be installed, and the file need not pass the
    present checks."""
    root = _parsed(data, BENCH)
    return {
        "name": _scalar(root, "name") or "unknown",
        "laboratory": _scalar(root, "laboratory", "name"),
        "fixture": _scalar(root, "fixture", "asset"),
        "digest": hashlib.sha256(data).hexdigest()[:12],
    }


@lru_cache(maxsize=256)
def _plan_facts(data: bytes) -> JsonObject:
    root = _parsed(data, PLAN)
    mounting = None if root is None else root.get("mounting")
    return {
        "title": _scalar(root, "title"),
        "mounting": "" if mounting is None else hashlib.sha256(repr(_content(mounting)).encode()).hexdigest()[:12],
        "digest": hashlib.sha256(data).hexdigest()[:12],
    }


def _parsed(data: bytes, name: str) -> source.Mapping | None:
    try:
        return source.parse(source.decode(data, name), name)
    except InputError:
        return None


def _scalar(root: source.Node | None, *keys: str) -> str:
    for key in keys:
        root = root.get(key) if isinstance(root, source.Mapping) else None
    return _short(root.text) if isinstance(root, source.Scalar) else ""


def _content(node: source.Node) -> Json:
    """Returns the content of a node as plain data, without its position in the file."""
    if isinstance(node, source.Scalar):
        return node.text
    if isinstance(node, source.Sequence):
        return [_content(one) for one in node.items]
    return sorted((key.text, _content(value)) for key, value in node.entries)


def _text(value: Json) -> str:
    return "" if value is None else _short(str(value))


def _short(text: str) -> str:
    """Returns a text without null characters and lone surrogates, which databases refuse."""
    clean = text.replace("\0", "\N{REPLACEMENT CHARACTER}").encode("utf-8", "replace").decode("utf-8")
    return clean if len(clean) <= _MOST_TEXT else f"{clean[:_MOST_TEXT]}…"
