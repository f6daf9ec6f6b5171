"""Draws pictures of orientations: the sensor's axes in the site's East-North-Up frame, as inline SVG.

The viewpoint is south-south-east of the sensor and above it, so that east points right, north points away from the viewer, and up
points upwards. In this view, no two of the six cardinal directions coincide. Axes towards the viewer are drawn over axes pointing
away.
"""

from __future__ import annotations

import math
from html import escape
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.plan.orientation import AXES, in_words

SIZE = 200  # user units, square
_REACH = 70.0  # length of a sensor axis
_CENTRE = (100.0, 102.0)
_TURN, _RAISE = math.radians(28), math.radians(30)
_RIGHT = np.array([math.cos(_TURN), math.sin(_TURN), 0.0])
_FORWARD = np.array([-math.sin(_TURN), math.cos(_TURN), 0.0])
_UPWARD = math.sin(_RAISE) * _FORWARD + math.cos(_RAISE) * np.array([0.0, 0.0, 1.0])
_TOWARDS = -math.cos(_RAISE) * _FORWARD + math.sin(_RAISE) * np.array([0.0, 0.0, 1.0])
_COLOURS = {"x": "#b3261e", "y": "#1b6e3c", "z": "#1c4fa1"}


def project(direction: Array) -> tuple[float, float]:
    """Returns the picture coordinates (right, down) of a vector (3,) in East-North-Up. A vector of length one has the length of a
    drawn axis."""
    right, upward = float(_RIGHT @ direction), float(_UPWARD @ direction)
    return _CENTRE[0] + _REACH * right, _CENTRE[1] - _REACH * upward


def orientation_svg(attitude: Array | None, name: str = "") -> str:
    """Returns the picture as an `<svg>` element with a title for screen readers.

    `attitude`: shape (3, 3), whose rows are the sensor's x, y, z axes in East-North-Up; None draws the frame with a question mark.
    """
    words = "unknown orientation" if attitude is None else in_words(np.asarray(attitude, dtype=float))
    title = f"{name}: {words}" if name else words
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="orientation" viewBox="0 0 {SIZE} {SIZE}" role="img" '
        f'font-family="sans-serif"><title>{escape(title)}</title>'
    ]
    parts += _site_frame()
    if attitude is None:
        parts.append(_text(_CENTRE[0], _CENTRE[1] + 12, "?", "#444", 40))
    else:
        rows = [(axis, np.asarray(row, dtype=float)) for axis, row in zip(AXES, attitude, strict=True)]
        for axis, row in sorted(rows, key=lambda item: float(_TOWARDS @ item[1])):
            parts += _arrow(axis, row)
        parts.append(f'<circle cx="{_CENTRE[0]:g}" cy="{_CENTRE[1]:g}" r="3.2" fill="#222"/>')
    parts.append("</svg>")
    return "".join(parts)


def _site_frame() -> list[str]:
    """Draws a plumb line, and the horizon as a disc with the names of the four directions."""
    turns = np.linspace(0, 2 * math.pi, 49)
    ring = [project(1.0 * np.array([math.cos(t), math.sin(t), 0.0])) for t in turns]
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in ring[:-1]) + "Z"
    parts = [f'<path d="{path}" fill="#f3f5f7" stroke="#b6bec6" stroke-width="1"/>']
    for ends in (((-1, 0, 0), (1, 0, 0)), ((0, -1, 0), (0, 1, 0)), ((0, 0, -1.12), (0, 0, 1.12))):
        (x1, y1), (x2, y2) = (project(np.array(end, dtype=float)) for end in ends)
        parts.append(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
            f'stroke="#b6bec6" stroke-width="1" stroke-dasharray="3 3"/>'
        )
    for name, way in (("E", (1, 0, 0)), ("W", (-1, 0, 0)), ("N", (0, 1, 0)), ("S", (0, -1, 0)), ("Up", (0, 0, 1))):
        x, y = _beyond(project(np.array(way, dtype=float)), 26)
        parts.append(_text(x, y + 4, name, "#5a646e", 13))
    return parts


def _beyond(tip: tuple[float, float], by: float) -> tuple[float, float]:
    """Returns the point of the picture that lies `by` units beyond the tip of an axis, seen from the centre."""
    right, down = tip[0] - _CENTRE[0], tip[1] - _CENTRE[1]
    scale = 1 + by / math.hypot(right, down)
    return _CENTRE[0] + scale * right, _CENTRE[1] + scale * down


def _arrow(axis: str, direction: Array) -> list[str]:
    """Draws one sensor axis. Axes pointing away from the viewer are drawn thinner."""
    towards = float(_TOWARDS @ direction)
    width = 3.4 + 1.2 * towards
    (x0, y0), (x1, y1) = project(np.zeros(3)), project(direction)
    length = math.hypot(x1 - x0, y1 - y0)
    colour = _COLOURS[axis]
    if length < 6:  # seen end-on: a disc for the tip of an arrow, a cross for its tail
        return [*_end_on(towards > 0, colour), _text(x0 + 13, y0 - 9, axis, colour, 17, bold=True)]
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    head = min(13.0, length / 2)
    bx, by = x1 - head * ux, y1 - head * uy
    half = head * 0.42
    corners = ((x1, y1), (bx - half * uy, by + half * ux), (bx + half * uy, by - half * ux))
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    lx, ly = _beyond((x1, y1), 10)
    return [
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{bx:.1f}" y2="{by:.1f}" stroke="{colour}" stroke-width="{width:.1f}"/>',
        f'<polygon points="{points}" fill="{colour}"/>',
        _text(lx, ly + 5, axis, colour, 17, bold=True),
    ]


def _end_on(towards: bool, colour: str) -> list[str]:
    x, y = _CENTRE
    ring = f'<circle cx="{x:g}" cy="{y:g}" r="8" fill="#fff" stroke="{colour}" stroke-width="2.5"/>'
    if towards:
        return [ring, f'<circle cx="{x:g}" cy="{y:g}" r="3" fill="{colour}"/>']
    corners = [(x - 5, y - 5), (x + 5, y + 5), (x - 5, y + 5), (x + 5, y - 5)]
    strokes = [
        f'<line x1="{a[0]:g}" y1="{a[1]:g}" x2="{b[0]:g}" y2="{b[1]:g}" stroke="{colour}" stroke-width="2"/>'
        for index, (a, b) in enumerate(pairwise(corners))
        if index % 2 == 0
    ]
    return [ring, *strokes]


def _text(x: float, y: float, words: str, colour: str, size: float, bold: bool = False) -> str:
    weight = ' font-weight="700"' if bold else ""
    halo = ' stroke="#fff" stroke-width="3" paint-order="stroke" stroke-linejoin="round"'
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="middle" fill="{colour}"{weight}{halo}>'
        f"{escape(words)}</text>"
    )
