"""From the motion that a plan states to the motion of a schedule, with the checks that concern motion alone.

Cycles of turns and stops are followed move by move: each must start where the last ended and land where it says, and the cycle
must not wind up cables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from planrunner.plan import model
from planrunner.plan.findings import Findings, Mark, closest
from planrunner.plan.orientation import DIRECTIONS
from planrunner.plan.quantity import Quantity
from planrunner.plan.schedule import Cycle, Motion, Move, Rest, Rock, Spin

TURN = 2 * math.pi
_ANGLE_TOLERANCE = math.radians(1e-6)


def motion_of(state: Mapping[str, Any], marks: Mapping[str, Mark], dwell: float | None, log: Findings) -> Motion | None:
    """The motion of one segment; None after a finding."""
    rate: Quantity | None = state.get("rate")
    if rate is not None:
        return Spin(rate.value) if rate.value else Rest()
    motion: model.Motion | str | None = state.get("motion")
    if motion is None or isinstance(motion, str):
        return Rest()
    stated = [name for name in ("rate", "rock", "cycle") if getattr(motion, name) is not None]
    if len(stated) != 1:
        what = " and ".join(stated) if stated else "nothing"
        log.error("meaning-motion", marks["motion"], f"a motion is one of rate, rock and cycle; this says {what}", "keep one")
        return None
    sign = -1.0 if motion.sense == "clockwise" else 1.0
    if motion.rate is not None:
        about = DIRECTIONS[motion.about]
        return Spin(sign * motion.rate.value, (float(about[0]), float(about[1]), float(about[2])))
    if motion.rock is not None:
        return _rock(motion, motion.rock, dwell, marks["motion"], log)
    return _cycle(motion, sign, log)


def _rock(motion: model.Motion, rock: model.RockSpec, dwell: float | None, mark: Mark, log: Findings) -> Rock | None:
    duration = motion.for_.value if motion.for_ else (dwell if dwell is not None else math.inf)
    if dwell is not None and duration > dwell:
        log.error("meaning-rock", motion.at("for"), f"rocks for {motion.for_}, longer than the dwell of {dwell:g} s", "shorten it")
        return None
    phases = tuple(phase.value for phase in rock.phases) or (0.0,)
    return Rock(rock.amplitude.value, rock.frequency.value, phases, duration)


def _cycle(motion: model.Motion, sign: float, log: Findings) -> Cycle | None:
    positions = {name: angle.value for name, angle in (motion.cycle or {}).items()}
    if not motion.moves or motion.stop is None or motion.turn_rate is None:
        missing = [n for n, v in (("moves", motion.moves), ("turn_rate", motion.turn_rate), ("stop", motion.stop)) if not v]
        log.error("meaning-cycle", motion.origin.mark, f"a cycle also needs {', '.join(missing)}", "add for example stop: 5 min")
        return None
    moves: list[Move] = []
    here: str | None = None
    net = 0.0
    errors = len(log.errors)
    for number, text in enumerate(motion.moves, start=1):
        match = re.fullmatch(model.MOVE, text)
        assert match is not None
        start, end = match["start"], match["end"]
        mark = motion.at("moves")
        for name in (start, end):
            if name not in positions:
                log.error("meaning-cycle-position", mark, f"move {number} names '{name}', no position", closest(name, positions))
                return None
        turn = math.radians(float(match["turn"]))
        if here is not None and start != here:
            log.error("meaning-cycle-start", mark, f"move {number} starts at {start}, but the one before ends at {here}", f"start it at {here}")
        landing = (positions[start] + turn - positions[end] + math.pi) % TURN - math.pi
        if abs(landing) > _ANGLE_TOLERANCE:
            at = math.degrees((positions[start] + turn) % TURN)
            message = f"move {number} ({text.strip()}) does not land where it says: it ends at {at:g} deg, {end} is at {math.degrees(positions[end]):g} deg"
            log.error("meaning-cycle-landing", mark, message, "mend the turn or the position")
        net += turn
        here = end
        moves.append(Move(start, sign * turn, end))
    if here != moves[0].start:
        message = f"the cycle starts at {moves[0].start} and ends at {here}, so it cannot be repeated"
        log.error("meaning-cycle-closed", motion.at("moves"), message, "add the move back")
    elif abs(net) > _ANGLE_TOLERANCE:
        message = f"every cycle winds the cables up by {math.degrees(net):+g} deg"
        log.error("physics-cable-wrap", motion.at("moves"), message, "let as many turns go back as forth")
    if len(log.errors) > errors:
        return None
    signed = {name: sign * angle for name, angle in positions.items()}
    return Cycle(signed, tuple(moves), motion.turn_rate.value, motion.stop.value)
