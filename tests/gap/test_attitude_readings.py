"""Quaternions of an attitude reference that are read in the wrong way are named; errors of the sensor are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.error_model.observed import Channel, Observed, ObservedSegment, joined
from planrunner.gap.hypotheses.declarations import (
    DECLARED_ORDER,
    REAL_PART_LAST,
    AttitudeReading,
    attitude_read_otherwise,
)
from planrunner.physics.moved_body import by_attitude
from planrunner.plan.schedule import RecordedMotion
from tests.gap.turntable import DEG, SITE, Array

RATE, SECONDS = 20.0, 60.0
EARTH = 15.041067 * DEG / 3600 * np.array([0, np.cos(SITE.latitude), np.sin(SITE.latitude)])


def hand_held(order: tuple[int, int, int, int], conjugate: bool, matrix: Array, seed: int = 4) -> Observed:
    """Six turns by hand, with the rate about each axis as three sines. `order`, `conjugate`: how the reference writes its quaternions:
    component k of the record is component `order[k]` of the attitude, real part first. `matrix`: gains of the gyros."""
    draw = np.random.default_rng(seed)
    segments = []
    for number in range(6):
        time = np.arange(int(RATE * SECONDS)) / RATE
        speed = np.zeros((len(time), 3))
        for _ in range(3):
            phase = 2 * np.pi * draw.uniform(0.05, 0.3, 3) * time[:, None] + draw.uniform(0, 6, 3)
            speed += draw.uniform(10, 40, 3) * np.sin(phase)
        body = Rotation.random(random_state=number)
        turned = [body]
        for step in speed[:-1]:
            body = body * Rotation.from_rotvec(step * DEG / RATE)
            turned.append(body)
        attitude = Rotation.concatenate(turned)
        # A step turns the body between two samples, so the rate at a sample is the mean of the steps before and after it.
        rates = np.vstack([speed[:1], (speed[1:] + speed[:-1]) / 2]) * DEG + attitude.inv().apply(EARTH)
        written = (attitude.inv() if conjugate else attitude).as_quat(scalar_first=True)[:, list(order)]
        course = by_attitude(time, written, SITE)
        values = rates @ matrix.T + draw.normal(0, 0.3 * DEG, rates.shape) + 0.5 * DEG
        zero = np.zeros(len(time))
        motion = RecordedMotion(attitude=("q_w", "q_x", "q_y", "q_z"))
        parts = (time + 100.0 * number, zero, zero, zero, zero + 25.0, zero, values)
        segments.append(ObservedSegment(f"S{number}", motion, np.eye(3), *parts, course=course))
    channels = [Channel(f"gyro_{axis}", "gyro", k, "deg/s", DEG, 0.05 * DEG) for k, axis in enumerate("xyz")]
    return joined(SITE, channels, segments)


ERRORS = np.eye(3) + np.array([[0.02, 0.01, 0.0], [0.0, -0.03, 0.01], [0.0, 0.01, 0.0]])


@pytest.mark.parametrize(("written", "conjugate"), [((0, 1, 2, 3), True), ((1, 2, 3, 0), False)])
def test_quaternions_read_in_the_wrong_way_are_named(written: tuple[int, int, int, int], conjugate: bool) -> None:
    order = DECLARED_ORDER if written[0] == 0 else REAL_PART_LAST
    found = attitude_read_otherwise(hand_held(written, conjugate, ERRORS))
    assert found == AttitudeReading(order, conjugate)


@pytest.mark.parametrize(
    "matrix", [ERRORS, np.diag([1.0, -1.0, 1.0]), -np.eye(3), np.eye(3)[[1, 0, 2]], 57.3 * np.eye(3)]
)
def test_other_mistakes_are_no_other_reading(matrix: Array) -> None:
    assert attitude_read_otherwise(hand_held((0, 1, 2, 3), False, matrix)) is None
