"""Motions other than a spin, as the axes of a table make them: whether they can, and when each turn of a cycle begins, brakes and ends."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from itertools import cycle as again

from planrunner.instruments.interfaces import InstrumentError
from planrunner.physics.kinematics import SLACK, TableAxis, limits_in_words
from planrunner.plan.schedule import Cycle, Rock

_GRANTED = 1 + 1e-9


def check_rock(axes: Sequence[TableAxis], motion: Rock, where: str = "") -> None:
    """Raises `InstrumentError` when rings are missing, or need more than they reach. where: begins the message."""
    if len(motion.phases) > len(axes):
        raise InstrumentError(f"{where}{len(motion.phases)} rings are to rock, the table has {len(axes)}")
    circular = 2 * math.pi * motion.frequency
    for axis, _ in zip(axes, motion.phases, strict=False):
        rate, acceleration = motion.amplitude * circular, motion.amplitude * circular**2
        if rate > axis.max_rate * _GRANTED or acceleration > axis.max_acceleration * _GRANTED:
            needed = f"{math.degrees(rate):.4g} deg/s and {math.degrees(acceleration):.4g} deg/s^2"
            raise InstrumentError(f"{where}rocking needs {needed} of the axis '{axis.name}', more than it reaches")


def check_cycle(axis: TableAxis, motion: Cycle, where: str = "") -> None:
    """Raises `InstrumentError` when the axis does not turn so fast."""
    if motion.rate > axis.max_rate * _GRANTED:
        able = f"{math.degrees(axis.max_rate):g} deg/s, not {math.degrees(motion.rate):g} deg/s"
        raise InstrumentError(f"{where}the axis '{axis.name}' reaches {able}")


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


def check_reach(axis: TableAxis, start: float, motion: Cycle) -> None:
    """Raises `InstrumentError` when a cycle that begins at `start` [rad] comes to a stop of the axis."""
    places = list(accumulate((move.turn for move in motion.moves), initial=start))
    low, high = min(places), max(places)
    if low < axis.lowest - SLACK or high > axis.highest + SLACK:
        reach = f"from {math.degrees(low):g} to {math.degrees(high):g} deg"
        raise InstrumentError(f"the cycle goes {reach} of the axis '{axis.name}'; {limits_in_words(axis)}")
