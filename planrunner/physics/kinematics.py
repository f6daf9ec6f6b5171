"""Rate-table kinematics: joint angles for an attitude, reach, cable wrap and the time a move takes."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TableAxis:
    """One axis of a table, outermost first.

    direction: the axis at joint angle zero, ENU unit vector, before the site's azimuth is applied. max_rate: rad/s; max_acceleration:
    rad/s^2; lowest, highest: joint limits, rad (infinite for a continuous axis with slip rings).
    """

    name: str
    direction: tuple[float, float, float]
    max_rate: float
    max_acceleration: float
    lowest: float = -math.inf
    highest: float = math.inf


def move_time(angle: float, max_rate: float, max_acceleration: float) -> float:
    """Seconds for a rest-to-rest move with a trapezoidal rate profile.

    Accelerating to rate w takes w/a and covers w²/2a, so a move of |angle| < w²/a is triangular: 2·√(|angle|/a).
    """
    distance = abs(angle)
    if distance < max_rate**2 / max_acceleration:
        return 2 * math.sqrt(distance / max_acceleration)
    return distance / max_rate + max_rate / max_acceleration
