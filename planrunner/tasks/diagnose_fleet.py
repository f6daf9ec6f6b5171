"""Diagnoses several runs together. First, each run is diagnosed alone. Then every effect that any run names is fitted in every run.
Finally, each amplitude is attributed to the device, the bench or the occasion.
"""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from planrunner.archive import seal as seals
from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_reader import RunReader
from planrunner.archive.storage import digest
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import Finding, Findings, InputError, Mark, closest
from planrunner.base.guarded_folder import NotOrdinaryError
from planrunner.base.processes import processors
from planrunner.base.progress import Announce, Pace
from planrunner.base.workers import Workers, results_of
from planrunner.gap.fleet.amplitudes import AmplitudeEstimate, AmplitudeKey, amplitudes
from planrunner.gap.fleet.attribution import SURE, Attribution, Contribution, Estimates, Source, Uncertain, attribute
from planrunner.gap.fleet.changes import ChangeKind, FleetChange, changes, since_steps
from planrunner.gap.fleet.lots import SharedByLot, shared_by_lots
from planrunner.instruments.models import DataOrigin
from planrunner.plan.model import NOMINAL_TERMS
from planrunner.plan.run_information import DEVICE, device_of
from planrunner.plan.source import read_text
from planrunner.tasks.diagnose import observe, recorded_run
from planrunner.tasks.kept_diagnoses import KeptDiagnoses, key_of

if TYPE_CHECKING:
    from planrunner.gap.answer.diagnosis import Diagnosis

FLEET_FORMAT = 1
LOT = "lot"
"""Item of the run information that names the production lot of the device."""
STATED = (Source.DEVICE, Source.BENCH, Source.OCCASION)
"""Sources whose labels a table can contain."""
_COLUMNS = ("run", *(source.value for source in STATED))
T = TypeVar("T")
Obstacles = tuple[Finding, ...]
_LEAST = 1e-12  # probability with which a run counts that gives an effect none


@dataclass(frozen=True, slots=True)
class RunOrigin:
    """Names a run, and its device, bench and occasion.

    `created`: time when the run began, UTC, ISO 8601. `lot`: production lot of the device; empty if not stated. `seal`: SHA-256 of
    the seal; empty for a run that is not sealed.
    """

    run: Path
    labels: Mapping[Source, str]
    created: str = ""
    lot: str = ""
    seal: str = ""


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """Contains the diagnosis of one run.

    `plan`: title of the plan. `sensor`: kind of the sensor. `effects`: the effects that the verdict names. `members`: sets of
    effects that the plan cannot distinguish; a set is written as 'a+b'. `probability`: maps each set of effects to its probability.
    `shapes`: maps each effect to its best shape, in the unit of the shape, and to the evidence for this shape in nats. `origin`:
    whether the samples are measured, simulated or played back.
    """

    plan: str
    sensor: str
    nominal: tuple[str, ...]
    kind: str
    effects: tuple[str, ...]
    members: tuple[str, ...]
    probability: Mapping[str, float]
    shapes: Mapping[str, tuple[float, float]]
    origin: DataOrigin
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class Attributed:
    """Contains one amplitude, and the sources to which it is attributed. `runs`: indices of the n runs that determine the
    amplitude. `values`, `standard_uncertainties`: arrays of shape (n,), the amplitude and its standard uncertainty in each of these
    runs, in the unit of `key`."""

    key: AmplitudeKey
    runs: tuple[int, ...]
    values: tuple[float, ...]
    standard_uncertainties: tuple[float, ...]
    attribution: Attribution
    changes: tuple[FleetChange, ...] = ()


