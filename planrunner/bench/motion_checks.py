"""Checks a motion against the table and the sensor's sampling, and computes the time to start the motion and to come to rest.

The limits of the axes are checked by `planrunner.physics.table_motion`, which the drivers of the tables also use.

A cycle of turns and stops cancels constant errors if its residual over the stops, its residual over the turns, and its mean angle
are zero. `planrunner.physics.rotation_cycle` computes these quantities.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.bench.model import BenchModels
from planrunner.bench.table_states import STOPS_LATE, TableState, spin_misses
from planrunner.instruments.models import TableModel
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis, Unreachable
from planrunner.physics.modulation import MEAN_RADIUS, schuler_drive, schuler_rate
from planrunner.physics.rotation_cycle import NOTHING, RotationCycle
from planrunner.physics.table_motion import Excess, SpinCourse, about_one_axis, cycle_excess, rock_excess, spin_excess
from planrunner.plan.schedule import Cycle, Motion, RecordedMotion, Rest, Rock, Spin
from planrunner.plan.units import DIMENSIONS, unit

MarkOf = Callable[[str], Mark]
"""Function that returns the mark of one of the motion's keys."""

# A fraction of a turn biases the mean rate by the horizontal Earth rate; below this fraction of the rate it is negligible.
WHOLE_TURN_TOLERANCE = 100e-6
_UPRIGHT = math.cos(math.radians(0.1))
_DESIGN = "`planrunner design` finds cycles without a residual"


@dataclass(frozen=True, slots=True)
class Hold:
    """States how long a motion is held.

    `settle`: planned settling time, s. `dwell`: planned dwell, s; None if the dwell lasts as long as the recording. `sampled`:
    sample rate, Hz; None if the sensor is not known. `sooner`: how much earlier than planned the settling may end, s. It is 0 if
    the settling has a fixed length, and positive if the settling ends as soon as measurements allow.
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
    """Returns the time [s] until the table is in motion, and the state of the table after the dwell. If the table cannot execute
    the motion, a finding at the position of the motion in the plan is added to `log`.

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
            hint = "rock only the outermost ring, or write `table_angle: false` in the bench file"
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
    end, stopping = _cycle(table.axes[0], starts, motion, hold.dwell, models.site, at, log)
    missed = motion.rate * STOPS_LATE
    return 0.0, state.ended(table.axes, 0, end - starts[0], (-missed, missed), stopping)


