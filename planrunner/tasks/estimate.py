"""Evaluates the recording of a run: makes the estimates, applies the limits, makes the reports, and stores all of this as a new
analysis of the run. Also reads and recomputes the results of stored analyses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Literal

from planrunner.archive.analyses import Basis, StoredAnalysis, add_analysis
from planrunner.archive.formats import IntegrityError, from_bytes, to_bytes
from planrunner.archive.provenance import computed_with
from planrunner.archive.recording import RecordedSegment, duration_of
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import APPROVALS, open_run
from planrunner.base.documents import Json
from planrunner.base.findings import Finding, InputError
from planrunner.base.progress import Announce
from planrunner.base.workers import ALONE, Workers
from planrunner.bench.model import Bench
from planrunner.estimators.analysis import analyse
from planrunner.estimators.results import NAME as RESULTS
from planrunner.estimators.results import Results, comparable
from planrunner.observation.screening import watch_of
from planrunner.reporting import words
from planrunner.reporting.certificate_requirements import is_certificate
from planrunner.reporting.context import CertificateFacts, PrintedSignature, ReportContext, SegmentSummary
from planrunner.reporting.verdict import Headline
from planrunner.reporting.view import render_report
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.run_signatures import SignatureStanding, bench_signing, signatures_of
from planrunner.tasks.amendment import (
    AMENDMENT,
    EVALUATED_PLAN,
    Amendment,
    amended_analysis,
    checked_amendment,
    in_words,
    require_same_measurement,
)
from planrunner.tasks.approvals import approved_by
from planrunner.tasks.bench_signature import key_of, sign_analysis
from planrunner.tasks.certify import ISSUED, facts, issued_as, not_before, obstacles, recorded_information
from planrunner.tasks.check import Document, Sound, check_plan
from planrunner.tasks.evaluation_approvals import approvals_of_amended

FILES = ("plan.yaml", "bench.yaml")


@dataclass(frozen=True, slots=True)
class Analysis:
    """Contains an analysis of a run: its folder and its results.

    `withheld`: reasons why certificates that the plan requests were not written. `remarks`: notes about the run folder. `before`:
    number of the previous analysis, if there is one. `same`: True if this analysis and the previous analysis have equal results.
    `unsigned`: the reason why the bench did not sign the analysis although it should have; empty otherwise.
    """

    folder: Path
    results: Results
    headline: Headline
    reports: tuple[Path, ...]
    withheld: tuple[Finding, ...] = ()
    remarks: tuple[Finding, ...] = ()
    before: int | None = None
    same: bool = False
    unsigned: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class Evaluated:
    """Contains an analysis that has been computed but not written.

    `bench`: the bench of the run; a bench that signs its runs also signs the analysis. `basis`: the state of the journal and the
    seal from which the analysis was made. `files`: maps the name of each file to its contents. `reports`: names of the files that
    are reports. The other attributes have the same meaning as in `Analysis`.
    """

    run: Path
    bench: Bench
    basis: Basis
    files: Mapping[str, bytes]
    reports: tuple[str, ...]
    results: Results
    headline: Headline
    withheld: tuple[Finding, ...]
    remarks: tuple[Finding, ...]
    before: int | None
    same: bool


@dataclass(frozen=True, slots=True)
class Issue:
    """Describes a request for reports after a run: the names of the reports, the run information given with the request, and an
    earlier run. The earlier run is the folder of a run of the same item, made before the item was adjusted. `ring`: the user's key
    ring; used to verify the signatures that a report shows."""

    reports: tuple[str, ...] = ()
    given: Mapping[str, str] = field(default_factory=dict)
    before: Path | None = None
    ring: KeyRing | None = None


def analyse_run(
    run: Path,
    issue: Issue | None = None,
    checked: Sound | None = None,
    notice: Announce | None = None,
    amendment: Amendment | None = None,
) -> Analysis:
    """Makes the estimates from the recording of a run, and writes the results and reports as a new analysis.

    `checked`: the checked plan of this run; it is not checked again if the folder contains the same plan and bench. `notice`:
    receives the progress of reading.

    `issue`: the reports to make, and run information for them; by default, the reports that the plan requests. A certificate that
    only the plan requests is withheld if it cannot be issued. If `issue` requests a certificate that cannot be issued, `InputError`
    with all obstacles is raised.

    `amendment`: states who makes the analysis and why; it is stored with the analysis. If the amendment has a plan, the estimates
    and limits of this plan replace those of the run's plan.
    """
    return keep(evaluate_run(run, issue, checked, notice, amendment))


def evaluate_run(
    run: Path,
    issue: Issue | None = None,
    checked: Sound | None = None,
    notice: Announce | None = None,
    amendment: Amendment | None = None,
    workers: Workers = ALONE,
) -> Evaluated:
    """Does the same as `analyse_run`, and raises the same errors, but writes nothing. Afterwards, `keep` stores the result as an
    analysis of the run. The evaluation may run in one process and `keep` in another. `workers`: processes that share the Monte
    Carlo draws."""
    issue = issue or Issue()
    amendment = None if amendment is None else checked_amendment(amendment)
    made = _analyse(run, issue, checked, notice, kept=True, amendment=amendment, workers=workers)
    reports = tuple(dict.fromkeys(issue.reports or made.sound.plan.report))
    withheld: tuple[Finding, ...] = ()
    if any(is_certificate(name) for name in reports):
        withheld = tuple(_obstacles(made, issue))
        if withheld and issue.reports:
            raise InputError(withheld)
        reports = tuple(name for name in reports if not withheld or not is_certificate(name))
    files = {RESULTS: to_bytes({**made.results.to_json(), "computed_with": computed_with()})}
    files |= made.amending
    for report in reports:
        files[report] = render_report(made.context, report).encode()
    if any(is_certificate(name) for name in reports):
        files[ISSUED] = to_bytes(issued_as(made.shown))
    earlier = made.reader.analyses[-1] if made.reader.analyses else None
    same = earlier is not None and comparable(_read_results(earlier)) == comparable(from_bytes(files[RESULTS]))
    before = None if earlier is None else earlier.number
    return Evaluated(
        run,
        made.sound.bench,
        made.reader.basis,
        files,
        reports,
        made.results,
        made.context.headline,
        withheld,
        made.reader.findings,
        before,
        same,
    )


def keep(made: Evaluated, *, elsewhere: bool = False) -> Analysis:
    """Writes an evaluation to the folder of its run, as a new analysis. `elsewhere`: True if another computer made the evaluation;
    the bench then does not sign it."""
    # Only a signature needs the run once more. Reading its journal takes most of the time that an analysis takes here.
    reader = None if key_of(made.bench) is None else RunReader.open(made.run)
    stored = add_analysis(open_run(made.run) if reader is None else reader.folder, made.files, made.basis)
    unsigned: tuple[Finding, ...] = ()
    if reader is not None:
        reader = replace(reader, basis=made.basis)
        unsigned = sign_analysis(reader, made.bench, stored, made.results, elsewhere=elsewhere)
    paths = tuple(stored.path / name for name in made.reports)
    return Analysis(
        stored.path, made.results, made.headline, paths, made.withheld, made.remarks, made.before, made.same, unsigned
    )


def report_through(run: Path, template: Path, issue: Issue | None = None, notice: Announce | None = None) -> str:
    """Renders the results of a run with a user's template; writes nothing to the run folder."""
    made = _analyse(run, issue or Issue(), notice=notice)
    return render_report(made.context, template.name.removesuffix(".j2"), template.parent)