@dataclass(frozen=True)
class FleetDiagnosis:
    """Contains the diagnosis of several runs together.

    `effects`: the effects that were fitted in every run in addition to the nominal terms. `not_attributed`: the effects that a run
    names but that are not attributed, each with the reason. `shared`: amplitudes that all devices of a production lot have in
    common.
    """

    origins: tuple[RunOrigin, ...]
    verdicts: tuple[RunVerdict, ...]
    effects: tuple[str, ...]
    attributed: tuple[Attributed, ...]
    not_attributed: Mapping[str, str]
    shared: tuple[SharedByLot, ...] = ()
    findings: Findings = field(default_factory=Findings)

    @property
    def origin(self) -> DataOrigin:
        """Returns the origin of the samples of all runs. The origin is `simulated` if the samples of at least one run are
        simulated."""
        found = {one.origin for one in self.verdicts}
        return next(one for one in ("simulated", "replayed", "measured") if one in found)

    def to_json(self) -> JsonObject:
        """Returns JSON data according to `schemas/fleet.schema.json`."""
        return {
            "planrunner_fleet": FLEET_FORMAT,
            "runs": [
                {
                    "run": str(origin.run),
                    **{source.value: label for source, label in origin.labels.items()},
                    "plan": verdict.plan,
                    "verdict": verdict.kind,
                    "effects": list(verdict.effects),
                }
                for origin, verdict in zip(self.origins, self.verdicts, strict=True)
            ],
            "nominal": list(self.verdicts[0].nominal),
            "effects": list(self.effects),
            "amplitudes": [self._amplitude(one) for one in self.attributed],
            "shared": [_shared_plain(one) for one in self.shared],
            "not_attributed": [{"effect": name, "reason": why} for name, why in self.not_attributed.items()],
        }

    def _change(self, one: Attributed, change: FleetChange) -> JsonObject:
        runs = [self.origins[one.runs[k]] for k in change.runs]
        before = [] if change.kind is ChangeKind.DRIFT else runs[: change.before]
        return {
            "kind": change.kind.value,
            "sources": [[source.value, label] for source, label in change.sources],
            "size": change.size,
            "expanded_uncertainty": change.expanded,
            "unit": one.key.unit if change.kind is ChangeKind.STEP else f"{one.key.unit}/d",
            "p": change.p,
            "after": runs[change.earliest].created,
            "until": runs[change.latest if change.kind is ChangeKind.STEP else -1].created,
            "first_after": str(runs[change.before].run),
            "runs_before": len(before),
            "runs_after": len(runs) - len(before),
        }

    def _amplitude(self, one: Attributed) -> JsonObject:
        estimates = zip(one.runs, one.values, one.standard_uncertainties, strict=True)
        return {
            "effect": one.key.effect,
            "name": one.key.name,
            "unit": one.key.unit,
            "shape": one.key.shape,
            "none": one.attribution.none,
            "probability": dict(one.attribution.probability),
            "contributions": [
                _plain(item, [self.origins[index].labels[Source.DEVICE] for index in one.runs])
                for item in one.attribution.contributions
            ],
            "named": [list(_words(item)) for item in one.attribution.named],
            "open": [list(_words(item)) for item in one.attribution.open],
            "changes": [self._change(one, change) for change in one.changes],
            "estimates": [
                {"run": str(self.origins[index].run), "value": value, "standard_uncertainty": u}
                for index, value, u in estimates
            ],
        }


def _shared_plain(one: SharedByLot) -> JsonObject:
    return {
        "lot": one.lot,
        "effect": one.key.effect,
        "name": one.key.name,
        "unit": one.key.unit,
        "devices": list(one.devices),
        "others": one.others,
        "difference": one.difference,
        "expanded_uncertainty": one.expanded,
        "chance": one.chance,
    }


def _words(one: Contribution) -> tuple[str, ...]:
    return tuple(source.value for source in one.component.sources)


def _plain(one: Contribution, devices: Sequence[str]) -> JsonObject:
    """Returns a contribution as plain JSON data. `devices`: the device of each of the n runs."""
    return {
        "sources": list(_words(one)),
        "probability": one.probability,
        "share": one.share,
        "standard_deviation": one.spread,
        "interval_95": list(one.spread_interval),
        "parts": [
            {
                "label": part.label,
                "since": part.since or None,
                "runs": part.runs,
                "devices": len(
                    {device for device, k in zip(devices, one.component.members, strict=True) if k == number}
                ),
                "part": _uncertain(part.part),
                "level": _uncertain(part.level),
                "difference": _uncertain(part.difference),
            }
            for number, part in enumerate(one.parts)
        ],
    }


def _uncertain(one: Uncertain | None) -> JsonObject | None:
    return None if one is None else {"value": one.value, "expanded_uncertainty": one.expanded}


