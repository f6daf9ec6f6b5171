"""Writes the static site of an archive. The site shows runs, devices, benches and coefficients over time, in files that a browser
opens without a server.

Browsers do not allow a page on a file share to read data files, but they load scripts. The data are therefore written as scripts
that pass JSON to the page: the runs in chunks (`data-<digest>/runs-0.js` and so on), and one file for each device. The file
`data.js` names these scripts and is replaced last, so that a reader sees either the old site or the new one. Texts cannot become
code: the page receives them as JSON strings in ASCII and shows them as text.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from planrunner import __version__
from planrunner.archive import analyses as stored
from planrunner.archive import formats
from planrunner.archive.storage import Storage
from planrunner.archive.verifying import BENCH
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.base.progress import Announce, Pace
from planrunner.base.shipped import shipped_bytes
from planrunner.bench.model import bench_of
from planrunner.night import record
from planrunner.night.history.change_points import ChangePoint
from planrunner.night.history.check_standard import state_in
from planrunner.night.history.control_charts import Chart
from planrunner.night.history.index import Index
from planrunner.night.history.rows import CoefficientRow, HistoryPoint, LimitRow, RunRow
from planrunner.night.history.trend import trend

FORMAT = 1
NIGHTS = 30
"""Number of nights that can be selected on the wall."""
MOST_RECORD = 2**24
"""Maximum size in bytes of the record of a night."""
CHUNK = 1000
"""Number of runs in one file."""
NIGHT = timedelta(hours=24)
"""Length of the period that the wall shows. The period ends at the newest run."""
ENTRY = "data.js"
"""File by which a folder is recognised as a site. planrunner writes only to such a folder or to an empty folder."""
DATA = re.compile(r"data-[0-9a-f]{16}")
PAGE = ("site.html", "site.js", "strip.js", "page.css")
VENDORED = ("uPlot.iife.min.js", "uPlot.min.css", "uPlot.LICENSE")
REPORTS = (".html", ".md")
"""Extensions of the files of an analysis to which the site links."""


@dataclass(frozen=True, slots=True)
class BuiltSite:
    """A site that was written. `page`: the file to open in a browser. `runs`, `devices`: number of runs and of devices."""

    page: Path
    runs: int
    devices: int


@dataclass(frozen=True, slots=True)
class _Point:
    """The value of a coefficient in one run. `run`: index of the run in the list of runs."""

    run: int
    row: CoefficientRow
    limits: tuple[LimitRow, ...]


def build_site(index: Index, out: Path, notice: Announce | None = None) -> BuiltSite:
    """Writes the site of an archive into `out`, which is created if it does not exist. Raises `InputError` if `out` contains
    anything but a site."""
    runs = index.runs()
    links = _archive_link(index.archive, out)
    devices = sorted({run.device for run in runs if run.device})
    files: dict[str, Json] = {}
    pace = Pace("reading the runs", len(runs), notice)
    points: dict[str, dict[tuple[str, str], list[_Point]]] = {device: {} for device in devices}
    rows: list[Json] = []
    for place, run in enumerate(runs):
        rows.append(_run(run, index.archive))
        if run.device:
            limits = index.limits(run.folder)
            for row in index.coefficients(run.folder):
                own = tuple(limit for limit in limits if limit.quantity == row.quantity)
                points[run.device].setdefault((row.quantity, row.unit), []).append(_Point(place, row, own))
        pace.reached(place + 1)
    for number, begin in enumerate(range(0, len(rows), CHUNK)):
        files[f"runs-{number}"] = rows[begin : begin + CHUNK]
    for number, device in enumerate(devices):
        files[f"device-{number}"] = [
            _series(device, quantity, unit, found, runs) for (quantity, unit), found in sorted(points[device].items())
        ]
    texts = {name: _script(name, value) for name, value in files.items()}
    whole = hashlib.sha256(b"".join(texts[name] for name in sorted(texts))).hexdigest()[:16]
    entry: JsonObject = {
        "planrunner_site": FORMAT,
        "version": __version__,
        "archive": index.archive.name or str(index.archive),
        "link": links,
        "data": f"data-{whole}",
        "chunks": math.ceil(len(rows) / CHUNK),
        "runs": len(rows),
        "devices": devices,
        "night_since": _night(runs),
        "nights": list(_nights(index.archive)),
        "standards": list(_standards(index, runs)),
        "faults": [[fault.folder, fault.message] for fault in index.faults()],
    }
    _write(out, f"data-{whole}", texts, _script("entry", entry))
    return BuiltSite(out / "index.html", len(runs), len(devices))


def _night(runs: Sequence[RunRow]) -> str:
    """Returns the moment from which the wall display shows runs. This moment is a fixed time before the newest run. `runs`: all
    runs, the newest first."""
    if not runs:
        return ""
    return (datetime.fromisoformat(runs[0].created) - NIGHT).isoformat(timespec="microseconds")


def _nights(archive: Path) -> Iterator[Json]:
    """Yields the newest nights, each with the results of its tests and the reasons for these results. A damaged record is omitted;
    `verify` reports it."""
    from jsonschema import Draft202012Validator

    validator = Draft202012Validator(formats.schema("night"))
    try:
        nights = GuardedFolder.open(archive).folder(record.FOLDER)
        names = sorted(nights.entries(), reverse=True)
    except OSError:
        return
    left = NIGHTS
    for name in names:
        if not left:
            return
        try:
            night = formats.from_bytes(nights.folder(name).read(record.RECORD, MOST_RECORD))
        except (OSError, ValueError):
            continue
        if validator.is_valid(night):
            left -= 1
            yield {
                key: night[key]
                for key in ("night", "title", "state", "begins", "ends", "exit_code", "counts", "remarks")
            } | {
                "check_standards": [
                    [one["bench"], *(one["state"][key] for key in ("device", "standing", "reasons"))]
                    for one in night.get("check_standards", ())
                ],
                "fleet": [
                    {key: group[key] for key in ("plan", "runs", "statements")} for group in night.get("fleet", ())
                ],
                "tests": [
                    [test[key] for key in ("test", "device", "bench", "state", "reason", "run")]
                    for test in night["tests"]
                ],
            }


def _run(run: RunRow, archive: Path) -> Json:
    """Converts a run to a row with the columns of `RUN` in site.js."""
    return [
        run.folder,
        run.created,
        run.plan,
        run.title,
        run.device,
        run.bench,
        run.operator,
        run.verdict,
        run.state,
        run.analysis,
        run.warnings,
        run.origin,
        list(_reports(archive, run)),
    ]


def _reports(archive: Path, run: RunRow) -> Iterator[str]:
    """Yields the file names of the reports in a run's newest analysis."""
    if not run.analysis:
        return
    folder = archive.joinpath(*PurePosixPath(run.folder).parts, stored.FOLDER, str(run.analysis))
    try:
        with os.scandir(folder) as listed:
            found = sorted(
                item.name for item in listed if item.name.endswith(REPORTS) and item.is_file(follow_symlinks=False)
            )
    except OSError:
        return
    yield from found


