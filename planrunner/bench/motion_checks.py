"""What a motion asks of a table: rates, accelerations, cable wrap and whole turns, and how long the table takes to be in motion.

A spin and rocking are checked here; the turns and stops of a cycle in `planrunner.bench.cycle_checks`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from planrunner.bench.cycle_checks import Place, check_cycle
from planrunner.bench.model import BenchModels
from planrunner.instruments.models import TableModel
from planrunner.physics.kinematics import (
    Array,
    TableAxis,
    Unreachable,
    limits_in_words,
    spin_axis,
    spin_up_time,
)
from planrunner.plan.findings import Findings, Mark
from planrunner.plan.schedule import Motion, Rest, Rock, Spin

# A part of a turn left over biases the mean rate by the horizontal Earth rate; below this share of the rate nobody notices.
WHOLE_TURN_TOLERANCE = 100e-6


@dataclass(frozen=True, slots=True)
class TableState:
    """Where the table is: joint angles [rad], outermost first, and how long [s] it takes to come to rest."""

    joints: Array
    stopping: float = 0.0


def start_motion(
    motion: Motion,
    dwell: float | None,
    input_axes: Array | None,
    state: TableState,
    models: BenchModels,
    at: Place,
    log: Findings,
) -> tuple[float, TableState]:
    """Seconds until the table is in motion, and its state after the dwell. What it cannot do is a finding where the plan says so.

    input_axes: (n, 3), where the sensor's input axes point as the motion begins, East-North-Up; None where that is not known. at: the mark
    of one of the motion's keys, or, for an empty one, of the motion.
    """
    table, mark = models.table, at("")
    if isinstance(motion, Rest):
        return 0.0, state
    if table is None:
        if not models.replays:
            no_table("move the sensor", mark, log)
        return 0.0, state
    if isinstance(motion, Spin):
        return _spin(table, motion, dwell, input_axes, state, models, mark, log)
    if isinstance(motion, Rock):
        return _rock(table, motion, mark, log), state
    joints = state.joints.copy()
    joints[0] = check_cycle(table.axes[0], float(joints[0]), motion, dwell, models.site, at, log)
    return 0.0, TableState(joints)


def no_table(what: str, mark: Mark, log: Findings) -> None:
    log.error("physics-no-table", mark, f"this bench has no table to {what}", "use a bench with a table")


def _spin(
    table: TableModel,
    motion: Spin,
    dwell: float | None,
    input_axes: Array | None,
    state: TableState,
    models: BenchModels,
    mark: Mark,
    log: Findings,
) -> tuple[float, TableState]:
    try:
        index = spin_axis(table.axes, state.joints, motion.about, models.site.azimuth)
    except Unreachable as error:
        log.error("physics-rate-axis", mark, f"the table cannot spin about that direction: {error}", "spin about up")
        return 0.0, state
    axis = table.axes[index]
    if abs(motion.rate) > axis.max_rate * (1 + 1e-12):
        message = f"{_deg(motion.rate)} deg/s is beyond the {axis.name} axis, which reaches {_deg(axis.max_rate)} deg/s"
        log.error("physics-rate", mark, message, "lower the rate")
        return 0.0, state
    if dwell is not None:
        _whole_turns(motion, dwell, input_axes, models, mark, log)
        state = _turn_away(axis, index, motion.rate * dwell, state, mark, log)
    seconds = spin_up_time(axis, motion.rate)
    return seconds, replace(state, stopping=seconds)


def _turn_away(axis: TableAxis, index: int, angle: float, state: TableState, mark: Mark, log: Findings) -> TableState:
    """Follows the joint through a spin: a continuous axis ends anywhere, a limited one must not wind up its cables."""
    end = float(state.joints[index]) + angle
    if not axis.continuous and not axis.lowest <= end <= axis.highest:
        message = (
            f"spinning through {_deg(angle)} deg winds up the cables of the {axis.name} axis: {limits_in_words(axis)}"
        )
        log.error("physics-cable-wrap", mark, message, "shorten the dwell or use a table with slip rings")
        return state
    joints = state.joints.copy()
    joints[index] = math.remainder(end, 2 * math.pi) if axis.continuous else end
    return replace(state, joints=joints)


def _whole_turns(
    motion: Spin, dwell: float, input_axes: Array | None, models: BenchModels, mark: Mark, log: Findings
) -> None:
    """Warns where part of a turn leaves Earth rate in the mean of an axis that is tilted from the rotation axis."""
    turns = abs(motion.rate) * dwell / (2 * math.pi)
    if abs(turns - round(turns)) < 1e-3 or input_axes is None:
        return
    about = np.array(motion.about)
    earth = models.site.earth_rate_enu
    across = float(np.linalg.norm(earth - about * (earth @ about)))
    cosines = np.abs(input_axes @ about)
    leftover = across * abs(math.sin(math.pi * turns)) / (math.pi * turns)
    worst = max(
        (leftover * math.sqrt(max(0.0, 1 - c * c)) / (abs(motion.rate) * c) for c in cosines if c > 0.05),
        default=0.0,
    )
    if worst > WHOLE_TURN_TOLERANCE:
        share = f"up to {worst * 1e6:.0f} ppm of the rate that a tilted axis sees"
        message = f"{turns:.3g} turns at {_deg(motion.rate)} deg/s leave Earth rate in the mean: {share}"
        log.warning("physics-whole-turns", mark, message, "write dwell: {turns: 1, at_least: …}")


def _rock(table: TableModel, motion: Rock, mark: Mark, log: Findings) -> float:
    circular = 2 * math.pi * motion.frequency
    if len(motion.phases) > len(table.axes):
        message = f"{len(motion.phases)} rings are to rock, the table has {len(table.axes)}"
        log.error("physics-axes", mark, message, "give a phase for each ring at most")
    for axis in table.axes[: len(motion.phases)]:
        rate, acceleration = motion.amplitude * circular, motion.amplitude * circular**2
        if rate > axis.max_rate:
            message = f"rocking reaches {_deg(rate)} deg/s; the {axis.name} axis reaches {_deg(axis.max_rate)} deg/s"
            log.error("physics-rate", mark, message, "lower amplitude or frequency")
        if acceleration > axis.max_acceleration:
            message = f"rocking needs {_deg(acceleration)} deg/s^2; the {axis.name} axis gives {_deg(axis.max_acceleration)} deg/s^2"
            log.error("physics-acceleration", mark, message, "lower amplitude or frequency")
    return motion.lead_in


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