def diagnose_fleet(
    runs: Sequence[Path],
    nominal: Sequence[str] | None = None,
    origins: Path | None = None,
    workers: Workers | None = None,
    notice: Announce | None = None,
    *,
    skip: bool = False,
    kept: KeptDiagnoses | None = None,
) -> FleetDiagnosis:
    """Diagnoses several runs together.

    `nominal`: terms that the simulations fit; by default, those in the plans. `origins`: CSV table that states the device, bench or
    occasion of runs. `workers`: processes that share the runs; by default, processes on this computer. `notice`: receives the
    progress. `skip`: True to omit runs that cannot be diagnosed and add a note about each; otherwise, such a run is an error.
    `kept`: stored results of sealed runs from earlier diagnoses. These results are used again, and new results are added to them.

    Raises `InputError` with all obstacles. Raises `IntegrityError` if a run folder was changed and `skip` is False.
    """
    listed = _origins(runs, origins, skip=skip)
    labelled = [one for one in listed if isinstance(one, RunOrigin)]
    workers = workers or Workers(processors())
    given = None if nominal is None else tuple(nominal)
    pace = Pace("diagnosing the runs", 1.0, notice).reached
    kept = kept or KeptDiagnoses(None)
    verdict_keys = [_key(one, "verdict", list(given or ())) for one in labelled]
    found = _from_kept(
        kept,
        verdict_keys,
        lambda missing: results_of(partial(_verdict, given, skip), [labelled[k].run for k in missing], workers, pace),
        _verdict_plain,
        _verdict_of,
    )
    findings = Findings()
    obstacles = [one for one in (*listed, *found) if not isinstance(one, RunOrigin | RunVerdict)]
    if not skip:
        _require_all(obstacles)
    for obstacle in obstacles:
        findings.note(
            obstacle[0].code, obstacle[0].mark, f"this run is left out: {obstacle[0].message}", obstacle[0].hint
        )
    known = tuple(one for one, made in zip(labelled, found, strict=True) if isinstance(made, RunVerdict))
    runs = [one.run for one in known]
    verdicts = tuple(one for one in found if isinstance(one, RunVerdict))
    if not verdicts:
        _require_all(obstacles)
    for verdict in verdicts:
        findings.extend(verdict.findings)
    _compare(runs, verdicts, findings)
    named = _named(verdicts)
    effects, left = _with_amplitudes(named)
    chosen = tuple((name, _shape(name, verdicts)) for name in effects)
    fitting = Pace("fitting the named effects in every run", 1.0, notice).reached
    fit_keys = [_key(one, "amplitudes", [list(verdicts[0].nominal), [list(pair) for pair in chosen]]) for one in known]
    fits = _from_kept(
        kept,
        fit_keys,
        lambda missing: results_of(
            partial(_fitted, verdicts[0].nominal, chosen), [runs[k] for k in missing], workers, fitting
        ),
        _fit_plain,
        _fit_of,
    )
    attributed = _attributed(fits, known, workers)
    if not attributed:
        message = "no amplitude is determined by two or more of the runs"
        raise InputError.at(
            Mark(str(runs[0])), "fleet-nothing-common", message, "give runs of the same or similar plans"
        )
    for name in effects:
        if not any(one.key.effect == name for one in attributed):
            left[name] = "fewer than two runs determine its amplitudes in addition to the other terms"
    return FleetDiagnosis(known, verdicts, effects, attributed, left, _shared(attributed, known), findings)


# -- results from before -----------------------------------------------------------------------------------------------


def _key(origin: RunOrigin, kind: str, asked: Json) -> str:
    """Returns the key under which the result for a run is stored; empty for a run that is not sealed, because such a run may
    change."""
    return key_of(kind, origin.seal, asked) if origin.seal else ""