def _series(device: str, quantity: str, unit: str, found: Sequence[_Point], runs: Sequence[RunRow]) -> Json:
    """Returns a coefficient of a device over time, the oldest run first, with the limits of the plans, the control charts and the
    changes. Values, uncertainties and control limits that do not exist are None."""
    ordered = list(reversed(found))
    held = trend(device, quantity, [HistoryPoint(runs[point.run], point.row, point.limits) for point in ordered])
    usable = {point.run.folder for point in held.points}
    places = [k for k, point in enumerate(ordered) if runs[point.run].folder in usable]
    charts = held.charts

    def spread(values: NDArray[np.float64] | None) -> list[Json]:
        """Returns a list with one entry for each run: the value of the chart, or None if the run has no value in the chart."""
        placed: list[Json] = [None] * len(ordered)
        for k, value in zip(places, () if values is None else values.tolist(), strict=values is not None):
            placed[k] = value
        return placed

    def limits(chart: Chart | None, *, statistic: bool = True) -> dict[str, Json]:
        own = {"value": spread(None if chart is None else chart.statistic)} if statistic else {}
        lower, upper = (None, None) if chart is None else (chart.lower, chart.upper)
        return {**own, "lower": spread(lower), "upper": spread(upper)}

    control = limits(None if charts is None else charts.shewhart, statistic=False)
    return {
        "quantity": quantity,
        "unit": unit,
        "run": [point.run for point in ordered],
        "value": [_finite(point.row.value) for point in ordered],
        "u": [_finite(point.row.standard_uncertainty) for point in ordered],
        "plan_lower": [_finite(max((one.lower for one in point.limits), default=math.nan)) for point in ordered],
        "plan_upper": [_finite(min((one.upper for one in point.limits), default=math.nan)) for point in ordered],
        "control_lower": control["lower"],
        "control_upper": control["upper"],
        "ewma": limits(None if charts is None else charts.ewma),
        "cusum_up": limits(None if charts is None else charts.cusum_up),
        "cusum_down": limits(None if charts is None else charts.cusum_down),
        "changes": [_change(one, places) for one in held.changes],
    }


