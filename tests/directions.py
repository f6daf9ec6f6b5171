"""The six directions in east, north, up, for what tests work out by hand: written out here, apart from the package's table."""

from __future__ import annotations

WORDS = {
    "east": (1, 0, 0),
    "west": (-1, 0, 0),
    "north": (0, 1, 0),
    "south": (0, -1, 0),
    "up": (0, 0, 1),
    "down": (0, 0, -1),
}