def _from_kept(
    kept: KeptDiagnoses,
    keys: Sequence[str],
    compute: Callable[[Sequence[int]], Sequence[T]],
    plain: Callable[[T], Json],
    of_plain: Callable[[Json], T],
) -> list[T]:
    """Returns the result for each key: the stored result if there is one; otherwise a computed result, which is then stored.
    `compute`: computes the results for the given positions in `keys`. `plain`: converts a result to JSON data; it returns null for
    a result that must not be stored."""
    found: dict[int, T] = {}
    for place, key in enumerate(keys):
        held = kept.get(key) if key else None
        if held is not None:
            with contextlib.suppress(KeyError, TypeError, ValueError):
                found[place] = of_plain(held)
    missing = [place for place in range(len(keys)) if place not in found]
    for place, made in zip(missing, compute(missing) if missing else (), strict=True):
        found[place] = made
        data = plain(made)
        if keys[place] and data is not None:
            kept.put(keys[place], data)
    return [found[place] for place in range(len(keys))]


def _verdict_plain(one: RunVerdict | Obstacles) -> Json:
    """Converts the verdict on a run to JSON data. Returns null for obstacles to a diagnosis, which are not stored because they may
    disappear, for example when a package is installed."""
    if not isinstance(one, RunVerdict):
        return None
    made: JsonObject = {item.name: getattr(one, item.name) for item in fields(one)}
    return {
        **made,
        **{name: list(made[name]) for name in ("nominal", "effects", "members")},
        "probability": dict(one.probability),
        "shapes": {name: list(pair) for name, pair in one.shapes.items()},
        "findings": [finding.to_json() for finding in one.findings],
    }


def _verdict_of(held: Json) -> RunVerdict | Obstacles:
    return RunVerdict(
        **{
            **held,
            **{name: tuple(held[name]) for name in ("nominal", "effects", "members")},
            "shapes": {name: (pair[0], pair[1]) for name, pair in held["shapes"].items()},
            "findings": tuple(
                Finding(
                    Mark(one["file"], one["line"], one["column"]),
                    *(one[key] for key in ("code", "severity", "message", "hint")),
                )
                for one in held["findings"]
            ),
        }
    )


def _fit_plain(fit: Sequence[AmplitudeEstimate]) -> Json:
    return [
        {
            "effect": one.key.effect,
            "name": one.key.name,
            "unit": one.key.unit,
            "shape": one.key.shape,
            "orientations": [list(axes) for axes in one.key.orientations],
            "value": float(one.value).hex(),
            "standard_uncertainty": float(one.standard_uncertainty).hex(),
        }
        for one in fit
    ]


def _fit_of(held: Json) -> list[AmplitudeEstimate]:
    return [
        AmplitudeEstimate(
            AmplitudeKey(
                one["effect"],
                one["name"],
                one["unit"],
                one["shape"],
                tuple(tuple(axes) for axes in one["orientations"]),
            ),
            float.fromhex(one["value"]),
            float.fromhex(one["standard_uncertainty"]),
        )
        for one in held
    ]


# -- which device, bench and occasion ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Opened:
    """Describes a run folder that has passed the check. `bench`: name of the bench. `table`: asset number or serial number of the
    bench's table, if known."""

    run: JsonObject
    bench: str
    table: str
    seal: str


def _opened(run: Path) -> _Opened:
    from planrunner.tasks.estimate import sound_run

    reader = RunReader.open(run)
    bench = sound_run(reader).bench
    seal = digest(reader.folder.read(seals.NAME, seals.MOST_BYTES)) if reader.sealed else ""
    if "table" not in bench.instruments:
        return _Opened(reader.run, bench.name, "", seal)
    table = bench.instruments["table"].asset or reader.instruments.get("table", {}).get("serial", "")
    return _Opened(reader.run, bench.name, table, seal)


def _origins(runs: Sequence[Path], table: Path | None, *, skip: bool) -> list[RunOrigin | Obstacles]:
    """Returns every run with the names of its device, bench and occasion. If these names cannot be determined for a run, the
    obstacles are returned instead. The names come from the user's table and, if it does not state them, from the run folder.
    `skip`: see `_attempted`. Raises `InputError` for a run that is given twice and for a table with errors. If `skip` is False,
    also raises `InputError` with all obstacles."""
    log = Findings()
    resolved = [run.resolve() for run in runs]
    for index, run in enumerate(runs):
        if resolved[index] in resolved[:index]:
            log.error("fleet-run-twice", Mark(str(run)), "this run is given twice", "give every run once")
    stated = {} if table is None else _stated(table, runs, log)
    opened = {run: _attempted(_opened, run, skip=skip) for run in runs}
    if not skip:
        log.extend(finding for one in opened.values() if not isinstance(one, _Opened) for finding in one)
    if log.errors:
        raise InputError(log)
    tables: dict[str, set[str]] = {}
    for one in opened.values():
        if isinstance(one, _Opened):
            tables.setdefault(one.bench, set()).add(one.table)
    several = {name for name, found in tables.items() if len(found) > 1}
    known = [
        _labelled(run, one, stated.get(run, {}), several) if isinstance(one, _Opened) else one
        for run, one in opened.items()
    ]
    if not skip:
        _require_all(one for one in known if not isinstance(one, RunOrigin))
    return known