def sound_run(reader: RunReader, today: date | None = None, bench: Document | None = None) -> Sound:
    """Checks the plan and the bench of a run folder in the same way as before the run, and returns them. Raises `InputError` if the
    plan and the bench no longer pass the checks.

    `today`: the day on which calibrations must be valid; by default, the day of the run. `bench`: bench file to use instead of the
    one in the folder.
    """
    made = datetime.fromisoformat(reader.run["created"]).astimezone().date()
    plan = Document(reader.plan_bytes, str(reader.path / "plan.yaml"))
    bench = bench or Document(reader.bench_bytes, str(reader.path / "bench.yaml"))
    return check_plan(plan, bench, today or made).sound()


def evaluated_as(reader: RunReader, analysis: StoredAnalysis) -> Sound:
    """Returns the checked plan and bench of a run. If the analysis used an amended plan, returns this plan instead of the plan of
    the run. Raises `InputError` if that plan no longer passes its checks, and `IntegrityError` if a file of the run was changed."""
    if EVALUATED_PLAN not in analysis.files:
        return sound_run(reader)
    return _evaluated(reader, Document(analysis.read(EVALUATED_PLAN), str(analysis.path / EVALUATED_PLAN)))


def recompute(
    reader: RunReader, analysis: StoredAnalysis, notice: Announce | None = None, workers: Workers = ALONE
) -> Results:
    """Recomputes the results from the samples, with the plan that the analysis used; writes nothing. `workers`: processes that
    share the Monte Carlo draws. Raises `IntegrityError` if a file of the run was changed."""
    return _estimated(reader, evaluated_as(reader, analysis), notice, workers)[1]


