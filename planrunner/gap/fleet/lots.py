"""What the devices of one lot have in common, and no other device has."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from planrunner.base.dataclass import dataclass
from planrunner.gap.fleet.amplitudes import AmplitudeKey
from planrunner.gap.fleet.attribution import Uncertain

MOST_CHANCE = 0.05
"""Largest probability with which k devices drawn at random from all would be just those of the lot."""


@dataclass(frozen=True, slots=True)
class SharedByLot:
    """An amplitude that separates the devices of a lot from all others. difference: of the mean of the lot from the mean of the others, and
    `expanded`, the half-width of its 95 % interval, in the unit of the key. others: number of the other devices. chance: 1 divided by the
    number of ways to choose as many devices from all."""

    lot: str
    key: AmplitudeKey
    devices: tuple[str, ...]
    others: int
    difference: float
    expanded: float
    chance: float


def shared_by_lots(
    key: AmplitudeKey, levels: Mapping[str, Uncertain], lots: Mapping[str, str]
) -> Iterator[SharedByLot]:
    """The lots whose devices all lie on one side of all other devices, with intervals that do not overlap. levels: amplitude of each
    device; lots: device → its lot, if known."""
    for lot in sorted(set(lots.values())):
        own = [name for name in levels if lots.get(name) == lot]
        others = [name for name in levels if lots.get(name) != lot]
        if len(own) < 2 or not others:
            continue
        chance = 1 / math.comb(len(levels), len(own))
        above = min(_low(levels[name]) for name in own) > max(_high(levels[name]) for name in others)
        below = max(_high(levels[name]) for name in own) < min(_low(levels[name]) for name in others)
        if chance <= MOST_CHANCE and (above or below):
            (first, u), (second, v) = _mean(levels, own), _mean(levels, others)
            yield SharedByLot(lot, key, tuple(own), len(others), first - second, math.hypot(u, v), chance)


def _low(one: Uncertain) -> float:
    return one.value - one.expanded


def _high(one: Uncertain) -> float:
    return one.value + one.expanded


def _mean(levels: Mapping[str, Uncertain], names: list[str]) -> tuple[float, float]:
    """The mean, and the half-width of its interval; the levels count as independent."""
    n = len(names)
    return sum(levels[name].value for name in names) / n, math.hypot(*(levels[name].expanded for name in names)) / n
