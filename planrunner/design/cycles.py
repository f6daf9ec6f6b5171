"""Searches for rotation cycles in which a constant horizontal error leaves no residual. In such a cycle, the contributions of the
error cancel over all stops, and also over all turns.

`same_order` keeps the planned order of the stops and chooses the sense of every turn. If no choice of senses in one round is good
enough, `same_order` also searches cycles of two or more rounds. `free_order` also chooses the order of the stops. In its cycles,
every position is held equally often. The cycles of both functions end at the first position with unwound cables. Among several
cycles, both functions prefer a mean angle of zero, then the smallest range of cable, and then the shortest duration.

Workers can share a search. The search of `same_order` is divided into parts with equal numbers of choices; the search of
`free_order` is divided by the first move. The parts are independent of each other, and their results are combined in a fixed order,
so the result does not depend on the number of workers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeGuard

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.workers import ALONE, Workers, results_in_order
from planrunner.physics.rotation_cycle import NOTHING, RotationCycle

TURN = 2 * math.pi
HALF_TURN = math.pi
MOST_CHOICES = 2**16  # largest number of combinations of senses in one round of `same_order`
MOST_STEPS = 200_000  # largest number of steps in one search of `free_order`; divided equally among its parts
CHOICES_OF_A_PART = 2**13
MOST_MOVES = 24
_ANGLE = 1e-9  # rad; angles, or mean angles, that differ by less count as equal


class CycleError(ValueError):
    """Raised if no cycle can be found. The message gives the reason."""


@dataclass(frozen=True, slots=True)
class Cable:
    """The range of angles that the cable of the axis permits [rad], counted from the first position."""

    lowest: float = -math.inf
    highest: float = math.inf

    def holds(self, low: float, high: float) -> bool:
        return self.lowest - _ANGLE <= low and high <= self.highest + _ANGLE


@dataclass(frozen=True, slots=True)
class Round:
    """States how many cycles one search tried, and how many of them were suitable.

    `moves`: number of moves in each cycle. `tried`: number of cycles that were tried. `balanced`: number of cycles with zero
    residual. `wound`: number of cycles with zero residual that end with wound-up cables. `exhaustive`: True if all possible cycles
    were tried.
    """

    moves: int
    tried: int
    balanced: int
    wound: int
    exhaustive: bool = True


@dataclass(frozen=True, slots=True)
class FoundCycle:
    """The result of several searches. `cycle`: the best cycle with zero residual, or None if none was found. `rounds`: the searches
    in the order in which they were made."""

    cycle: RotationCycle | None
    rounds: tuple[Round, ...]


@dataclass(frozen=True, slots=True)
class StudiedCycle:
    """One cycle of a design study.

    `cycle`: the cycle; its angles are positive in the sense of rotation that is positive in the plan. `moves`: the moves as a plan
    writes them. `drive`: ratio of the growth of the Schuler oscillation with this cycle to the growth without rotation.
    """

    cycle: RotationCycle
    moves: tuple[str, ...]
    drive: float


def same_order(planned: RotationCycle, cable: Cable = Cable(), workers: Workers = ALONE) -> FoundCycle:
    """Searches for cycles through the planned stops in the planned order. A turn may have either sense. The longest permitted turn
    is the longest planned turn or half a turn, whichever is longer.

    Raises `CycleError` if there are too many choices, or if the stops themselves are not balanced, because no choice of turns can
    correct this.
    """
    if abs(planned.integral()[0]) > NOTHING * planned.period:
        raise CycleError(
            "the stop times on opposite sides differ, and turns cannot compensate for this: stop equally long on opposite sides"
        )
    most = max(HALF_TURN, *(abs(turn) for turn in planned.turns)) + _ANGLE
    choices = [_ways(turn, most) for turn in planned.turns]
    rounds: list[Round] = []
    best: RotationCycle | None = None
    for repeats in itertools.count(1):
        count = math.prod(map(len, choices)) ** repeats
        if count > MOST_CHOICES or repeats * len(choices) > MOST_MOVES:
            break
        parts = [range(first, min(first + CHOICES_OF_A_PART, count)) for first in range(0, count, CHOICES_OF_A_PART)]
        work = partial(_best_of_part, choices * repeats, planned, cable)
        found, tally = _together(len(choices) * repeats, results_in_order(work, parts, workers))
        rounds.append(tally)
        best = _better(best, found)
        if _centred(best):
            break
    if not rounds:
        raise CycleError(f"{len(choices)} moves allow too many combinations of turns to try them all")
    return FoundCycle(best, tuple(rounds))


def _together(moves: int, parts: Iterable[tuple[RotationCycle | None, Round]]) -> tuple[RotationCycle | None, Round]:
    """Combines the results of the parts of a search for cycles of `moves` moves."""
    best: RotationCycle | None = None
    tallies = []
    for found, tally in parts:
        best = _better(best, found)
        tallies.append(tally)
    return best, Round(
        moves, sum(one.tried for one in tallies), sum(one.balanced for one in tallies),
        sum(one.wound for one in tallies), all(one.exhaustive for one in tallies),
    )  # fmt: skip


def _best_of_part(
    choices: Sequence[Sequence[float]], planned: RotationCycle, cable: Cable, part: range
) -> tuple[RotationCycle | None, Round]:
    """Returns the result of `_best_of` for one part of all combinations of turns. The combinations are numbered in the order of
    `itertools.product`."""
    numbers = np.unravel_index(np.array(part), [len(ways) for ways in choices])
    turns = np.column_stack([np.array(ways)[number] for ways, number in zip(choices, numbers, strict=True)])
    return _best_of(turns, planned, cable)


def _ways(turn: float, most: float) -> list[float]:
    """Returns all turns that end at the same position as `turn` and are not longer than `most` [rad]. The first of them is `turn`
    itself. A turn of zero is left out."""
    others = [turn + TURN * whole for whole in range(-2, 3) if whole]
    return [turn, *(other for other in others if abs(other) <= most and abs(other) > _ANGLE)]


def _best_of(turns: Array, planned: RotationCycle, cable: Cable) -> tuple[RotationCycle | None, Round]:
    """Returns the best of m cycles whose stops have equal durations (None if no cycle is suitable), and the extent of this search.
    `turns`: array of shape (m, n), the n turns of each cycle."""
    ends = np.cumsum(turns, axis=1)
    begins = ends - turns
    left = np.zeros(len(turns), dtype=complex)
    lasting = np.zeros(len(turns))
    for size in np.unique(turns):
        part, seconds = _turn(float(size), planned)
        where = turns == size
        left += np.sum(np.exp(1j * begins) * where, axis=1) * part
        lasting += np.sum(where, axis=1) * seconds
    period = lasting + turns.shape[1] * planned.stop
    balanced = np.abs(left) <= NOTHING * period
    wound = balanced & (np.abs(ends[:, -1]) > _ANGLE)
    low, high = np.minimum(0, ends.min(axis=1)), np.maximum(0, ends.max(axis=1))
    fits = (low >= cable.lowest - _ANGLE) & (high <= cable.highest + _ANGLE)
    best: RotationCycle | None = None
    for row in np.flatnonzero(balanced & ~wound & fits):
        best = _better(
            best, RotationCycle(tuple(turns[row].tolist()), planned.stop, planned.rate, planned.acceleration)
        )
    tally = Round(turns.shape[1], len(turns), int(balanced.sum()), int(wound.sum()))
    return best, tally


def free_order(
    positions: Sequence[float],
    planned: RotationCycle,
    cable: Cable = Cable(),
    workers: Workers = ALONE,
) -> FoundCycle:
    """Searches for cycles through `positions` [rad, from the first position of the planned cycle]. Every position is held equally
    often, and no turn is longer than half a turn.

    Let n be the number of positions. The search first tries every order with n moves, then every order with 2·n moves, and so on.
    The search ends when a cycle has zero residual and a mean angle of zero. If there are too many orders, the search tries only
    turns to neighbouring positions. Raises `CycleError` if the positions are not balanced.
    """
    angles = sorted({round(angle % TURN, 9) % round(TURN, 9): angle % TURN for angle in positions}.values())
    if len(angles) < 2:
        raise CycleError("there is only one position: add positions opposite each other")
    if abs(sum(np.exp(1j * np.array(angles)))) > NOTHING * len(angles):
        shown = ", ".join(f"{math.degrees(angle):g}" for angle in angles)
        raise CycleError(f"the positions {shown} deg do not balance: add positions opposite to them")
    rounds: list[Round] = []
    best: RotationCycle | None = None
    for visits in range(1, MOST_MOVES // len(angles) + 1):
        for near in (False, True):
            work = partial(_best_after, angles, visits, planned, cable, near)
            firsts = range(len(_steps(angles, _home(angles), near)))
            found, tally = _together(visits * len(angles), results_in_order(work, firsts, workers))
            rounds.append(tally)
            best = _better(best, found)
            if tally.exhaustive:
                break
        if _centred(best) or not tally.exhaustive:
            break
    return FoundCycle(best, tuple(rounds))


def _home(angles: Sequence[float]) -> int:
    """Returns the position in which a cycle begins and ends."""
    return min(range(len(angles)), key=lambda index: abs(math.remainder(angles[index], TURN)))


def _best_after(
    angles: Sequence[float], visits: int, planned: RotationCycle, cable: Cable, near: bool, first: int
) -> tuple[RotationCycle | None, Round]:
    """Returns the best of the cycles that begin with the step number `first` from the home position (None if no such cycle is
    suitable), and the extent of this search."""
    return _Search(angles, visits, planned, cable, near, first).run()


class _Search:
    """Searches every order of stops that begins with a given first step. Branches that wind up the cables further than the best
    cycle found so far are omitted."""

    def __init__(
        self,
        angles: Sequence[float],
        visits: int,
        planned: RotationCycle,
        cable: Cable,
        near: bool,
        first: int,
    ):
        self.moves = visits * len(angles)
        self.left = [visits] * len(angles)
        self.planned, self.cable = planned, cable
        self.home = _home(angles)
        self.steps = [_steps(angles, index, near) for index in range(len(angles))]
        made = {turn: _turn(turn, planned) for steps in self.steps for _, turn in steps}
        self.parts = [
            {turn: complex(np.exp(1j * angle)) * made[turn][0] for _, turn in steps}
            for angle, steps in zip(angles, self.steps, strict=True)
        ]
        self.seconds = {turn: seconds for turn, (_, seconds) in made.items()}
        self.first, self.most = first, MOST_STEPS // max(1, len(self.steps[self.home]))
        self.best: RotationCycle | None = None
        self.narrowest = math.inf  # range of the best cycle, as soon as its mean angle is zero
        self.tried = self.balanced = self.wound = self.walked = 0

    def run(self) -> tuple[RotationCycle | None, Round]:
        for turns in self._walk(self.home, 0.0, 0.0, 0.0, 0j, ()):
            self._take(turns)
            if self.walked > self.most:
                break
        tally = Round(self.moves, self.tried, self.balanced, self.wound, self.walked <= self.most)
        return self.best, tally

    def _walk(
        self, at: int, angle: float, low: float, high: float, left: complex, turns: tuple[float, ...]
    ) -> Iterator[tuple[tuple[float, ...], complex]]:
        """Yields every closed sequence of turns, with the sum of the residuals of its turns."""
        self.walked += 1
        if len(turns) == self.moves:
            if at == self.home:
                yield turns, left
            return
        self.left[at] -= 1
        for to, turn in self.steps[at] if turns else [self.steps[at][self.first]]:
            end = angle + turn
            lower, higher = min(low, end), max(high, end)
            last = len(turns) == self.moves - 1
            if (to == self.home if last else self.left[to] > 0) and self._worth(lower, higher):
                yield from self._walk(to, end, lower, higher, left + self.parts[at][turn], (*turns, turn))
            if self.walked > self.most:
                break
        self.left[at] += 1

    def _worth(self, low: float, high: float) -> bool:
        return self.cable.holds(low, high) and high - low <= self.narrowest + _ANGLE

    def _take(self, walk: tuple[tuple[float, ...], complex]) -> None:
        turns, left = walk
        self.tried += 1
        stop = self.planned.stop
        period = len(turns) * stop + math.fsum(self.seconds[turn] for turn in turns)
        if abs(left) > NOTHING * period:
            return
        self.balanced += 1
        if abs(math.fsum(turns)) > _ANGLE:
            self.wound += 1
            return
        planned = self.planned
        self.best = _better(self.best, RotationCycle(turns, stop, planned.rate, planned.acceleration))
        if _centred(self.best):
            self.narrowest = self.best.reach[1] - self.best.reach[0]


def _steps(angles: Sequence[float], start: int, near: bool) -> list[tuple[int, float]]:
    """Returns the permitted steps of at most half a turn from one position. Each step is a pair: the index of the next position,
    and the turn to that position. The shortest turn comes first; of two equally long turns, the positive turn comes first."""
    count = len(angles)
    ends = [(start + 1) % count, (start - 1) % count] if near else [index for index in range(count) if index != start]
    found = set()
    for end in ends:
        short = math.remainder(angles[end] - angles[start], TURN)
        for turn in (short, short - math.copysign(TURN, short)):
            if abs(turn) <= HALF_TURN + _ANGLE:
                found.add((end, round(turn, 12)))
    return sorted(found, key=lambda step: (round(abs(step[1]), 9), -step[1]))


def _turn(turn: float, planned: RotationCycle) -> tuple[complex, float]:
    """Returns the residual [s] of one turn that begins at angle zero, and the duration of the turn [s]."""
    if abs(turn) <= _ANGLE:
        return 0j, 0.0
    alone = RotationCycle((turn,), 0.0, planned.rate, planned.acceleration)
    return alone.integral()[1], alone.period


def _better(first: RotationCycle | None, second: RotationCycle | None) -> RotationCycle | None:
    """Returns the better of two cycles with zero residual. If both are equally good, returns the first. None means that there is no
    cycle."""
    if first is None or second is None:
        return first or second
    return second if _merit(second) < _merit(first) else first


def _merit(cycle: RotationCycle) -> tuple[float, float, float]:
    low, high = cycle.reach
    return round(abs(cycle.mean_angle), 9), round(high - low, 9), round(cycle.period, 6)


def _centred(cycle: RotationCycle | None) -> TypeGuard[RotationCycle]:
    return cycle is not None and abs(cycle.mean_angle) <= _ANGLE
