"""Pictures of orientations: every cardinal attitude looks different, and arrows point where the axes point."""

from __future__ import annotations

import itertools
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from planrunner.plan.orientation import rotation
from planrunner.reporting.orientations import SIZE, orientation_svg

SVG = "{http://www.w3.org/2000/svg}"
COLOUR = {"x": "#b3261e", "y": "#1b6e3c", "z": "#1c4fa1"}


def cardinal() -> list[np.ndarray]:
    """The 24 right-handed signed permutation matrices."""
    made = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                made.append(matrix)
    return made


def tips(attitude: np.ndarray) -> dict[str, tuple[float, float]]:
    """Where each axis's arrowhead ends, from the picture: the first corner of its polygon."""
    root = ElementTree.fromstring(orientation_svg(attitude))
    found = {}
    for polygon in root.iter(SVG + "polygon"):
        axis = next(name for name, colour in COLOUR.items() if polygon.get("fill") == colour)
        x, y = (polygon.get("points") or "").split()[0].split(",")
        found[axis] = (float(x), float(y))
    return found


def test_the_24_cardinal_attitudes_are_distinguished_by_their_arrows_alone() -> None:
    attitudes = cardinal()
    assert len(attitudes) == 24
    seen = [tips(attitude) for attitude in attitudes]
    assert all(len(one) == 3 for one in seen)
    for one, other in itertools.combinations(seen, 2):
        apart = max(np.hypot(one[axis][0] - other[axis][0], one[axis][1] - other[axis][1]) for axis in "xyz")
        assert apart > 15, (one, other)


def test_arrows_point_where_the_words_say() -> None:
    """Up is straight up in the picture, east to the right, north to the right and up (away); opposites opposite."""
    # x east, y north, z up
    found = tips(np.eye(3))
    centre = (100.0, 102.0)
    east, north, up = (np.subtract(found[axis], centre) for axis in "xyz")
    assert abs(up[0]) < 0.1
    assert up[1] < -40
    assert east[0] > 50
    assert 0 < east[1] < 30
    assert north[0] > 20
    assert north[1] < -20
    turned = tips(np.diag([-1.0, -1.0, 1.0]))
    np.testing.assert_allclose(np.subtract(turned["x"], centre), -east, atol=0.11)
    np.testing.assert_allclose(np.subtract(turned["y"], centre), -north, atol=0.11)


def test_everything_stays_inside_the_picture() -> None:
    for attitude in [*cardinal(), rotation(0, 0.7) @ rotation(1, -0.4)]:
        picture = orientation_svg(attitude)
        for text in ElementTree.fromstring(picture).iter(SVG + "text"):
            assert 5 <= float(text.get("x") or "nan") <= SIZE - 5
            assert 12 <= float(text.get("y") or "nan") <= SIZE - 2


def test_an_axis_seen_end_on_is_a_disc_or_a_cross() -> None:
    picture = orientation_svg(np.eye(3))
    assert 'r="8"' not in picture
    # The eye's direction, from the docstring: south-south-east (28 degrees from south towards east), raised by 30 degrees.
    a, e = np.radians(28), np.radians(30)
    eye = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
    side = np.array([np.cos(a), np.sin(a), 0.0])
    towards = orientation_svg(np.array([eye, side, np.cross(eye, side)]))
    away = orientation_svg(np.array([-eye, -side, np.cross(eye, side)]))
    assert 'r="8"' in towards
    assert 'r="8"' in away
    assert towards.count('r="3"') == 1
    assert away.count('r="3"') == 0
    ElementTree.fromstring(away)


def test_unknown_and_names() -> None:
    picture = orientation_svg(None, "tumble <1>")
    root = ElementTree.fromstring(picture)
    title = root.find(SVG + "title")
    assert title is not None
    assert title.text == "tumble <1>: unknown orientation"
    assert not list(root.iter(SVG + "polygon"))
    assert re.search(r">\?<", picture)


@pytest.mark.parametrize("attitude", cardinal()[:4])
def test_title_says_it_in_words(attitude: np.ndarray) -> None:
    title = ElementTree.fromstring(orientation_svg(attitude)).find(SVG + "title")
    assert title is not None
    assert re.fullmatch(r"x \w+, y \w+, z \w+", title.text or "")
