"""Finds amplitudes that distinguish the devices of one lot from all other devices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from planrunner.base.dataclass import dataclass
from planrunner.gap.fleet.amplitudes import AmplitudeKey
from planrunner.gap.fleet.attribution import Uncertain

MOST_CHANCE = 0.05
"""Largest accepted probability that k devices, drawn at random from all devices, are exactly the devices of the lot."""


@dataclass(frozen=True, slots=True)
class SharedByLot:
    """Describes an amplitude that distinguishes the devices of a lot from all other devices.

    `difference`: mean of the lot minus mean of the others, in the unit of the key. Each device contributes one value, the mean of
    its amplitudes. `expanded`: half-width of the 95 % interval of `difference`. `others`: number of the other devices. `chance`:
    probability that a random choice of devices, as many as the lot has, gives exactly this lot. It is 1 divided by the number of
    possible choices.
    """

    lot: str
    key: AmplitudeKey
    devices: tuple[str, ...]
    others: int
    difference: float
    expanded: float
    chance: float


def shared_by_lots(
    key: AmplitudeKey, levels: Mapping[str, Sequence[Uncertain]], lots: Mapping[str, str]
) -> Iterator[SharedByLot]:
    """Finds the lots that differ from all other devices: all devices of the lot have larger amplitudes than all other devices, or
    all have smaller amplitudes. The intervals of the two groups must not overlap. `levels`: amplitudes of each device: a single
    amplitude, or one for each period between steps of the device. `lots`: the lot of each device for which it is known."""
    for lot in sorted(set(lots.values())):
        own = [name for name in levels if lots.get(name) == lot]
        others = [name for name in levels if lots.get(name) != lot]
        if len(own) < 2 or not others:
            continue
        chance = 1 / math.comb(len(levels), len(own))
        above = min(_low(levels[name]) for name in own) > max(_high(levels[name]) for name in others)
        below = max(_high(levels[name]) for name in own) < min(_low(levels[name]) for name in others)
        if chance <= MOST_CHANCE and (above or below):
            first, second = (_mean([_mean(levels[name]) for name in names]) for names in (own, others))
            difference, expanded = first.value - second.value, math.hypot(first.expanded, second.expanded)
            yield SharedByLot(lot, key, tuple(own), len(others), difference, expanded, chance)


def _low(levels: Sequence[Uncertain]) -> float:
    return min(one.value - one.expanded for one in levels)


def _high(levels: Sequence[Uncertain]) -> float:
    return max(one.value + one.expanded for one in levels)


def _mean(given: Sequence[Uncertain]) -> Uncertain:
    """Returns the mean of values and the half-width of its interval. The values are treated as independent."""
    n = len(given)
    return Uncertain(sum(one.value for one in given) / n, math.hypot(*(one.expanded for one in given)) / n)
