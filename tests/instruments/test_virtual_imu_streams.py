"""Streams of the virtual inertial sensor: blocks, time, reference channels, and the same bits after a restart."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from inertial_bench import DEG, LEVEL, TRIAD, InertialBench
from test_virtual_imu import X_UP

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.virtual.streaming import BLOCK
from planrunner.plan.schedule import Cycle, Move, Rest, Rock, Spin

NOISY = """
gyros: {angle_random_walk: 0.01 deg/sqrt(h), bias_instability: 0.1 deg/h, rate_random_walk: 0.1 deg/h/sqrt(h), resolution: 0.1 arcsec,
  bias_repeatability: 1 deg/h, warm_up: 1 deg/h, axes: {x: {}, y: {}, z: {scale_factor_error: 100 ppm}}}
accelerometers: {velocity_random_walk: 0.01 m/s/sqrt(h), bias_instability: 10 ug, resolution: 1e-5 m/s, axes: {x: {}, y: {}, z: {}}}
reference: true
"""
CYCLE = Cycle({"A": 0.0, "B": 1.5}, (Move("A", 1.5, "B"), Move("B", -1.5, "A")), 20 * DEG, 7.0)
STEPS = [
    (X_UP, Rest(), "powered"),
    (LEVEL, Spin(10 * DEG), "powered"),
    (LEVEL, Rest(), "unpowered"),
    (X_UP, Rock(2 * DEG, 0.2, (0.0, 1.0, 2.0), 30.0), "powered"),
    (LEVEL, CYCLE, "powered"),
]


def carry_out(bench, begin):
    """Segments from `begin` on, and a checkpoint as JSON text after each."""
    data, checkpoints = [], []
    for index, (attitude, motion, mode) in list(enumerate(STEPS))[begin:]:
        bench.orient(attitude)
        bench.sensor.set_mode(mode)
        bench.move(motion)
        data.append(bench.record(60.0, motion=motion, index=index))
        bench.clock.sleep(bench.table.end_motion())
        checkpoints.append(json.dumps([bench.clock.now(), bench.table.checkpoint(), bench.sensor.checkpoint()]))
    return data, checkpoints


@pytest.mark.parametrize("carrier", [None, "{speed: 3 m/s, heading: 20 deg, period: 30 s, track: great-circle}"])
def test_a_resumed_run_is_identical_bit_for_bit(carrier):
    whole, checkpoints = carry_out(InertialBench(NOISY, carrier=carrier), 0)
    for broken_after in range(1, len(STEPS)):
        bench = InertialBench(NOISY, carrier=carrier)
        now, of_table, of_sensor = json.loads(checkpoints[broken_after - 1])
        bench.clock.set(now)
        bench.table.restore(of_table)
        bench.sensor.restore(of_sensor)
        rest, later = carry_out(bench, broken_after)
        for before, after in zip(whole[broken_after:], rest, strict=True):
            for name in before:
                assert np.array_equal(before[name], after[name]), name
        assert later == checkpoints[broken_after:]


def test_blocks_are_bounded_and_time_increases_by_the_sample_interval():
    bench = InertialBench(NOISY)
    slow = replace(CYCLE, stop=200.0)
    bench.move(slow)
    start = bench.clock.now()
    blocks = bench.blocks(2500.03, motion=slow)
    assert [b.time.size for b in blocks] == [BLOCK, BLOCK, 50_003]
    assert all(v.shape == b.time.shape for b in blocks for v in b.channels.values())
    time = np.concatenate([b.time for b in blocks])
    assert np.diff(time) == pytest.approx(0.01, abs=1e-9)
    assert time[0] == pytest.approx(start + 0.01)
    assert bench.clock.now() == pytest.approx(start + 2500.03)


def test_reference_channels_say_where_the_bench_is():
    still = InertialBench(TRIAD + "reference: true").record(0.1)
    assert still["reference_latitude"] == pytest.approx(np.full(10, 30.0))
    assert still["reference_longitude"] == pytest.approx(np.full(10, 10.0))
    assert still["reference_height"] == pytest.approx(np.full(10, 100.0))
    assert np.all(still["reference_velocity_east"] == 0.0)
    # Due north at 20 m/s from the start of the ramp on: the velocity at the end of the first second is 20/60 m/s.
    moved = InertialBench(TRIAD + "reference: true", carrier="speed: 20 m/s").record(2.0)
    factor = 1 + 100 / 6_351_377.10  # height over the meridian's radius at 30 deg, a(1 − e²)/(1 − e²/4)^1.5
    assert moved["reference_velocity_north"][99] == pytest.approx(20 / 60 * factor, rel=1e-10)
    # It feels its acceleration northwards, and the Earth turning beneath it.
    assert moved["accel_y"] == pytest.approx(np.full(200, 20 / 60 * factor), abs=1e-6)
    assert moved["gyro_x"][-1] == pytest.approx(-(40 / 60 / 6_351_377.10) / DEG, rel=0.01)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"dwell": None}, "only possible with a recording"),
        ({"dwell": 1.0, "rate": 1000.0}, "the sensor gives 100 Hz at most"),
    ],
)
def test_what_it_cannot_record_is_said(how, words):
    with pytest.raises(InstrumentError, match=words):
        InertialBench().blocks(**how)


def test_a_mode_that_it_has_not_is_said():
    with pytest.raises(InstrumentError, match="no mode 'caged'; its modes are powered and unpowered"):
        InertialBench().sensor.set_mode("caged")