def _change(one: ChangePoint, places: Sequence[int]) -> Json:
    """Returns a change of level as JSON data. `before`, `after`: positions, in the series, of the last value before the change and
    of the first value after it."""
    return {
        "before": places[one.index - 1],
        "after": places[one.index],
        "step": one.step,
        "u": one.standard_uncertainty,
        "p": one.p,
        "causes": [[cause.words, cause.before, cause.after, cause.shared] for cause in one.causes],
    }


def _standards(index: Index, runs: Sequence[RunRow]) -> Iterator[Json]:
    """Yields the states of check standards: one for each bench that declares a check standard in the bench file of its newest
    run."""
    now = datetime.now(UTC)
    newest: dict[str, RunRow] = {}
    for run in runs:
        newest.setdefault(run.bench, run)
    for _, run in sorted(newest.items()):
        file = index.archive.joinpath(*PurePosixPath(run.folder).parts, BENCH)
        try:
            folder = GuardedFolder.open(file.parent)
            state = state_in(index, bench_of(folder.read(BENCH, MOST_RECORD), str(file)), now)
        except (OSError, InputError):  # a bench file of another version, or with a driver that is not installed here
            continue
        if state is not None:
            yield state.to_json()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _script(name: str, value: Json) -> bytes:
    """Returns a script that passes data to the page: a function call whose argument is JSON in ASCII, which JavaScript reads in the
    same way."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return f"planrunnerData({json.dumps(name)},{text});\n".encode("ascii")


def _archive_link(archive: Path, out: Path) -> str | None:
    """Returns the path from the site to the archive, as a link; None if there is no such path, for example between two Windows
    drives."""
    try:
        way = os.path.relpath(archive.absolute(), out.absolute())
    except ValueError:
        return None
    return quote(Path(way).as_posix())


def _write(out: Path, data: str, texts: dict[str, bytes], entry: bytes) -> None:
    storage = Storage("flushed")
    try:
        out.mkdir(parents=True, exist_ok=True)
        folder = GuardedFolder.open(out)
        present = folder.entries()
        if present and ENTRY not in present:
            message = "this folder is not empty, and is not a site that planrunner made"
            raise InputError.at(Mark(str(out)), "site-not-empty", message, "choose a new folder")
        for name in PAGE:
            storage.write_whole(folder, "index.html" if name == "site.html" else name, shipped_bytes("web", name))
        for name in VENDORED:
            storage.write_whole(folder, name, shipped_bytes("web", f"vendor/{name}"))
        inner = folder.folder(data) if data in present else folder.make_folder(data)
        for name, text in texts.items():
            storage.write_whole(inner, f"{name}.js", text)
        storage.write_whole(folder, ENTRY, entry)
        for name in present:
            if DATA.fullmatch(name) and name != data:
                folder.remove_folder(name)
    except OSError as error:
        message = f"the site cannot be written: {error.strerror or error}"
        raise InputError.at(
            Mark(str(out)), "site-unwritable", message, "free disk space, or choose another folder"
        ) from None
