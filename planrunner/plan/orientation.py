"""Describes orientations: directions of the sensor's axes at the site, in words or as rotations.

{x: up, y: north, z: west}                       words, at least two axes
{from: {x: up, y: north}, rotate: [x 30 deg, z -45 deg]}   then turned about its own axes, in order
{quaternion: [w, x, y, z]}                       of the rotation that takes site (ENU) components to sensor components
unknown                                          found in the data
"""

from __future__ import annotations

import math
import re
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, closest
from planrunner.plan.directions import DIRECTIONS, Direction, perpendicular, word_of
from planrunner.plan.quantity import PLAIN, QuantityError, anchored, parse_quantity
from planrunner.plan.source import Mapping, Node, Scalar, Sequence, Written

Matrix = NDArray[np.float64]

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Orientation:
    """An orientation. `text`: the orientation in words, for reviewers. `matrix`: shape (3, 3) as nested tuples, whose rows are the
    sensor's axes in East-North-Up; None if the orientation is unknown."""

    text: str
    matrix: tuple[tuple[float, ...], ...] | None

    @property
    def attitude(self) -> Matrix | None:
        """Returns the matrix as an array, which is read-only because segments share it; None for an unknown orientation."""
        return None if self.matrix is None else _array(self.matrix)


@lru_cache(maxsize=4096)
def _array(matrix: tuple[tuple[float, ...], ...]) -> Matrix:
    array = np.array(matrix, dtype=float)
    array.flags.writeable = False
    return array


UNKNOWN = Orientation("unknown", None)


def in_words(attitude: Matrix) -> str:
    """Writes the orientation in words, such as `x up, y north, z west`. If there is no word for the direction of an axis, the
    direction is given as numbers."""
    return ", ".join(f"{axis} {_pointing(row)}" for axis, row in zip(AXES, attitude, strict=True))


def as_mapping(attitude: Matrix) -> str | None:
    """Returns the orientation as a plan states it, such as `{x: up, y: north, z: west}`; None if an axis points in a direction
    without a word."""
    words = [word_of(row) for row in attitude]
    return (
        None
        if None in words
        else "{" + ", ".join(f"{axis}: {word}" for axis, word in zip(AXES, words, strict=True)) + "}"
    )


def _pointing(row: Matrix | Direction) -> str:
    return word_of(row) or f"({row[0]:+.3f} E, {row[1]:+.3f} N, {row[2]:+.3f} U)"


