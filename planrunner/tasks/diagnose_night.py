"""Diagnoses the runs of a night together with recent runs of the same plans. The result shows how the devices and the bench have
changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from planrunner.archive.formats import IntegrityError
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, count_of
from planrunner.base.workers import Workers
from planrunner.night.history.rows import RunFilter, RunRow
from planrunner.night.suite import NightDiagnosis
from planrunner.plan.run_information import DEVICE
from planrunner.reporting.fleet_page import statements
from planrunner.tasks.diagnose_fleet import diagnose_fleet
from planrunner.tasks.history import Freshness, opened
from planrunner.tasks.kept_diagnoses import KeptDiagnoses

LEAST = 4
"""Smallest number of runs that can show a change: two before it and two after it."""


def diagnose_night(
    archive: Path, runs: Sequence[str], asked: NightDiagnosis, workers: Workers | None = None
) -> Iterator[tuple[JsonObject | None, str]]:
    """Yields a record and a remark for each plan. The record is the diagnosis (`fleet` of schemas/night.schema.json). The remark
    states how many runs the diagnosis omits; it is empty if no run is omitted. If there is no diagnosis, the record is None and
    the remark gives the reason. After the plans, up to two further remarks follow, with None as the record: one names the runs of
    the night that state no device, the other names the damaged runs in the archive.

    `runs`: names of the run folders that the night made. Raises `InputError` if the index cannot be used.
    """
    since = (datetime.now(UTC) - timedelta(seconds=asked.within.value)).isoformat()
    with opened(archive, None, Freshness()) as index:
        every = index.runs(RunFilter(since=since))
        damaged = ", ".join(fault.folder for fault in index.faults())
    known = [run for run in every if run.state == "sealed" and run.device]
    own = [run for run in known if run.folder in runs]
    for key in dict.fromkeys((run.plan, run.title) for run in own):
        group = [run for run in known if (run.plan, run.title) == key][: asked.recent]
        if len(group) >= LEAST:
            yield _of_plan(archive, group, [run.folder for run in own], workers or Workers())
        else:
            yield None, f"{key[0]}: too few runs to be diagnosed together ({len(group)})"
    unknown = ", ".join(run.folder for run in every if run.folder in runs and not run.device)
    if unknown:
        yield None, f"the night: runs that name no device ({' or '.join(DEVICE)}) are left out: {unknown}"
    if damaged:
        yield None, f"the night: damaged runs are left out: {damaged}"


def _of_plan(
    archive: Path, group: Sequence[RunRow], own: Sequence[str], workers: Workers
) -> tuple[JsonObject | None, str]:
    plan, folders = group[0].title or group[0].plan, [archive / run.folder for run in reversed(group)]
    try:
        made = diagnose_fleet(folders, workers=workers, skip=True, kept=KeptDiagnoses.of_user())
    except (InputError, IntegrityError) as error:
        return None, f"{plan}: the runs cannot be diagnosed together: {error}"
    found = made.to_json()
    verdicts: list[Json] = [
        {"run": name, "verdict": one["verdict"], "effects": one["effects"]}
        for one in found["runs"]
        for name in [Path(one["run"]).name]
        if name in own
    ]
    record = {
        "plan": plan,
        "runs": len(found["runs"]),
        "statements": statements(found),
        "changes": [
            {"effect": one["effect"], "name": one["name"], **change}
            for one in found["amplitudes"]
            for change in one["changes"]
        ],
        "shared": found["shared"],
        "verdicts": verdicts,
    }
    left = len(group) - len(found["runs"])
    return record, f"{plan}: no diagnosis of {count_of(left, 'run')}" if left else ""
