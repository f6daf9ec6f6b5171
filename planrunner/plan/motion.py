"""Converts the motion in a plan to the motion of a schedule. Also makes the checks that concern only motion.

Cycles of turns and stops are checked move by move. Each move must start where the previous one ended and end at its stated
position, and the cycle must not wind up cables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace

from planrunner.base.findings import Findings, Mark, closest
from planrunner.plan.directions import DIRECTIONS
from planrunner.plan.schedule import Cycle, Motion, Move, RecordedMotion, Rest, Rock, Spin
from planrunner.plan.segments import MOVE, MotionSpec, RecordedSpec, RockSpec, State

TURN = 2 * math.pi
_ANGLE_TOLERANCE = math.radians(1e-6)


# The keys of each form of motion.
_KEYS = {
    "rate": {"rate", "about", "sense"},
    "rock": {"rock", "after", "for"},
    "cycle": {"cycle", "moves", "turn_rate", "stop", "sense"},
    "recorded": {"recorded", "about", "sense"},
}
_FORMS = "rate, rock, cycle and recorded"


def motion_of(state: State, marks: Mapping[str, Mark], dwell: float | None, log: Findings) -> Motion | None:
    """Returns the motion of one segment; None if the motion is not valid, in which case a finding is added. `dwell`: planned dwell,
    s; None if it is not known."""
    if state.rate is not None:
        return Spin(state.rate.value) if state.rate.value else Rest()
    motion = state.motion
    if motion is None or isinstance(motion, str):
        return Rest()
    if motion.origin.broken:
        return None
    with log.resting_on(motion.origin.mark):
        return _stated_motion(motion, marks, dwell, log)


def _stated_motion(motion: MotionSpec, marks: Mapping[str, Mark], dwell: float | None, log: Findings) -> Motion | None:
    stated = [name for name in _KEYS if getattr(motion, name) is not None]
    if len(stated) != 1:
        what = " and ".join(stated) if stated else "none of them"
        log.error(
            "meaning-motion",
            marks["motion"],
            f"a motion has exactly one of the keys {_FORMS}; this one has {what}",
            "keep one of them" if stated else "add one of them",
        )
        return None
    form = stated[0]
    foreign = [key for key in motion.origin.keys if "." not in key and "[" not in key and key not in _KEYS[form]]
    for key in foreign:
        log.error("meaning-motion", motion.at(key), f"'{key}' has no meaning for a motion by {form}", "remove it")
    if foreign:
        return None
    sign = -1.0 if motion.sense == "clockwise" else 1.0
    if motion.rate is not None:
        return Spin(sign * motion.rate.value, DIRECTIONS[motion.about]) if motion.rate.value else Rest()
    if motion.rock is not None:
        return _rock(motion, motion.rock, dwell, log)
    if motion.recorded is not None:
        return _moved(motion, motion.recorded, sign, log)
    return _cycle(motion, sign, log)


def _moved(motion: MotionSpec, recorded: RecordedSpec, sign: float, log: Findings) -> RecordedMotion | None:
    if recorded.origin.broken:
        return None
    shown = [name for name in ("angle", "attitude", "rates") if getattr(recorded, name)]
    if len(shown) > 1 or not (shown or recorded.forces):
        what = " and ".join(shown) or "none of them"
        message = (
            f"a recorded motion has one of the keys angle, attitude and rates, or forces alone; this one has {what}"
        )
        log.error(
            "meaning-recorded-motion", recorded.origin.mark, message, "state what in the recording shows the motion"
        )
        return None
    for key in ("about", "sense"):
        if key in motion.origin.keys and not recorded.angle:
            message = f"'{key}' has no meaning without `angle`: `{shown[0] if shown else 'forces'}` already gives the directions"
            log.error("meaning-motion", motion.at(key), message, "remove it")
            return None
    if recorded.angle and recorded.forces:
        message = "`forces` cannot be given with `angle`: the angle of an encoder does not determine the specific force"
        hint = "leave `forces` out, or give the rotation by `rates` or `attitude`"
        log.error("meaning-recorded-motion", recorded.at("forces"), message, hint)
        return None
    east, north, up = DIRECTIONS[motion.about]
    about = (sign * east, sign * north, sign * up)
    seconds = recorded.averaging.value if recorded.averaging else 0.0
    return RecordedMotion(recorded.angle or "", about, recorded.attitude, recorded.rates, recorded.forces, seconds)


def _rock(motion: MotionSpec, rock: RockSpec, dwell: float | None, log: Findings) -> Rock | None:
    phases = tuple(phase.value for phase in rock.phases) or (0.0,)
    endless = Rock(
        rock.amplitude.value, rock.frequency.value, phases, math.inf, motion.after.value if motion.after else 0.0
    )
    left = math.inf if dwell is None else dwell - endless.steady
    if left <= 0:
        message = (
            f"the dwell of {dwell:g} s ends before the rocking reaches its full amplitude, {endless.steady:g} s after the start of "
            "the dwell"
        )
        log.error("meaning-rock", motion.at("after"), message, "shorten `after`, or dwell longer")
        return None
    duration = motion.for_.value if motion.for_ else left
    if duration > left:
        within = f"the {left:g} s that remain of the dwell" if motion.after else f"the dwell of {dwell:g} s"
        message = f"rocks for {motion.for_}, longer than {within}"
        log.error("meaning-rock", motion.at("for"), message, "shorten it, or dwell longer")
        return None
    return replace(endless, duration=duration)


def _cycle(motion: MotionSpec, sign: float, log: Findings) -> Cycle | None:
    positions = {name: angle.value for name, angle in (motion.cycle or {}).items()}
    needed = {"moves": motion.moves, "turn_rate": motion.turn_rate, "stop": motion.stop}
    missing = [name for name, value in needed.items() if not value]
    if missing or motion.turn_rate is None or motion.stop is None:
        examples = {"moves": "moves: [A +180 C, C -180 A]", "turn_rate": "turn_rate: 10 deg/s", "stop": "stop: 5 min"}
        hint = "add for example " + ", ".join(examples[name] for name in missing)
        needs = f"the key{'s' if missing[1:] else ''} {', '.join(missing)}"
        log.error("meaning-cycle", motion.origin.mark, f"a cycle also needs {needs}", hint)
        return None
    moves: list[Move] = []
    net = 0.0
    errors = log.raised
    for text in motion.moves:
        match = re.fullmatch(MOVE, text)
        assert match is not None
        turn = math.radians(float(match["turn"].replace("−", "-")))
        net += turn
        moves.append(Move(match["start"], sign * turn, match["end"]))
    _check_positions(moves, positions, motion, log)
    for index, move in enumerate(moves):
        at, before = motion.at(f"moves[{index}]"), moves[index - 1]
        _check_move(index + 1, motion.moves[index].strip(), move, sign * move.turn, positions, at, log)
        if index and move.start != before.end and {move.start, before.end} <= set(positions):
            message = f"move {index + 1} starts at {move.start}, but the one before ends at {before.end}"
            log.error("meaning-cycle-start", at, message, f"start it at {before.end}")
    if log.raised == errors:
        _check_cycle(moves, net, motion, log)
    if log.raised > errors:
        return None
    signed = {name: sign * angle for name, angle in positions.items()}
    return Cycle(signed, tuple(moves), motion.turn_rate.value, motion.stop.value)


def _check_positions(moves: list[Move], positions: Mapping[str, float], motion: MotionSpec, log: Findings) -> None:
    """Adds one finding for each name that is not the name of a position, even if several moves use it."""
    users: dict[str, list[int]] = {}
    for index, move in enumerate(moves):
        for name in dict.fromkeys((move.start, move.end)):
            if name not in positions:
                users.setdefault(name, []).append(index)
    for name, found in users.items():
        others = f"({len(found) - 1} more moves use this name too)" if found[1:] else ""
        message = f"move {found[0] + 1} ({motion.moves[found[0]].strip()}) names '{name}', which is not a position of this cycle{others}"
        log.error("meaning-cycle-position", motion.at(f"moves[{found[0]}]"), message, closest(name, positions))


def _check_move(
    number: int, text: str, move: Move, turn: float, positions: Mapping[str, float], mark: Mark, log: Findings
) -> None:
    if not {move.start, move.end} <= set(positions):
        return
    if not turn:
        message = f"move {number} ({text}) turns by 0 deg"
        log.error("meaning-cycle", mark, message, "remove this move; for a longer rest, increase `stop`")
        return
    there = positions[move.start] + turn
    if abs(math.remainder(there - positions[move.end], TURN)) > _ANGLE_TOLERANCE:
        angle = math.degrees(positions[move.end])
        message = (
            f"move {number} ({text}) does not end at its position: it ends at {_degrees(there)} deg, but {move.end} is at {angle:g} "
            "deg"
        )
        log.error("meaning-cycle-landing", mark, message, f"to end at {move.end}, turn {_turns(positions, move)}")


def _check_cycle(moves: list[Move], net: float, motion: MotionSpec, log: Findings) -> None:
    if moves[-1].end != moves[0].start:
        message = f"the cycle starts at {moves[0].start} and ends at {moves[-1].end}, so it cannot be repeated"
        at = motion.at(f"moves[{len(moves) - 1}]")
        log.error("meaning-cycle-closed", at, message, f"add a move from {moves[-1].end} back to {moves[0].start}")
    elif abs(net) > _ANGLE_TOLERANCE:
        message = f"each cycle winds up the cables by {math.degrees(net):+g} deg"
        log.error("physics-cable-wrap", motion.at("moves"), message, "turn as many degrees back as forward")


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle) % 360, 6) % 360:g}"


def _turns(positions: Mapping[str, float], move: Move) -> str:
    """Returns, in words, the two rotations that lead to the end position of a move: the short way and the long way."""
    short = round(math.degrees(math.remainder(positions[move.end] - positions[move.start], TURN)), 6)
    return f"{short:+g} or {short - math.copysign(360, short):+g} deg"
