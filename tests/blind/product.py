"""Hands a blind case to the product's diagnosis: the one module here that knows `planrunner`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.base.findings import Findings
from planrunner.bench.model import BenchModels
from planrunner.bench.scheduling import build_schedule
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.closure import FoldChoice, choices_of, predictions, whole_choices
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions
from planrunner.gap.answer.diagnosis import diagnose as diagnosed
from planrunner.gap.fleet.attribution import Contribution, Estimates, Source, attribute
from planrunner.gap.hypotheses.declarations import corrected
from planrunner.gap.hypotheses.forms import shape_alone, whole_forms
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import ChamberModel, NoiseModel, OutputModel, SensorModel, TableModel
from planrunner.observation.samples import observed
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis
from planrunner.plan.expand import expand
from planrunner.plan.model import parse_plan
from planrunner.plan.schedule import Motion, Rest, Rock, Segment, Spin
from planrunner.tasks.propose import Frame, propose_next
from tests.blind import folder as store
from tests.blind.device import SENSORS
from tests.blind.folder import Shown
from tests.blind.generator import Case, channel_names, device_of, mean_change
from tests.blind.motion import WORDS, Array, Fault, Schedule, vector
from tests.blind.plans import PLANS, Axis
from tests.blind.plans import Segment as Row

ZERO_CELSIUS = 273.15
TABLE = TableModel(
    tuple(
        TableAxis(name, direction, np.radians(350.0), np.radians(500.0))
        for name, direction in (("outer", (0, 0, 1)), ("middle", (1, 0, 0)), ("inner", (0, 0, 1)))
    )
)
CHAMBER = ChamberModel(ZERO_CELSIUS - 20.0, ZERO_CELSIUS + 70.0, 2.0 / 60)
"""What a laboratory has that can do all plans here: a three-axis table and a chamber."""
_WORD: dict[tuple[float, ...], str] = {direction: word for word, direction in WORDS.items()}


def attributed(values: Array, noise: Array, members: Mapping[str, NDArray[np.int64]]) -> Sequence[Contribution]:
    """What the product says of the estimates of one amplitude in several runs. members: the number of every run's group, by source."""
    groups = {source: [str(number) for number in members[source.value]] for source in Source}
    return attribute(Estimates(values, noise, groups)).contributions


def motion(row: Row) -> Motion:
    if row.kind == "rate":
        return Spin(np.radians(row.rate))
    if row.kind == "rock":
        return Rock(np.radians(row.amplitude), row.frequency, (0.0,), row.duration)
    return Rest()


def planned(index: int, row: Row, before: float) -> Segment:
    """The segment as a plan would state it; a ramp leaves the temperature before it."""
    now = row.chamber + ZERO_CELSIUS
    return Segment(
        index,
        row.label,
        np.array([vector(axis) for axis in row.axes], float),
        " ".join(map(str, row.axes)),
        motion(row),
        row.duration,
        temperature=before + ZERO_CELSIUS if row.ramp else now,
        ramp_to=now if row.ramp else None,
        start=row.start,
    )


def sensor_model(shown: Shown) -> SensorModel:
    """Declared noise in the product's terms: N of a one-sided density S is S ÷ √2."""
    outputs = []
    for name in channel_names(shown.sensor):
        kind, axis = name.split("_")[:2]
        channels = shown.bench["channels"]
        declared = channels.get(f"{kind}_{axis}", channels[kind])
        noise = NoiseModel(
            declared["white_noise_density"] / np.sqrt(2), declared["bias_instability"], declared["resolution"]
        )
        outputs.append(OutputModel(name, declared["unit"], noise=noise))
    return SensorModel("imu", tuple(outputs), shown.bench["sampling_hz"])


def recorded_segments(shown: Shown) -> list[RecordedSegment]:
    """The rows of each segment, found by time."""
    units = {"table_angle_deg": "deg", "temperature_degC": "degC"}
    units |= {name: "deg/s" if name.startswith("gyro") else "m/s^2" for name in channel_names(shown.sensor)}
    time, found, before = shown.columns["time_s"], [], 25.0
    for index, row in enumerate(shown.segments):
        rows = slice(*np.searchsorted(time, [row.start - 1e-6, row.end - 1e-6]))
        block = Block(time[rows], {name: shown.columns[name][rows] for name in units})
        statistics = statistics_of([block], list(units), len(block.time))
        found.append(RecordedSegment(planned(index, row, before), units, statistics, _blocks(block)))
        before = row.chamber
    return found