def rotation(axis: int, angle: float) -> Matrix:
    """Returns the matrix R of a rotation by `angle` [rad] about the sensor's axis 0, 1 or 2. The matrix converts components in the
    old axes to components in the rotated axes: v_new = R @ v_old."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result = np.eye(3)
    result[i, i] = result[j, j] = c
    result[i, j], result[j, i] = s, -s
    return result


class OrientationKind:
    """Reads the orientations in a plan (see `planrunner.plan.kinds`)."""

    def read(self, node: Node, log: Findings) -> Orientation | None:
        if isinstance(node, Scalar):
            if node.value == "unknown":
                return UNKNOWN
            log.error(
                "form-type",
                node.mark,
                f"'{node.text[:40]}' is not an orientation",
                "write {x: up, y: north, z: west}, or unknown",
            )
            return None
        if not isinstance(node, Mapping):
            log.error(
                "form-type", node.mark, "an orientation is a mapping, not a list", "write {x: up, y: north, z: west}"
            )
            return None
        words = [(key.text, item.value) for key, item in node.entries if isinstance(item, Scalar)]
        if len(words) == len(node.entries) and (sound := _sound(tuple(words))) is not None:
            return sound
        names = {key.text for key, _ in node.entries}
        known = (*AXES, *_TURNED, "quaternion")
        unknown = [key for key, _ in node.entries if key.text not in known]
        for key in unknown:
            log.error("form-unknown-key", key.mark, f"unknown key '{key.text[:60]}'", closest(key.text, known))
        if unknown:
            return None
        if "quaternion" in names:
            return _read_quaternion(node, log) if self._only(node, ("quaternion",), log) else None
        if names & set(_TURNED):
            return _read_rotated(node, log) if self._only(node, _TURNED, log) else None
        return _read_words(node, log)

    def _only(self, node: Mapping, allowed: tuple[str, ...], log: Findings) -> bool:
        other = next((key for key, _ in node.entries if key.text not in allowed), None)
        if other is None:
            return True
        hint = (
            "put the axes under 'from': {from: {x: up, y: north}, rotate: [x 30 deg]}"
            if other.text in AXES
            else f"remove '{other.text}'"
        )
        log.error("form-orientation", other.mark, f"'{other.text}' cannot be used together with '{allowed[-1]}'", hint)
        return False

    def schema(self) -> dict[str, object]:
        axes = {
            axis: {
                "description": f"Where the sensor's {axis} axis points.",
                "examples": [word],
                "enum": list(DIRECTIONS),
            }
            for axis, word in zip(AXES, ("up", "north", "west"), strict=True)
        }
        words = {"type": "object", "properties": axes, "additionalProperties": False, "minProperties": 2}
        turned = {
            "type": "object",
            "properties": {
                "from": {
                    "description": "Orientation to start from; by default x east, y north, z up.",
                    "examples": [{"x": "up", "y": "north"}],
                    **words,
                },
                "rotate": {
                    "description": "Turns about the sensor's own axes, one after the other.",
                    "examples": [["x 30 deg", "z -45 deg"]],
                    "type": "array",
                    "minItems": 1,
                    "items": {"type": "string", "maxLength": 200, "pattern": anchored(f"[xyz] {PLAIN}")},
                },
            },
            "required": ["rotate"],
            "additionalProperties": False,
        }
        numbers = {
            "type": "object",
            "properties": {
                "quaternion": {
                    "description": "[w, x, y, z] of the rotation from site (ENU) to sensor components; need not be "
                    "normalised.",
                    "examples": [[1, 0, 0, 0]],
                    "type": "array",
                    "minItems": 4,
                    "maxItems": 4,
                    "items": {"type": "number"},
                }
            },
            "required": ["quaternion"],
            "additionalProperties": False,
        }
        return {"anyOf": [{"const": "unknown"}, words, turned, numbers]}


_TURNED = ("from", "rotate")


@lru_cache(maxsize=1024)
def _sound(words: tuple[tuple[str, object], ...]) -> Orientation | None:
    """Returns the orientation that these words describe. Returns None if they do not describe a valid orientation."""
    nowhere = Written("")
    entries = [(Scalar(key, key, nowhere), Scalar(str(word), str(word), nowhere)) for key, word in words]
    return _read_words(Mapping(tuple(entries), nowhere), Findings())


def _read_words(node: Mapping, log: Findings) -> Orientation | None:
    given: dict[str, Direction] = {}
    before = log.raised
    for key, item in node.entries:
        word = item.value if isinstance(item, Scalar) else None
        if key.text not in AXES:
            log.error("form-unknown-key", key.mark, f"unknown key '{key.text[:60]}'", closest(key.text, AXES))
        elif not isinstance(word, str) or word not in DIRECTIONS:
            text = item.text[:40] if isinstance(item, Scalar) else ""
            shown = f"'{text}' is not a direction" if text else "a direction is expected here"
            log.error(
                "form-direction",
                item.mark,
                shown,
                closest(text, DIRECTIONS) if text else f"one of {', '.join(DIRECTIONS)}",
            )
        else:
            given[key.text] = DIRECTIONS[word]
    if log.raised > before:
        return None
    if len(given) < 2:
        log.error(
            "form-orientation", node.mark, "an orientation needs at least two axes", "write {x: up, y: north, z: west}"
        )
        return None
    for first, second in combinations(given, 2):
        if not perpendicular(given[first], given[second]):
            opposite = tuple(-value for value in given[second])
            what = {given[second]: "point the same way", opposite: "are opposite each other"}
            shown = what.get(given[first], "are not at right angles")
            words = ", ".join(f"{axis} {_pointing(given[axis])}" for axis in (first, second))
            message = f"{first} and {second} {shown} ({words})"
            at = next(item.mark for key, item in node.entries if key.text == second)
            log.error("meaning-orientation", at, message, "the three axes must be at right angles to each other")
            return None
    return _right_handed(given, node, log)


def _right_handed(given: dict[str, Direction], node: Mapping, log: Findings) -> Orientation | None:
    matrix, text, handed = _completed(tuple(given.items()))
    if not handed:
        axes = np.array(matrix)
        third = _pointing(np.cross(axes[0], axes[1]))
        message = f"left-handed axes ({text}): x × y points {third}, not {_pointing(axes[2])}"
        log.error("meaning-left-handed", node.mark, message, "write for example " + " or ".join(_repairs(axes)))
        return None
    return Orientation(text, matrix)


@lru_cache(maxsize=256)
def _completed(given: tuple[tuple[str, Direction], ...]) -> tuple[tuple[tuple[float, ...], ...], str, bool]:
    """Completes two or three given perpendicular axes to three axes. Returns the axes as rows in East-North-Up, the axes in words,
    and True if they are right-handed."""
    known = dict(given)
    rows = [np.array(known[axis], dtype=float) if axis in known else None for axis in AXES]
    for index in range(3):
        if rows[index] is None:
            rows[index] = np.cross(rows[(index + 1) % 3], rows[(index + 2) % 3])  # type: ignore[arg-type]
    matrix = np.array(rows) + 0.0  # no negative zeros
    return tuple(map(tuple, matrix.tolist())), in_words(matrix), bool(np.linalg.det(matrix) > 0)


def _repairs(matrix: Matrix) -> list[str]:
    """Returns, in words, the right-handed orientations that result if two axes of a left-handed `matrix` are exchanged or one axis
    is reversed."""
    repairs = []
    for i, j in ((1, 2), (0, 1), (0, 2)):
        swapped = matrix.copy()
        swapped[[i, j]] = swapped[[j, i]]
        repairs.append(swapped)
    for i in (2, 1, 0):
        flipped = matrix.copy()
        flipped[i] = -flipped[i]
        repairs.append(flipped)
    return [text for text in map(as_mapping, repairs) if text is not None]


_TURN = rf"([xyz]) ({PLAIN})"  # compiled where a plan has one: that takes milliseconds


def _read_rotated(node: Mapping, log: Findings) -> Orientation | None:
    start, turns = node.get("from"), node.get("rotate")
    before = log.raised
    matrix, text = np.eye(3), "x east, y north, z up"
    if start is not None:
        base = _read_words(start, log) if isinstance(start, Mapping) else None
        if base is not None:
            matrix, text = np.array(base.matrix), base.text
        elif not isinstance(start, Mapping):
            log.error("form-type", start.mark, "axes as words are expected here", "write {x: up, y: north, z: west}")
    if not isinstance(turns, Sequence) or not turns.items:
        at = turns.mark if turns else node.mark
        log.error("form-type", at, "a list of turns is expected in 'rotate'", "write rotate: [x 30 deg, z -45 deg]")
        return None
    for turn in turns.items:
        match = (
            re.fullmatch(_TURN, turn.value)
            if isinstance(turn, Scalar) and isinstance(turn.value, str) and len(turn.value) <= 200
            else None
        )
        if not match:
            shown = f"'{turn.text[:40]}' is not a turn: " if isinstance(turn, Scalar) else ""
            log.error(
                "form-turn",
                turn.mark,
                f"{shown}a turn is an axis of the sensor and an angle",
                "write for example x 30 deg",
            )
            continue
        try:
            angle = parse_quantity(match[2], "angle")
        except QuantityError as error:
            log.error(error.code, turn.mark, str(error), error.hint)
            continue
        matrix = rotation(AXES.index(match[1]), angle.value) @ matrix
        text += f", then {match[1]} {angle}"
    return Orientation(text, tuple(map(tuple, matrix.tolist()))) if log.raised == before else None


def _read_quaternion(node: Mapping, log: Findings) -> Orientation | None:
    numbers = node.get("quaternion")
    items = numbers.items if isinstance(numbers, Sequence) else ()
    values = [item.value for item in items if isinstance(item, Scalar)]
    at = numbers.mark if numbers else node.mark
    if (
        len(items) != 4
        or len(values) != 4
        or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values)
    ):
        log.error(
            "form-quaternion",
            at,
            "a quaternion is a list of four numbers [w, x, y, z]",
            "write for example [1, 0, 0, 0]",
        )
        return None
    norm = math.hypot(*(float(v) for v in values))  # type: ignore[arg-type]
    if not 1e-6 < norm < 1e6:
        message = "this quaternion has no direction: its length is zero, infinite, or far too large or too small"
        log.error("meaning-quaternion", at, message, "write for example [1, 0, 0, 0]")
        return None
    w, x, y, z = (float(v) / norm for v in values)  # type: ignore[arg-type]
    matrix = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
        ]
    )
    return Orientation(in_words(matrix), tuple(map(tuple, matrix.tolist())))
