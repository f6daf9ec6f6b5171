"""Runs a checked plan: opens the bench, executes the schedule, and seals the recording. Also continues interrupted runs.

The layers are independent of each other; this module combines them for the command line and for other programs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

from planrunner.archive.lock import FolderLock
from planrunner.archive.origin import foreign
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.space import recording_bytes, require_space
from planrunner.archive.storage import Durability
from planrunner.archive.verifying import Examined, examine, open_run
from planrunner.base.findings import Finding, Findings, InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.progress import Announce
from planrunner.bench.attendance import check_unattended
from planrunner.bench.model import locate, runs_on_virtual_clock
from planrunner.bench.opening import NotSafeError, OpenBench, guarded_bench
from planrunner.bench.replacing import REACHED_BY, addresses, other_than_reached
from planrunner.execution.executor import Outcome, execute
from planrunner.execution.operator import Operator
from planrunner.execution.progress import ProgressCallback
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import Foresees, InstrumentError, PlaysBack, UnservedError
from planrunner.plan import source
from planrunner.plan.selection import closest_label
from planrunner.tasks.approvals import still_approved
from planrunner.tasks.bench_signature import sign_seal
from planrunner.tasks.check import Document, Sound
from planrunner.tasks.check_standard import Admission, Override, admit, admit_again
from planrunner.tasks.estimate import sound_run
from planrunner.tasks.stamp import after_sealing, stamper_of


@dataclass(frozen=True, slots=True)
class Retake:
    """Contains the labels of recorded segments that must be rejected and repeated, and the reason."""

    labels: tuple[str, ...]
    reason: str


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
    required for a folder that was not made on this computer, unless `trust_bench` permits the use of the bench file in the folder.
    `override`: a decision to continue although the check standard of the bench is not in control; the state of the check standard
    is determined again. An override with which the run began remains valid. `approvals`: a plan file; approvals that were given
    after the run began are read from the folder of this file. The journal records the approvals that are used.

    The function first locks the folder, then locks the bench, and then connects the instruments. If two processes try to resume the
    same run, the second is refused before it connects to an instrument.
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