def _check_moved(motion: RecordedMotion, models: BenchModels, at: MarkOf, log: Findings) -> None:
    """Checks a motion that is not commanded. The motion must be possible on this bench, and the sensor of the bench must have the
    channels that show the motion."""
    if models.table is not None:
        message = "a recorded motion is not possible on this bench, because its table moves only as the plan commands"
        log.error(
            "physics-recorded-motion", at("recorded"), message, "describe the motion of the table, or use another bench"
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
    log.error("physics-no-table", mark, f"this bench has no table that can {what}", "use a bench with a table")


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
            log.error("physics-acceleration", mark, one.message, "lower the amplitude or the frequency")
        else:
            hint = "turn by smaller angles, begin at another position, or use a table with slip rings"
            log.error("physics-cable-wrap", mark, one.message, hint)


def _check_sampled(motion: Rock, sampled: float | None, mark: Mark, log: Findings) -> None:
    """Checks the condition of the sampling theorem: a sine at half the sample rate or above would be recorded with a wrong
    frequency. `sampled`: sample rate, Hz; None if it is not known."""
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
    the table may be are examined. `seconds`: time for which the rate is held, s."""
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
    parallel to the rotation axis. Such an axis senses a part of the Earth rate that varies during a turn. `dwell`: planned dwell,
    s. `input_axes`: the same as in `start_motion`."""
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

    For N = `turns`, the mean (1/2πN)·∫ cos θ dθ from θ₀ to θ₀ + 2πN is cos(θ₀ + πN)·sin(πN)/(πN). The magnitude of this mean is at
    most |sin πN|/(πN), and the mean is zero after whole turns.
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


def _cycle(
    axis: TableAxis, starts: Sequence[float], motion: Cycle, dwell: float | None, site: Site, at: MarkOf, log: Findings
) -> tuple[float, float]:
    """Adds findings about a cycle of the table. `starts`: the angles [rad] at which the joint may be when the cycle begins, the
    planned one first. For the other angles, only the limits of the axis are checked. Returns two values for a cycle that begins at
    the planned angle: the angle [rad] at which the joint rests after the dwell, and the time [s] to come to rest."""
    start = starts[0]
    excess = next(filter(None, (cycle_excess(axis, begin, motion) for begin in starts)), [])
    for one in excess:
        if one.kind == "rate":
            log.error("physics-rate", at("turn_rate"), one.message, "lower turn_rate")
        else:
            hint = "choose turns that return by the same path, or begin the cycle at another position"
            log.error("physics-cable-wrap", at("moves"), one.message, hint)
    if excess:
        return start, 0.0
    cycle = RotationCycle.of(motion, axis.max_acceleration)
    if abs(axis.direction[2]) < _UPRIGHT:
        message = (
            f"the cycle turns the {axis.name} axis, which is not vertical: it therefore modulates the errors perpendicular "
            "to that axis, and not the horizontal errors"
        )
        log.warning("physics-cycle-axis", at("cycle"), message, "use a bench whose outermost axis is vertical")
    stops, turns = cycle.integral()
    _check_residual(cycle, stops, turns, at("moves"), log)
    if abs(stops) > NOTHING * cycle.period:
        _check_stops(motion, at("moves"), log)
    if abs(cycle.mean_angle) > NOTHING * 2 * math.pi:
        heading = 1e-5 * math.degrees(cycle.mean_angle) * 3600
        message = (
            f"the mean angle of the cycle is {_deg(cycle.mean_angle)} deg: a scale factor error of 10 ppm in the azimuth gyro makes a mean "
            f"heading error of {heading:+.2g} arcsec"
        )
        log.warning("physics-cycle-angle", at("moves"), message, "make the cycle turn equally far to both sides")
    if dwell is None:
        return start, 0.0
    _check_schuler(cycle, dwell, site, at("stop"), log)
    _check_whole(cycle, dwell, at("moves"), log)
    rate = cycle.turning_rate(dwell)
    stopping = abs(rate) / axis.max_acceleration
    return start + float(cycle.angle(np.array([dwell]))[0]) + 0.5 * rate * stopping, stopping


def _check_residual(cycle: RotationCycle, stops: complex, turns: complex, mark: Mark, log: Findings) -> None:
    share = abs(stops + turns) / cycle.period
    if share <= NOTHING:
        return
    percent = f"{100 * share:.{2 if share < 0.995 else 3}g}"  # 100, not 1e+02
    miles = 0.01 * math.radians(1) * share * MEAN_RADIUS / 1852
    message = (
        f"the cycle of {cycle.period:.1f} s does not cancel a constant horizontal error: over one cycle, the error accumulates for an "
        f"effective time of {_seconds_left(stops)} from the stops and {_seconds_left(turns)} from the turns, so {percent} % of it "
        f"is not modulated. A gyro drift of 0.01 deg/h then acts like an unmodulated drift of {0.01 * share:.2g} deg/h "
        f"({miles:.2g} nautical miles per hour)"
    )
    log.warning("physics-cycle-residual", mark, message, _DESIGN)


def _check_stops(motion: Cycle, mark: Mark, log: Findings) -> None:
    """Adds a warning if the stops on one side have a longer total time in a cycle than the stops on the opposite side."""
    angles = {name: round(math.degrees(angle) % 360, 6) % 360 for name, angle in motion.positions.items()}
    names: dict[float, str] = {}
    held: dict[float, float] = {}
    for move in motion.moves:
        angle = angles[move.start]
        names.setdefault(angle, move.start)
        held[angle] = held.get(angle, 0.0) + motion.stop
    unlike = []
    for angle, seconds in held.items():
        opposite = held.get(round((angle + 180) % 360, 6) % 360, 0.0)
        if seconds > opposite:
            unlike.append(f"{names[angle]} for {seconds:g} s per cycle, the opposite side for {opposite:g} s")
    message = f"the stop times on opposite sides differ: {'; '.join(unlike)}"
    log.warning("physics-cycle-stops", mark, message, "stop equally long on opposite sides")


def _check_schuler(cycle: RotationCycle, dwell: float, site: Site, mark: Mark, log: Findings) -> None:
    drive = schuler_drive(cycle, dwell, site)
    if drive < 1:
        return
    minutes = 2 * math.pi / schuler_rate(site) / 60
    message = (
        f"a cycle of {cycle.period / 60:.1f} min drives the Schuler oscillation of {minutes:.1f} min: within this dwell, a "
        f"constant horizontal gyro drift makes the oscillation {drive:.2g} times as large as without rotation"
    )
    log.warning(
        "physics-cycle-schuler",
        mark,
        message,
        "shorten the stops, so that no harmonic of the cycle is near the Schuler frequency",
    )


def _check_whole(cycle: RotationCycle, dwell: float, mark: Mark, log: Findings) -> None:
    count = dwell / cycle.period
    if abs(count - round(count)) * cycle.period < 1e-3:
        return
    message = f"the dwell holds {count:.2f} cycles of {cycle.period:.1f} s; the errors of the incomplete last cycle are not balanced"
    log.note("physics-cycle-part", mark, message, f"write dwell: {{cycles: {max(1, round(count))}}}")


def _seconds_left(left: complex) -> str:
    """States in words how much of a sensor error remains after a cycle: the component in the direction of the error and, if it is
    not zero, the perpendicular component (positive to the left, seen from above)."""
    across = f"{left.imag:+.2f} s (perpendicular to it)" if abs(left.imag) > 5e-3 else ""
    if abs(left.real) <= 5e-3:
        return across or "0 s"
    return f"{left.real:+.2f} s (along the error) and {across}" if across else f"{left.real:+.2f} s"


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
