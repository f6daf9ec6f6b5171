"""Tilts and attitudes of a stabilised element against hand-worked figures and against quaternions of scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rocking_recordings import ARCSEC, DEG, EARTH, GRAVITY, HORIZONTAL, OMEGA, PER_HOUR, RING_AXES, VERTICAL
from scipy.spatial.transform import Rotation

from planrunner.estimators.rocking.attitude import (
    earth_turn,
    encoder_attitude,
    level_state,
    rotation_vector,
    turned,
    turned_by,
)

X_UP, Y_UP = HORIZONTAL, VERTICAL
Z_UP = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # x north, y west, z up
UP = np.array([0.0, 0.0, 1.0])


def frames(order: str, angles: tuple[float, ...]) -> np.ndarray:
    """R_a(…)·R_b(…)·R_c(…) as a matrix of components: the last letter turns first. A frame's turn is the inverse of a vector's."""
    made = np.eye(3)
    for axis, angle in zip(order, angles, strict=True):
        made = made @ Rotation.from_euler(axis, angle).as_matrix().T
    return made


def known_state(attitude, order):
    state = level_state(attitude, order)
    assert state is not None
    return state


def test_a_frame_turns_as_printed():
    a = 0.3
    printed = np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1]])
    np.testing.assert_allclose(turned(2, a), printed)


@pytest.mark.parametrize(
    ("attitude", "force", "order", "expected"),
    [
        # y up: 0.01 g along x is a turn about z of asin 0.01 = 2062.68 arcsec; −0.02/0.99975 along z one about x of +1.14617 deg
        (Y_UP, (0.01, 0.99975, -0.02), "xzy", (math.atan(0.02 / 0.99975), 2062.6825 * ARCSEC)),
        (Y_UP, (0.01, 0.99975, -0.02), "zxy", (math.asin(0.02), math.atan(0.01 / 0.99975))),
        # x up: d_y = asin(f_z/g)
        (X_UP, (0.99975, 0.02, 0.01), "xzy", (math.asin(0.01), -math.atan(0.02 / 0.99975))),
        # z up: d_y = −asin(f_x/g)
        (Z_UP, (0.01, 0.02, 0.99975), "xzy", (math.atan(0.02 / 0.99975), -math.asin(0.01))),
        # y down: signs change
        (
            np.diag([1.0, -1.0, -1.0]) @ Y_UP,
            (0.01, -0.99975, 0.02),
            "xzy",
            (math.atan(0.02 / 0.99975), -math.asin(0.01)),
        ),
    ],
)
def test_tilts_by_hand(attitude, force, order, expected):
    state = known_state(attitude, order)
    np.testing.assert_allclose(state.tilts(np.array([force]) * GRAVITY, GRAVITY)[0], expected, rtol=1e-6)


@pytest.mark.parametrize("order", ["xzy", "zxy"])
@pytest.mark.parametrize("attitude", [X_UP, Y_UP, Z_UP, np.diag([1.0, -1.0, -1.0]) @ Y_UP])
def test_tilts_undo_the_turns_in_their_order(attitude, order):
    """The gravity of C = R_other·R_sine·R_vertical gives back both tilts exactly, however large, and C gives back the heading."""
    state = known_state(attitude, order)
    letters = "".join("xyz"[axis] for axis in (state.other, state.sine, state.vertical))
    sine, other, heading = 0.11, -0.23, 0.4
    made = frames(letters, (other, sine, heading)) @ attitude
    tilts = state.tilts(GRAVITY * (made @ UP)[None], GRAVITY)[0]
    about = dict(zip(state.level, tilts, strict=True))
    assert about[state.sine] == pytest.approx(sine, abs=1e-12)
    assert about[state.other] == pytest.approx(other, abs=1e-12)
    assert state.heading(made) == pytest.approx(heading, abs=1e-12)
    np.testing.assert_allclose(state.attitude(tilts, heading), made, atol=1e-12)


def test_the_orders_are_those_of_the_method():
    letters = {}
    for order in ("xzy", "zxy"):
        for name, attitude in (("x", X_UP), ("y", Y_UP), ("z", Z_UP)):
            state = known_state(attitude, order)
            letters[order, name] = "".join("xyz"[axis] for axis in (state.other, state.sine, state.vertical))
    assert letters["xzy", "y"] == "xzy"
    assert letters["zxy", "y"] == "zxy"
    assert letters["xzy", "x"] == "zyx"  # d_y = asin(f_z/g)
    assert letters["xzy", "z"] == "xyz"  # d_y = −asin(f_x/g)


def test_no_axis_vertical_is_no_level_state():
    assert level_state(frames("x", (math.radians(30),)) @ Y_UP, "xzy") is None


def test_an_inertially_fixed_element_against_quaternions():
    """C(0)·R(Ω_ie·t) by matrices, and by carrying gravity into an inertial frame and from there into the element by quaternions."""
    times = np.array([0.0, 60.0, 600.0, 3600.0])
    start = Rotation.from_matrix(VERTICAL.T) * Rotation.from_rotvec([0.01, -0.02, 0.005])  # element → site at zero
    by_quaternions = start.inv().apply(Rotation.from_rotvec(np.outer(times, EARTH)).apply(UP))
    ours = start.as_matrix().T @ earth_turn(EARTH, times) @ UP
    np.testing.assert_allclose(ours, by_quaternions, atol=1e-14)


def test_in_ten_minutes_it_tilts_by_nearly_two_degrees():
    """15.041 deg/h · cos 40° · 600 s = 1.92 deg about north."""
    state = known_state(VERTICAL, "xzy")
    tilted = state.tilts(GRAVITY * (VERTICAL @ earth_turn(EARTH, np.array([600.0])) @ UP), GRAVITY)[0]
    assert math.degrees(tilted[0]) == pytest.approx(-15.041067 * math.cos(40 * DEG) / 6, rel=1e-3)
    assert math.degrees(tilted[0]) == pytest.approx(-1.92, abs=0.005)


def test_a_constant_projection_is_wrong_by_eighteen_hundredths_of_a_degree_an_hour():
    """From 60 to 600 s, with the Earth rate at release added as if its projection stayed: by hand Ω_N·Ω_U·(60 + 600)/2 s about east."""
    state = known_state(VERTICAL, "xzy")
    tilts = state.tilts(GRAVITY * (VERTICAL @ earth_turn(EARTH, np.array([60.0, 600.0])) @ UP), GRAVITY)
    left = (tilts[1] - tilts[0]) / 540 + (VERTICAL @ EARTH)[[0, 2]]
    assert np.abs(left).max() / PER_HOUR == pytest.approx(0.18, abs=0.005)
    assert abs(left[1]) == pytest.approx(EARTH[1] * EARTH[2] * 330.0, rel=0.01)


def test_rotation_vectors_go_there_and_back():
    draw = np.random.default_rng(4)
    vectors = draw.uniform(-0.6, 0.6, (200, 3))
    np.testing.assert_allclose(
        turned_by(vectors), np.swapaxes(Rotation.from_rotvec(vectors).as_matrix(), 1, 2), atol=1e-14
    )
    np.testing.assert_allclose(rotation_vector(turned_by(vectors)), vectors, atol=1e-13)
    tiny = np.array([[3e-13, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(rotation_vector(turned_by(tiny)), tiny, atol=1e-16)


def test_rings_and_gimbals_give_the_attitude_of_quaternions():
    draw = np.random.default_rng(5)
    rings, gimbals, azimuth = draw.uniform(-2, 2, (3, 50)), draw.uniform(-0.2, 0.2, (3, 50)), 0.3
    base = Rotation.from_rotvec([0, 0, -azimuth])
    for axis, angle in zip(RING_AXES, rings, strict=True):
        base = base * Rotation.from_rotvec(np.outer(angle, axis))
    element = base * Rotation.from_euler("XYZ", gimbals.T)
    ours = encoder_attitude(list(rings), RING_AXES, azimuth, list(gimbals), (0, 1, 2))
    np.testing.assert_allclose(ours, np.swapaxes(element.as_matrix(), 1, 2), atol=1e-13)


def test_the_earth_of_the_tests_is_that_of_the_method():
    assert pytest.approx(15.041067, rel=1e-7) == OMEGA / PER_HOUR
