"""Running a plan from start to finish: check → open the bench → execute → estimate → report.

The layers know nothing of one another; here they are put together, for the command line and for programs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planrunner.archive.analyses import add_analysis
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.space import recording_bytes, require_space
from planrunner.archive.storage import Durability
from planrunner.bench.opening import open_bench
from planrunner.checking import Checked, check_plan
from planrunner.estimators.analysis import Results, analyse
from planrunner.execution.executor import execute
from planrunner.execution.outcome import Outcome
from planrunner.execution.progress import ProgressCallback
from planrunner.execution.stopping import StopRequest
from planrunner.plan.findings import InputError


@dataclass(frozen=True, slots=True)
class Analysis:
    """An analysis of a run: where it was written and what it found."""

    folder: Path
    results: Results
    reports: tuple[Path, ...]


def start(
    checked: Checked,
    *,
    info: Mapping[str, str],
    runs: Path,
    stop: StopRequest,
    data_root: Path | None = None,
    seed: int | None = None,
    durability: Durability = "durable",
    progress: ProgressCallback | None = None,
) -> tuple[Path, Outcome]:
    """Carry out a sound plan in a new run folder beneath `runs`; the folder and how it ended.

    Disk space is checked, and every instrument connected and asked who it is, before the folder is made and anything moves.
    Raises `InputError` and `InstrumentError` for what prevents the start.
    """
    schedule, models, bench = checked.schedule, checked.models, checked.bench
    assert schedule is not None and models is not None and bench is not None and checked.plan is not None
    seed = bench.seed if seed is None else seed
    if models.sensor is not None:
        require_space(runs, recording_bytes(schedule, models.sensor.sample_rate, len(models.sensor.outputs) + 1))
    with open_bench(bench, data_root=data_root, seed=seed) as opened:
        name = Path(checked.file).stem
        writer = RunWriter.create(runs, name, checked.plan_bytes, checked.bench_bytes, info, durability, seed=seed)
        with writer:
            outcome = execute(schedule, opened, writer, stop=stop, progress=progress)
    return writer.path, outcome


def resume(
    run: Path,
    *,
    stop: StopRequest,
    data_root: Path | None = None,
    durability: Durability | None = None,
    progress: ProgressCallback | None = None,
) -> Outcome:
    """Go on with a run that was cut short, from its own plan and bench."""
    checked = check_run(run)
    assert checked.schedule is not None and checked.bench is not None
    seed = RunReader.open(run).run["seed"]
    with (
        open_bench(checked.bench, data_root=data_root, seed=seed) as opened,
        RunWriter.reopen(run, durability=durability) as writer,
    ):
        return execute(checked.schedule, opened, writer, stop=stop, progress=progress, start_at=writer.next_segment)


def check_run(run: Path) -> Checked:
    """The plan and bench of a run folder, checked as before it ran. Raises `InputError` when they no longer pass."""
    checked = check_plan(run / "plan.yaml", bench_path=run / "bench.yaml")
    if not checked.ok:
        raise InputError(checked.findings)
    return checked


def analyse_run(run: Path) -> Analysis:
    """Estimate from a run's recording alone and write the results and reports as a new analysis."""
    from planrunner.reporting.from_run import report_context
    from planrunner.reporting.report import render_report

    reader = RunReader.open(run)
    checked = check_run(run)
    assert checked.plan is not None and checked.schedule is not None and checked.models is not None
    sensor = checked.models.sensor
    assert sensor is not None
    recording = reader.recording(checked.schedule)
    results = analyse(checked.plan.estimates, checked.plan.limits, recording, checked.models.site, sensor)
    number = len(reader.analyses()) + 1
    context = report_context(reader, checked, recording, results, number)
    files = {"results.json": to_bytes(results.to_json())}
    for report in checked.plan.report:
        files[report] = render_report(context, report).encode()
    folder = add_analysis(run, files)
    return Analysis(folder, results, tuple(folder / name for name in checked.plan.report))


def to_bytes(value: Any) -> bytes:
    """JSON text of results: full precision, no NaN, the same bytes for the same numbers."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
