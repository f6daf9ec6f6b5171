"""Reads the history of an archive, for the commands `runs`, `history` and `compare` and for other programs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, InputError, closest
from planrunner.base.progress import Announce
from planrunner.base.workers import Workers
from planrunner.night.history.gauge import GaugeStudy, UnbalancedError, gauge_study
from planrunner.night.history.index import Index
from planrunner.night.history.rows import FaultRow, RunFilter, RunRow
from planrunner.night.history.trend import Trend, trend
from planrunner.plan.quantity import parse_quantity

RUNS_FORMAT = 1


@dataclass(frozen=True, slots=True)
class RunList:
    """Contains a list of runs.

    `runs`: the runs that pass the filter, the newest first. `total`: number of all runs that pass the filter; it may exceed the
    length of the list. `faults`: folders that could not be read and are therefore not in the index.
    """

    runs: tuple[RunRow, ...]
    total: int
    faults: tuple[FaultRow, ...]

    def to_json(self) -> JsonObject:
        """Returns JSON data according to schemas/runs.schema.json."""
        return {
            "planrunner_runs": RUNS_FORMAT,
            "total": self.total,
            "runs": [run.to_json() for run in self.runs],
            "faults": [{"folder": fault.folder, "message": fault.message} for fault in self.faults],
        }


@dataclass(frozen=True, slots=True)
class Freshness:
    """States how an index is updated before it is queried.

    `refresh`: True to read new and changed runs. `rebuild`: True to read all runs again. `workers`: processes that share the
    reading.
    """

    refresh: bool = True
    rebuild: bool = False
    notice: Announce | None = None
    workers: Workers | None = None


def opened(archive: Path, index: str | None, fresh: Freshness) -> Index:
    """Opens the index of an archive and updates it. The caller must close the index. Raises `InputError` if the index cannot be
    used."""
    found = Index.open(archive, index)
    try:
        if fresh.refresh or fresh.rebuild:
            found.refresh(rebuild=fresh.rebuild, notice=fresh.notice, workers=fresh.workers)
    except BaseException:
        found.close()
        raise
    return found


def list_runs(index: Index, wanted: RunFilter) -> RunList:
    return RunList(tuple(index.runs(wanted)), index.count(wanted), tuple(index.faults()))


def coefficients_of(index: Index, device: str) -> list[str]:
    """Returns the names of all coefficients in the runs of a device. Raises `InputError` for an unknown device."""
    known = index.quantities(device)
    if not known:
        devices = [one.device for one in index.devices() if one.device]
        message = f"no run in {index.archive} has results of a device '{device[:60]}'"
        raise InputError.at(COMMAND_LINE, "history-unknown-device", message, closest(device, devices))
    return known


def trend_of(index: Index, device: str, quantity: str, tolerance: str | None = None, since: str = "") -> Trend:
    """Returns the history of a coefficient of a device. `tolerance`: permissible deviation, such as `0.5 deg/h`. Raises
    `InputError` for an unknown device or coefficient."""
    known = coefficients_of(index, device)
    if quantity not in known:
        message = f"no run of '{device}' has a coefficient '{quantity[:60]}'"
        raise InputError.at(COMMAND_LINE, "history-unknown-coefficient", message, closest(quantity, known))
    points = index.history(device, quantity, since)
    found = trend(device, quantity, points)
    if tolerance is None:
        return found
    return trend(device, quantity, points, _tolerance(tolerance, found.unit))


def gauge_of(index: Index, quantity: str, wanted: RunFilter) -> tuple[GaugeStudy, str]:
    """Computes the gauge study of a coefficient from the runs that pass the filter. Returns the study and the unit of the
    coefficient. Raises `InputError` if these runs do not form a complete gauge study."""
    points = [point for point in index.points(quantity, wanted) if math.isfinite(point.coefficient.value)]
    units = {point.coefficient.unit for point in points}
    hint = "with --device, --plan, --since and --until, choose runs in which every combination occurs at least twice"
    if len(units) != 1:
        what = f"no run has a coefficient '{quantity[:60]}'" if not units else "the runs state different units"
        raise InputError.at(COMMAND_LINE, "gauge-design", what, hint)
    labels = {
        "device": [point.run.device for point in points],
        "operator": [point.run.operator for point in points],
        "bench": [point.run.bench for point in points],
    }
    try:
        return gauge_study(labels, [point.coefficient.value for point in points]), units.pop()
    except UnbalancedError as error:
        raise InputError.at(
            COMMAND_LINE, "gauge-design", f"the runs do not form a balanced study: {error}", hint
        ) from None


def _tolerance(text: str, unit: str) -> float:
    from planrunner.plan.units import unit as unit_of

    try:
        stated, own = parse_quantity(text), unit_of(unit)
        if stated.unit.dimension == own.dimension and stated.value > 0:
            return own.from_si(stated.value) - own.from_si(0.0)
    except ValueError:
        pass
    message = f"'{text[:40]}' is not a permissible deviation in {unit}"
    raise InputError.of_usage(message, f"write for example --tolerance '0.5 {unit}'")
