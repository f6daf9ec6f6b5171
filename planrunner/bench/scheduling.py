"""Plan × bench → schedule: transitions worked out, and every state held against what the bench can do.

The findings added here are those of physics: reach, rates, accelerations, temperatures, cable wrap, whole turns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from planrunner.bench.model import BenchModels
from planrunner.instruments.models import TableModel
from planrunner.physics.kinematics import (
    Array,
    TableAxis,
    Unreachable,
    joint_angles,
    limits_in_words,
    spin_axis,
    spin_up_time,
    transition_time,
)
from planrunner.plan.expand import StatedSegment
from planrunner.plan.findings import Findings, Mark, closest
from planrunner.plan.model import Ramp, Turns
from planrunner.plan.motion import motion_of
from planrunner.plan.orientation import Orientation
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Cycle, Motion, Rest, Rock, Schedule, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

# A part of a turn left over biases the mean rate by the horizontal Earth rate; below this share of the rate nobody notices.
WHOLE_TURN_TOLERANCE = 100e-6


def build_schedule(stated: Sequence[StatedSegment], models: BenchModels, log: Findings) -> Schedule:
    """The schedule of the sound segments; each segment with an error is left out, the others are still checked."""
    planner = _Planner(models, log)
    segments: list[Segment] = []
    for item in stated:
        segment = planner.segment(len(segments), item)
        if segment is not None:
            segments.append(segment)
    return Schedule(tuple(segments), planner.time + planner.return_time())


class _Planner:
    """Follows the bench from state to state."""

    def __init__(self, models: BenchModels, log: Findings):
        self.models = models
        self.log = log
        self.time = 0.0
        self.temperature: float | None = models.chamber.ambient if models.chamber else None
        axes = models.table.axes if models.table else ()
        self.joints: Array = np.zeros(len(axes))
        self._soaked: float | None = None
        self._mounted: Orientation | None = None
        self._stopping = 0.0
        self._reached: dict[Any, Array] = {}
        self._complained: set[tuple[Any, ...]] = set()

    def segment(self, index: int, item: StatedSegment) -> Segment | None:
        before = len(self.log.errors)
        state, marks = item.state, item.marks
        orientation = self._orientation(item)
        dwell = self._dwell(item)
        motion = motion_of(state, marks, dwell, self.log)
        kelvin, ramp_to = self._temperature(item)
        if orientation is None or motion is None or (dwell is None and state.get("dwell") != "recorded"):
            return None
        mark_of = marks.get
        transition = self._change_temperature(kelvin, mark_of("temperature") or item.mark)
        soak = _seconds(state, "soak") if kelvin is not None and kelvin != self._soaked else 0.0
        self._soaked = kelvin if kelvin is not None else self._soaked
        transition += self._move(orientation, mark_of("orientation") or item.mark)
        transition += self._start(motion, dwell, orientation, marks, item.mark)
        if ramp_to is not None:
            self._check_temperature(ramp_to, marks["temperature"])
        self._check_mode(item)
        if len(self.log.errors) > before:
            return None
        settle = _seconds(state, "settle")
        start = self.time + transition + soak + settle
        self.time = start + (dwell or 0.0)
        if ramp_to is not None:
            self.temperature, self._soaked = ramp_to, None
        rate = state.get("sample_rate")
        return Segment(
            index=index,
            label=item.label,
            attitude=orientation.attitude,
            orientation=orientation.text,
            motion=motion,
            dwell=dwell,
            settle=settle,
            soak=soak,
            temperature=kelvin,
            ramp_to=ramp_to,
            sample_rate=rate.value if rate else None,
            mode=state.get("mode"),
            on_break=state.get("on_break", "retake"),
            transition=transition,
            start=start,
            marks={**marks, "": item.mark},
        )

    def return_time(self) -> float:
        """From the last segment to the safe state: the chamber back at ambient, the table at rest where it is."""
        chamber = self.models.chamber
        if chamber is None or self.temperature is None:
            return 0.0
        return chamber.seconds_to_change(self.temperature - chamber.ambient)

    # -- what a segment states -----------------------------------------------------------------------------------

    def _orientation(self, item: StatedSegment) -> Orientation | None:
        orientation: Orientation | None = item.state.get("orientation")
        if orientation is None:
            hint = "add for example `orientation: {x: up, y: north, z: west}`, or `orientation: unknown`"
            self._once("meaning-no-orientation", item.mark, f"the segment '{item.label}' has no orientation", hint)
        return orientation

    def _dwell(self, item: StatedSegment) -> float | None:
        dwell = item.state.get("dwell")
        if dwell is None:
            self._once(
                "meaning-no-dwell",
                item.mark,
                f"the segment '{item.label}' has no dwell",
                "add for example `dwell: 2 min`",
            )
        elif isinstance(dwell, Quantity):
            return dwell.value
        elif isinstance(dwell, Turns):
            return self._turns(item, dwell)
        return None

    def _turns(self, item: StatedSegment, dwell: Turns) -> float | None:
        log = Findings()
        motion = motion_of(item.state, item.marks, None, log)
        if not isinstance(motion, Spin):
            hint = "give a rate, or a dwell as a time"
            self._once("meaning-turns", item.marks["dwell"], f"'{item.label}' dwells in turns, but does not spin", hint)
            return None
        period = 2 * math.pi / abs(motion.rate)
        turns = dwell.turns
        if dwell.at_least is not None:
            turns = max(turns, math.ceil(dwell.at_least.value / period - 1e-9))
        return turns * period

    def _temperature(self, item: StatedSegment) -> tuple[float | None, float | None]:
        stated = item.state.get("temperature")
        if isinstance(stated, Ramp):
            return None, stated.ramp_to.value
        return (stated.value if stated is not None else None), None

    # -- what the bench can do -----------------------------------------------------------------------------------

    def _once(self, code: str, mark: Mark, message: str, hint: str) -> None:
        """One finding a place: a sweep over a wrong state says so once."""
        if (code, mark) not in self._complained:
            self._complained.add((code, mark))
            self.log.error(code, mark, message, hint)

    def _change_temperature(self, kelvin: float | None, mark: Mark) -> float:
        if kelvin is None or not self._check_temperature(kelvin, mark):
            return 0.0
        chamber = self.models.chamber
        assert chamber is not None
        change = kelvin - (self.temperature if self.temperature is not None else chamber.ambient)
        self.temperature = kelvin
        return chamber.seconds_to_change(change)

    def _check_temperature(self, kelvin: float, mark: Mark) -> bool:
        chamber = self.models.chamber
        if chamber is None and self.models.replays:
            return False
        if chamber is None:
            hint = "use a bench with a chamber, or leave temperature out"
            self.log.error("physics-no-chamber", mark, "this bench has no chamber to hold a temperature", hint)
            return False
        if not chamber.lowest - 1e-9 <= kelvin <= chamber.highest + 1e-9:
            lowest, highest = chamber.lowest - ZERO_CELSIUS, chamber.highest - ZERO_CELSIUS
            message = (
                f"{kelvin - ZERO_CELSIUS:g} degC is beyond the chamber, which reaches {lowest:g} to {highest:g} degC"
            )
            self.log.error("physics-temperature", mark, message, "stay within the chamber's range")
            return False
        return True

    def _check_mode(self, item: StatedSegment) -> None:
        mode, sensor = item.state.get("mode"), self.models.sensor
        if mode is not None and sensor is not None and mode not in sensor.modes and not self.models.replays:
            hint = closest(mode, sensor.modes) or "leave mode out: this sensor has only one"
            self._once("physics-mode", item.marks["mode"], f"the sensor of this bench has no mode '{mode}'", hint)

    def _move(self, orientation: Orientation, mark: Mark) -> float:
        table, attitude = self.models.table, orientation.attitude
        if table is None and attitude is not None and not self.models.replays:
            self._mounted = self._mounted or orientation
            if orientation.matrix != self._mounted.matrix:
                self._no_table(f"turn the sensor from '{self._mounted.text}' to '{orientation.text}'", mark)
        if table is None or attitude is None:
            return 0.0
        key = (orientation.matrix, tuple(self.joints))
        try:
            target = self._reached.get(key)
            if target is None:
                target = joint_angles(table.axes, attitude, near=self.joints, azimuth=self.models.site.azimuth)
                self._reached[key] = target
        except Unreachable as error:
            self.log.error(
                "physics-orientation",
                mark,
                f"the table cannot reach '{orientation.text}': {error}",
                "choose another orientation or bench",
            )
            return 0.0
        seconds = self._stopping + transition_time(table.axes, self.joints, target)
        self.joints, self._stopping = target, 0.0
        return seconds

    def _start(
        self, motion: Motion, dwell: float | None, orientation: Orientation, marks: Mapping[str, Mark], mark: Mark
    ) -> float:
        table = self.models.table
        if isinstance(motion, Rest):
            return 0.0
        at = marks.get("motion") or marks.get("rate") or mark
        if table is None:
            if not self.models.replays:
                self._no_table("move the sensor", at)
            return 0.0
        if isinstance(motion, Spin):
            return self._spin(table, motion, dwell, orientation, at)
        if isinstance(motion, Rock):
            return self._rock(table, motion, at)
        return self._cycle(table.axes[0], motion, at)

    def _no_table(self, what: str, mark: Mark) -> None:
        self._once("physics-no-table", mark, f"this bench has no table to {what}", "use a bench with a table")

    def _spin(
        self, table: TableModel, motion: Spin, dwell: float | None, orientation: Orientation, mark: Mark
    ) -> float:
        try:
            index = spin_axis(table.axes, self.joints, motion.about, self.models.site.azimuth)
        except Unreachable as error:
            self.log.error(
                "physics-rate-axis", mark, f"the table cannot spin about that direction: {error}", "spin about up"
            )
            return 0.0
        axis = table.axes[index]
        if abs(motion.rate) > axis.max_rate * (1 + 1e-12):
            message = (
                f"{_deg(motion.rate)} deg/s is beyond the {axis.name} axis, which reaches {_deg(axis.max_rate)} deg/s"
            )
            self.log.error("physics-rate", mark, message, "lower the rate")
            return 0.0
        if dwell is not None:
            self._whole_turns(motion, dwell, orientation, mark)
            self._turn_away(axis, index, motion.rate * dwell, mark)
        self._stopping = spin_up_time(axis, motion.rate)
        return spin_up_time(axis, motion.rate)

    def _turn_away(self, axis: TableAxis, index: int, angle: float, mark: Mark) -> None:
        """Follows the joint through a spin: a continuous axis ends anywhere, a limited one must not wind up its cables."""
        end = float(self.joints[index]) + angle
        if not axis.continuous and not axis.lowest <= end <= axis.highest:
            message = f"spinning through {_deg(angle)} deg winds up the cables of the {axis.name} axis: {limits_in_words(axis)}"
            self.log.error("physics-cable-wrap", mark, message, "shorten the dwell or use a table with slip rings")
            return
        self.joints = self.joints.copy()
        self.joints[index] = math.remainder(end, 2 * math.pi) if axis.continuous else end

    def _whole_turns(self, motion: Spin, dwell: float, orientation: Orientation, mark: Mark) -> None:
        """Warns where part of a turn leaves Earth rate in the mean of an axis that is tilted from the rotation axis."""
        turns = abs(motion.rate) * dwell / (2 * math.pi)
        if abs(turns - round(turns)) < 1e-3 or orientation.attitude is None:
            return
        about = np.array(motion.about)
        earth = self.models.site.earth_rate_enu
        across = float(np.linalg.norm(earth - about * (earth @ about)))
        cosines = np.abs(orientation.attitude @ about)
        leftover = across * abs(math.sin(math.pi * turns)) / (math.pi * turns)
        worst = max(
            (leftover * math.sqrt(max(0.0, 1 - c * c)) / (abs(motion.rate) * c) for c in cosines if c > 0.05),
            default=0.0,
        )
        if worst > WHOLE_TURN_TOLERANCE:
            share = f"up to {worst * 1e6:.0f} ppm of the rate that a tilted axis sees"
            message = f"{turns:.3g} turns at {_deg(motion.rate)} deg/s leave Earth rate in the mean: {share}"
            self.log.warning("physics-whole-turns", mark, message, "write dwell: {turns: 1, at_least: …}")

    def _rock(self, table: TableModel, motion: Rock, mark: Mark) -> float:
        circular = 2 * math.pi * motion.frequency
        if len(motion.phases) > len(table.axes):
            message = f"{len(motion.phases)} rings are to rock, the table has {len(table.axes)}"
            self.log.error("physics-axes", mark, message, "give a phase for each ring at most")
        for axis in table.axes[: len(motion.phases)]:
            rate, acceleration = motion.amplitude * circular, motion.amplitude * circular**2
            if rate > axis.max_rate:
                message = (
                    f"rocking reaches {_deg(rate)} deg/s; the {axis.name} axis reaches {_deg(axis.max_rate)} deg/s"
                )
                self.log.error("physics-rate", mark, message, "lower amplitude or frequency")
            if acceleration > axis.max_acceleration:
                message = f"rocking needs {_deg(acceleration)} deg/s^2; the {axis.name} axis gives {_deg(axis.max_acceleration)} deg/s^2"
                self.log.error("physics-acceleration", mark, message, "lower amplitude or frequency")
        return 1.0 / motion.frequency

    def _cycle(self, axis: TableAxis, motion: Cycle, mark: Mark) -> float:
        if motion.rate > axis.max_rate:
            message = f"turns at {_deg(motion.rate)} deg/s; the {axis.name} axis reaches {_deg(axis.max_rate)} deg/s"
            self.log.error("physics-rate", mark, message, "lower turn_rate")
        angle, low, high = 0.0, 0.0, 0.0
        for move in motion.moves:
            angle += move.turn
            low, high = min(low, angle), max(high, angle)
        if high - low > axis.highest - axis.lowest:
            message = f"the cycle turns through {_deg(high - low)} deg; the {axis.name} axis allows {_deg(axis.highest - axis.lowest)} deg"
            self.log.error("physics-cable-wrap", mark, message, "choose turns that go back as they came")
        return 0.0


def _seconds(state: Mapping[str, Any], name: str) -> float:
    value = state.get(name)
    return float(value.value) if value is not None else 0.0


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