def _labelled(run: Path, opened: _Opened, stated: Mapping[Source, str], several: Set[str]) -> RunOrigin | Obstacles:
    """Returns the run with the names of its device, bench and occasion, or the obstacles to determining these names. `several`:
    names of benches that have had different tables. The name of the table is appended to the name of such a bench."""
    info = opened.run.get("info", {})
    table = f" (table {opened.table or 'without a number'})" if opened.bench in several else ""
    device = stated.get(Source.DEVICE) or device_of(info)
    if not device:
        hint = f"state the device in a table for --origins, with the columns {', '.join(_COLUMNS)}"
        message = (
            f"run.json does not say which device was measured: it contains neither {' nor '.join(map(repr, DEVICE))}"
        )
        return tuple(InputError.at(Mark(str(run)), "fleet-no-device", message, hint).findings)
    labels = {
        Source.DEVICE: device,
        Source.BENCH: stated.get(Source.BENCH) or f"{opened.bench}{table}",
        Source.OCCASION: stated.get(Source.OCCASION) or run.resolve().name,
    }
    return RunOrigin(run, labels, str(opened.run["created"]), str(info.get(LOT) or ""), opened.seal)


def _stated(path: Path, runs: Sequence[Path], log: Findings) -> dict[Path, dict[Source, str]]:
    """Reads the names in a CSV table with the columns run, device, bench and occasion. The last three columns are optional, and so
    are their entries."""
    text = read_text(path)
    reader = csv.DictReader(text.splitlines(), strict=True)
    by_name = {run.resolve().name: run for run in runs}
    found: dict[Path, dict[Source, str]] = {}
    try:
        fields = [name or "" for name in reader.fieldnames or ()]
        for name in fields:
            if name not in _COLUMNS:
                log.error(
                    "fleet-origins",
                    Mark(str(path), 1, 1, text=text),
                    f"unknown column '{name[:40]}'",
                    closest(name, _COLUMNS),
                )
        if "run" not in fields:
            hint = f"the first line names the columns: {', '.join(_COLUMNS)}"
            log.error("fleet-origins", Mark(str(path), 1, 1, text=text), "the table has no column 'run'", hint)
            return found
        for row in reader:
            mark = Mark(str(path), reader.line_num, 1, text=text)
            name = Path((row["run"] or "").strip()).name
            if name not in by_name:
                log.error("fleet-origins", mark, f"'{name[:80]}' is not one of the runs given", closest(name, by_name))
            elif by_name[name] in found:
                log.error("fleet-origins", mark, f"'{name[:80]}' is listed twice", "keep one of the lines")
            else:
                cells = {source: (row.get(source.value) or "").strip() for source in STATED}
                found[by_name[name]] = {source: cell for source, cell in cells.items() if cell}
    except csv.Error as error:
        mark = Mark(str(path), max(1, reader.line_num), 1, text=text)
        log.error("fleet-origins", mark, f"the table is not readable as CSV: {error}", "save it as CSV with commas")
    return found


# -- each run ----------------------------------------------------------------------------------------------------------


