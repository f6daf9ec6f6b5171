"""Computes the kinematics of rate tables: the attitude for joint angles, the joint angles for an attitude, the reachable attitudes,
and the duration of moves.

Axes are listed outermost first. R_i is the rotation by the joint angle q_i, right-handed about the direction that the axis has at
joint angle zero. If α is the azimuth of the site (clockwise from north), the attitude of the platform in East-North-Up is
R_z(−α)·R_1·R_2·R_3. With all joints at zero and α = 0, the sensor's x, y, z axes point east, north, up. Adjacent axes are
perpendicular to each other. The joint angles for an attitude follow from the classical subproblems of screw theory (Murray, Li,
Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, section 3.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

Angles = tuple[float, ...]

TURN = 2 * math.pi
LOCKED = 1e-9  # sine of the angle between outer and inner axis below which they count as parallel (gimbal lock)
REACHED = 1e-7  # rad; an attitude nearer than this counts as reached
ALIGNED = 1e-5  # rad; an axis nearer than this to a direction counts as lying along it
SLACK = 1e-9  # rad beyond a joint limit that rounding may cause
NEARLY = math.radians(20)  # rad by which a limited axis takes a longer way if this leads it nearer to zero
ALIKE = 1e-6  # rad; moves of a continuous axis whose lengths differ by less count as equally long
AS_QUICK = 1e-3  # relative difference of duration, and of length, below which two moves count as equally good


class Unreachable(ValueError):  # noqa: N818 - reads as what the table says
    """Reports that the table cannot reach an attitude or a direction. The message names the axis, the angle and the limit."""


@dataclass(frozen=True, slots=True)
class TableAxis:
    """One axis of a table. The axes of a table are listed outermost first.

    `direction`: unit vector of the axis at joint angle zero, in East-North-Up, before the azimuth of the site is applied.
    `max_rate`: largest rate, rad/s. `max_acceleration`: largest acceleration, rad/s^2. `lowest`, `highest`: limits of the joint
    angle, rad (infinite for a continuous axis with slip rings).
    """

    name: str
    direction: tuple[float, float, float]
    max_rate: float
    max_acceleration: float
    lowest: float = -math.inf
    highest: float = math.inf

    @property
    def continuous(self) -> bool:
        return math.isinf(self.lowest) and math.isinf(self.highest)


def rotation_about(axis: Sequence[float], angle: float) -> Array:
    """Returns the right-handed rotation matrix by `angle` [rad] about the unit vector `axis`, by Rodrigues' formula, shape (3, 3)."""
    x, y, z = axis
    c, s = math.cos(angle), math.sin(angle)
    v = 1.0 - c
    return np.array(
        [
            [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, c + v * y * y, v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, c + v * z * z],
        ]
    )


