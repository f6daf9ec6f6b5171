"""Reading a run folder: what was run, which segments count, their statistics in one pass, and their samples in
blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from planrunner.archive import formats
from planrunner.archive import journal as journal_lines
from planrunner.archive import seal as seals
from planrunner.archive.analyses import analyses, check_analysis
from planrunner.archive.integrity import IntegrityError
from planrunner.archive.journal_state import Acknowledged, JournalState, Rejected, read_state
from planrunner.archive.recording import RecordedSegment
from planrunner.archive.segment_file import read_part, units_of
from planrunner.archive.statistics import statistics_of
from planrunner.archive.storage import digest_file
from planrunner.instruments.interfaces import Block
from planrunner.plan.findings import InputError, Mark
from planrunner.plan.schedule import Schedule


@dataclass(frozen=True)
class RunReader:
    """A run folder as it stands. `run`: the content of run.json. Reading changes nothing and needs no lock."""

    path: Path
    run: dict[str, Any]
    seal: dict[str, Any] | None
    state: JournalState
    torn: int

    @classmethod
    def open(cls, path: Path) -> RunReader:
        """Checks run.json, the journal's chain, the seal and the digests of plan and bench; samples are checked as
        they are read.

        Raises `InputError` when `path` is not a run folder and `IntegrityError` when it is not as it was written. A
        torn last line of a run that was killed is left out.
        """
        if not (path / journal_lines.NAME).is_file() and not (path / "run.json").is_file():
            hint = "give a folder beneath runs/"
            raise InputError.at(Mark(str(path)), "run-not-found", "this is not a run folder", hint)
        run = formats.read_json(path / "run.json", "run", "planrunner_run", formats.RUN_FORMAT)
        state, scan = read_state(path / journal_lines.NAME)
        seal = seals.read_seal(path)
        if seal is not None:
            seals.check_seal(path, seal, scan, state)
        reader = cls(path, run, seal, state, scan.torn)
        for name, expected in state.created["files"].items():
            reader._check(name, expected)
        return reader

    # -- what was run --------------------------------------------------------------------------------------------------

    @property
    def plan_bytes(self) -> bytes:
        return (self.path / "plan.yaml").read_bytes()

    @property
    def bench_bytes(self) -> bytes:
        return (self.path / "bench.yaml").read_bytes()

    @property
    def instruments(self) -> dict[str, dict[str, str]]:
        """Instrument name → what it said of itself."""
        return self.state.instruments

    @property
    def sealed(self) -> bool:
        """Whether the run is finished and sealed."""
        return self.seal is not None and self.state.finished

    def acknowledged(self) -> tuple[Acknowledged, ...]:
        """The segments that count, in the schedule's order."""
        return tuple(self.state.acknowledged[index] for index in sorted(self.state.acknowledged))

    def rejected(self) -> tuple[Rejected, ...]:
        """Data that were kept but do not count, with the reason."""
        return tuple(self.state.rejected)

    def analyses(self) -> tuple[Path, ...]:
        """Folders of the analyses, oldest first."""
        return analyses(self.path)

    # -- samples -------------------------------------------------------------------------------------------------------

    def recording(self, schedule: Schedule) -> tuple[RecordedSegment, ...]:
        """The acknowledged segments with statistics, each file read once; in the schedule's order.

        schedule: made from the run's own plan and bench. Raises `IntegrityError` where it does not fit what was
        recorded.
        """
        segments = []
        for item in self.acknowledged():
            if item.index >= len(schedule.segments) or schedule.segments[item.index].label != item.label:
                message = f"segment {item.index + 1} was recorded as '{item.label}', which the plan does not have there"
                raise IntegrityError(f"{self.path}: {message}; was planrunner updated since?")
            units = units_of(self.path, item.parts[0]) if item.parts else {}
            read = partial(self.blocks, item)
            rows = sum(part.rows for part in item.parts)
            readings = {name: float("nan") if value is None else float(value) for name, value in item.readings.items()}
            statistics = statistics_of(read(tuple(units)), tuple(units), rows)
            segment = schedule.segments[item.index]
            segments.append(RecordedSegment(segment, units, statistics, read, item.truncated, readings))
        return tuple(segments)

    def blocks(self, item: Acknowledged, channels: Sequence[str] | None = None) -> Iterator[Block]:
        """The samples of a segment in blocks of bounded size; `channels` None for all."""
        for part in item.parts:
            yield from read_part(self.path, part, channels)

    # -- integrity -----------------------------------------------------------------------------------------------------

    def check_digests(self) -> int:
        """Hold every recorded file and analysis against its digest; returns how many files were checked. Raises
        `IntegrityError`."""
        files: dict[str, str] = {part.file: part.sha256 for part in self.state.files()}
        files |= self.state.created["files"]
        if self.seal is not None:
            files |= {name: value for name, value in self.seal["files"].items() if name != journal_lines.NAME}
        for name, expected in files.items():
            self._check(name, expected)
        for folder in self.analyses():
            check_analysis(folder)
        return len(files)

    def check_events(self) -> int:
        """Hold every event of the journal against its whole schema; returns how many. Raises `IntegrityError`."""
        path = self.path / journal_lines.NAME
        scan = journal_lines.JournalScan(path)
        for event in scan:
            fault = formats.check_event(event)
            if fault is not None:
                raise IntegrityError(f"{path}:{scan.count}: {fault}")
        return scan.count

    def _check(self, name: str, expected: str) -> None:
        path = self.path / name
        try:
            found = digest_file(path)
        except OSError as error:
            raise IntegrityError(f"{path}: cannot be read: {error.strerror}; take the file from a backup") from None
        if found != expected:
            raise IntegrityError(f"{path}: differs from what was recorded (SHA-256); take the file from a backup")