def _attempted(make: Callable[[Path], T], run: Path, *, skip: bool) -> T | Obstacles:
    """Returns the result of calling `make` for a run, or the obstacles that it reports. If `skip` is True, a changed run folder is
    an obstacle; otherwise an error is raised for it."""
    from planrunner.observation.refusals import ObservationError

    try:
        return make(run)
    except InputError as error:
        return tuple(error.findings)
    except ObservationError as error:
        return tuple(InputError.at(Mark(str(run)), "gap-unfit", str(error), error.hint).findings)
    except (IntegrityError, NotOrdinaryError) as error:
        if not skip:
            raise
        said = f"{error.filename}: {error.strerror}" if isinstance(error, NotOrdinaryError) else str(error)
        return tuple(InputError.at(Mark(str(run)), "run-integrity", said).findings)


def _verdict(nominal: tuple[str, ...] | None, skip: bool, run: Path) -> RunVerdict | Obstacles:
    """Returns the verdict on a run, or the obstacles to diagnosing it."""
    return _attempted(partial(_diagnosed, nominal), run, skip=skip)


def _diagnosed(nominal: tuple[str, ...] | None, run: Path) -> RunVerdict:
    from threadpoolctl import threadpool_limits

    from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose

    with threadpool_limits(limits=1, user_api="blas"):
        recorded = recorded_run(run)
        plan = recorded.sound.plan
        terms = nominal or (DiagnosisOptions().nominal if plan.diagnosis is None else plan.diagnosis.nominal)
        observed, findings = observe(recorded, terms)
        made = diagnose(observed, DiagnosisOptions(nominal=tuple(terms)))
    said = made.verdict
    return RunVerdict(
        plan.title,
        plan.sensor.kind,
        tuple(terms),
        said.kind,
        said.effects,
        said.members,
        dict(made.posterior.of_effects()),
        _shapes(made),
        recorded.sound.models.origin,
        tuple(findings),
    )


def _shapes(made: Diagnosis) -> dict[str, tuple[float, float]]:
    found = {}
    for candidate in made.grounds.candidates:
        if candidate.variants and candidate.best.variant.shape is not None:
            found[candidate.id] = candidate.best.variant.shape, float(candidate.log_bayes.max())
    return found


def _fitted(
    nominal: tuple[str, ...], effects: tuple[tuple[str, float | None], ...], run: Path
) -> list[AmplitudeEstimate]:
    """Returns the amplitudes of the nominal terms and of the given effects, fitted to a run that has already been diagnosed."""
    from threadpoolctl import threadpool_limits

    from planrunner.error_model.effects.interface import effect_named
    from planrunner.gap.hypotheses.candidates import Weighing

    with threadpool_limits(limits=1, user_api="blas"):
        observed, _ = observe(recorded_run(run), nominal)
        loaded = [(effect_named(name), shape) for name, shape in effects]
        return amplitudes(Weighing(observed, nominal), nominal, loaded)


# -- together ----------------------------------------------------------------------------------------------------------


def _require_all(obstacles: Iterable[Obstacles]) -> None:
    found = [finding for one in obstacles for finding in one]
    if found:
        raise InputError(found)


def _compare(runs: Sequence[Path], verdicts: Sequence[RunVerdict], log: Findings) -> None:
    """Raises `InputError` for runs that cannot be compared; adds a note to the log if their plans differ."""
    first, wrong = verdicts[0], Findings()
    for run, one in zip(runs, verdicts, strict=True):
        if one.sensor != first.sensor:
            message = f"its sensor is of the kind '{one.sensor}', that of the first run is of the kind '{first.sensor}'"
            wrong.error("fleet-other-sensor", Mark(str(run)), message, "give only runs of one kind of sensor")
        elif set(one.nominal) != set(first.nominal):
            message = (
                f"its simulation fits {', '.join(one.nominal) or 'nothing'}; that of the first run fits "
                f"{', '.join(first.nominal) or 'nothing'}"
            )
            wrong.error("fleet-other-terms", Mark(str(run)), message, "give the same terms for all runs with --nominal")
    if wrong.errors:
        raise InputError(wrong)
    plans = list(dict.fromkeys(one.plan for one in verdicts))
    if len(plans) > 1:
        message = f"the runs have {len(plans)} plans: {'; '.join(plans)}"
        hint = "each amplitude is compared among the runs whose plan determines it"
        log.note("fleet-plans", Mark(str(runs[0])), message, hint)


