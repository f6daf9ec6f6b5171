"""A cycle as the axis of a real table makes it: when each turn begins, brakes and ends."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle as again

from planrunner.plan.schedule import Cycle


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of a cycle. begins, brakes, ends: s since the cycle began; rate: rad/s, with its sign; target: rad from where it began."""

    begins: float
    brakes: float
    ends: float
    rate: float
    target: float


def turns_of(motion: Cycle, acceleration: float) -> Iterator[Turn]:
    """The turns of a cycle, over and over, each after its stop. acceleration: rad/s^2. The area under a turn's rate, a trapezoid or a
    triangle, is its angle; whatever its ramps are, if both are alike, it is the rate times the time until the axis brakes."""
    now = target = 0.0
    for move in again(motion.moves):
        begins = now + motion.stop
        size = abs(move.turn)
        rate = min(motion.rate, math.sqrt(size * acceleration))
        target += move.turn
        brakes = begins + size / rate
        now = brakes + rate / acceleration
        yield Turn(begins, brakes, now, math.copysign(rate, move.turn), target)