def _blocks(block: Block) -> Callable[[Sequence[str]], Iterator[Block]]:
    def blocks(names: Sequence[str]) -> Iterator[Block]:
        yield Block(block.time, {name: block.channels[name] for name in names})

    return blocks


def observation(shown: Shown, encoder: bool = True) -> Observed:
    """The case as the product reads it. encoder: whether the recording contains the angle of the table."""
    declared = shown.bench["site"]
    site = Site(
        np.radians(declared["latitude_deg"]),
        declared["gravity_m_per_s2"],
        earth_rate=np.radians(declared["earth_rate_deg_per_h"]) / 3600,
        magnetic_field=tuple(declared["magnetic_field_enu"]),
    )
    return observed(
        recorded_segments(shown),
        site,
        sensor_model(shown),
        angle_channel="table_angle_deg" if encoder else None,
        temperature_channel="temperature_degC",
        magnetic=declared["magnetic_field_enu"],
        free_angle=True,
    )


@lru_cache(maxsize=1)
def _kept(folder: Path, name: str) -> Diagnosis:
    """The diagnosis of a case, kept until the next case: its answer and its closure share it. folder: of the campaign."""
    return diagnosed(corrected(observation(store.shown(folder, name)))[0])


def diagnose(shown: Shown) -> dict[str, Any]:
    """The diagnosis' answer without what only its page shows."""
    answer = _kept(shown.folder.parents[1], shown.name).to_json()
    answer.pop("pictures", None)
    return {**answer, "declarations": [one.effect for one in corrected(observation(shown))[1]]}


def diagnosis_of(shown: Shown, effects: Sequence[str] | None = None) -> Diagnosis:
    """The diagnosis itself."""
    return diagnosed(observation(shown), DiagnosisOptions(effects=None if effects is None else tuple(effects)))


Shut = tuple[float, float, float, float]
"""A stated closure, the ends of its interval, and the share by which the true gap of the held-out segments shrinks."""


def closures_of(answer: Diagnosis, case: Case) -> dict[str, Shut]:
    """The closure of all channels under '', and by channel; without those that are not stated."""
    shut, weighing, known = answer.closure, answer.grounds.weighing, answer.grounds.noise
    if known is None or not shut.resolvable:
        return {}
    sensor = SENSORS[case.sensor]
    factors = [channel.factor for channel in weighing.observed.channels]
    schedule, noise = Schedule(PLANS[case.plan], sensor.sampling), case.label["noise_factors"]
    changed = mean_change(schedule, sensor, case.device, list(case.faults), noise) * factors
    coefficients = weighing.spectrum.project(weighing.observed, changed)
    gap, difference, channel = predictions(weighing, known, answer.grounds.choices, coefficients)
    names = [one.name for one in weighing.observed.channels]
    found = {"": (shut.shrinks_by, *shut.interval_90, _shrinks_by(gap, difference))}
    for one in shut.channels:
        at = channel == names.index(one.channel)
        found[one.channel] = (one.shrinks_by, *one.interval_90, _shrinks_by(gap[at], difference[at]))
    return found


def closure_and_truth(shown: Shown) -> dict[str, Any]:
    """The closure beside the shares by which the true gap of the held-out segments shrinks: `true`, by the very predictions that it was
    made with, and `told`, by those of the same folds when the true effects are told. It opens what is sealed, and answers nothing else."""
    sealed = shown.folder.parents[1] / "sealed"
    label = json.loads((sealed / f"{shown.name}.json").read_text(encoding="utf-8"))["label"]
    device = device_of(int((sealed / "seed").read_text(encoding="utf-8")), int(shown.name.split("-")[1]), shown.sensor)
    faults = [Fault(e["effect"], np.array(e["theta"]), tuple(e["shape"])) for e in label["entries"]]
    answer = _kept(shown.folder.parents[1], shown.name)
    plain = {"closure": answer.to_json()["closure"]}
    if answer.grounds.noise is not None and answer.closure.resolvable:
        weighing, known = answer.grounds.weighing, answer.grounds.noise
        factors = [channel.factor for channel in weighing.observed.channels]
        changed = mean_change(shown.schedule, shown.sensor, device, faults, label["noise_factors"]) * factors
        coefficients = weighing.spectrum.project(weighing.observed, changed)
        told = _told(answer, label["effects"])
        plain["closure"] |= {
            "true": _shrinks_by(*predictions(weighing, known, answer.grounds.choices, coefficients)[:2]),
            "told": _shrinks_by(*predictions(weighing, known, told, coefficients, -np.inf)[:2]) if told else None,
        }
    return plain


