"""What is made of recorded segments: stimulus against scipy's rotations, channels, and bad input."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.refusals import ObservationError
from planrunner.observation.samples import observed
from planrunner.observation.surroundings import settled, smoothed
from planrunner.physics.sampled_motion import motion_at
from planrunner.plan.schedule import Motion, Rest, Rock, Segment, Spin
from tests.gap.turntable import DEG, SITE, felt, record

UNITS = {"gyro_x": "deg/s", "accel_z": "g", "table_angle": "deg", "sensor_temperature": "degC"}
SENSOR = SensorModel("imu", (OutputModel("gyro_x", "deg/s", noise=NoiseModel(0.001, 0.0, 0.0005)),), 10.0)


def _segment(index: int, motion: Motion, nan: bool = False, attitude: np.ndarray | None = None) -> RecordedSegment:
    time = 100.0 * index + np.arange(50) / 10
    columns = {
        "gyro_x": np.full(50, 2.0),
        "accel_z": np.full(50, 1.0),
        "table_angle": np.degrees(getattr(motion, "rate", 0.0)) * (time - time[0]) + 40.0,
        "sensor_temperature": 30.0 + 0.02 * (time - time[0]),
    }
    if nan:
        columns["gyro_x"][3] = np.nan

    def blocks(names: Sequence[str]) -> Iterator[Block]:
        yield Block(time, {name: columns[name] for name in names})

    segment = Segment(
        index, f"P{index}", np.eye(3) if attitude is None else attitude, "given", motion, 5.0, temperature=303.15
    )
    return RecordedSegment(segment, UNITS, statistics_of(blocks(tuple(UNITS)), tuple(UNITS), 50), blocks)


def test_stimulus_is_that_of_scipys_rotations() -> None:
    found = record()
    omega, force = felt(found)
    assert found.omega == pytest.approx(omega, abs=1e-12)
    assert found.force == pytest.approx(force, abs=1e-9)


def test_channels_units_encoder_and_thermometer() -> None:
    recording = [_segment(0, Rest()), _segment(1, Spin(9 * DEG)), _segment(2, Rest(), nan=True)]
    found = observed(
        recording, SITE, SENSOR, angle_channel="table_angle", temperature_channel="sensor_temperature", power_on=-600.0
    )
    assert [(c.name, c.kind, c.axis) for c in found.channels] == [("gyro_x", "gyro", 0), ("accel_z", "accel", 2)]
    assert found.channels[0].white == pytest.approx(0.001 * DEG)
    assert found.values[0] == pytest.approx([2 * DEG, 9.80665])
    assert found.rejected == 1
    assert list(np.diff(found.bounds)) == [50, 50, 49]
    assert found.time[0] == 600.0
    assert found.angle[50] == pytest.approx(40 * DEG)
    assert found.angle[60] == pytest.approx(49 * DEG)
    assert found.temperature[10] == pytest.approx(30.02)
    assert found.temperature_rate[10] == pytest.approx(0.02)


def test_bad_recordings_say_what_is_wrong() -> None:
    unknown = _segment(0, Rest())
    with pytest.raises(ObservationError, match="no recorded segments"):
        observed([], SITE, SENSOR)
    with pytest.raises(ObservationError, match="'P0' is unknown"):
        observed([replace(unknown, segment=replace(unknown.segment, attitude=None))], SITE, SENSOR)
    with pytest.raises(ObservationError, match="'P0' rocks several rings at once"):
        observed([_segment(0, Rock(0.1, 1.0, (0.0, 0.5), 5.0))], SITE, SENSOR)
    with pytest.raises(ObservationError, match="no channel 'encoder'"):
        observed([_segment(0, Rest())], SITE, SENSOR, angle_channel="encoder")
    with pytest.raises(ObservationError, match="no channel has a unit of angular rate"):
        observed([replace(unknown, units={"temperature": "degC"})], SITE, SENSOR)


def test_rocking_follows_the_encoder_that_was_late_and_wraps() -> None:
    motion = Rock(5 * DEG, 0.5, (0.0,), 20.0)
    since = np.arange(0, 10, 0.05)
    true = 5 * DEG * np.sin(2 * np.pi * 0.5 * (since - 0.1))
    part = motion_at(motion, since, np.mod(true, 2 * np.pi))
    assert np.angle(np.exp(1j * (part["angle"] - true))) == pytest.approx(0.0, abs=1e-9)
    assert part["rate"] == pytest.approx(5 * DEG * np.pi * np.cos(np.pi * (since - 0.1)), abs=1e-9)


def test_temperature_is_smoothed() -> None:
    time = np.arange(0, 60, 0.1)
    noisy = 20 + 5 * np.exp(-time / 90) + np.random.default_rng(1).normal(0, 0.02, len(time))
    found = smoothed(time, noisy)
    assert found.celsius == pytest.approx(20 + 5 * np.exp(-time / 90), abs=0.01)
    assert found.rate == pytest.approx(-5 / 90 * np.exp(-time / 90), abs=2e-3)
    assert np.isnan(found.uncertainty)


def test_a_long_approach_to_a_setpoint_is_followed_and_a_steady_temperature_is_one() -> None:
    time = np.arange(0, 600, 0.1)
    noise = np.random.default_rng(1).normal(0, 0.02, len(time))
    found = smoothed(time, 20 + 25 * np.exp(-time / 90) + noise)
    assert found.celsius == pytest.approx(20 + 25 * np.exp(-time / 90), abs=0.01)
    still = smoothed(time, 20 + noise)
    assert np.ptp(still.celsius) == 0 and not still.rate.any()
    assert still.celsius[0] == pytest.approx(20 + noise.mean())
    assert still.uncertainty == pytest.approx(0.02 / np.sqrt(len(time)), rel=0.15)
    exact = smoothed(time, np.full(len(time), 20.0))
    assert exact.celsius == pytest.approx(20.0) and exact.uncertainty == pytest.approx(0.0, abs=1e-12)


def test_segments_of_one_setpoint_share_a_temperature_that_the_thermometer_cannot_distinguish() -> None:
    recording = [_segment(index, Rest()) for index in range(3)]
    known = [1e-3, 1e-3, 2e-3]
    for last, expected in ((30.002, (30.001 + 30.003 + 30.002 / 4) / 2.25), (30.02, None)):
        parts = [{"temperature": np.full(5, value)} for value in (30.001, 30.003, last)]
        settled(recording, parts, known)
        found = [float(part["temperature"][0]) for part in parts]
        assert found == pytest.approx([30.001, 30.003, last] if expected is None else [expected] * 3)


def test_segments_stand_in_the_order_of_time() -> None:
    recording = [_segment(0, Rest()), _segment(1, Spin(9 * DEG)), _segment(2, Rest())]
    found, planned_otherwise = (observed(each, SITE, SENSOR) for each in (recording, recording[::-1]))
    assert planned_otherwise.labels == found.labels == ("P0", "P1", "P2")
    assert np.array_equal(planned_otherwise.time, found.time)
    assert np.array_equal(planned_otherwise.bounds, found.bounds)
