"""Writes a run folder: creates it atomically, adds events and segments, and finally seals it.

    runs/<UTC time>-<plan name>-<short id>/
      run.json  plan.yaml  bench.yaml  approvals.json  journal.jsonl  segments/  seal.json  analyses/

Acknowledged data are never changed or removed. An interrupted segment keeps its finished parts of samples. These parts count if the
plan says `on_break: keep`; otherwise, they are only stored with the reason, and the segment is repeated.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from planrunner.archive import formats
from planrunner.archive import journal as journal_lines
from planrunner.archive import seal as seals
from planrunner.archive.formats import IntegrityError
from planrunner.archive.journal import Journal, finite, utc_now
from planrunner.archive.lock import FolderLock
from planrunner.archive.origin import leave_origin
from planrunner.archive.provenance import versions
from planrunner.archive.resuming import ResumePoint, settle_break
from planrunner.archive.run_log import LogEvent, RunLog, require_growth
from planrunner.archive.segment_file import (
    FOLDER,
    PART_BYTES,
    PART_SECONDS,
    Part,
    SegmentWriter,
    file_stem,
    safe_name,
)
from planrunner.archive.stamp_files import keep_stamp
from planrunner.archive.storage import ASIDE, Durability, Storage, digest
from planrunner.archive.summaries import METADATA, to_text
from planrunner.archive.verifying import APPROVALS, BENCH, MENDED, PLAN, RUN, Examined, examine, open_run
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder, NotOrdinaryError
from planrunner.bench.watchdog_report import NAME as REPORT
from planrunner.bench.watchdog_report import read_report
from planrunner.instruments.interfaces import Block, SummaryChannels
from planrunner.plan.schedule import Segment


@dataclass(frozen=True, slots=True)
class Witnessed:
    """Contains a time stamp of the first `events` events of the journal, which will be stored in the run folder.

    `token`: the reply of the authority in DER; None if there is no time stamp. `why`: the reason why there is no time stamp. `at`:
    the time that the stamp states, UTC.
    """

    events: int
    token: bytes | None
    at: str = ""
    why: str = ""


class Witness(Protocol):
    """Obtains time stamps of the journal while the journal grows. The run does not wait for these stamps."""

    def see(self, events: int, line: bytes, *, last: bool = False) -> None:
        """Tells the witness the number of acknowledged events in the journal, and the last line of the journal. `last`: True if the
        journal is finished, so that a stamp is due now."""
        ...

    def take(self, *, wait: bool = False) -> Sequence[Witnessed]:
        """Returns the stamps that have arrived since the last call. `wait`: True to wait for stamps that have been requested but
        not received."""
        ...


class RunWriter:
    """Writes a run folder; a folder has only one writer at a time. `create` and `reopen` make a writer. A writer must be closed by
    `close` or by the end of its context."""

    def __init__(
        self,
        folder: GuardedFolder,
        name: str,
        storage: Storage,
        lock: FolderLock,
        journal: Journal,
        point: ResumePoint,
    ):
        self.path = folder.path
        self.folder = folder
        self._segments = folder.folder(FOLDER)
        self._name = name
        self.part_bytes = PART_BYTES
        self.part_seconds = PART_SECONDS
        self._storage = storage
        self._lock = lock
        self._journal = journal
        self._point = point
        self._segment: Segment | None = None
        self._attempt = 1
        self._samples: SegmentWriter | None = None
        self._parts: list[Part] = []
        self.witness: Witness | None = None

    # -- opening -------------------------------------------------------------------------------------------------------

    @classmethod
    def create(
        cls,
        root: Path,
        plan_name: str,
        plan_bytes: bytes,
        bench_bytes: bytes,
        info: Mapping[str, Json],
        durability: Durability = "durable",
        *,
        seed: int | None = None,
        storage: Storage | None = None,
        identity: str | None = None,
        approvals: bytes | None = None,
        check_standard: JsonObject | None = None,
        parameters: Mapping[str, str] = MappingProxyType({}),
    ) -> RunWriter:
        """Makes a new run folder in `root`, which is created if it does not exist.

        `identity`: hexadecimal digits for the end of the folder's name; random by default. With these digits, the caller can find
        the folder even if this process is killed.

        `info`: JSON data given with the run (device serial, operator, ambient …). `approvals`: content of approvals.json, if the
        bench requires approvals. `check_standard`: state of the check standard of the bench, if the bench has one. `parameters`:
        values that were given for parameters of the plan. If `root` has a log, an entry records that the run has begun. Raises
        `InputError` if the folder cannot be written, and `IntegrityError` for a log that was changed.
        """
        storage = storage or Storage(durability)
        now = datetime.now(UTC)
        name = f"{now:%Y%m%dT%H%M%SZ}-{safe_name(plan_name)}-{identity or os.urandom(3).hex()}"
        run = {
            "planrunner_run": formats.RUN_FORMAT,
            "run": name,
            "created": now.isoformat(timespec="microseconds"),
            "plan": plan_name,
            "seed": seed,
            "durability": storage.durability,
            "versions": versions(),
            "info": dict(info),
            **({} if check_standard is None else {"check_standard": check_standard}),
            **({"parameters": dict(parameters)} if parameters else {}),
        }
        try:
            log = RunLog.of(root, storage)
            if log is not None:
                content = log.read()
                require_growth(content, log.path)
                size = len(content.entries)
                run["log"] = {"origin": content.origin, "size": size, "root": content.root(size)}
            given = {RUN: formats.to_bytes(run), PLAN: plan_bytes, BENCH: bench_bytes}
            if approvals is not None:
                given[APPROVALS] = approvals
            return cls._build(root, name, given, storage)
        except OSError as error:
            hint = "choose another folder for runs, or change its permissions"
            message = f"the run folder cannot be written: {error.strerror or error}"
            raise InputError.at(Mark(str(root)), "runs-unwritable", message, hint) from None

    @classmethod
    def _build(cls, root: Path, name: str, given: Mapping[str, bytes], storage: Storage) -> RunWriter:
        root.mkdir(parents=True, exist_ok=True)
        runs, aside = GuardedFolder.open(root), f".{name}{ASIDE}"
        begun = storage.make_folder(runs, aside)
        try:
            for given_name, data in given.items():
                storage.write_whole(begun, given_name, data)
            storage.make_folder(begun, FOLDER)
            with storage.open_new(begun, journal_lines.NAME) as file:
                created = Journal(storage, file)
                digests = {given_name: digest(data) for given_name, data in given.items()}
                created.append("created", {"run": name, "files": digests})
            leave_origin(begun, created.head)
            storage.sync_folder(begun)
            storage.rename(runs, aside, name)
            storage.sync_folder(runs)
        except OSError:
            runs.remove_folder(aside)
            raise
        folder = runs.folder(name)
        lock = FolderLock(folder)
        try:
            file = storage.open_existing(folder, journal_lines.NAME)
        except BaseException:
            lock.release()
            raise
        journal = Journal(storage, file, head=created.head, count=created.count, size=file.tell())
        made = cls(folder, name, storage, lock, journal, ResumePoint(files=digests))
        try:
            made._enter("begun")
        except BaseException:
            made.close()
            runs.remove_folder(name)
            raise
        return made

    @classmethod
    def reopen(
        cls,
        run: Path | Examined,
        *,
        reason: str | None = None,
        durability: Durability | None = None,
        storage: Storage | None = None,
        lock: FolderLock | None = None,
        bench: bytes | None = None,
        approvals: Sequence[JsonObject] = (),
        check_standard: JsonObject | None = None,
    ) -> RunWriter:
        """Continues an interrupted run: removes an incomplete last line and settles the segment in progress.

        `run`: path of the run folder. To avoid a second verification, `run` may instead be the result of `examine` for the folder.
        The samples must have been examined too, and the given lock must have been held during the examination.

        `reason`: reason for reopening a finished, sealed run; required for such a run. `lock`: lock of the folder, if the caller
        already holds it; the writer then becomes responsible for it. `bench`: a bench file that replaces the one in the folder; the
        journal records its digest. `approvals`: entries of approvals of the plan that were given since the run began; the journal
        records them. `check_standard`: the present state of the check standard of the bench.

        Raises `InputError` if the folder is in use, finished or not writable, and `IntegrityError` if it was changed.
        """
        folder = run.folder if isinstance(run, Examined) else open_run(run)
        file: FileIO | None = None
        try:
            lock = lock or FolderLock(folder)
            examined = run if isinstance(run, Examined) else examine(folder, samples="contents")
            examined.require_whole(*MENDED)
            state, scan = examined.state, examined.scan
            assert state is not None and scan is not None
            if examined.seal is not None and state.finished and reason is None:
                raise InputError.at(
                    Mark(str(folder.path)),
                    "run-finished",
                    "this run is finished and sealed",
                    "use `planrunner estimate`",
                )
            storage = storage or Storage(durability or examined.run["durability"])
            file = storage.open_existing(folder, journal_lines.NAME)
            if scan.torn:
                storage.truncate(file, scan.size)
                storage.sync(file)
            file.seek(scan.size)
            journal = Journal(storage, file, head=scan.head, count=scan.count, size=scan.size)
            told: JsonObject = {} if examined.seal_digest is None else {"seal": examined.seal_digest}
            if bench is not None:
                told["bench"] = digest(bench)
            if approvals:
                told["approvals"] = list(approvals)
            if check_standard is not None:
                told["check_standard"] = check_standard
            journal.append("reopened", {"repaired_bytes": scan.torn, "reason": reason or "resumed", **told})
            point = settle_break(folder, storage, journal, state)
            return cls(folder, examined.run["run"], storage, lock, journal, point)
        except BaseException as error:
            if file is not None:
                file.close()
            if lock is not None:
                lock.release()
            if isinstance(error, NotOrdinaryError):
                raise IntegrityError(f"{error.filename}: {error.strerror}; {formats.FROM_BACKUP}") from None
            if isinstance(error, OSError):
                message = f"the run folder cannot be written: {error.strerror or error}"
                raise InputError.at(
                    Mark(str(folder.path)), "run-unwritable", message, "free disk space, or change its permissions"
                ) from None
            raise

    # -- state of a reopened run ---------------------------------------------------------------------------------------

    @property
    def next_segment(self) -> int:
        """Returns the index of the first segment that had not been acknowledged when the folder was opened; 0 for a new run."""
        return self._point.next_segment

    @property
    def resume_point(self) -> ResumePoint:
        """Returns the clock and the states from which the run continues."""
        return self._point

    def acknowledged(self, index: int) -> bool:
        """Returns True if a segment had been acknowledged when the folder was opened."""
        return index in self._point.acknowledged

    # -- growing -----------------------------------------------------------------------------------------------------

    def note(self, event: str, **data: Json) -> None:
        """Adds an event about the run as a whole, such as `started`, `failed`, `stopped`, `safe` or `instruments`."""
        self._append(event, data)

    def take_watchdog_report(self) -> None:
        """Enters into the journal the actions that a watchdog has taken since the end of the run. Raises `OSError` if the journal
        cannot be written."""
        report = read_report(self.folder)
        if report is not None:
            self.note("rescued", report=report)
            self.folder.remove(REPORT)

    def begin(
        self, segment: Segment, clock: float, channels: Mapping[str, str], summary: SummaryChannels | None = None
    ) -> None:
        """Begins a segment. `channels`: maps each channel to its unit; empty if nothing is recorded. `summary`: if the segment is
        recorded as a summary, the meaning of the channels' values."""
        index = segment.index
        self._attempt = self._point.attempts[index] = self._point.attempts.get(index, 0) + 1
        self._segment, self._parts, self._samples = segment, [], None
        self._journal.append(
            "begun",
            {
                "segment": index,
                "label": segment.label,
                "attempt": self._attempt,
                "clock": clock,
                "on_break": segment.on_break,
            },
            acknowledge=False,
        )
        if channels:
            stem = file_stem(index, segment.label, self._attempt)
            self._samples = SegmentWriter(
                self._segments,
                stem,
                channels,
                self._storage,
                description={
                    "label": segment.label,
                    "segment": str(index),
                    "attempt": str(self._attempt),
                    **({} if summary is None else {METADATA: to_text(summary)}),
                },
                part_bytes=self.part_bytes,
                part_seconds=self.part_seconds,
            )

    def append(self, block: Block, clock: float) -> None:
        """Adds samples to the segment. Each part that becomes complete is acknowledged by an event."""
        assert self._segment is not None and self._samples is not None
        self._samples.append(block)
        for part in self._samples.take_finished():
            self._parts.append(part)
            data = {"segment": self._segment.index, "attempt": self._attempt, "part": part.to_json(), "clock": clock}
            self._append("part", data)

    def acknowledge(
        self,
        clock: float,
        states: Mapping[str, Json],
        readings: Mapping[str, float],
        *,
        truncated: bool = False,
        reason: str = "",
        frames: Mapping[str, Json] | None = None,
    ) -> None:
        """Finishes the files of the segment, and acknowledges the segment. `clock`, `states`: time and states from which the run
        can continue after this segment. `frames`: frame counts of the sensor."""
        assert self._segment is not None
        parts = self._close_samples()
        event = {
            "segment": self._segment.index,
            "label": self._segment.label,
            "attempt": self._attempt,
            "parts": [part.to_json() for part in parts],
            "clock": clock,
            "readings": finite(readings),
            "states": states,
            "truncated": truncated,
        }
        if truncated:
            event["reason"] = reason
        if frames is not None:
            event["frames"] = frames
        self._append("segment", event)
        self._account(parts)

    def break_off(self, reason: str, clock: float, states: Mapping[str, Json]) -> None:
        """Ends the segment in progress after an interruption; does nothing between segments. The samples of the segment are kept.
        Estimates use these samples if the plan states `on_break: keep`."""
        segment = self._segment
        if segment is None:
            return
        parts = self._keep_what_there_is()
        if segment.on_break == "keep" and any(part.rows for part in parts):
            self.acknowledge(clock, states, {}, truncated=True, reason=reason)
            return
        self.set_aside(reason)

    def set_aside(self, reason: str, frames: Mapping[str, Json] | None = None) -> None:
        """Ends the segment in progress because it is unusable and will be repeated. Its data are kept with the reason."""
        segment = self._segment
        assert segment is not None
        parts = self._keep_what_there_is()
        told: JsonObject = {} if frames is None else {"frames": frames}
        self._append(
            "rejected",
            {
                "segment": segment.index,
                "label": segment.label,
                "attempt": self._attempt,
                "parts": [part.to_json() for part in parts],
                "reason": reason,
                **told,
            },
        )
        self._account(parts)

    def reject(self, index: int, reason: str) -> None:
        """Rejects an acknowledged segment, so that it is repeated. Its data are kept with the reason."""
        item = self._point.acknowledged.pop(index)
        parts = [part.to_json() for part in item.parts]
        data = {"segment": index, "label": item.label, "attempt": item.attempt, "parts": parts, "reason": reason}
        self._append("rejected", data)

    def finish(self) -> None:
        """Finishes the run after every segment has been acknowledged: writes the last event, enters the seal into the log of the
        archive if there is one, and seals the folder."""
        if self.witness is not None:
            self.witness.see(self._journal.count, self._journal.last, last=True)
            self._keep(self.witness.take(wait=True))
        self._journal.append("finished", {"finished": utc_now()})
        seal = seals.seal_of(self.folder, self._name, self._point.files, self._journal.head, self._journal.count)
        self._enter("sealed", seal=digest(seal))
        self._storage.write_whole(self.folder, seals.NAME, seal)

    def close(self) -> None:
        """Releases the folder. A segment in progress remains in the same state as after a crash."""
        try:
            self._drop_samples()
        finally:
            with contextlib.suppress(OSError):
                self._journal.close()
            self._lock.release()

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _append(self, event: str, data: Mapping[str, Json]) -> None:
        """Adds an event that is acknowledged, together with the time stamps that have arrived."""
        self._journal.append(event, data)
        if self.witness is not None:
            self._keep(self.witness.take())
            self.witness.see(self._journal.count, self._journal.last)

    def _keep(self, stamps: Sequence[Witnessed]) -> None:
        """Stores time stamps of the journal in the run folder, and records them in the journal."""
        for stamp in stamps:
            if stamp.token is None:
                self._journal.append("unstamped", {"events": stamp.events, "reason": stamp.why})
                continue
            file = keep_stamp(self.folder, self._storage, f"after-{stamp.events}", stamp.token)
            data = {"events": stamp.events, "file": file, "sha256": digest(stamp.token), "time": stamp.at}
            self._journal.append("stamped", data)

    def _enter(self, event: LogEvent, seal: str = "") -> None:
        """Adds an entry about the run to the log of its archive, if there is one. Raises `OSError`, and `IntegrityError` for a log
        that was changed."""
        log = RunLog.of(self.path.parent, self._storage)
        if log is not None:
            log.append(event, self._name, events=self._journal.count, head=self._journal.head, seal=seal)

    def _account(self, parts: list[Part]) -> None:
        """Records the end of the segment in the journal. The event names the segment's files."""
        self._point.files.update((part.file, part.sha256) for part in parts)
        self._segment = None

    def _close_samples(self) -> list[Part]:
        if self._samples is not None:
            self._parts.extend(self._samples.close())
            self._samples = None
        return self._parts

    def _keep_what_there_is(self) -> list[Part]:
        """Finishes the file of samples in progress, as far as errors of the disk permit. Returns all parts of the segment."""
        if self._samples is not None and self._samples.rows:
            try:
                self._close_samples()
            except OSError:  # finished parts are on the disk; the rest is lost
                self._drop_samples()
        return self._drop_samples()

    def _drop_samples(self) -> list[Part]:
        """Discards the file of samples in progress; returns the finished parts of the segment."""
        if self._samples is not None:
            samples, self._samples = self._samples, None
            self._parts.extend(samples.take_finished())
            samples.abandon()
        return self._parts
