"""Collects everything that a reviewer must judge before a run is released."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date, datetime
from pathlib import Path

from planrunner.archive.analyses import StoredAnalysis, chosen_analysis
from planrunner.archive.journal import JournalScan
from planrunner.archive.recording import RecordedSegment
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import examine, open_run
from planrunner.base.documents import Json
from planrunner.base.findings import count_of
from planrunner.base.progress import Announce
from planrunner.estimators.results import Results
from planrunner.observation.screening import watch_of
from planrunner.reporting.certificate_requirements import references
from planrunner.reporting.review_page import DigestedFile, ReviewContext, RunDeviation
from planrunner.signing.key_ring import KeyRing
from planrunner.tasks.amendment import in_words, stored_amendment
from planrunner.tasks.approvals import run_approvals
from planrunner.tasks.check import Sound
from planrunner.tasks.estimate import evaluated_as, report_context, stored_results
from planrunner.tasks.verify import verification, verify_evaluations, verify_signatures

UNUSUAL = ("noticed", "paused", "rescued", "failed", "stopped", "reopened")
"""Kinds of events that a reviewer must read."""


def review_of(
    run: Path, number: int | None = None, notice: Announce | None = None, ring: KeyRing | None = None
) -> ReviewContext:
    """Returns the data for the review page of a run and one of its analyses. `number`: the analysis; by default, the newest.
    `ring`: the user's key ring.

    Raises `InputError` if the run has no such analysis, and `IntegrityError` if the folder was changed; `planrunner verify` then
    shows the changes.
    """
    found = examine(open_run(run), samples="digests")
    reader = RunReader.of(found)
    verify_signatures(found, ring)
    run_approvals(found, ring)
    evaluations = verify_evaluations(found, ring)
    analysis = chosen_analysis(run, reader.analyses, number)
    sound = evaluated_as(reader, analysis)
    recording = reader.recording(sound.schedule, watch_of(sound.sensor), notice)
    results = stored_results(analysis)
    report = report_context(
        reader,
        sound,
        recording,
        results,
        analysis=str(analysis.number),
        analysed=str(analysis.digests["made"]),
        ring=ring,
    )
    changes = [RunDeviation(change, item.message, grave=True) for change, item in verification(found).changes]
    parts = {part.file: item.label for item in reader.rejected() for part in item.parts}
    parts |= {part.file: kept.label for kept in reader.acknowledged() for part in kept.parts}
    files = [DigestedFile(name, str(value)) for name, value in reader.state.created["files"].items()]
    if reader.basis.seal is not None:
        files.append(DigestedFile("seal.json", reader.basis.seal))
    files += [
        DigestedFile(part.file, part.sha256, parts.get(part.file, ""), part.bytes) for part in found.files.values()
    ]
    files += [
        DigestedFile(f"analyses/{analysis.number}/{name}", str(value))
        for name, value in analysis.digests["files"].items()
    ]
    uncovered = [
        RunDeviation("not approved", f"the evaluation of analysis {one.analysis} is {one.words}", grave=True)
        for one in evaluations
        if one.analysis == analysis.number and not one.covered and not one.fault
    ]
    deviations = (*changes, *uncovered, *_deviations(reader, sound, recording, results, analysis))
    return ReviewContext(report, deviations, tuple(files), tuple(_events(reader)))


def _deviations(
    reader: RunReader,
    sound: Sound,
    recording: tuple[RecordedSegment, ...],
    results: Results,
    analysis: StoredAnalysis,
) -> Iterator[RunDeviation]:
    if not reader.sealed:
        yield RunDeviation("not sealed", "the run is not finished and sealed: more data may follow", grave=True)
    for text in reader.state.failures:
        yield RunDeviation("fault", text)
    for name, why in results.failures.items():
        yield RunDeviation("no result", f"{name}: {why}", estimate=name, grave=True)
    held = {item.index for item in reader.acknowledged()}
    for segment in sound.schedule.segments:
        if segment.index not in held:
            yield RunDeviation("not recorded", "planned, but not recorded", segment.label, grave=True)
    if sound.models.origin == "simulated":
        yield RunDeviation("simulated", "at least one instrument is simulated, so no item was measured", grave=True)
    for item in reader.rejected():
        yield RunDeviation(
            "recorded again", f"attempt {item.attempt} is not used: {item.reason or 'no reason given'}", item.label
        )
    for kept in reader.acknowledged():
        if kept.truncated:
            yield RunDeviation("shortened", kept.reason or "shorter than planned", kept.label)
    for recorded in recording:
        bad = [one for one in recorded.finds or () if one.bad]
        if bad:
            kinds = ", ".join(sorted({one.kind.value for one in bad}))
            rows = sum(one.rows for one in bad)
            yield RunDeviation("left out", f"{count_of(rows, 'sample')} left out ({kinds})", recorded.label)
        if recorded.statistics.rejected:
            yield RunDeviation(
                "left out",
                f"{count_of(int(recorded.statistics.rejected), 'sample')} without a valid value",
                recorded.label,
            )
    yield from _calibrations(sound, datetime.fromisoformat(str(reader.run["created"])).date())
    for finding in sound.findings:
        if finding.severity == "warning":
            yield RunDeviation("warning of the check", f"{finding.message} ({finding.code})")
    for estimate in results.estimates.values():
        for warning in estimate.warnings:
            yield RunDeviation("warning", str(warning), estimate=estimate.name)
    for one in reader.analyses:
        amendment = stored_amendment(one)
        if amendment is not None:
            yield RunDeviation("amendment", f"analysis {one.number} {in_words(amendment)}")
    newest = reader.analyses[-1].number
    if analysis.number != newest:
        yield RunDeviation("newer analysis", f"this page shows analysis {analysis.number}; the newest is {newest}")


def _calibrations(sound: Sound, performed: date) -> Iterator[RunDeviation]:
    """Yields a deviation for each item (instrument or site) with a calibration that was no longer valid on the day on which the run
    began."""
    for item in references(sound.bench):
        due = "" if item.calibration is None else item.calibration.due or ""
        try:
            expired = bool(due) and date.fromisoformat(due) < performed
        except ValueError:
            continue  # reported by the check
        if expired:
            yield RunDeviation("calibration expired", f"{item.name}: due on {due}, the run was on {performed}")


def _events(reader: RunReader) -> Iterator[tuple[str, str, str]]:
    for event in JournalScan(reader.folder):
        if event["event"] in UNUSUAL:
            yield str(event["at"])[:19].replace("T", " "), str(event["event"]), _told(event)


def _told(event: Mapping[str, Json]) -> str:
    known = ("seq", "at", "event", "previous", "clock", "seal")
    return ", ".join(
        f"{name}: {value}" for name, value in event.items() if name not in known and value not in ("", None)
    )
