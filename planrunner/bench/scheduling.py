"""Makes a schedule from a plan and a bench. Computes the transitions between states, and checks that the bench can reach every
state.

The findings that are added here concern physics: what the bench can reach, and how it is sampled. Motions are checked in
`planrunner.bench.motion_checks`, temperatures in `planrunner.bench.temperature_checks`.

Settling conditions and limits are converted to SI units. The module also checks that the bench can measure the quantities to which
these conditions and limits apply. With simulated time, nothing is measured: a state is steady as soon as the simulated instrument
reports it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import Findings, Mark, closest, elsewhere
from planrunner.bench.model import BenchModels
from planrunner.bench.motion_checks import Hold, no_table, start_motion
from planrunner.bench.table_states import TableState
from planrunner.bench.temperature_checks import Temperatures
from planrunner.physics.kinematics import Unreachable
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan import model
from planrunner.plan.expand import StatedSegment
from planrunner.plan.motion import motion_of
from planrunner.plan.orientation import Orientation
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Cycle, Motion, Rest, Schedule, Segment, Spin, Stability, Watch
from planrunner.plan.segments import MotionSpec, Ramp, StabilitySpec, State, Tolerated, Turns, WatchSpec

Add = Callable[[str, Mark, str, str], None]


def wait_of(stated: Quantity | StabilitySpec | None) -> tuple[float, Stability | None]:
    """Returns the planned time [s] of a `settle` or `soak`. Also returns the condition of stability if the plan states one,
    otherwise None."""
    if not isinstance(stated, StabilitySpec):
        return (0.0 if stated is None else stated.value), None
    duration = stated.for_.value
    return duration, Stability(_in_si(stated), duration, stated.within.value)


def watch_of(stated: WatchSpec | None) -> Watch | None:
    """Converts the limits that a plan states under `watch` to SI units; None if it states none."""
    if stated is None:
        return None
    lost, corrupt = stated.lost_frames, stated.corrupt_frames
    return Watch(
        _in_si(stated),
        None if lost is None else lost.value,
        None if corrupt is None else corrupt.value,
        stated.doubts == "limit",
        stated.retakes,
    )


def check_measured(state: State, marks: Mapping[str, Mark], models: BenchModels, add: Add) -> None:
    """Adds an error for each limit on a quantity that no instrument of the bench can measure. `add`: a function that adds a
    finding; its arguments are the code, the position in the plan, the message and the hint."""
    for name, stated in (("soak", state.soak), ("settle", state.settle), ("watch", state.watch)):
        if isinstance(stated, Tolerated) and stated.stated() and not models.measures:
            message = f"no instrument of this bench has live readings of {', '.join(stated.stated())}"
            add("physics-unmeasured", marks[name], message, "leave them out, or use a bench that measures them")
    watch = state.watch
    if watch is None or models.counts:
        return
    if watch.lost_frames is not None or watch.corrupt_frames is not None:
        message = "the sensor's driver does not count lost and corrupt frames"
        add("physics-unmeasured", marks["watch"], message, "leave their limits out, or use another driver")


def _in_si(stated: Tolerated) -> dict[str, float]:
    return {name: quantity.value for name, quantity in stated.stated().items()}


def build_schedule(
    stated: Sequence[StatedSegment],
    models: BenchModels,
    log: Findings,
    mounting: Mapping[str, model.MountedAxis] | None = None,
) -> Schedule:
    """Returns the schedule of the valid segments. A segment with an error is omitted; the other segments are still checked.

    `mounting`: directions of the sensor's input axes in its frame, if stated in the plan; by default the axes of the frame.
    """
    planner = _Planner(models, log, mounting or {})
    segments: list[Segment] = []
    for item in stated:
        segment = planner.segment(len(segments), item)
        if segment is not None:
            segments.append(segment)
    planner.report_missing()
    schedule = Schedule(tuple(segments), planner.time + planner.return_time())
    return schedule if _bearable(schedule, models, log) else Schedule((), 0.0)


LONGEST = 366 * 86400.0
"""Maximum duration of a schedule, s: longer than any test of a sensor, and short enough for dates and time counters."""

MOST_SAMPLES = 10_000_000_000
"""Maximum number of samples of a schedule. With this number, each channel takes 80 GB."""


def _bearable(schedule: Schedule, models: BenchModels, log: Findings) -> bool:
    """Returns True if planning can continue with a schedule of this size. Adds findings if the schedule takes more than a year or
    gives more samples than can be stored."""
    if not schedule.segments:
        return True
    before = log.raised
    if schedule.total > LONGEST:
        parts = [
            (seconds, segment, key)
            for segment in schedule.segments
            for key, seconds in (("dwell", segment.dwell or 0.0), ("settle", segment.settle), ("soak", segment.soak))
        ]
        seconds, segment, key = max(parts, key=lambda part: part[0])
        message = f"the plan takes {_days(schedule.total)}, more than a year; the {key} of '{segment.label}' alone takes {_days(seconds)}"
        log.error("limit-time", segment.marks.get(key, segment.marks[""]), message, "shorten it, or split the plan")
    own = models.sensor.sample_rate if models.sensor is not None else 0.0
    counts = [(segment.dwell or 0.0) * (segment.sample_rate or own) for segment in schedule.segments]
    if sum(counts) > MOST_SAMPLES and log.raised == before:
        most, segment = max(zip(counts, schedule.segments, strict=True), key=lambda pair: pair[0])
        message = (
            f"the plan records {sum(counts):.1e} samples, more than {MOST_SAMPLES:.0e} (80 GB per channel); "
            f"'{segment.label}' gives {most:.1e} of them"
        )
        mark = segment.marks.get("sample_rate") or segment.marks.get("dwell") or segment.marks[""]
        log.error("limit-samples", mark, message, "sample more slowly, dwell for less, or split the plan")
    return log.raised == before


def _days(seconds: float) -> str:
    days = f"{seconds / 86400:,.0f}".replace(",", " ")
    return f"{days} day" if days == "1" else f"{days} days"


def _lacking(segments: Mapping[Mark, str], key: str) -> tuple[Mark, str]:
    """Returns the position and the message of the finding about segments that lack a required key. The message names the first of
    these segments. `segments`: maps the position of each segment in the plan to its label."""
    first, label = next(iter(segments.items()))
    return first, f"the segment '{label}' has no {key}{elsewhere(list(segments), first)}"


class _Planner:
    """Follows the state of the bench from segment to segment while a schedule is made."""

    def __init__(self, models: BenchModels, log: Findings, mounting: Mapping[str, model.MountedAxis]):
        self.models = models
        self.input_axes = np.array([axis.direction for axis in mounting.values()]) if mounting else np.eye(3)
        self.log = log
        self.time = 0.0
        self.temperatures = Temperatures(models, log)
        axes = models.table.axes if models.table else ()
        self.state = TableState(np.zeros(len(axes)))
        self._timed = True  # until a segment is left out, because the soak time of the sensor is unknown after it
        self._soaked: float | None = None
        self._kept: float | None = None  # K, by the chamber
        self._mounted: Orientation | None = None
        self._surroundings: dict[str, Quantity | None] = {}
        self._warned: set[str] = set()
        self._complained: set[tuple[str, Mark]] = set()
        self._without_orientation: dict[Mark, str] = {}
        self._without_dwell: dict[Mark, str] = {}

    def segment(self, index: int, item: StatedSegment) -> Segment | None:
        before = self.log.raised
        state, marks = item.state, item.marks
        orientation = self._orientation(item)
        dwell = self._dwell(item)
        settle, stable = wait_of(state.settle)
        motion = motion_of(state, marks, dwell, self.log)
        kelvin, ramp_to = self._temperature(item)
        if orientation is None or motion is None or (dwell is None and state.dwell != "recorded"):
            self._timed = False
            return None
        mark_of = marks.get
        transition = self.temperatures.change(kelvin, self.time, mark_of("temperature") or item.mark)
        soak, soaked = wait_of(state.soak) if kelvin is not None and kelvin != self._soaked else (0.0, None)
        self._soaked = kelvin if kelvin is not None else self._soaked
        attitude = orientation.attitude
        transition += self._move(orientation, attitude, mark_of("orientation") or item.mark)
        longest = settle if stable is None else stable.patience
        hold = Hold(longest, dwell, self._sampled(item), longest - settle)
        transition += self._start(motion, hold, attitude, item)
        self._check_mode(item)
        self._check_samples(item, dwell)
        check_measured(state, marks, self.models, self._once)
        self._check_surroundings(item)
        start = self.time + transition + soak + settle
        if ramp_to is not None:
            self.temperatures.ramp(ramp_to, start, dwell, marks["temperature"])
            self._soaked = None
        if self.log.raised > before:
            self._timed = False
            return None
        if self._timed and kelvin is not None and soaked is None:
            self.temperatures.check_soaked(item.label, start, soak, mark_of("soak") or marks["temperature"])
        self.time = start + (dwell or 0.0)
        rate = state.sample_rate
        kept = self._kept
        if not self.models.replays:
            self._kept = next((one for one in (ramp_to, kelvin) if one is not None), kept)
        return Segment(
            index=index,
            label=item.label,
            attitude=attitude,
            orientation=orientation.text,
            motion=motion,
            dwell=dwell,
            settle=settle,
            soak=soak,
            temperature=kelvin,
            ramp_to=ramp_to,
            kept_temperature=kept,
            supply_voltage=None if state.supply_voltage is None else state.supply_voltage.value,
            ambient_pressure=None if state.ambient_pressure is None else state.ambient_pressure.value,
            sample_rate=rate.value if rate else None,
            mode=state.mode,
            on_break=state.on_break or "retake",
            stable=stable,
            soaked=soaked,
            watch=watch_of(state.watch),
            prompts=tuple(text for text, _ in item.prompts),
            transition=transition,
            start=start,
            marks={**marks, "": item.mark, "prompt": item.prompts[0][1] if item.prompts else item.mark},
        )

    def report_missing(self) -> None:
        """Adds one finding for each missing key, even if several segments lack it, because a key that is missing in `defaults` is
        missing in every segment."""
        if self._without_orientation:
            hint = "add for example `orientation: {x: up, y: north, z: west}` there or to `defaults`, or `orientation: unknown`"
            self.log.error("meaning-no-orientation", *_lacking(self._without_orientation, "orientation"), hint)
        if self._without_dwell:
            hint = "add for example `dwell: 2 min` there or to `defaults`"
            self.log.error("meaning-no-dwell", *_lacking(self._without_dwell, "dwell"), hint)

    def return_time(self) -> float:
        """Returns the time [s] from the end of the last segment to the safe state, in which the chamber is at ambient temperature
        and the table is at rest."""
        return max(self.state.stopping, self.temperatures.return_time())

    # -- keys of a segment ---------------------------------------------------------------------------------------------

    def _orientation(self, item: StatedSegment) -> Orientation | None:
        orientation = item.state.orientation
        if orientation is None:
            self._without_orientation.setdefault(item.mark, item.label)
        return orientation

    def _dwell(self, item: StatedSegment) -> float | None:
        dwell = item.state.dwell
        if dwell is None:
            self._without_dwell.setdefault(item.mark, item.label)
        elif isinstance(dwell, Quantity):
            return dwell.value
        elif isinstance(dwell, str) and not self.models.replays:
            message = "this bench records live: there is no recording that determines the dwell"
            self._once("physics-dwell", item.marks["dwell"], message, "write for example `dwell: 2 min`")
        elif isinstance(dwell, Turns):
            return self._turns(item, dwell)
        return None

    def _turns(self, item: StatedSegment, dwell: Turns) -> float | None:
        """Returns the duration [s] of a dwell that is stated in whole turns of a spin or in whole cycles of turns and stops; None
        if the dwell or the motion has an error."""
        if (dwell.turns is None) == (dwell.cycles is None):
            message = f"the dwell of '{item.label}' has {'both turns and cycles' if dwell.turns else 'neither turns nor cycles'}"
            self._once("meaning-turns", item.marks["dwell"], message, "write for example `dwell: {turns: 1}`")
            return None
        motion = motion_of(item.state, item.marks, None, Findings())
        if motion is None:
            return None  # `segment` reports the error
        stated = dwell.turns or dwell.cycles or 1
        if dwell.turns and isinstance(motion, Spin):
            period = 2 * math.pi / abs(motion.rate)
        elif dwell.cycles and isinstance(motion, Cycle):
            axes = self.models.table.axes if self.models.table else ()
            period = RotationCycle.of(motion, axes[0].max_acceleration if axes else math.inf).period
        else:
            asked = "turns" if dwell.turns else "cycles"
            does = "spin" if dwell.turns else "have a cycle"
            message = f"the dwell of '{item.label}' is given in {asked}, but the segment does not {does}"
            hint = "write turns if the motion is a rate, cycles if it is a cycle, or a time"
            self._once("meaning-turns", item.marks["dwell"], message, hint)
            return None
        if dwell.at_least is not None:
            stated = max(stated, math.ceil(dwell.at_least.value / period - 1e-9))
        return stated * period

    def _temperature(self, item: StatedSegment) -> tuple[float | None, float | None]:
        stated = item.state.temperature
        if isinstance(stated, Ramp):
            return None, stated.ramp_to.value
        return (stated.value if stated is not None else None), None

    # -- capabilities of the bench -----------------------------------------------------------------------------------

    def _once(self, code: str, mark: Mark, message: str, hint: str) -> None:
        """Adds at most one finding for each position in the plan, so that a sweep over a wrong state is reported once."""
        if (code, mark) not in self._complained:
            self._complained.add((code, mark))
            self.log.error(code, mark, message, hint)

    def _check_mode(self, item: StatedSegment) -> None:
        mode, sensor = item.state.mode, self.models.sensor
        if mode is not None and sensor is not None and mode not in sensor.modes and not self.models.replays:
            hint = closest(mode, sensor.modes) or "leave mode out: this sensor has only one mode"
            self._once("physics-mode", item.marks["mode"], f"the sensor of this bench has no mode '{mode}'", hint)

    def _check_surroundings(self, item: StatedSegment) -> None:
        """Adds a warning if the supply voltage or the pressure changes without a prompt that asks for the change."""
        for key in ("supply_voltage", "ambient_pressure"):
            stated = getattr(item.state, key)
            before = self._surroundings.setdefault(key, stated)
            if stated is None:
                continue
            self._surroundings[key] = stated
            changed = before is not None and before.value != stated.value
            if changed and self.models.origin == "measured" and not item.prompts and key not in self._warned:
                self._warned.add(key)
                message = (
                    f"'{item.label}' needs {stated} after {before}, but no instrument sets the {key.replace('_', ' ')}"
                )
                hint = "ask for it with a `prompt`, such as `prompt: Set the supply to {supply_voltage}`"
                self.log.warning("physics-surroundings", item.marks[key], message, hint)

    def _check_samples(self, item: StatedSegment, dwell: float | None) -> None:
        rate, sensor, sampled = item.state.sample_rate, self.models.sensor, self._sampled(item)
        if rate is not None and sensor is not None and (refused := sensor.rate_refused(rate.value)):
            hint = (
                "use the sample rate to which the sensor is set, or leave sample_rate out"
                if sensor.one_rate
                else "sample more slowly"
            )
            self._once("physics-sample-rate", item.marks["sample_rate"], refused, hint)
        elif dwell is not None and sampled is not None and dwell * sampled < 1 - 1e-9:
            message = f"a dwell of {dwell:.4g} s ends before the first sample at {sampled:g} Hz"
            mark = item.marks.get("sample_rate") or item.marks["dwell"]
            self._once("physics-samples", mark, message, "sample faster or dwell longer")

    def _move(self, orientation: Orientation, attitude: Array | None, mark: Mark) -> float:
        table = self.models.table
        if table is None and attitude is not None and not self.models.replays:
            self._mounted = self._mounted or orientation
            if orientation.matrix != self._mounted.matrix:
                no_table(f"turn the sensor from '{self._mounted.text}' to '{orientation.text}'", mark, self.log)
        if table is None or attitude is None:
            return 0.0
        try:
            moved, seconds = self.state.oriented(table.axes, attitude, self.models.site.azimuth)
        except Unreachable as error:
            self.log.error(
                "physics-orientation",
                mark,
                f"the table cannot reach '{orientation.text}': {error}",
                "choose another orientation or bench",
            )
            return 0.0
        seconds += self.state.stopping
        self.state = moved
        return seconds

    def _start(self, motion: Motion, hold: Hold, attitude: Array | None, item: StatedSegment) -> float:
        stopping, before = self.state.stopping, self.state.still()
        if isinstance(motion, Rest):
            self.state = before
            return stopping
        stated = item.state.motion
        whole = item.marks.get("motion") or item.marks.get("rate") or item.mark

        def at(key: str) -> Mark:
            return stated.at(key) if key and isinstance(stated, MotionSpec) else whole

        seen = None if attitude is None else self.input_axes @ attitude
        seconds, self.state = start_motion(motion, hold, seen, before, self.models, at, self.log)
        return stopping + seconds

    def _sampled(self, item: StatedSegment) -> float | None:
        """Returns the sample rate [Hz] of a segment; None if the sensor is not known."""
        rate, sensor = item.state.sample_rate, self.models.sensor
        if rate is not None:
            return rate.value
        return None if sensor is None else sensor.sample_rate
