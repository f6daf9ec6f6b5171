"""Rewrites orientations, dwells, moves or rates in the text of a plan. Only the rewritten values change; comments and layout are
preserved.

An orientation is written as the nearest orientation in words, followed by turns about the sensor's axes, so that a reviewer can
picture the orientation.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import yaml
from numpy.typing import NDArray

from planrunner.plan.directions import CARDINAL
from planrunner.plan.orientation import AXES, as_mapping, rotation

Matrix = NDArray[np.float64]

MOVES_A_LINE = 8
DECIMALS = 2  # decimals of turns in degrees: 0.005 deg is 18 arcsec, a second-order effect near an optimum


class RewriteError(ValueError):
    """Reports that a plan states the value in a form that cannot be rewritten. The message gives the position and the remedy."""


@functools.cache
def cardinal_orientations() -> tuple[Matrix, ...]:
    """Returns the 24 right-handed attitudes with axes parallel to the site's axes. Each attitude is a matrix whose rows are the
    sensor's axes in East-North-Up."""
    found = []
    for first, second in itertools.permutations(CARDINAL.values(), 2):
        if np.dot(first, second) == 0:
            attitude = np.array([first, second, np.cross(first, second)], dtype=float)
            attitude.setflags(write=False)
            found.append(attitude)
    return tuple(found)


def orientation_text(attitude: Matrix, decimals: int = DECIMALS) -> str:
    """Returns the text with which a plan states the orientation. If the axes are cardinal, the text contains only words. Otherwise,
    it gives the nearest cardinal orientation in words, followed by the turns about x, y and z (in this order) that lead from there
    to the orientation. `decimals`: largest number of decimals of an angle in degrees."""
    start = max(cardinal_orientations(), key=lambda words: float(np.sum(words * attitude)))
    turns = [
        f"{axis} {_degrees(angle, decimals)} deg"
        for axis, angle in zip(AXES, _turns(start, attitude), strict=True)
        if round(angle, decimals) != 0
    ]
    words = as_mapping(start)
    assert words is not None  # cardinal
    return f"{{from: {words}, rotate: [{', '.join(turns)}]}}" if turns else words


def as_written(attitude: Matrix, decimals: int = DECIMALS) -> Matrix:
    """Returns the attitude that the text from `orientation_text` describes, with its rounded angles."""
    start = max(cardinal_orientations(), key=lambda words: float(np.sum(words * attitude)))
    result = start
    for axis, angle in enumerate(_turns(start, attitude)):
        result = rotation(axis, math.radians(round(angle, decimals))) @ result
    return result


def _turns(start: Matrix, end: Matrix) -> tuple[float, float, float]:
    """Returns the angles [deg] of successive rotations about x, y, z that lead from `start` to `end`.

    With passive rotations, end·startᵀ = Z·Y·X. The transpose of this matrix is therefore the product of the active rotations about
    x, y and z.
    """
    turned = start @ end.T
    y = math.asin(min(1.0, max(-1.0, float(turned[0, 2]))))
    x = math.atan2(-float(turned[1, 2]), float(turned[2, 2]))
    z = math.atan2(-float(turned[0, 1]), float(turned[0, 0]))
    return math.degrees(x), math.degrees(y), math.degrees(z)


def _degrees(angle: float, decimals: int) -> str:
    """Writes an angle with two decimals, and with further decimals only if they are not zero."""
    text = f"{round(angle, decimals):.{decimals}f}"
    return text[: len(text) - decimals + DECIMALS] + text[len(text) - decimals + DECIMALS :].rstrip("0")


