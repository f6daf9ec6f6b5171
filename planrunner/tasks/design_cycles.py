"""Designs the rotation cycle of a segment. Computes which part of a constant horizontal sensor error remains after the planned
cycle, and finds cycles after which no part of the error remains.

In a study, angles and rotations are positive in the plan's sense of rotation, which may be clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from planrunner.base.findings import Findings, InputError
from planrunner.base.workers import ALONE, Workers
from planrunner.design.cycles import Cable, CycleError, FoundCycle, StudiedCycle, free_order, same_order
from planrunner.design.study import Asked, FoundCycles
from planrunner.estimators.interface import EstimationError
from planrunner.physics.kinematics import TableAxis, Unreachable, joint_angles
from planrunner.physics.modulation import schuler_drive
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan import model, source
from planrunner.plan.expand import expand
from planrunner.plan.rewriting import RewriteError, with_moves
from planrunner.plan.schedule import Cycle, Segment
from planrunner.plan.segments import MotionSpec
from planrunner.tasks.check import Checked

ORDERS = {"same": "same order", "free": "free order"}


def has_cycle_alone(checked: Checked) -> bool:
    """Returns True if a plan has a cycle, but no estimate whose positions could be designed."""
    cycles = checked.schedule is not None and any(isinstance(item.motion, Cycle) for item in checked.schedule.segments)
    return cycles and not any(design.blocks for design in checked.designs.values())


def design_cycle(checked: Checked, asked: Asked, workers: Workers = ALONE) -> FoundCycles:
    """Designs the rotation cycle of a plan. Raises `InputError` with the findings about the plan, and `EstimationError` if there is
    no cycle to design. `workers`: processes that share the searches."""
    if asked.time is not None:
        raise EstimationError("--time distributes dwell times; the length of a cycle follows from its turns and stops")
    if checked.findings.errors or checked.schedule is None or checked.models is None or checked.plan is None:
        raise InputError(checked.findings)
    segment = _find(checked.schedule.segments, asked.segment)
    motion, table = segment.motion, checked.models.table
    assert isinstance(motion, Cycle)
    if table is None or checked.models.replays:
        raise EstimationError("this bench has no table that can turn; choose another bench with --bench")
    axis, site = table.axes[0], checked.models.site
    sign = _sense(checked.plan, segment.label)
    stated = RotationCycle.of(motion, axis.max_acceleration)
    planned = _turned(stated, sign)
    cable = _cable(table.axes, segment, site.azimuth, sign)
    first = motion.positions[motion.moves[0].start]
    positions = [sign * (motion.positions[move.start] - first) for move in motion.moves]
    searches: dict[str, FoundCycle] = {}
    reasons: dict[str, str] = {}
    ways: dict[str, Callable[[], FoundCycle]] = {
        "same order": lambda: same_order(planned, cable, workers),
        "free order": lambda: free_order(positions, planned, cable, workers=workers),
    }
    for name, search in ways.items():
        try:
            searches[name] = search()
        except CycleError as error:
            reasons[name] = str(error)
    found = {"planned": planned} | {name: one.cycle for name, one in searches.items() if one.cycle is not None}
    seconds = segment.dwell or stated.period
    cycles = {
        name: StudiedCycle(one, _moves(one, motion, sign), schuler_drive(_turned(one, sign), seconds, site))
        for name, one in found.items()
    }
    chosen = ORDERS[asked.order]
    text = _text(checked, segment, cycles[chosen].moves) if chosen in cycles else ""
    return FoundCycles(segment, axis, cycles, searches, reasons, chosen, text)


def _find(segments: Sequence[Segment], label: str | None) -> Segment:
    having = [segment for segment in segments if isinstance(segment.motion, Cycle)]
    if not having:
        raise EstimationError("no segment of the plan has a cycle of turns and stops")
    if label is None:
        return having[0]
    for segment in having:
        if segment.label == label:
            return segment
    shown = ", ".join(segment.label for segment in having[:10])
    raise EstimationError(f"no segment '{label}' has a cycle; these do: {shown}")


def _turned(cycle: RotationCycle, sign: float) -> RotationCycle:
    """Returns the cycle. If `sign` is −1, all rotations are reversed."""
    return replace(cycle, turns=tuple(sign * turn for turn in cycle.turns))


def _cable(axes: Sequence[TableAxis], segment: Segment, azimuth: float, sign: float) -> Cable:
    """Returns the range of angles that the axis can reach, relative to its angle at the start of the cycle."""
    start = 0.0
    if segment.attitude is not None:
        try:
            start = float(joint_angles(axes, segment.attitude, [0.0] * len(axes), azimuth)[0])
        except Unreachable as error:
            raise EstimationError(str(error)) from None
    return Cable(*sorted((sign * (axes[0].lowest - start), sign * (axes[0].highest - start))))


def _sense(plan: model.Plan, label: str) -> float:
    """Returns the sign that converts the plan's angles to anticlockwise angles: −1 if the plan counts them clockwise, otherwise 1."""
    return -1.0 if _motion(plan, label).sense == "clockwise" else 1.0


def _motion(plan: model.Plan, label: str) -> MotionSpec:
    """Returns the motion of a segment with a cycle, as the plan states it."""
    motion = next(item.state.motion for item in expand(plan, Findings()) if item.label == label)
    assert isinstance(motion, MotionSpec)
    return motion


def _moves(cycle: RotationCycle, motion: Cycle, sign: float) -> tuple[str, ...]:
    """Returns the moves of a cycle as the plan writes them, with its names of positions and its sense of rotation."""
    first = motion.positions[motion.moves[0].start]

    def named(angle: float) -> str:
        there = first + sign * angle
        return min(motion.positions, key=lambda name: abs(math.remainder(motion.positions[name] - there, 2 * math.pi)))

    names = [named(float(angle)) for angle in (*cycle.stops, cycle.net_turn)]
    return tuple(
        f"{start} {round(math.degrees(turn), 9):+.12g} {end}"
        for start, turn, end in zip(names[:-1], cycle.turns, names[1:], strict=True)
    )


def _text(checked: Checked, segment: Segment, moves: Sequence[str]) -> str:
    assert checked.plan is not None
    mark = _motion(checked.plan, segment.label).at("moves")
    try:
        return with_moves(source.decode(checked.plan_bytes, checked.file), (mark.line, mark.column), moves)
    except RewriteError as error:
        raise EstimationError(f"{checked.file}: {error}") from None