def cross(a: Array, b: Array) -> Array:
    """Returns the cross product a × b, shape (3,). `numpy.cross` is designed for many vectors and takes ten times as long for a
    single pair."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def attitude(axes: Sequence[TableAxis], angles: Sequence[float] | Array, azimuth: float = 0.0) -> Array:
    """Returns the sensor's axes (3, 3) as rows in East-North-Up. `angles`: array of shape (n,) in rad, joint angles. `azimuth`:
    azimuth of the site, rad."""
    platform = rotation_about((0.0, 0.0, 1.0), -azimuth)
    for axis, angle in zip(axes, angles, strict=True):
        platform = platform @ rotation_about(axis.direction, angle)
    return np.asarray(platform.T)


def joint_angles(
    axes: Sequence[TableAxis], target: Array, near: Sequence[float] | Array, azimuth: float = 0.0
) -> Array:
    """Returns the joint angles (n,) [rad] for an attitude `target` (3, 3), whose rows are the sensor's axes in East-North-Up. Among
    all solutions within the limits, the result is the solution that the table reaches fastest from the joint angles `near`.

    The angle of a limited axis includes full turns, so that cables unwind if necessary. A continuous axis turns the shorter way.
    Among equally fast solutions, the solution with the limited axes nearest to zero is chosen. Among the remaining solutions, the
    solution that turns in the positive direction is chosen. Raises `Unreachable`, which states the reason, if there is no solution.
    """
    return quickest_move(axes, target, near, azimuth)[0]


def quickest_move(
    axes: Sequence[TableAxis], target: Array, near: Sequence[float] | Array, azimuth: float = 0.0
) -> tuple[Array, float]:
    """Returns the joint angles (n,) as in `joint_angles`, and the time [s] that the move takes. The arguments are those of
    `joint_angles`. Raises `Unreachable`, which states the reason, if the attitude cannot be reached."""
    start = np.asarray(near, dtype=float).tobytes()
    angles, seconds = _quickest_move(tuple(axes), np.asarray(target, dtype=float).tobytes(), start, azimuth)
    return np.array(angles), seconds


def quickest_ends(axes: Sequence[TableAxis], target: Array, starts: Array, azimuth: float = 0.0) -> Array:
    """Computes the joint angles that `quickest_move` gives for the attitude `target` (3, 3) from each of n starts. Starts and
    results have the shape (n, joints). Do not modify the result: it is cached."""
    return _quickest_ends(tuple(axes), np.asarray(target, dtype=float).tobytes(), starts.tobytes(), azimuth)


@lru_cache(maxsize=512)
def _quickest_ends(axes: tuple[TableAxis, ...], target: bytes, starts: bytes, azimuth: float) -> Array:
    rows = np.frombuffer(starts).reshape(-1, len(axes))
    ends = np.array([_quickest_move(axes, target, row.tobytes(), azimuth)[0] for row in rows]).reshape(rows.shape)
    ends.flags.writeable = False
    return ends


# Plans repeat their orientations, so solutions are cached. The key is bytes, because the sign of a zero decides between equivalent angles.
@lru_cache(maxsize=8192)
def _quickest_move(axes: tuple[TableAxis, ...], target: bytes, start: bytes, azimuth: float) -> tuple[Angles, float]:
    near: Angles = tuple(np.frombuffer(start).tolist())
    candidates = _solutions(axes, target, None, azimuth) or _solutions(axes, target, near, azimuth)
    ways: list[Angles] = []
    reasons: list[tuple[float, str]] = []
    for candidate in candidates:
        placed = [_place(axis, angle, start) for axis, angle, start in zip(axes, candidate, near, strict=True)]
        outside = [reason for _, reason in placed if reason is not None]
        if outside:
            reasons.append(max(outside))
        else:
            ways.append(tuple(angle for angle, _ in placed))
    if not ways:
        raise Unreachable(min(reasons)[1])
    best = _preferred(axes, near, ways)
    return best, transition_time(axes, near, best)


@lru_cache(maxsize=8192)
def _solutions(axes: tuple[TableAxis, ...], target: bytes, near: Angles | None, azimuth: float) -> tuple[Angles, ...]:
    """Returns all solutions of the joint angles for an attitude, regardless of the present position of the table. In gimbal lock,
    one angle is free, and is chosen with the help of the joint angles `near`; if `near` is None, the result is empty. Raises
    `Unreachable` if the geometry of the axes does not allow the attitude."""
    wanted = rotation_about((0.0, 0.0, 1.0), azimuth) @ np.frombuffer(target).reshape(3, 3).T
    candidates = {1: _one_axis, 2: _two_axes, 3: _three_axes}[len(axes)](axes, wanted, near)
    off = _misalignment(axes, candidates[0], wanted) if candidates else 0.0
    if off > REACHED:
        names = " and ".join(f"'{axis.name}'" for axis in axes)
        only = f"has only the axis {names}" if len(axes) == 1 else f"has only the axes {names}"
        message = f"the table {only}; the nearest orientation it reaches is {math.degrees(off):.4g} deg away"
        raise Unreachable(message)
    return tuple(candidates)


def _preferred(axes: Sequence[TableAxis], near: Angles, ways: list[Angles]) -> Angles:
    """Chooses the fastest of several moves to joint angles. Of equally fast moves, it chooses the shortest. If several moves are
    left, it chooses the move whose limited axes are nearest to zero. If several are still left, it chooses the move in which the
    first axis that differs turns in the positive direction."""
    if len(ways) == 1:
        return ways[0]
    ways = _least(ways, [transition_time(axes, near, way) for way in ways])
    ways = _least(ways, [math.dist(way, near) for way in ways])
    wound = [math.hypot(*(angle for axis, angle in zip(axes, way, strict=True) if not axis.continuous)) for way in ways]
    ways = _least(ways, wound)
    for index in range(len(axes)):
        furthest = max(way[index] for way in ways)
        ways = [way for way in ways if way[index] >= furthest - ALIKE]
    return ways[0]


def _least(ways: list[Angles], values: list[float]) -> list[Angles]:
    """Returns the moves with the smallest value. Moves with a slightly larger value are included if rounding, or the end of a
    previous motion, could cause the difference."""
    most = min(values) * (1 + AS_QUICK) + ALIKE
    return [way for way, value in zip(ways, values, strict=True) if value <= most]


def move_time(angle: float, max_rate: float, max_acceleration: float) -> float:
    """Returns the time [s] of a move from rest to rest with a trapezoidal rate profile.

    With the acceleration a, the table reaches the rate w after the time w/a; by then, it has turned by w²/2a. A move with |angle| <
    w²/a therefore does not reach w. The rate profile of such a move is a triangle, and the move takes the time 2·√(|angle|/a).
    """
    distance = abs(angle)
    if distance < max_rate**2 / max_acceleration:
        return 2 * math.sqrt(distance / max_acceleration)
    return distance / max_rate + max_rate / max_acceleration


def transition_time(axes: Sequence[TableAxis], start: Sequence[float] | Array, end: Sequence[float] | Array) -> float:
    """Returns the time [s] of a move from rest to rest between two sets of joint angles [rad]. All axes move at the same time, so
    the slowest one determines the time. `start`, `end`: arrays of shape (n,), the two sets of joint angles."""
    moves = zip(axes, start, end, strict=True)
    return max(move_time(stop - begin, axis.max_rate, axis.max_acceleration) for axis, begin, stop in moves)


def spin_up_time(axis: TableAxis, rate: float) -> float:
    """Returns the time [s] to accelerate from rest to `rate` [rad/s], or to brake to rest."""
    return abs(rate) / axis.max_acceleration


def joint_directions(axes: Sequence[TableAxis], angles: Sequence[float] | Array, azimuth: float = 0.0) -> Array:
    """Returns the directions of all axes at these joint angles, as unit vectors in East-North-Up, shape (n, 3). Do not modify the
    result: it is cached. `azimuth`: azimuth of the site, rad."""
    return _joint_directions(tuple(axes), np.asarray(angles, dtype=float).tobytes(), azimuth)


@lru_cache(maxsize=8192)
def _joint_directions(axes: tuple[TableAxis, ...], angles: bytes, azimuth: float) -> Array:
    carried = rotation_about((0.0, 0.0, 1.0), -azimuth)
    rows = []
    for axis, angle in zip(axes, np.frombuffer(angles).tolist(), strict=True):
        rows.append(carried @ np.asarray(axis.direction))
        carried = carried @ rotation_about(axis.direction, angle)
    directions = np.array(rows)
    directions.flags.writeable = False
    return directions


def spin_axis(
    axes: Sequence[TableAxis], angles: Sequence[float] | Array, about: Sequence[float], azimuth: float = 0.0
) -> int:
    """Returns the index of the axis that, at these joint angles, is parallel or antiparallel to the site direction `about`.

    If there are several such axes, the outermost is chosen, because it carries the others. Raises `Unreachable` if there is none;
    the message states the angles between the axes and the direction.
    """
    cosines = joint_directions(axes, angles, azimuth) @ np.asarray(about, dtype=float)
    for index, cosine in enumerate(cosines):
        if abs(cosine) > math.cos(ALIGNED):
            return index
    off = [
        f"'{axis.name}' {math.degrees(math.acos(min(1.0, abs(float(c))))):.4g} deg"
        for axis, c in zip(axes, cosines, strict=True)
    ]
    raise Unreachable(
        f"no axis of the table is parallel to the axis of rotation at this attitude; angles between them: {', '.join(off)}"
    )


def check_geometry(axes: Sequence[TableAxis]) -> None:
    """Raises `Unreachable` if there are not one to three axes, or if an axis is not perpendicular to the axis that carries it."""
    if not 1 <= len(axes) <= 3:
        raise Unreachable(f"a table has one to three axes, not {len(axes)}")
    for outer, inner in pairwise(axes):
        if abs(float(np.dot(outer.direction, inner.direction))) > 1e-9:
            raise Unreachable(f"the axis '{inner.name}' is not at right angles to '{outer.name}', which carries it")


# -- solving ---------------------------------------------------------------------------------------------------------


def _one_axis(axes: Sequence[TableAxis], wanted: Array, near: Angles | None) -> list[Angles]:
    return [(_best_turn(axes[0].direction, wanted),)]


def _two_axes(axes: Sequence[TableAxis], wanted: Array, near: Angles | None) -> list[Angles]:
    first, second = (np.asarray(axis.direction) for axis in axes)
    outer = _angle_between(first, second, wanted @ second)
    if outer is None:
        if near is None:
            return []
        outer = near[0]
    rest = rotation_about(axes[0].direction, outer).T @ wanted
    return [(outer, _best_turn(axes[1].direction, rest))]


def _three_axes(axes: Sequence[TableAxis], wanted: Array, near: Angles | None) -> list[Angles]:
    """Returns the solutions for three axes. There are two solutions or, if the outer and the inner axis are parallel, a
    one-parameter family, from which some are selected.

    Let R_1·R_2·R_3 = W and W·a_3 = b. Then a_1·(R_2 a_3) = a_1·b determines q_2 up to a sign; q_1 is the angle that turns R_2·a_3
    into b; and q_3 follows. The sine is computed directly, as |a_1 × b|, because an arc cosine would lose half of the digits near
    gimbal lock.
    """
    first, second, third = (np.asarray(axis.direction) for axis in axes)
    carried = wanted @ third
    sine = float(np.linalg.norm(cross(first, carried)))
    locked = sine < LOCKED
    half = math.atan2(0.0 if locked else sine, float(first @ carried))
    zero = math.atan2(float(first @ cross(second, third)), float(first @ third))
    found: list[Angles] = []
    for middle in {zero + half, zero - half}:
        turned = rotation_about(axes[1].direction, middle) @ third
        if locked:
            found += _locked_family(axes, middle, wanted, near) if near is not None else []
            continue
        outer = _angle_between(first, turned, carried)
        assert outer is not None
        found.append((outer, middle, _inner(axes, outer, middle, wanted)))
    return sorted(found)


def _inner(axes: Sequence[TableAxis], outer: float, middle: float, wanted: Array) -> float:
    carrier = rotation_about(axes[0].direction, outer) @ rotation_about(axes[1].direction, middle)
    return _best_turn(axes[2].direction, carrier.T @ wanted)


def _locked_family(axes: Sequence[TableAxis], middle: float, wanted: Array, near: Sequence[float]) -> list[Angles]:
    """Returns the solutions in gimbal lock. If the outer and the inner axis are parallel, only the sum of their angles matters. In
    each of the returned solutions, one of the two axes keeps its angle or goes to a limit. `middle`: angle of the middle axis, rad.
    `wanted`: array of shape (3, 3), the rotation of the platform. `near`: the present joint angles, rad."""
    outer, inner = axes[0], axes[2]
    turned = rotation_about(axes[1].direction, middle) @ np.asarray(inner.direction)
    same_way = 1.0 if float(np.dot(outer.direction, turned)) > 0 else -1.0
    total = _inner(axes, 0.0, middle, wanted)  # q_3 = total − same_way·q_1
    outers = [near[0], *(limit for limit in (outer.lowest, outer.highest) if math.isfinite(limit))]
    for inner_angle in (near[2], inner.lowest, inner.highest):
        if math.isfinite(inner_angle):
            outers.append(same_way * (total - inner_angle))
    return [(angle, middle, total - same_way * angle) for angle in outers]


def _best_turn(axis: Sequence[float], wanted: Array) -> float:
    """Returns the angle of that rotation R about `axis` that is nearest to the rotation `wanted` (with the largest trace of
    Rᵀ·wanted)."""
    unit = np.asarray(axis)
    skew = np.array([wanted[2, 1] - wanted[1, 2], wanted[0, 2] - wanted[2, 0], wanted[1, 0] - wanted[0, 1]])
    return math.atan2(float(unit @ skew), float(np.trace(wanted) - unit @ wanted @ unit))


def _angle_between(axis: Array, start: Array, end: Array) -> float | None:
    """Returns the angle about `axis` that rotates `start` towards `end`; None if one of the vectors is parallel to the axis."""
    a = start - axis * float(axis @ start)
    b = end - axis * float(axis @ end)
    if min(np.linalg.norm(a), np.linalg.norm(b)) < LOCKED:
        return None
    return math.atan2(float(axis @ cross(a, b)), float(a @ b))


def _misalignment(axes: Sequence[TableAxis], angles: Angles, wanted: Array) -> float:
    """Returns the angle [rad] between the rotation of the platform at these joint angles and the rotation `wanted`."""
    off = attitude(axes, angles) @ wanted
    skew = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
    return math.atan2(float(np.linalg.norm(skew)), float(np.trace(off)) - 1.0)


def _place(axis: TableAxis, angle: float, near: float) -> tuple[float, tuple[float, str] | None]:
    """Returns the angle that differs from `angle` by full turns, lies within the limits, and is nearest to `near`. If there is no
    such angle within the limits, also returns the distance to the limits and a text with the reason.

    If two angles are half a turn away, they are equally near. In this case, a continuous axis turns in the positive direction, and
    a limited axis goes to the angle that is nearer to zero. The limited axis goes to this angle even if the other angle is nearer
    to `near` by up to `NEARLY`. If both angles are equally far from zero, the axis goes to the positive one.
    """
    nearest = angle + TURN * math.floor((near - angle + ALIKE) / TURN + 0.5)
    if axis.continuous:
        return nearest, None
    lowest, highest = axis.lowest, axis.highest
    around = (nearest - TURN, nearest, nearest + TURN)
    low = nearest if math.isinf(lowest) else angle + TURN * math.ceil((lowest - SLACK - angle) / TURN)
    high = nearest if math.isinf(highest) else angle + TURN * math.floor((highest + SLACK - angle) / TURN)
    choices = [choice for choice in (*around, low, high) if lowest - SLACK <= choice <= highest + SLACK]
    if choices:
        shortest = min(abs(choice - near) for choice in choices)
        ways = [choice for choice in choices if abs(choice - near) <= shortest + NEARLY]
        zero = min(abs(choice) for choice in ways)
        best = max(choice for choice in ways if abs(choice) <= zero + ALIKE)
        return min(max(best, lowest), highest), None
    central = math.remainder(angle, TURN)
    beyond = max(lowest - central, central - highest)
    return nearest, (
        beyond,
        f"the axis '{axis.name}' would have to be at {math.degrees(central):.4g} deg; {limits_in_words(axis)}",
    )


def limits_in_words(axis: TableAxis) -> str:
    low = "any angle" if math.isinf(axis.lowest) else f"{math.degrees(axis.lowest):g}"
    high = "any angle" if math.isinf(axis.highest) else f"{math.degrees(axis.highest):g} deg"
    return f"the axis can turn only from {low} to {high}"
