"""What a cycle of turns and stops asks of the table axis that makes it."""

from __future__ import annotations

import math

from planrunner.physics.kinematics import TableAxis
from planrunner.plan.findings import Findings, Mark
from planrunner.plan.schedule import Cycle


def check_cycle(axis: TableAxis, motion: Cycle, mark: Mark, log: Findings) -> None:
    """Findings at `mark` where the axis is too slow for the turns or the cycle winds up its cables."""
    if motion.rate > axis.max_rate:
        message = f"turns at {_deg(motion.rate)} deg/s; the {axis.name} axis reaches {_deg(axis.max_rate)} deg/s"
        log.error("physics-rate", mark, message, "lower turn_rate")
    angle, low, high = 0.0, 0.0, 0.0
    for move in motion.moves:
        angle += move.turn
        low, high = min(low, angle), max(high, angle)
    if high - low > axis.highest - axis.lowest:
        message = f"the cycle turns through {_deg(high - low)} deg; the {axis.name} axis allows {_deg(axis.highest - axis.lowest)} deg"
        log.error("physics-cable-wrap", mark, message, "choose turns that go back as they came")


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
