"""Compares the gyros of a recording that has no description yet with its accelerometers.

A turn between two intervals at rest changes the direction of gravity in the sensor's axes. The accelerometers show this change
directly. The change can also be computed by integrating the outputs of the gyros. The comparison of the two shows the unit of the
gyros, and whether axes are exchanged or reversed."""

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

UNITS = ("rad/s", "mrad/s", "deg/s", "mdeg/s", "deg/h")
LEAST_TURNS = 4
"""Smallest number of turns from which a conclusion is drawn."""
_LEAST_ANGLE = 20.0  # deg by which gravity must turn
_LONGEST = 30.0  # s of a turn, over which the bias of a gyro may add up
_AGREES = 15.0  # deg of median error with which gyros and accelerometers agree
_CLEARLY = 3.0  # times this error, and more, for any other explanation of another unit or other axes
_LEAST_AGAINST = 3  # turns that must contradict another explanation, if half of the turns do not
_FEW = 0.2  # largest share of turns that may speak for the other explanation
_MOST = 45.0  # deg: all errors above count alike, as of a turn that was disturbed


_OWN = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class TurnComparison:
    """Contains the result of a comparison of gyros with accelerometers.

    `unit`: unit of the gyros. `axes`: for each of the gyros x, y and z, the axis in the accelerometers' frame about which the gyro
    measures, with a sign, such as `-y`. An axis is empty if the turns do not show it. `error`: median angle [deg] between the direction
    of gravity that is measured after a turn and the direction that is computed from the gyros."""

    unit: str
    axes: tuple[str, str, str]
    error: float

    @property
    def same_axes(self) -> bool:
        return all(axis in ("", own) for axis, own in zip(self.axes, "xyz", strict=True))


@dataclass(frozen=True, slots=True)
class _Turn:
    """One turn between two intervals at rest.

    `before`, `after`: arrays of shape (3,), direction of gravity before and after the turn. `steps`: array of shape (n, 3), outputs
    of the gyros without their bias, integrated over successive windows, in the unit of the gyros times s."""

    before: Array
    after: Array
    steps: Array


def turns_compared(gyro: Array, accel: Array, begin: Array, end: Array, still: Sequence[Span]) -> TurnComparison | None:
    """Compares gyros with accelerometers over the turns between the intervals at rest `still`.

    Returns None if there are fewer than `LEAST_TURNS` turns, or if no combination of a unit and an assignment of axes makes gyros and
    accelerometers agree. Also returns None if they agree in two units. If they agree with several assignments of axes, the axes of
    the accelerometers are used, unless the turns contradict this; otherwise, the axes that differ between the assignments are left
    empty. `gyro`, `accel`: arrays of shape (n, 3), averages of the outputs over n windows. `begin`, `end`: arrays of shape (n,),
    start and end times of the windows, s."""
    turns = list(_turns(gyro, accel, begin, end, still))
    if len(turns) < LEAST_TURNS:
        return None
    forms = [(word, axes, unit(word).factor * matrix) for word in UNITS for axes, matrix in _signed_axes()]
    errors = _errors(turns, np.array([matrix for _, _, matrix in forms]))
    found = [(word, axes, own) for (word, axes, _), own in zip(forms, errors, strict=True)]
    word, axes, best = min(found, key=lambda one: float(np.minimum(one[2], _MOST).mean()))
    error = float(np.median(best))
    if error >= _AGREES:
        return None
    left = [one for one in found if not _contradicted(one[2], best)]
    if any(other != word for other, _, _ in left):
        return None
    possible = [axes for _, axes, _ in left]
    if _OWN not in possible:
        x, y, z = (own if all(one[k] == own for one in possible) else "" for k, own in enumerate(axes))
        return TurnComparison(word, (x, y, z), error)
    return TurnComparison(word, _OWN, error)


def _contradicted(errors: Array, best: Array) -> bool:
    """Returns True if the turns contradict an explanation.

    There are two cases. First, the median error of the explanation is large. Second, its error is large in some turns that the best
    explanation describes, and hardly any turn supports it. `errors`, `best`: arrays of shape (n,), errors [deg] of the explanation
    and of the best explanation in each turn."""
    if float(np.median(errors)) > max(_AGREES, _CLEARLY * float(np.median(best))):
        return True
    against = np.count_nonzero((errors > np.maximum(_AGREES, _CLEARLY * best)) & (best < _AGREES))
    in_favour = np.count_nonzero((best > np.maximum(_AGREES, _CLEARLY * errors)) & (errors < _AGREES))
    return bool(against >= _LEAST_AGAINST and in_favour <= _FEW * against)


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
    """Yields all 48 ways to exchange and reverse three axes, each with the matrix that converts vectors from gyro axes to
    accelerometer axes."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[order, range(3)] = signs
            x, y, z = (f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True))
            yield (x, y, z), matrix


def _errors(turns: Sequence[_Turn], matrices: Array) -> Array:
    """Returns, for each of m matrices and each of n turns, the angle [deg] between the direction of gravity that is measured after the
    turn and the direction that is computed from the gyros, shape (m, n).

    In the axes of the sensor, a direction u that is fixed in space follows du/dt = -ω × u. `matrices`: array of shape (m, 3, 3); each
    matrix converts outputs of the gyros to rates in rad/s about the axes of the accelerometers."""
    from scipy.spatial.transform import Rotation

    angles = []
    for turn in turns:
        computed = np.tile(turn.before, (len(matrices), 1))
        for step in turn.steps:
            computed = Rotation.from_rotvec(-matrices @ step).apply(computed)
        angles.append(np.degrees(np.arccos(np.clip(computed @ turn.after, -1.0, 1.0))))
    return np.column_stack(angles)
