"""Runs a plan from start to finish: check the plan → open the bench → execute → estimate → report.

The layers are independent of each other; this module combines them for the command line and for other programs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import date, datetime
from pathlib import Path

from planrunner.archive.analyses import Basis, StoredAnalysis, add_analysis
from planrunner.archive.formats import IntegrityError, from_bytes, to_bytes
from planrunner.archive.lock import FolderLock
from planrunner.archive.origin import foreign
from planrunner.archive.provenance import computed_with
from planrunner.archive.recording import RecordedSegment
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.space import recording_bytes, require_space
from planrunner.archive.storage import Durability
from planrunner.archive.verifying import APPROVALS, Examined, examine, open_run
from planrunner.base.documents import Json
from planrunner.base.findings import Finding, Findings, InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.progress import Announce
from planrunner.base.workers import ALONE, Workers
from planrunner.bench.attendance import check_unattended
from planrunner.bench.model import Bench, locate, runs_on_virtual_clock
from planrunner.bench.opening import NotSafeError, OpenBench, guarded_bench
from planrunner.bench.replacing import REACHED_BY, addresses, other_than_reached
from planrunner.estimators.analysis import analyse
from planrunner.estimators.results import NAME, Results, comparable
from planrunner.execution.executor import Outcome, execute
from planrunner.execution.operator import Operator
from planrunner.execution.progress import ProgressCallback
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import Foresees, InstrumentError, PlaysBack, UnservedError
from planrunner.observation.screening import watch_of
from planrunner.plan import source
from planrunner.plan.selection import closest_label
from planrunner.reporting.certificate_requirements import is_certificate
from planrunner.reporting.context import CertificateFacts, ReportContext
from planrunner.reporting.verdict import Headline
from planrunner.reporting.view import render_report
from planrunner.signing.key_ring import KeyRing
from planrunner.tasks.amendment import (
    AMENDMENT,
    EVALUATED_PLAN,
    Amendment,
    amended_analysis,
    checked_amendment,
    in_words,
    require_same_measurement,
)
from planrunner.tasks.approvals import still_approved
from planrunner.tasks.bench_signature import key_of, sign_analysis, sign_seal
from planrunner.tasks.certify import ISSUED, facts, issued_as, not_before, obstacles, recorded_information
from planrunner.tasks.check import Document, Sound, check_plan
from planrunner.tasks.check_standard import Admission, Override, admit, admit_again
from planrunner.tasks.evaluation_approvals import approvals_of_amended
from planrunner.tasks.report import report_context
from planrunner.tasks.stamp import after_sealing, stamper_of

RESULTS = NAME


@dataclass(frozen=True, slots=True)
class Analysis:
    """Contains an analysis of a run: its folder and its results.

    `withheld`: reasons why certificates that the plan requests were not written. `remarks`: notes about the run folder. `before`:
    number of the previous analysis, if there is one. `same`: True if the numbers of this analysis are equal to those of the
    previous analysis. `unsigned`: the reason why the bench did not sign the analysis although it should have; empty otherwise.
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

    `bench`: the bench of the run; if it signs its runs, it also signs the analysis. `basis`: the state of the journal and the seal
    from which the analysis was made. `files`: maps the name of each file to its contents. `reports`: names of the files that are
    reports. The other attributes have the same meaning as in `Analysis`.
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
class Retake:
    """Names recorded segments to reject and repeat: their labels, and the reason."""

    labels: tuple[str, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class Issue:
    """Describes a request for reports after a run: the names of the reports, the run information given with the request, and an
    earlier run. The earlier run is the folder of a run of the same item, made before the item was adjusted. `ring`: key ring with
    the keys that the user knows; it verifies the signatures that a report prints."""

    reports: tuple[str, ...] = ()
    given: Mapping[str, str] = field(default_factory=dict)
    before: Path | None = None
    ring: KeyRing | None = None


def start(
    sound: Sound,
    *,
    info: Mapping[str, str],
    runs: Path,
    stop: StopRequest,
    data_root: Path | None = None,
    seed: int | None = None,
    durability: Durability = "durable",
    progress: ProgressCallback | None = None,
    operator: Operator | None = None,
    identity: str | None = None,
    admission: Admission | None = None,
) -> tuple[Path, Outcome]:
    """Executes a sound plan in a new run folder in `runs`; returns the folder and the outcome.

    The function checks the disk space and connects every instrument before it makes the folder and before anything moves.

    `operator`: answers the prompts of the plan; None for an unattended run. `identity`: hexadecimal digits at the end of the
    folder's name. `admission`: the permission to begin that depends on the bench's check standard; by default, it is determined
    from the runs in `runs`. Raises `InputError` or `InstrumentError` if the run cannot start.
    """
    kept = _approved(sound, runs)
    operator = _attended(sound, operator)
    admission = admission or admit(sound.bench, sound.name, info, runs)
    seed = sound.bench.seed if seed is None else seed
    require_space(runs, recording_bytes(sound.schedule, sound.sensor.sample_rate, len(sound.sensor.outputs) + 1))

    def create() -> RunWriter:
        files = sound.plan_bytes, sound.bench_bytes
        return RunWriter.create(
            runs,
            sound.name,
            *files,
            info,
            durability,
            seed=seed,
            identity=identity,
            approvals=kept,
            check_standard=admission.record,
            parameters=sound.parameters,
        )

    return _carry_out(sound, data_root, seed, create, stop, progress, operator)


def resume(
    run: Path,
    *,
    stop: StopRequest,
    data_root: Path | None = None,
    progress: ProgressCallback | None = None,
    operator: Operator | None = None,
    retake: Retake | None = None,
    bench: str | None = None,
    trust_bench: bool = False,
    approvals: Path | None = None,
    override: Override | None = None,
) -> Outcome:
    """Continues an interrupted run with its plan and bench, or repeats segments of a finished or unfinished run.

    `bench`: the name of a shipped bench, or a file, that replaces the bench file in the run folder. The new bench file may differ
    from the replaced file only in the addresses of instruments. A bench file names the devices to connect to. Therefore, `bench` is
    required for a folder that was not made on this computer. `bench` is not required if `trust_bench` permits the use of the bench
    file in the folder. `override`: a decision to continue although the check standard of the bench is not in control; the state of
    the check standard is determined again. An override with which the run began remains valid. `approvals`: a plan file; approvals
    that were given after the run began are read from the folder of this file. The journal records the approvals that are used.

    The folder is locked first, then the bench, and only then are instruments connected. If two processes try to resume the same
    run, the second is refused before it connects to an instrument.
    """
    folder = open_run(run)  # no lock is left in what is no run folder
    lock = _lock(folder)
    try:
        found = examine(folder, samples="contents")  # once, under the lock; what was found is handed on
        reader = RunReader.of(found, to_reopen=True)
        file = None if bench is None else _stand_in(reader, bench)
        return _resume(
            found,
            reader,
            lock,
            stop,
            data_root,
            progress,
            operator,
            retake,
            file,
            trust_bench=trust_bench,
            approvals=approvals,
            override=override,
        )
    finally:
        lock.release()


def _approved(sound: Sound, runs: Path) -> bytes | None:
    """Returns the approval data that the new run folder will contain; None if the bench requires no approvals.

    Raises `InputError` if approvals are missing. Approvals are checked for every run, even if its plan was checked before.
    """
    bench = sound.bench
    if bench.approvals is None:
        return None
    if sound.approvals is None:
        message = f"the bench '{bench.name}' requires approvals, and this plan was not checked for them"
        hint = "run a plan file that is approved for this bench, or use another bench"
        raise InputError.at(bench.at("approvals"), "approval-missing", message, hint)
    return sound.approvals.to_bytes(runs)


def _lock(run: GuardedFolder) -> FolderLock:
    """Locks the run folder. Raises `InputError` if another process writes to the folder, or if the folder cannot be written."""
    try:
        return FolderLock(run)
    except OSError as error:
        message = f"the run folder cannot be written: {error.strerror or error}"
        raise InputError.at(Mark(str(run.path)), "run-unwritable", message, "change its permissions") from None


def _resume(
    found: Examined,
    reader: RunReader,
    lock: FolderLock,
    stop: StopRequest,
    data_root: Path | None,
    progress: ProgressCallback | None,
    operator: Operator | None,
    retake: Retake | None,
    file: Document | None,
    *,
    trust_bench: bool,
    approvals: Path | None,
    override: Override | None,
) -> Outcome:
    """Continues a run while its folder is locked. `file`: the bench file to use instead of the one in the folder."""
    if reader.sealed and retake is None:
        raise InputError.at(
            Mark(str(reader.path)), "run-finished", "this run is finished and sealed", "use `planrunner estimate`"
        )
    seed = reader.run["seed"]
    sound = sound_run(reader, date.today(), file)
    if file is None and not trust_bench:
        _require_made_here(reader, sound)
    further = still_approved(reader, sound.plan, sound.bench, None if file is None else Path(file.shown), approvals)
    admission = admit_again(sound.bench, reader, override, None if file is None else Path(file.shown))
    again = () if retake is None else _chosen(reader, retake.labels)
    operator = _attended(sound, operator)
    reason = None if retake is None else retake.reason

    def reopen() -> RunWriter:
        data = None if file is None else file.data
        writer = RunWriter.reopen(
            found, reason=reason, lock=lock, bench=data, approvals=further, check_standard=admission.record
        )
        try:
            writer.take_watchdog_report()
            for index in again:
                writer.reject(index, reason or "")
        except BaseException:
            writer.close()
            raise
        return writer

    outcome = _carry_out(sound, data_root, seed, reopen, stop, progress, operator)[1]
    return replace(outcome, remarks=(*admission.findings, *outcome.remarks))


def _stand_in(reader: RunReader, bench: str) -> Document:
    """Reads the bench file that replaces the bench file of the run. Raises `InputError` if the two differ in more than the
    addresses of instruments."""
    path, shown = locate(bench, Path())
    data = source.read_bytes(path, shown)
    other = other_than_reached(reader.bench_bytes, data, (str(reader.path / "bench.yaml"), shown))
    if other:
        more = f" and {len(other) - 5} more" if len(other) > 5 else ""
        message = f"this bench differs from the one with which the run began, in {', '.join(other[:5])}{more}"
        hint = (
            f"only the keys {', '.join(REACHED_BY)} of the instruments may differ: copy bench.yaml from the run folder, and "
            "change only these keys"
        )
        raise InputError.at(Mark(shown), "run-other-bench", message, hint)
    return Document(data, shown)


def _require_made_here(reader: RunReader, sound: Sound) -> None:
    """Raises `InputError` for a run folder of unknown origin, because the bench file in it would decide which devices are connected
    and commanded."""
    why = foreign(reader.folder, reader.first)
    if not why:
        return
    known = addresses(sound.bench)
    if sound.bench.time_stamps is not None:
        known["time_stamps"] = sound.bench.time_stamps.url
    reached = ", ".join(f"{name} at {address}" for name, address in known.items())
    message = f"{why}; its bench file {f'connects to {reached}' if reached else 'does not connect to any address'}"
    hint = "read it, then add --trust-bench; or give your own bench file with --bench"
    raise InputError.at(Mark(str(reader.path / "bench.yaml")), "run-not-made-here", message, hint)


def _carry_out(
    sound: Sound,
    data_root: Path | None,
    seed: int | None,
    open_writer: Callable[[], RunWriter],
    stop: StopRequest,
    progress: ProgressCallback | None,
    operator: Operator | None,
) -> tuple[Path, Outcome]:
    """Connects the bench, opens the run folder, and executes all segments that have not been recorded yet. The outcome is recorded
    even if the bench cannot be made safe."""
    ended: tuple[Path, Outcome] | None = None
    try:
        with _ready(sound, data_root, seed, progress) as (bench, warnings), open_writer() as writer:
            writer.witness = stamper = stamper_of(sound.bench)
            if bench.watchdog is not None:
                bench.watchdog.report_to(writer.path)
            outcome = execute(
                sound.schedule,
                bench,
                writer,
                stop=stop,
                progress=progress,
                start_at=writer.next_segment,
                operator=operator,
            )
            if outcome.finished:
                unsigned = sign_seal(writer.folder, writer.path.name, sound.bench)
                remarks = after_sealing(writer.folder, sound.bench, stamper)
                outcome = replace(outcome, remarks=remarks, unsigned=unsigned)
            outcome = replace(outcome, remarks=(*warnings, *outcome.remarks))
            ended = writer.path, outcome
    except NotSafeError as error:
        if ended is None:
            raise
        path, outcome = ended
        ended = path, replace(outcome, unsafe=outcome.unsafe or (str(error),))
    return ended


def _attended(sound: Sound, operator: Operator | None) -> Operator | None:
    """Returns the operator who answers the prompts; None on a simulated bench. Raises `InputError` if the plan needs an operator
    and none is present."""
    if runs_on_virtual_clock(sound.bench):
        return None
    if operator is None:
        log = Findings()
        check_unattended(sound.bench, sound.schedule, log)
        if log.errors:
            raise InputError(log)
    return operator


def _chosen(reader: RunReader, labels: Sequence[str]) -> tuple[int, ...]:
    """Returns the indices of the recorded segments with these labels."""
    known = {item.label: item.index for item in reader.acknowledged()}
    for label in labels:
        if label not in known:
            message = f"this run has no recorded segment '{label}' to record again"
            raise InputError.at(Mark(str(reader.path)), "run-no-segment", message, closest_label(label, known))
    return tuple(sorted({known[label] for label in labels}))


@contextmanager
def _ready(
    sound: Sound, data_root: Path | None, seed: int | None, notice: Announce | None
) -> Iterator[tuple[OpenBench, Sequence[Finding]]]:
    """Connects the bench and makes it ready for the schedule. Yields the bench, and the warnings about the recording that it plays
    back. If this recording is unsuitable, `InputError` is raised instead of `InstrumentError`, because nothing can have moved."""
    bench, file, found = sound.bench, sound.bench.origin.mark.file, Findings()
    with ExitStack() as stack:
        try:
            guarded = guarded_bench(bench, sound.bench_bytes, file, data_root=data_root, seed=seed, notice=notice)
            opened = stack.enter_context(guarded)
            if isinstance(opened.sensor, PlaysBack):
                opened.sensor.look_over(sound.schedule.segments, found)
                if found.errors:
                    raise InputError(found.errors)
            elif isinstance(opened.sensor, Foresees):
                opened.sensor.foresee(sound.schedule.segments)
        except InstrumentError as error:
            raise _unfit(sound, error) from None
        yield opened, tuple(found)


def _unfit(sound: Sound, error: InstrumentError) -> Exception:
    if not sound.models.replays:
        return error
    if isinstance(error, UnservedError):
        return InputError(error.findings)
    hint = "check the bench file, --data and the plan's labels"
    return InputError.at(Mark(sound.file), "recording-unfit", str(error), hint)


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
    """Does the same as `analyse_run`, but writes nothing. Afterwards, `keep` stores the result as an analysis of the run. The
    evaluation may run in another process than `keep`. `workers`: processes that share the Monte Carlo draws."""
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


def recompute(
    reader: RunReader, analysis: StoredAnalysis, notice: Announce | None = None, workers: Workers = ALONE
) -> Results:
    """Recomputes the results from the samples, with the plan that the analysis used; writes nothing. `workers`: processes that
    share the Monte Carlo draws. Raises `IntegrityError` if a file of the run was changed."""
    return _estimated(reader, evaluated_as(reader, analysis), notice, workers)[1]


def evaluated_as(reader: RunReader, analysis: StoredAnalysis) -> Sound:
    """Returns the checked plan and bench of a run. If the analysis used an amended plan, returns this plan instead of the plan of
    the run. Raises `InputError` if that plan no longer passes its checks, and `IntegrityError` if a file of the run was changed."""
    if EVALUATED_PLAN not in analysis.files:
        return sound_run(reader)
    return _evaluated(reader, Document(analysis.read(EVALUATED_PLAN), str(analysis.path / EVALUATED_PLAN)))


def report_through(run: Path, template: Path, issue: Issue | None = None, notice: Announce | None = None) -> str:
    """Renders the results of a run with a user's template; writes nothing to the run folder."""
    made = _analyse(run, issue or Issue(), notice=notice)
    return render_report(made.context, template.name.removesuffix(".j2"), template.parent)


@dataclass(frozen=True, slots=True)
class _Made:
    reader: RunReader
    sound: Sound
    results: Results
    context: ReportContext
    shown: CertificateFacts
    amending: dict[str, bytes]


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
    """Makes the analysis of a run without writing it. `kept`: True if it will be the next analysis of the run, so that its reports
    show this number."""
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


def _obstacles(made: _Made, issue: Issue) -> list[Finding]:
    found = obstacles(made.reader, made.sound, made.results, made.shown)
    return (
        found if issue.before is None else [*found, *not_before(made.shown, made.reader, RunReader.open(issue.before))]
    )