def stored_results(analysis: StoredAnalysis) -> Results:
    """Returns the results stored in an analysis. Raises `IntegrityError` if the stored results were changed."""
    try:
        return Results.from_json(_read_results(analysis), str(analysis.path / RESULTS))
    except (InputError, AttributeError, OverflowError) as error:  # as no version wrote it
        raise IntegrityError(f"{analysis.path / RESULTS}: not a results file of planrunner: {error}") from None


def _read_results(analysis: StoredAnalysis) -> Json:
    """Returns the stored results of an analysis as JSON data. Results that older versions stored may lack keys that the present
    schema requires. Raises `IntegrityError` if the results were changed."""
    try:
        return from_bytes(analysis.read(RESULTS))
    except ValueError as error:
        raise IntegrityError(f"{analysis.path / RESULTS}: not JSON: {str(error)[:200]}; estimate again") from None


def computed_by(analysis: StoredAnalysis) -> tuple[Json, dict[str, str]]:
    """Returns the stored results of an analysis as JSON data, and the versions of the software that computed them, if these
    versions are stored. Raises `IntegrityError` if the results were changed."""
    data = _read_results(analysis)
    stated = data.get("computed_with", {}) if isinstance(data, Mapping) else {}
    return data, {str(name): str(version) for name, version in stated.items()}


@dataclass(frozen=True, slots=True)
class _Made:
    reader: RunReader
    sound: Sound
    results: Results
    context: ReportContext
    shown: CertificateFacts
    amending: dict[str, bytes]


def _analyse(
    run: Path,
    issue: Issue,
    checked: Sound | None = None,
    notice: Announce | None = None,
    *,
    kept: bool = False,
    amendment: Amendment | None = None,
    workers: Workers = ALONE,
) -> _Made:
    """Makes the analysis of a run without writing it. `kept`: True if the result will be stored as the next analysis of the run;
    the reports then show the number of this analysis."""
    reader = RunReader.open(run)
    same = checked is not None and (checked.plan_bytes, checked.bench_bytes) == (reader.plan_bytes, reader.bench_bytes)
    sound = checked if checked is not None and same else sound_run(reader)
    amending, stated = {}, ""
    if amendment is not None:
        facts_of = amendment.to_json(amended_analysis(reader, amendment))
        amending, stated = {AMENDMENT: to_bytes(facts_of)}, in_words(facts_of)
        if amendment.plan is not None:
            sound = _evaluated(reader, amendment.plan)
            amending[EVALUATED_PLAN] = amendment.plan.data
            own = approvals_of_amended(reader, sound.plan, sound.bench, Path(amendment.plan.shown))
            if own is not None:
                amending[APPROVALS] = own
            if sound.bench.approvals is not None:
                stated += "; " + ("its plan was approved" if own is not None else "its plan was NOT approved")
    recording, results = _estimated(reader, sound, notice, workers)
    before = None if issue.before is None else _analyse(issue.before, Issue(), notice=notice)
    shown = facts(
        reader,
        sound,
        recording,
        issue.given,
        None if before is None else before.results.estimates,
        "" if before is None else before.reader.run["run"],
    )
    earlier = reader.analyses
    number = str(earlier[-1].number + 1 if earlier else 1) if kept else ""
    context = report_context(
        reader, sound, recording, results, analysis=number, certificate=shown, amendment=stated, ring=issue.ring
    )
    return _Made(reader, sound, results, context, shown, amending)


