"""Attitude conversions against SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.navigation import attitude


@pytest.mark.parametrize("seed", range(20))
def test_quaternion_and_matrix_are_those_of_scipy(seed: int) -> None:
    rotation = Rotation.random(random_state=seed)
    found = attitude.quaternion(rotation.as_matrix())
    assert np.allclose(attitude.matrix(found), rotation.as_matrix(), atol=1e-14)
    theirs = np.roll(rotation.as_quat(), 1)
    assert np.allclose(found * np.sign(found @ theirs), theirs, atol=1e-14)


@pytest.mark.parametrize("half_turn", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_half_turns(half_turn: tuple[int, int, int]) -> None:
    rotation = Rotation.from_rotvec(np.pi * np.array(half_turn)).as_matrix()
    assert np.allclose(attitude.matrix(attitude.quaternion(rotation)), rotation, atol=1e-15)


def test_heading_pitch_and_roll_have_the_stated_senses() -> None:
    # Nose to the east: heading 90; then nose up 10; then right side down 5.
    heading, pitch, roll = Rotation.from_rotvec([[0, 0, -np.pi / 2], [np.radians(10), 0, 0], [0, np.radians(5), 0]])
    found = np.degrees(attitude.angles((heading * pitch * roll).as_matrix()))
    assert np.allclose(found, [90, 10, 5])
    assert np.allclose((heading * pitch * roll).as_matrix()[:, 1], [np.cos(np.radians(10)), 0, np.sin(np.radians(10))])
    assert (heading * pitch * roll).as_matrix()[2, 0] < 0


def test_sensitivities_of_the_angles_at_level() -> None:
    # A small turn about up takes the nose west of north; about east it lifts the nose; about north it lowers the right side.
    assert np.allclose(attitude.angle_sensitivities(np.eye(3)), [[0, 0, -1], [1, 0, 0], [0, 1, 0]], atol=1e-9)


def test_small_rotation_is_that_of_scipy() -> None:
    for size in (0.0, 1e-9, 0.1, 2.0):
        vector = size * np.array([0.6, -0.48, 0.64])
        assert np.allclose(attitude.small_rotation(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
