"""Compares the gyros of a recording that has no description yet with its accelerometers: a turn between two intervals at rest moves
gravity in the axes of the sensor by the integrated rate of turn. This shows the unit of the gyros, and exchanged or reversed axes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.plan.span import Span
from planrunner.plan.units import unit

UNITS = ("rad/s", "deg/s", "deg/h")
LEAST_TURNS = 4
"""Turns without which nothing is concluded."""
_LEAST_ANGLE = 20.0  # deg by which gravity must turn
_LONGEST = 30.0  # s of a turn, over which the bias of a gyro may add up
_AGREES = 15.0  # deg of median error with which gyros and accelerometers agree
_CLEARLY = 3.0  # times this error, and more, for any other explanation of another unit or other axes


@dataclass(frozen=True, slots=True)
class TurnComparison:
    """How gyros and accelerometers describe the same turns. unit: of the gyros; axes: for each gyro x, y, z the axis of the
    accelerometers about which it turns, with its sign; error: median angle [deg] between measured and computed gravity."""

    unit: str
    axes: tuple[str, str, str]
    error: float

    @property
    def same_axes(self) -> bool:
        return self.axes == ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class _Turn:
    """One turn between two intervals at rest. before, after: direction of gravity, (3,); steps: integrated outputs of the gyros in
    successive windows, (n, 3), unit of the gyros times s."""

    before: Array
    after: Array
    steps: Array


def turns_compared(gyro: Array, accel: Array, begin: Array, end: Array, still: Sequence[Span]) -> TurnComparison | None:
    """How the gyros describe the turns that the accelerometers show; None if there are fewer than `LEAST_TURNS` turns, if nothing
    agrees, or if several explanations do. gyro, accel: means of windows, (n, 3); begin, end: of the windows, (n,), s."""
    turns = list(_turns(gyro, accel, begin, end, still))
    if len(turns) < LEAST_TURNS:
        return None
    found = sorted(
        (
            TurnComparison(word, axes, _error(turns, unit(word).factor * matrix))
            for word in UNITS
            for axes, matrix in _signed_axes()
        ),
        key=lambda one: one.error,
    )
    best, *others = found
    clear = others[0].error > max(_AGREES, _CLEARLY * best.error)
    return best if best.error < _AGREES and clear else None


def _turns(gyro: Array, accel: Array, begin: Array, end: Array, still: Sequence[Span]) -> Iterator[_Turn]:
    def inside(first: float, last: float) -> NDArray[np.bool_]:
        return (begin >= first - 1e-9) & (end <= last + 1e-9)

    rests = [inside(span.start, span.end) for span in still]
    if not rests:
        return
    bias = np.nanmedian(gyro[np.any(rests, axis=0)], axis=0)
    for (here, there), (rest, next_rest) in zip(itertools.pairwise(still), itertools.pairwise(rests), strict=True):
        between = inside(here.end, there.start)
        if there.start - here.end > _LONGEST or not between.any():
            continue
        before, after = (np.nanmean(accel[one], axis=0) for one in (rest, next_rest))
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        steps = (gyro[between] - bias) * (end - begin)[between, np.newaxis]
        if np.isfinite(steps).all() and before @ after < math.cos(math.radians(_LEAST_ANGLE)):
            yield _Turn(before, after, steps)


def _signed_axes() -> Iterator[tuple[tuple[str, str, str], Array]]:
    """All 48 ways to exchange and reverse three axes, with the matrix from the gyros to the axes of the accelerometers."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[order, range(3)] = signs
            x, y, z = (f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True))
            yield (x, y, z), matrix


def _error(turns: Sequence[_Turn], matrix: Array) -> float:
    """Median angle [deg] between gravity after a turn as measured, and as computed from the gyros. In the axes of the sensor a fixed
    direction u follows du/dt = -ω × u. matrix: from the gyros to rad/s about the axes of the accelerometers."""
    from scipy.spatial.transform import Rotation

    angles = []
    for turn in turns:
        computed = turn.before
        for rotation in Rotation.from_rotvec(-turn.steps @ matrix.T):
            computed = rotation.apply(computed)
        angles.append(math.degrees(math.acos(min(1.0, max(-1.0, float(computed @ turn.after))))))
    return float(np.median(angles))