def _named(verdicts: Sequence[RunVerdict]) -> tuple[str, ...]:
    """Returns the effects that at least one run names. If the plan of a run cannot distinguish several effects, one of them is
    chosen. The chosen effect is the effect that another run names with certainty. If there is no such effect, the effect with the
    highest probability over all runs together is chosen."""
    certain = {name for one in verdicts if not one.members for name in one.effects}
    chosen = set(certain)
    for one in verdicts:
        members = [name for name in one.members if name != "unknown"]
        if not members or any(set(name.split("+")) <= certain for name in members):
            continue
        total = {
            name: sum(np.log(max(other.probability.get(name, 0.0), _LEAST)) for other in verdicts) for name in members
        }
        chosen |= set(max(members, key=lambda name: total[name]).split("+"))
    return tuple(sorted(chosen))


def _with_amplitudes(names: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Returns the effects that have amplitudes, and the other effects with the reason why they are not attributed."""
    from planrunner.error_model.effects.interface import OutsideCoefficients, effect_named

    kept, left = [], {}
    for name in names:
        if name == "unknown":
            continue
        if isinstance(effect_named(name), OutsideCoefficients):
            left[name] = "it acts on the noise and has no amplitude"
        else:
            kept.append(name)
    return tuple(kept), left


def _shape(name: str, verdicts: Sequence[RunVerdict]) -> float | None:
    """Returns the shape of an effect from the run that gives the most evidence for this shape. Returns None for an effect without a
    shape."""
    found = [one.shapes[name] for one in verdicts if name in one.shapes]
    return max(found, key=lambda item: item[1])[0] if found else None


def _attributed(
    fits: Sequence[Sequence[AmplitudeEstimate]], origins: Sequence[RunOrigin], workers: Workers
) -> tuple[Attributed, ...]:
    """Returns all amplitudes that at least two runs determine, with their attribution."""
    by_key: dict[AmplitudeKey, list[tuple[int, float, float]]] = {}
    for index, fit in enumerate(fits):
        for one in fit:
            if np.isfinite(one.value) and np.isfinite(one.standard_uncertainty) and one.standard_uncertainty > 0:
                by_key.setdefault(one.key, []).append((index, one.value, one.standard_uncertainty))
    listed = [item for item in by_key.items() if len(item[1]) > 1]
    listed.sort(key=lambda item: item[0].effect in NOMINAL_TERMS)  # the named effects first
    return tuple(results_of(partial(_one_attributed, tuple(origins), len(listed)), listed, workers))


def _one_attributed(
    origins: Sequence[RunOrigin], amplitudes_: int, given: tuple[AmplitudeKey, Sequence[tuple[int, float, float]]]
) -> Attributed:
    """Attributes one amplitude to its sources. `amplitudes_`: number of all amplitudes that are examined; the test for changes
    takes this number into account. After a change, a device or bench is treated as a new device or bench."""
    from threadpoolctl import threadpool_limits

    key, listed = given
    listed = sorted(listed, key=lambda one: origins[one[0]].created)
    indices, values, spreads = zip(*listed, strict=True)
    groups = {source: [origins[index].labels[source] for index in indices] for source in STATED}
    days = [datetime.fromisoformat(origins[index].created).timestamp() / 86400 for index in indices]
    estimates = Estimates(np.array(values), np.array(spreads), groups)
    with threadpool_limits(limits=1, user_api="blas"):
        found = changes(estimates, days, amplitudes_)
        since = since_steps(found, [origins[index].created for index in indices])
        made = attribute(replace(estimates, since=since))
    return Attributed(key, indices, values, spreads, made, found)


def _shared(attributed: Sequence[Attributed], origins: Sequence[RunOrigin]) -> tuple[SharedByLot, ...]:
    """Returns the amplitudes that the devices of one lot have in common and that no other device has."""
    lots = {one.labels[Source.DEVICE]: one.lot for one in origins if one.lot}
    found: list[SharedByLot] = []
    for one in attributed:
        device = one.attribution.of(Source.DEVICE)
        if device.probability < SURE or len(device.component.sources) > 1:
            continue
        levels: dict[str, list[Uncertain]] = {}
        for part in device.parts:
            levels.setdefault(part.label, []).append(part.level or part.part)
        found += shared_by_lots(one.key, levels, lots)
    return tuple(found)
