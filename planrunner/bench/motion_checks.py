"""Checks a motion against the table and the sensor's sampling, and computes the time to start the motion and to come to rest.

Spins and rocking are checked here; cycles of turns and stops are checked in `planrunner.bench.cycle_checks`. The limits of the axes
are checked by `planrunner.physics.table_motion`, which the drivers of the tables also use.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.bench.cycle_checks import MarkOf, check_cycle
from planrunner.bench.model import BenchModels
from planrunner.bench.table_states import STOPS_LATE, TableState, spin_misses
from planrunner.instruments.models import TableModel
from planrunner.physics.kinematics import Unreachable
from planrunner.physics.table_motion import Excess, SpinCourse, about_one_axis, rock_excess, spin_excess
from planrunner.plan.schedule import Motion, RecordedMotion, Rest, Rock, Spin
from planrunner.plan.units import DIMENSIONS, unit

# A fraction of a turn biases the mean rate by the horizontal Earth rate; below this fraction of the rate it is negligible.
WHOLE_TURN_TOLERANCE = 100e-6


@dataclass(frozen=True, slots=True)
class Hold:
    """States how long a motion is held.

    `settle`: planned settling time, s. `dwell`: planned dwell, s; None if the dwell lasts as long as the recording. `sampled`:
    sample rate, Hz; None if the sensor is not known. `sooner`: the time [s] by which the settling may end early; 0 if the settling
    has a fixed length. It may end early if it ends as soon as measurements allow.
    """

    settle: float
    dwell: float | None
    sampled: float | None = None
    sooner: float = 0.0


def start_motion(
    motion: Motion,
    hold: Hold,
    input_axes: Array | None,
    state: TableState,
    models: BenchModels,
    at: MarkOf,
    log: Findings,
) -> tuple[float, TableState]:
    """Returns the time [s] until the table is in motion, and the state of the table after the dwell. A motion that the table cannot
    execute becomes a finding at the position of the motion in the plan.

    `input_axes`: array of shape (n, 3), directions of the sensor's input axes when the motion begins, East-North-Up; None if not
    known. `at`: a function that returns the mark of one of the motion's keys in the plan or, for an empty key, the mark of the
    whole motion.
    """
    table, mark = models.table, at("")
    if isinstance(motion, Rest):
        return 0.0, state
    if isinstance(motion, RecordedMotion):
        _check_moved(motion, models, at, log)
        return 0.0, state
    if isinstance(motion, Rock):
        _check_sampled(motion, hold.sampled, at("rock"), log)
        if models.sensor is not None and models.sensor.records_angle and not about_one_axis(motion):
            message = (
                f"the sensor records the table's angle about one axis, but the plan rocks {len(motion.phases)} rings"
            )
            hint = "rock the outermost ring alone, or write `table_angle: false` in the bench file"
            log.error("physics-table-angle", at("rock"), message, hint)
    if table is None:
        if not models.replays:
            no_table("move the sensor", mark, log)
        return 0.0, state
    if isinstance(motion, Spin):
        return _spin(table, motion, hold, input_axes, state, models, mark, log)
    if isinstance(motion, Rock):
        return _rock(table, motion, hold.dwell, state, mark, log)
    starts = [float(start[0]) for start in state.starts()]
    end, stopping = check_cycle(table.axes[0], starts, motion, hold.dwell, models.site, at, log)
    missed = motion.rate * STOPS_LATE
    return 0.0, state.ended(table.axes, 0, end - starts[0], (-missed, missed), stopping)


def _check_moved(motion: RecordedMotion, models: BenchModels, at: MarkOf, log: Findings) -> None:
    """Checks a motion that is not commanded. The motion must be possible on this bench, and the sensor of the bench must have the
    channels that show the motion."""
    if models.table is not None:
        message = "the table of this bench moves only on command, so the sensor cannot move in a way that only the recording shows"
        log.error(
            "physics-recorded-motion", at("recorded"), message, "state the motion of the table, or use another bench"
        )
        return
    if models.sensor is None:
        return
    shown = (
        ("angle", (motion.angle,) if motion.angle else (), "angle"),
        ("attitude", motion.attitude, "ratio"),
        ("rates", motion.rates, "angular rate"),
        ("forces", motion.forces, "acceleration"),
    )
    for key, channels, dimension in shown:
        mark = at(f"recorded.{key}")
        for name in channels:
            output = models.sensor.output(name)
            if output is None:
                known = [one.name for one in models.sensor.outputs]
                message = f"the sensor of this bench has no output '{name}'"
                log.error("meaning-sensor-output", mark, message, closest(name, known))
            elif unit(output.unit).dimension != DIMENSIONS[dimension]:
                kind = "ratio (unit 1)" if dimension == "ratio" else dimension
                message = f"'{name}' is in {output.unit}, which is not a unit of {kind}"
                log.error("physics-recorded-motion", mark, message, f"name a channel of {kind} for `{key}`")
        if len(set(channels)) < len(channels):
            message = f"`{key}` names a channel twice"
            log.error("physics-recorded-motion", mark, message, "name a channel for each component")


def no_table(what: str, mark: Mark, log: Findings) -> None:
    log.error("physics-no-table", mark, f"this bench has no table to {what}", "use a bench with a table")


def _complain(excess: Sequence[Excess], mark: Mark, log: Findings) -> None:
    """Adds an error at the mark for each limit of an axis that a motion exceeds."""
    for one in excess:
        if one.kind == "rings":
            log.error("physics-axes", mark, one.message, "give at most one phase for each ring")
        elif one.kind == "rate":
            log.error("physics-rate", mark, one.message, "lower the rate, amplitude or frequency")
        elif one.kind == "axis":
            log.error("physics-rate-axis", mark, one.message, "give the segment an orientation, or spin about up")
        elif one.kind == "acceleration":
            log.error("physics-acceleration", mark, one.message, "lower amplitude or frequency")
        else:
            hint = "turn by smaller angles, begin at another position, or use a table with slip rings"
            log.error("physics-cable-wrap", mark, one.message, hint)


def _check_sampled(motion: Rock, sampled: float | None, mark: Mark, log: Findings) -> None:
    """Checks the condition of the sampling theorem: a sine at half the sample rate or above would be recorded with a wrong
    frequency."""
    if sampled is None or motion.frequency < sampled / 2 * (1 - 1e-9):
        return
    alias = abs(motion.frequency - sampled * round(motion.frequency / sampled))
    what = f"as a motion of {alias:.4g} Hz" if alias > 1e-9 * sampled else "as a constant"
    message = (
        f"rocking at {motion.frequency:g} Hz, sampled at {sampled:g} Hz, appears in the recording {what}: half the "
        "sample rate is "
        f"{sampled / 2:g} Hz"
    )
    log.warning("physics-nyquist", mark, message, "rock more slowly, or sample faster")


def _spin(
    table: TableModel,
    motion: Spin,
    hold: Hold,
    input_axes: Array | None,
    state: TableState,
    models: BenchModels,
    mark: Mark,
    log: Findings,
) -> tuple[float, TableState]:
    try:
        course = SpinCourse.of(motion, table.axes, state.joints, models.site.azimuth)
    except Unreachable as error:
        log.error("physics-rate-axis", mark, f"the table cannot turn about that direction: {error}", "spin about up")
        return 0.0, state
    if state.roughly is not None and course.joint > state.roughly:
        # The direction of an axis follows from the joints that carry it.
        carrier, axis = table.axes[state.roughly].name, table.axes[course.joint].name
        message = (
            f"the direction of the {axis} axis is not known exactly: the {carrier} axis, which carries it, is only "
            "approximately at its planned angle after the previous motion"
        )
        log.error(
            "physics-rate-axis", mark, message, "give the segment an orientation; the table then moves there first"
        )
        return 0.0, state
    seconds = None if hold.dwell is None else hold.settle + hold.dwell
    excess = spin_excess(table.axes, state.joints, course, seconds) or _elsewhere(table, motion, seconds, state, models)
    if excess:
        _complain(excess, mark, log)
        return 0.0, state
    if seconds is None or hold.dwell is None:
        return course.ramp, state.ended(table.axes, course.joint, 0.0, (0.0, 0.0), course.ramp)
    _whole_turns(motion, hold.dwell, input_axes, models, mark, log)
    angle = course.travel(seconds)
    misses = spin_misses(course.rate, angle, hold.sooner)
    return course.ramp, state.ended(table.axes, course.joint, angle, misses, course.ramp)


def _elsewhere(
    table: TableModel, motion: Spin, seconds: float | None, state: TableState, models: BenchModels
) -> list[Excess]:
    """Returns the limits of the axes that a spin exceeds if it begins at an angle other than the planned one. All angles at which
    the table may be are examined."""
    # The angle of a continuous innermost axis makes no difference to a spin.
    matter = len(table.axes) - 1 if table.axes[-1].continuous else len(table.axes)
    starts = {start[:matter].tobytes(): start for start in state.starts()[1:]}
    for start in starts.values():
        try:
            course = SpinCourse.of(motion, table.axes, start, models.site.azimuth)
        except Unreachable as error:
            return _perhaps([Excess("axis", f"the table cannot turn about that direction: {error}")])
        excess = spin_excess(table.axes, start, course, seconds)
        if excess:
            return _perhaps(excess)
    return []


def _perhaps(excess: Sequence[Excess]) -> list[Excess]:
    because = (
        "the angle at which an earlier motion stops is known only approximately. It determines in which "
        "direction the table continues; in one of the possible cases,"
    )
    return [replace(one, message=f"{because} {one.message}") for one in excess]


def _whole_turns(
    motion: Spin, dwell: float, input_axes: Array | None, models: BenchModels, mark: Mark, log: Findings
) -> None:
    """Warns if the spin ends with an incomplete turn that biases the mean of the samples. The bias occurs if an input axis is not
    parallel to the rotation axis. Such an axis senses a part of the Earth rate that varies during a turn."""
    turns = abs(motion.rate) * dwell / (2 * math.pi)
    if abs(turns - round(turns)) < 1e-3 or input_axes is None:
        return
    about = np.array(motion.about)
    earth = models.site.earth_rate_enu
    across = float(np.linalg.norm(earth - about * (earth @ about)))
    cosines = np.abs(input_axes @ about)
    leftover = across * mean_left(turns)
    worst = max(
        (leftover * math.sqrt(max(0.0, 1 - c * c)) / (abs(motion.rate) * c) for c in cosines if c > 0.05),
        default=0.0,
    )
    if worst > WHOLE_TURN_TOLERANCE:
        share = f"up to {worst * 1e6:.0f} ppm of the rate that a tilted axis senses"
        message = f"{turns:.3g} turns at {_deg(motion.rate)} deg/s do not average out the Earth's rotation: the mean contains {share}"
        log.warning("physics-whole-turns", mark, message, "write dwell: {turns: 1, at_least: …}")


def mean_left(turns: float) -> float:
    """Returns the largest possible absolute mean of a sine wave with the amplitude one during `turns` turns. The mean depends on
    the start angle of the sine wave; the result is the largest mean of all start angles.

    The mean (1/2πN)·∫ cos θ dθ from θ₀ to θ₀ + 2πN is cos(θ₀ + πN)·sin(πN)/(πN). Its magnitude is at most |sin πN|/(πN), and it is
    zero after whole turns.
    """
    return abs(math.sin(math.pi * turns)) / (math.pi * turns)


def _rock(
    table: TableModel, motion: Rock, dwell: float | None, state: TableState, mark: Mark, log: Findings
) -> tuple[float, TableState]:
    if not table.rocks:
        hint = "give its driver a command for rocking in the bench file, or use another table"
        log.error("physics-motion", mark, "the table of this bench has no rocking motion", hint)
    found = (rock_excess(table.axes, start, motion) for start in state.starts())
    planned = next(found)
    _complain(planned or _perhaps(next(filter(None, found), [])), mark, log)
    # Rocking fades out over one period at the end of its time or of the dwell.
    left = motion.period if dwell is None else min(motion.period, max(0.0, motion.over - dwell))
    return motion.lead_in, replace(state, stopping=left)


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