def _evaluated(reader: RunReader, plan: Document) -> Sound:
    """Returns the bench of a run and a plan with other estimates or limits, after checking both. Raises `InputError` if this plan
    differs from the plan of the run in anything else."""
    made = datetime.fromisoformat(reader.run["created"]).astimezone().date()
    bench = Document(reader.bench_bytes, str(reader.path / "bench.yaml"))
    sound = check_plan(plan, bench, made).sound()
    require_same_measurement(sound_run(reader), sound)
    return sound


def _estimated(
    reader: RunReader, sound: Sound, notice: Announce | None, workers: Workers
) -> tuple[tuple[RecordedSegment, ...], Results]:
    """Reads the recording of a run, and computes the results from it. Only one thread computes, because the last digits of sums may
    depend on the number of threads."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        recording = reader.recording(sound.schedule, watch_of(sound.sensor), notice)
        setup = replace(sound.setup, information=recorded_information(reader))
        results = analyse(
            sound.plan.estimates, sound.plan.limits, recording, sound.models.site, sound.sensor, setup, notice, workers
        )
    return recording, replace(results, origin=sound.models.origin)


def _obstacles(made: _Made, issue: Issue) -> list[Finding]:
    found = obstacles(made.reader, made.sound, made.results, made.shown)
    return (
        found if issue.before is None else [*found, *not_before(made.shown, made.reader, RunReader.open(issue.before))]
    )


def report_context(
    reader: RunReader,
    sound: Sound,
    recording: Iterable[RecordedSegment],
    results: Results,
    *,
    analysis: str = "",
    analysed: str | None = None,
    certificate: CertificateFacts | None = None,
    amendment: str = "",
    ring: KeyRing | None = None,
) -> ReportContext:
    """Returns all data that a report shows for one analysis. `ring`: the user's key ring; used to verify the signatures of the run.

    `amendment`: a text that states who amends which analysis and why.

    `analysis`: number of the analysis, if known. `analysed`: time of the analysis, UTC in ISO 8601; by default, now.
    """
    segments = tuple(SegmentSummary.of(item) for item in recording)
    moment = analysed or datetime.now(UTC).isoformat(timespec="seconds")
    return ReportContext(
        title=sound.plan.title,
        description=" ".join(sound.plan.description.split()),
        run_information={
            "run": reader.run["run"],
            **{name: _text(value) for name, value in reader.run["info"].items()},
        },
        bench=_bench(sound),
        instruments={name: _identity(sound, name, said) for name, said in reader.instruments.items()},
        site=sound.models.site,
        segments=segments,
        estimates=tuple(results.estimates.values()),
        limits=tuple(results.limits),
        failures=results.failures,
        warnings=tuple(reader.warnings(len(sound.schedule.segments))),
        provenance=provenance(reader, analysis, moment, seeded=_seeded(sound)) | _approvals(reader),
        on_top=dict(_on_top(reader, segments, analysis)) | ({"amendment": amendment} if amendment else {}),
        origin=sound.models.origin,
        certificate=certificate,
        seal=reader.basis.seal or "",
        signatures=tuple(printed_signatures(reader, ring)),
    )


def printed_signatures(reader: RunReader, ring: KeyRing | None) -> Iterator[PrintedSignature]:
    """Returns the signatures of a run in their present state, for a report. Raises `OSError` if a signature cannot be read."""
    signing = bench_signing(reader.bench_bytes, reader.state.earlier_seals)
    for one in signatures_of(reader.folder, ring, signing):
        yield PrintedSignature(
            one.meaning, one.name, one.signed, one.key, one.analyses, _PRINTED[one.standing], one.owner, one.why
        )


_PRINTED: dict[SignatureStanding, Literal["valid", "unknown", "invalid"]] = {
    "valid": "valid",
    "unknown key": "unknown",
    "invalid": "invalid",
}


def _bench(sound: Sound) -> dict[str, str]:
    """Returns the bench as its file describes it, and the ambient conditions of the room if the file states any."""
    bench, room = sound.bench, sound.bench.ambient
    stated = (
        {} if room is None else {"temperature": room.temperature, "pressure": room.pressure, "humidity": room.humidity}
    )
    facts = {"name": bench.name, "description": " ".join(bench.description.split())}
    return facts | {f"ambient {name}": str(value) for name, value in stated.items() if value is not None}


def _identity(sound: Sound, name: str, said: Mapping[str, str]) -> dict[str, str]:
    """Returns the identity that an instrument reports, and the asset number of the instrument from the bench file."""
    entry = sound.bench.instruments.get(name)
    return {**said, "asset": entry.asset} if entry is not None and entry.asset else dict(said)


def _seeded(sound: Sound) -> bool:
    """Returns True if the seed of the run had an effect, that is, if this program simulated an instrument."""
    return sound.models.origin == "simulated" and sound.bench.simulation is None


def _on_top(reader: RunReader, segments: Sequence[SegmentSummary], analysis: str) -> Iterator[tuple[str, str]]:
    """Yields the facts at the top of a report. These facts are the item, the operator, the date, and the duration from the first
    sample to the last. The number of the analysis is added, with the number of analyses that existed when this analysis was
    made."""
    info = {name: _text(value) for name, value in reader.run["info"].items()}
    for name in ("device_serial", "item_identification"):
        if info.get(name):
            yield name, info[name]
    yield "operator", info.get("operator") or "not stated"
    began = str(reader.run["created"])
    ended = "" if reader.seal is None else str(reader.seal["sealed"])
    yield "run (UTC)", _minute(began) + (f" to {_minute(ended, began)}" if ended else ", not finished")
    lasted = duration_of(item.statistics for item in segments if item.statistics is not None)
    if lasted is not None:
        yield "duration of the measurements", words.duration(lasted)
    if reader.approvals is not None:
        yield "plan approved by", ", ".join(name for name, _ in approved_by(reader))
    if analysis:
        yield "analysis", f"{analysis} (of {max(int(analysis), len(reader.analyses))} when this report was written)"


def _approvals(reader: RunReader) -> dict[str, str]:
    """Returns the approvals under which the plan ran."""
    return {f"approval {number} of the plan": text for number, (_, text) in enumerate(approved_by(reader), 1)}


def _minute(moment: str, before: str = "") -> str:
    """Returns a time in ISO 8601 in the form `2026-03-01 08:11`. The date is omitted if the time `before` has the same date."""
    text = moment[:16].replace("T", " ")
    return text[11:] if before[:10] == moment[:10] else text


def provenance(reader: RunReader, analysis: str, analysed: str, *, seeded: bool = True) -> dict[str, str]:
    """Returns the origin of the results: times, digests and versions of the run. The corresponding values of the analysis are added
    if they differ from the values of the run. `seeded`: True if the seed of the run had an effect."""
    from planrunner.archive.provenance import versions

    facts = {"analysis": analysis} if analysis else {}
    facts |= {"recording started (UTC)": str(reader.run["created"]), "analysed (UTC)": analysed}
    if reader.seal is not None:
        facts["sealed (UTC)"] = str(reader.seal["sealed"])
        facts["seal.json (SHA-256)"] = str(reader.basis.seal)
        facts["journal head (SHA-256)"] = str(reader.seal["journal"]["head"])
    digests = reader.state.created.get("files", {})
    facts |= {f"{name} (SHA-256)": str(digests[name]) for name in FILES if name in digests}
    if seeded and reader.run["seed"] is not None:
        facts["seed of simulated noise"] = str(reader.run["seed"])
    ran, now = reader.run["versions"], versions()
    for name in {**ran, **now}:
        first, second = ran.get(name, "none"), now.get(name, "none")
        facts[name] = first if first == second else f"{first} when run, {second} when analysed"
    return facts


def _text(value: Json) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {_text(item)}" for name, item in value.items())
    return str(value)
