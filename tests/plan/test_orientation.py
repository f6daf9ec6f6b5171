"""Orientations against a second formula each: cross products by hand, scipy's rotations, and the patent's printed table."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planrunner.base.findings import Findings
from planrunner.plan.orientation import UNKNOWN, Orientation, OrientationKind
from planrunner.plan.source import parse

# Right-handed when cyclic: east × north = up, north × up = east, up × east = north; a reversal changes the hand.
AXIS_OF = {"east": (0, 1), "west": (0, -1), "north": (1, 1), "south": (1, -1), "up": (2, 1), "down": (2, -1)}
EVEN = {(0, 1, 2), (1, 2, 0), (2, 0, 1)}


def cardinal() -> list[tuple[str, str, str]]:
    words = [("east", "west"), ("north", "south"), ("up", "down")]
    return [(a, b, c) for axes in permutations(words) for a, b, c in product(*axes)]


def right_handed(words: tuple[str, str, str]) -> bool:
    axes, signs = zip(*(AXIS_OF[word] for word in words), strict=True)
    return (1 if tuple(axes) in EVEN else -1) * signs[0] * signs[1] * signs[2] > 0


def read(text: str) -> tuple[Orientation | None, Findings]:
    log = Findings()
    node = parse(f"orientation:\n  {text}\n", "f").get("orientation")
    assert node is not None
    return OrientationKind().read(node, log), log


def test_there_are_24_of_each_hand() -> None:
    assert sum(map(right_handed, cardinal())) == 24
    assert len(cardinal()) == 48


@pytest.mark.parametrize("words", [w for w in cardinal() if right_handed(w)], ids="-".join)
def test_right_handed_words_are_taken(words: tuple[str, str, str]) -> None:
    x, y, z = words
    found, log = read(f"{{x: {x}, y: {y}, z: {z}}}")
    assert not len(log)
    assert found is not None and found.attitude is not None
    attitude = found.attitude
    assert attitude is not None
    for row, word in zip(attitude, words, strict=True):
        axis, sign = AXIS_OF[word]
        assert row[axis] == sign
        assert np.abs(row).sum() == 1
    assert found.text == f"x {x}, y {y}, z {z}"
    # Two axes say the third.
    for text in (f"{{x: {x}, y: {y}}}", f"{{y: {y}, z: {z}}}", f"{{z: {z}, x: {x}}}"):
        short, log = read(text)
        assert short == found
        assert not len(log)


@pytest.mark.parametrize("words", [w for w in cardinal() if not right_handed(w)], ids="-".join)
def test_left_handed_words_are_refused_with_right_handed_ones_named(words: tuple[str, str, str]) -> None:
    x, y, z = words
    found, log = read(f"{{x: {x}, y: {y}, z: {z}}}")
    assert found is None
    (finding,) = log
    assert (finding.code, finding.mark.line, finding.mark.column) == ("meaning-left-handed", 2, 3)
    assert f"x {x}, y {y}, z {z}" in finding.message
    repairs = finding.hint.removeprefix("write for example ").split(" or ")
    assert len(set(repairs)) == 6
    for repair in repairs:
        mended, rest = read(repair)
        assert mended is not None
        assert not len(rest)


def test_the_patents_printed_first_position() -> None:
    _, log = read("{x: up, y: west, z: north}")
    (finding,) = log
    assert finding.code == "meaning-left-handed"
    assert "x × y points south, not north" in finding.message
    assert "{x: up, y: north, z: west}" in finding.hint


@pytest.mark.parametrize(
    ("text", "code", "at"),
    [
        ("{x: up, y: up, z: north}", "meaning-orientation", "up, z"),
        ("{x: up, y: down}", "meaning-orientation", "down"),
        ("{x: upp, y: north}", "form-direction", "upp"),
        ("{x: up, y: 5}", "form-direction", "5"),
        ("{x: up, y: [north]}", "form-direction", "[north"),
        ("{x: up}", "form-orientation", "{x"),
        ("{}", "form-orientation", "{"),
        ("{x: up, y: north, q: west}", "form-unknown-key", "q:"),
        ("{x: up, rotate: [x 30 deg]}", "form-orientation", "x: up"),
        ("{quaternion: [1, 0, 0, 0], x: up}", "form-orientation", "x: up"),
        ("{rotate: [x 30]}", "form-turn", "x 30"),
        ("{rotate: [w 30 deg]}", "form-turn", "w 30"),
        ("{rotate: [x 30 deg ± 1 deg]}", "form-turn", "x 30"),
        ("{rotate: [x 30 s]}", "meaning-dimension", "x 30"),
        ("{rotate: [y 9 deg, x 30 dog]}", "meaning-unit", "x 30"),
        ("{rotate: []}", "form-type", "[]"),
        ("{rotate: x 30 deg}", "form-type", "x 30"),
        ("{from: {x: up, y: north}}", "form-type", "{from"),
        ("{from: unknown, rotate: [x 30 deg]}", "form-type", "unknown"),
        ("{from: {x: up, y: west, z: north}, rotate: [x 30 deg]}", "meaning-left-handed", "{x: up"),
        ("{quaternion: [1, 0, 0]}", "form-quaternion", "[1"),
        ("{quaternion: [1, 0, 0, a]}", "form-quaternion", "[1"),
        ("{quaternion: [0, 0, 0, 0]}", "meaning-quaternion", "[0"),
        ("{quaternion: [.nan, 0, 0, 0]}", "meaning-quaternion", "[.nan"),
        ("{quaternion: [.inf, 0, 0, 0]}", "meaning-quaternion", "[.inf"),
        ("{quaternion: [1e200, 1e200, 0, 0]}", "meaning-quaternion", "[1e200"),
        ("sideways", "form-type", "sideways"),
        ("[x, y]", "form-type", "[x"),
    ],
)
def test_what_is_no_orientation(text: str, code: str, at: str) -> None:
    found, log = read(text)
    assert found is None
    finding = next(iter(log))
    assert (finding.code, finding.mark.line, finding.mark.column) == (code, 2, text.index(at) + 3)
    assert finding.hint


def test_every_wrong_direction_is_named() -> None:
    _, log = read("{x: upp, y: nort, z: wast}")
    assert [finding.hint for finding in log] == ["did you mean 'up'?", "did you mean 'north'?", "did you mean 'west'?"]


def test_unknown_is_an_orientation() -> None:
    found, log = read("unknown")
    assert found is UNKNOWN
    assert found.attitude is None
    assert not len(log)


angles = st.floats(-720, 720).map(lambda value: round(value, 3))


@given(
    st.lists(st.tuples(st.sampled_from("xyz"), angles), min_size=1, max_size=5),
    st.sampled_from(list(filter(right_handed, cardinal()))),
)
def test_turns_agree_with_scipy(turns: list[tuple[str, float]], words: tuple[str, str, str]) -> None:
    """Turning a body about its own axes, one after the other, is scipy's intrinsic sequence (capital letters)."""
    x, y, z = words
    listed = ", ".join(f"{axis} {angle} deg" for axis, angle in turns)
    found, log = read(f"{{from: {{x: {x}, y: {y}, z: {z}}}, rotate: [{listed}]}}")
    assert not len(log)
    assert found is not None and found.attitude is not None
    start, _ = read(f"{{x: {x}, y: {y}, z: {z}}}")
    assert start is not None and start.attitude is not None
    body = Rotation.from_matrix(start.attitude.T)
    for axis, angle in turns:
        body = body * Rotation.from_euler(axis.upper(), angle, degrees=True)
    np.testing.assert_allclose(found.attitude, body.as_matrix().T, atol=1e-12)


@given(
    st.tuples(*[st.floats(-1, 1).map(lambda value: round(value, 6))] * 4).filter(lambda q: sum(v * v for v in q) > 1e-3)
)
def test_quaternions_agree_with_scipy(numbers: tuple[float, ...]) -> None:
    found, log = read(f"{{quaternion: [{', '.join(map(str, numbers))}]}}")
    assert not len(log)
    assert found is not None and found.attitude is not None
    w, x, y, z = numbers
    # scipy's matrix of the sensor's rotation has the sensor's axes as columns; ours has them as rows.
    np.testing.assert_allclose(found.attitude, Rotation.from_quat([x, y, z, w]).as_matrix().T, atol=1e-12)


def test_a_turn_by_hand() -> None:
    """A sensor with z up, turned by +90° about its z: x, which pointed east, points north."""
    found, _ = read("{rotate: [z 90 deg]}")
    assert found is not None and found.attitude is not None
    np.testing.assert_allclose(found.attitude, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
