"""Defines the words for directions at the site, and their vectors in East-North-Up. A new word is declared only in this module.

Parsing, suggestions, the schemas, the reference of keys, reports and the diagnosis use `DIRECTIONS`, so they need no change for a
new word. Designs and proposals search only among `CARDINAL`, so a new word does not change their choices.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

Direction = tuple[float, float, float]

CARDINAL: dict[str, Direction] = {
    "east": (1.0, 0.0, 0.0),
    "west": (-1.0, 0.0, 0.0),
    "north": (0.0, 1.0, 0.0),
    "south": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
"""The directions along the axes of the site. The attitudes along these directions are the 24 cardinal attitudes of a design."""
DIRECTIONS: dict[str, Direction] = {**CARDINAL}
"""Every word that a plan or a bench file may use, with its unit vector."""
RIGHT_ANGLE = 1e-9
"""Scalar product below which two directions count as perpendicular."""


def word_of(direction: Iterable[float], within: float = 1e-9) -> str | None:
    """Returns the direction word whose vector differs least from a unit vector; None if the vectors of all words differ too much.
    `within`: limit of the length of the difference between the two vectors."""
    given = tuple(direction)
    word, vector = min(DIRECTIONS.items(), key=lambda item: math.dist(item[1], given))
    return word if math.dist(vector, given) < within else None


def perpendicular(first: Direction, second: Direction) -> bool:
    (a, b, c), (x, y, z) = first, second
    return abs(a * x + b * y + c * z) < RIGHT_ANGLE