def _shrinks_by(gap: Array, difference: Array) -> float:
    return float(1 - np.linalg.norm(gap - difference) / np.linalg.norm(gap))


def _told(answer: Diagnosis, effects: Sequence[str]) -> list[FoldChoice]:
    """What remains to be chosen where the effects are known: their shapes. Empty where none of them changes the outputs' means."""
    weighing, by_id = answer.grounds.weighing, {c.id: c for c in answer.grounds.candidates if c.variants}
    known = [by_id[name] for name in sorted(effects) if name in by_id]
    if not known:
        return []
    if len(known) > 1:
        return choices_of(weighing, "told", [(one.best, one) for one in known], 1.0)
    shaped = shape_alone(known[0])
    exact = whole_forms(weighing, shaped) if shaped is not None else []
    if exact:
        return whole_choices(weighing, "told", known[0].effect, exact, 1.0)
    return choices_of(weighing, "told", [(known[0].best, known[0])], 1.0)


@dataclass(frozen=True)
class Further:
    """What a diagnosis proposes to measure next. rows: in the generator's terms, none where it says that nothing helps; promised:
    expected probability of the true one among the rivals."""

    rows: tuple[Row, ...]
    rivals: tuple[str, ...]
    promised: float


def posterior_and_next(
    shown: Shown, move: float, soak: float, equipped: bool
) -> tuple[dict[str, float], Further | None]:
    """The posterior, and the segments of the proposed plan as the plan language gives them back, after those that were recorded.

    move, soak: s, before each segment, and more after a change of temperature. equipped: whether the bench has `TABLE` and `CHAMBER`,
    which has gone back and soaked; of one that plays a recording back no more is known than what that shows.
    """
    found = diagnosed(observation(shown))
    model = sensor_model(shown)
    site = observation(shown).site
    has = BenchModels(site, TABLE, CHAMBER, model) if equipped else BenchModels(site, None, None, model, replays=True)
    outputs = tuple(output.name for output in model.outputs)
    frame = Frame("blind", "imu_recording", "imu", outputs, move if equipped else 0.0, soak)
    made = propose_next(found, recorded_segments(shown), has, frame)
    if made is None:
        return found.posterior.probability, None
    names = tuple(name for name, _ in made.proposal.rivals)
    if not made.text:
        return found.posterior.probability, Further((), names, made.proposal.probability)
    plan, log = parse_plan(made.text, "proposed")
    if plan is None or log.errors:
        raise ValueError([finding.message for finding in log.errors])
    segments = build_schedule(expand(plan, log), has, Findings()).segments
    last = shown.segments[-1]
    if equipped:
        last = replace(last, chamber=shown.segments[0].chamber, duration=last.duration + soak)
    rows = _rows(segments, last, move, soak)
    return found.posterior.probability, Further(rows, names, made.proposal.probability)


def posterior(shown: Shown) -> dict[str, float]:
    return diagnosed(observation(shown)).posterior.probability


def _axis(direction: Array) -> Axis:
    x, y, z = (float(v) for v in direction)
    near = (round(x, 9), round(y, 9), round(z, 9))
    return _WORD.get(near, (x, y, z))


def _rows(segments: Sequence[Segment], last: Row, move: float, soak: float) -> tuple[Row, ...]:
    found: list[Row] = []
    for item in segments:
        if item.attitude is None or item.dwell is None:
            raise ValueError(f"{item.label} has no orientation or no dwell")
        kelvin = item.ramp_to if item.ramp_to is not None else item.temperature
        target = last.chamber if kelvin is None else round(kelvin - ZERO_CELSIUS, 6)
        ramp = item.ramp_to is not None
        start = last.end + move + (soak if not ramp and target != last.chamber else 0.0)
        x, y, z = (_axis(axis) for axis in item.attitude)
        row = Row(f"next-{item.label}", "static", (x, y, z), item.dwell, chamber=target, ramp=ramp, start=start)
        if isinstance(item.motion, Spin):
            row = replace(row, kind="rate", rate=float(np.degrees(item.motion.rate)))
        elif isinstance(item.motion, Rock):
            amplitude = float(np.degrees(item.motion.amplitude))
            row = replace(row, kind="rock", amplitude=amplitude, frequency=item.motion.frequency)
        found.append(row)
        last = row
    return tuple(found)
