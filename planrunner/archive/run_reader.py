"""Reads a run folder: the plan, the bench, the valid segments, their statistics, and their samples in blocks.

While the samples of a file are used, another thread reads the next file and checks its digest. Reading and hashing release the
interpreter's lock, so both happen at the same time. At most one file is read ahead, so that the memory use does not grow with the
recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

from planrunner.archive.analyses import Basis, StoredAnalysis
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal_state import Acknowledged, JournalState, Rejected
from planrunner.archive.reading_progress import RowsRead
from planrunner.archive.recording import RecordedSegment, WatcherOf
from planrunner.archive.segment_file import SegmentData
from planrunner.archive.statistics import statistics_of
from planrunner.archive.summaries import summarised
from planrunner.archive.verifying import APPROVALS, BENCH, MENDED, PLAN, Examined, examine, open_run
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Finding
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.progress import Announce
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Schedule
from planrunner.plan.selection import spelt_alike


@dataclass(frozen=True)
class RunReader:
    """Reads a run folder in the state that it had when it was opened. Reading changes nothing and needs no lock.

    `run`: the content of run.json. `torn`: number of bytes in an incomplete last line of the journal. `first`: digest of the
    journal's first line. `basis`: the state of the journal and the seal, on which an analysis of this run is based. `analyses`: the
    stored analyses, oldest first. `findings`: warnings, such as that the run is not sealed. `approvals`: content of approvals.json,
    if the bench required approvals.
    """

    folder: GuardedFolder
    run: JsonObject
    plan_bytes: bytes
    bench_bytes: bytes
    seal: JsonObject | None
    state: JournalState
    torn: int
    first: str
    basis: Basis
    analyses: tuple[StoredAnalysis, ...]
    findings: tuple[Finding, ...]
    approvals: bytes | None = None

    @classmethod
    def open(cls, path: Path, *, to_reopen: bool = False) -> RunReader:
        """Opens a run folder. The digests of everything except samples are checked now; the digests of samples are checked when the
        samples are read (see `verifying`).

        Raises `InputError` if `path` is not a run folder, and `IntegrityError` if the folder was changed. If a run was killed, an
        incomplete last line is ignored. `to_reopen`: True to accept faults that are repaired when the run is reopened.
        """
        return cls.of(examine(open_run(path)), to_reopen=to_reopen)

    @classmethod
    def of(cls, found: Examined, *, to_reopen: bool = False) -> RunReader:
        """Reads a run folder that has already been examined; see `open`."""
        found.require_whole(*(MENDED if to_reopen else ()))
        assert found.state is not None and found.scan is not None
        return cls(
            found.folder,
            found.run,
            found.given[PLAN],
            found.given[BENCH],
            found.seal,
            found.state,
            found.scan.torn,
            found.scan.heads[1],
            found.basis,
            found.analyses,
            tuple(found.findings),
            found.given.get(APPROVALS),
        )

    # -- what was run --------------------------------------------------------------------------------------------------

    @property
    def path(self) -> Path:
        return self.folder.path

    @property
    def instruments(self) -> dict[str, dict[str, str]]:
        """Maps the name of each instrument to the description that the instrument gave of itself."""
        return self.state.instruments

    @property
    def sealed(self) -> bool:
        """Returns True if the run is finished and sealed."""
        return self.seal is not None and self.state.finished

    def acknowledged(self) -> tuple[Acknowledged, ...]:
        """Returns the valid segments in the order of the schedule."""
        return tuple(self.state.acknowledged[index] for index in sorted(self.state.acknowledged))

    def rejected(self) -> tuple[Rejected, ...]:
        """Returns the data that are stored but do not count, with the reason."""
        return tuple(self.state.rejected)

    def warnings(self, planned: int | None = None) -> list[str]:
        """Returns warnings about unusual events of the run that a reader of the results must know about. `planned`: number of
        planned segments; by default, the number in the journal."""
        planned = self.state.planned if planned is None else planned
        warnings = [f"Fault during the run: {text}" for text in self.state.failures]
        held = len(self.acknowledged())
        if held < planned:
            warnings.append(f"{planned - held} of {planned} planned segments were not recorded.")
        began = self.run.get("check_standard", {}).get("override")
        continued = [standard.get("override") for _, standard in self.state.standards]
        for number, override in enumerate([began, *(one for one in continued if one != began)]):
            if override is None:
                continue
            known = "" if "signature" in override else " (name not authenticated)"
            what = "continue" if number else "begin"
            warnings.append(
                f"The check standard was not in control; {override['by']}{known} let the run {what}: {override['why']}."
            )
        if not self.sealed:
            warnings.append("The run is not finished and not sealed: more data may follow.")
        for item in self.acknowledged():
            if item.truncated:
                warnings.append(f"Segment {item.label} is shorter than planned: {item.reason or 'cut short'}.")
        for other in self.rejected():
            reason = other.reason or "no reason given"
            warnings.append(
                f"Segment {other.label}, attempt {other.attempt}, was recorded, but it is not used: {reason}."
            )
        return warnings

    # -- samples -------------------------------------------------------------------------------------------------------

    def recording(
        self, schedule: Schedule, watch: WatcherOf | None = None, notice: Announce | None = None
    ) -> tuple[RecordedSegment, ...]:
        """Returns the acknowledged segments with statistics, in the order of the schedule. Each file is read once.

        `schedule`: the schedule made from the plan and the bench in the run folder. `watch`: screens the samples while they are
        read for the statistics. `notice`: receives the progress. Raises `IntegrityError` if the schedule does not match the
        recording.
        """
        segments = []
        whole = sum(part.rows for item in self.acknowledged() for part in item.parts)
        passed = RowsRead("reading the recording", whole, notice)
        stored = [part for item in self.acknowledged() for part in item.parts]
        read_one = (SegmentData(self.folder, part) for part in stored)
        files = ahead(read_one) if len(stored) > 1 else read_one
        for item in self.acknowledged():
            known = item.index < len(schedule.segments)
            if not (known and spelt_alike(item.label, schedule.segments[item.index].label)):
                message = f"segment {item.index + 1} was recorded as '{item.label}', but the plan has no such segment at this place"
                raise IntegrityError(f"{self.path}: {message}; has planrunner been updated since?")
            parts = islice(files, len(item.parts))
            first = next(parts, None)
            units, summary = ({}, None) if first is None else (first.units, first.summary)
            read = partial(self.blocks, item)
            rows = sum(part.rows for part in item.parts)
            readings = {name: float("nan") if value is None else float(value) for name, value in item.readings.items()}
            segment = schedule.segments[item.index]
            blocks = passed.through(_blocks(_with_first(first, parts), tuple(units)))
            first = None  # not kept while the other parts are read
            if summary is not None:
                segments.append(summarised(segment, units, summary, blocks, str(self.path), readings))
                continue
            watcher = None if watch is None else watch(segment, units, rows)
            statistics = statistics_of(blocks, tuple(units), rows, watcher, segment.motion)
            made = RecordedSegment(segment, units, statistics, read, item.truncated, readings)
            segments.append(made if watcher is None else made.watched(watcher))
        return tuple(segments)

    def blocks(self, item: Acknowledged, channels: Sequence[str] | None = None) -> Iterator[Block]:
        """Returns the samples of a segment in blocks of bounded size. `channels`: the channels to return; None for all channels."""
        return _blocks((SegmentData(self.folder, part) for part in item.parts), channels)

    # -- integrity -----------------------------------------------------------------------------------------------------

    def check_digests(self) -> int:
        """Checks the present content of the folder, including samples, against its digests. Returns the number of recorded files.
        Raises `IntegrityError` if anything differs from its digest."""
        found = examine(self.folder, samples="contents")
        found.require_whole()
        assert found.state is not None
        return len({part.file for part in found.state.files()}) + len(found.given)


def _with_first(first: SegmentData | None, others: Iterator[SegmentData]) -> Iterator[SegmentData]:
    """Yields all parts of a segment. The first part may already be open. Each part is released after it has been used."""
    if first is not None:
        yield first
    first = None
    yield from others


def _blocks(parts: Iterator[SegmentData], channels: Sequence[str] | None) -> Iterator[Block]:
    """Yields the samples of a segment in blocks. All parts of the segment must have the columns of its first part, and times must
    increase from part to part."""
    units: Mapping[str, str] | None = None
    last = float("-inf")
    for data in parts:
        if units is not None and data.units != units:
            raise IntegrityError(f"{data.path}: its columns differ from those of the first part of the segment")
        units = data.units
        for block in data.blocks(channels):
            if len(block.time):
                if not block.time[0] > last:
                    raise IntegrityError(f"{data.path}: its first time is not after the end of the preceding part")
                last = float(block.time[-1])
            yield block
        del data  # before the next part is taken


T = TypeVar("T")


def ahead(items: Iterator[T]) -> Iterator[T]:
    """Yields the given items in their order. Another thread makes the next item while the present one is used. If `items` raises an
    exception, the exception is raised in place of the item that failed."""
    from concurrent.futures import ThreadPoolExecutor

    end = object()
    with ThreadPoolExecutor(1, "reading ahead") as reader:
        following = reader.submit(next, items, end)
        while (item := following.result()) is not end:
            following = reader.submit(next, items, end)
            yield item  # type: ignore[misc]  # it is not the end
            item = None