def with_orientations(text: str, replacements: Mapping[tuple[int, int], str]) -> str:
    """Replaces the orientations that begin at the given positions, and returns the new text. `replacements`: maps each position
    (line, column) to the new orientation. Lines and columns count from 1. Raises `RewriteError` if no orientation begins at one of
    these positions."""
    spans = []
    known = {(node.start_mark.line + 1, node.start_mark.column + 1): node for node in _mappings(yaml.compose(text))}
    for place, new in replacements.items():
        if place not in known:
            raise RewriteError(
                f"line {place[0]}: no orientation is written here; write it as {{x: up, y: north, z: west}}"
            )
        node = known[place]
        begin, end = node.start_mark.index, node.end_mark.index
        spans.append((begin, begin + len(text[begin:end].rstrip()), new))
    for begin, end, new in sorted(spans, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def with_dwells(text: str, dwells: Mapping[tuple[int, int], str], orientations: Mapping[tuple[int, int], str]) -> str:
    """Splits sweeps over orientations into separate segments, each with its own dwell, and returns the new text.

    `dwells`, `orientations`: map the (line, column) where an orientation begins to its new dwell, or to the new orientation. A
    dwell or orientation that is not in these maps stays unchanged. Raises `RewriteError` if an orientation in `dwells` is not
    written in a sweep of this kind.
    """
    left = dict(dwells)
    spans = []
    root = yaml.compose(text)
    listed = _child(root, "segments")
    for item in listed.value if isinstance(listed, yaml.SequenceNode) else ():
        if not isinstance(item, yaml.MappingNode):
            continue
        named = {key.value: value for key, value in item.value}
        swept = _child(item, "for_each")
        if not isinstance(swept, yaml.MappingNode):
            continue
        only = set(named) == {"for_each"} and [key.value for key, _ in swept.value] == ["orientation"]
        if only and isinstance(swept.value[0][1], yaml.MappingNode):
            rows = swept.value[0][1].value
            places = [(node.start_mark.line + 1, node.start_mark.column + 1) for _, node in rows]
            if not set(places) & set(left):
                continue
            lines = [
                f"{{label: {key.value}, orientation: {orientations.get(place) or _of(text, node)}{_dwell(left.pop(place, None))}}}"
                for (key, node), place in zip(rows, places, strict=True)
            ]
            begin, end = item.start_mark.index, item.end_mark.index
            joint = "\n" + " " * (item.start_mark.column - 2) + "- "
            spans.append((begin, begin + len(text[begin:end].rstrip()), joint.join(lines)))
    if left:
        raise RewriteError(
            f"line {min(left)[0]}: a separate dwell cannot be written here; write the positions as "
            "`- for_each: {orientation: {P1: …, P2: …}}` with nothing else in that entry"
        )
    for begin, end, new in sorted(spans, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def with_moves(text: str, place: tuple[int, int], moves: Sequence[str]) -> str:
    """Replaces the list of moves that begins at `place` (line, column), and returns the new text. Lines and columns count from 1.
    Raises `RewriteError` if no list of moves begins there."""
    for node in _sequences(yaml.compose(text)):
        if (node.start_mark.line + 1, node.start_mark.column + 1) == place and node.value:
            break
    else:
        raise RewriteError(f"line {place[0]}: no moves are written here; write them as `moves: [A +180 C, C -180 A]`")
    rows = [", ".join(moves[first : first + MOVES_A_LINE]) for first in range(0, len(moves), MOVES_A_LINE)]
    joint = ",\n" + " " * (node.start_mark.column + 1)
    # A block list ends with its last entry; a comment may follow.
    end = node.end_mark.index if node.flow_style else node.value[-1].end_mark.index
    return text[: node.start_mark.index] + "[" + joint.join(rows) + "]" + text[end:]


def with_rates(text: str, place: tuple[int, int], rates: Sequence[str], turns: Sequence[int] | None = None) -> str:
    """Replaces the rates of the sweep that begins at `place` (line, column), and returns the new text. Lines and columns count from
    1.

    `turns`: the dwell for each rate, in whole turns; if given, the segment with the sweep is replaced by one segment for each rate.
    Raises `RewriteError` if no sweep begins there.
    """
    for item in _mappings(yaml.compose(text)):
        node = _child(_child(item, "for_each"), "rate")
        if node is not None and (node.start_mark.line + 1, node.start_mark.column + 1) == place:
            break
    else:
        raise RewriteError(f"line {place[0]}: no sweep over rates is written here; write it as `for_each: {{rate: …}}`")
    begin, end = item.start_mark.index, item.end_mark.index
    end = begin + len(text[begin:end].rstrip())
    if turns is None:
        written = _changed(text, begin, end, [(node, f'"{", ".join(rates)}"')])
    else:
        dwell = _child(item, "dwell")
        copies = []
        for rate, count in zip(rates, turns, strict=True):
            changes = [(node, f'"{rate}"')] + ([(dwell, f"{{turns: {count}}}")] if dwell is not None else [])
            copy = _changed(text, begin, end, changes)
            if dwell is None:
                copy = _with_key(copy, f"dwell: {{turns: {count}}}", item)
            copies.append(copy)
        written = ("\n" + " " * (item.start_mark.column - 2) + "- ").join(copies)
    return text[:begin] + written + text[end:]


def appended(text: str, node: yaml.CollectionNode, more: str, last: yaml.Node, dash: str = "") -> tuple[int, str]:
    """Prepares appending an item to a mapping or list. Returns the position in the text at which the item must be inserted, and the
    text to insert."""
    begin = node.start_mark.index
    end = begin + len(text[begin : last.end_mark.index].rstrip())
    if node.flow_style:
        return end, f", {more}"
    return end, "\n" + " " * node.start_mark.column + dash + more


def _changed(text: str, begin: int, end: int, changes: Sequence[tuple[yaml.Node, str]]) -> str:
    """Returns the part of the text from `begin` to `end`, with the nodes in `changes` replaced."""
    part = text[begin:end]
    for node, new in sorted(changes, key=lambda change: -change[0].start_mark.index):
        first, last = node.start_mark.index - begin, node.end_mark.index - begin
        last = first + len(part[first:last].rstrip())
        part = part[:first] + new + part[last:]
    return part


def _with_key(part: str, entry: str, item: yaml.Node) -> str:
    """Returns the text of a mapping after one more key has been added."""
    if isinstance(item, yaml.MappingNode) and item.flow_style:
        return part.rstrip().removesuffix("}").rstrip() + f", {entry}}}"
    return part + "\n" + " " * item.start_mark.column + entry


def _of(text: str, node: yaml.Node) -> str:
    return " ".join(text[node.start_mark.index : node.end_mark.index].split())


def _dwell(given: str | None) -> str:
    return "" if given is None else f", dwell: {given}"


def _child(node: yaml.Node | None, name: str) -> yaml.Node | None:
    pairs: Sequence[tuple[yaml.Node, yaml.Node]] = node.value if isinstance(node, yaml.MappingNode) else ()
    return next((value for key, value in pairs if key.value == name), None)


def _mappings(root: yaml.Node | None) -> Iterator[yaml.Node]:
    return (node for node in _collections(root) if isinstance(node, yaml.MappingNode))


def _sequences(root: yaml.Node | None) -> Iterator[yaml.SequenceNode]:
    return (node for node in _collections(root) if isinstance(node, yaml.SequenceNode))


def _collections(root: yaml.Node | None) -> Iterator[yaml.Node]:
    """Yields every mapping and every sequence once, even if aliases refer to it."""
    waiting, seen = [root], set()
    while waiting:
        node = waiting.pop()
        if node is None or id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode | yaml.SequenceNode):
            yield node
        if isinstance(node, yaml.MappingNode):
            waiting += [value for _, value in node.value]
        elif isinstance(node, yaml.SequenceNode):
            waiting += node.value
