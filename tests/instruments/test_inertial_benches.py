"""The shipped benches with virtual inertial sensors, and the examples of their documentation, opened and asked."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from inertial_bench import DEG, LEVEL, findings, read

from planrunner.bench.model import read_bench
from planrunner.bench.opening import open_bench
from planrunner.instruments.virtual.carrier import VirtualCarrierParameters
from planrunner.plan.schedule import Rest, Segment, Spin

OMEGA = 15.041067 / 3600  # deg/s
PAGE = Path(__file__).resolve().parents[2] / "docs" / "virtual-sensors.md"


def means(opened, dwell, motion=None):
    motion = motion or Rest()
    opened.clock.sleep(opened.table.orient(LEVEL))
    opened.clock.sleep(opened.table.begin_motion(motion, dwell))
    total: dict[str, float] = {}
    count = 0
    for block in opened.sensor.stream(Segment(0, "S", LEVEL, "", motion, dwell)):
        count += block.time.size
        for name, samples in block.channels.items():
            total[name] = total.get(name, 0.0) + samples.sum()
    opened.clock.sleep(opened.table.end_motion())
    return {name: value / count for name, value in total.items()}


def test_the_gyro_triad_at_300_degrees_a_second_over_whole_turns():
    with open_bench(read_bench("virtual_gyro_triad")[0]) as opened:
        data = means(opened, 12.0, Spin(300 * DEG))
    # cos 54.7427° = 0.577257; u = 300·cos θ and Earth's 9.66 deg/h·cos θ; at 25 degC, 5 K above the reference. In pulses of 1/40000 deg.
    vertical = 300 + OMEGA * math.sin(39.98 * DEG)
    for name, theta, delta, linear, square, asymmetry in (
        ("gyro_x", 54.7427, 210, 11, 0.08, 8),
        ("gyro_y", 54.7301, -140, -7, 0.05, -5),
    ):
        u = vertical * math.cos(theta * DEG)
        ppm = delta + 5 * linear + 25 * square + asymmetry / 2
        # The rest: 20 ppm of cubic terms at most, 15 of the table's rate error and 20 of switch-on, four deviations.
        assert data[name] == pytest.approx(40_000 * u * (1 + ppm * 1e-6), rel=60e-6), name
    assert abs(data["gyro_z"] / 40_000 / vertical / math.cos(54.7389 * DEG) - 1) < 200e-6


def test_the_imu_at_rest():
    with open_bench(read_bench("virtual_imu")[0]) as opened:
        data = means(opened, 1000.0)
    # Accelerometers scatter by 0.003/60/√1000 m/s² and their instability of 5 µg, √15 of it in all.
    spread = 4 * math.hypot(0.003 / 60 / math.sqrt(1000), 5 * 9.80665e-6 * 2)
    assert data["accel_x"] == pytest.approx(50 * 9.80665e-6 + 9.806 * 4 * DEG / 3600, abs=spread)
    assert data["accel_z"] == pytest.approx(9.806 * (1 + 50e-6) + 30 * 9.80665e-6, abs=spread)
    north, up = OMEGA * math.cos(45.78 * DEG), OMEGA * math.sin(45.78 * DEG)
    spread = 4 * math.hypot(0.002 / 60 / math.sqrt(1000), 0.003 / 3600 * 2)
    assert data["gyro_x"] == pytest.approx(0.02 / 3600, abs=spread)
    assert data["gyro_y"] == pytest.approx(north - 0.015 / 3600, abs=spread)
    assert data["gyro_z"] == pytest.approx(up + 0.01 / 3600, abs=spread)
    assert data["reference_latitude"] == pytest.approx(45.78)
    assert data["reference_longitude"] == pytest.approx(126.67)


def test_the_small_sensor_at_rest():
    with open_bench(read_bench("virtual_mems")[0]) as opened:
        data = means(opened, 100.0)
    # 1 g upwards: 1.0061·(1 + 200e-6 + 0.022) g, within its noise of 0.06/60/√100 m/s², instability, and the cosine of its misalignments.
    assert data["accel_z"] / 9.80665 == pytest.approx(1.0061 * (9.80154 / 9.80665 + 200e-6 + 0.022), abs=2e-4)
    assert data["gyro_x"] == pytest.approx((0.31 - 15 / 3600) * 1.0042, abs=4 * 60 / 3600 + 90 / 3600)
    assert np.isfinite(list(data.values())).all()


def test_the_examples_of_the_page_are_as_one_may_write_them():
    blocks = re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    ((_, sensor),) = yaml.safe_load(blocks[0]).items()
    assert sensor.pop("driver") == "virtual_imu"
    assert findings(yaml.safe_dump(sensor)) == []
    ((_, ship),) = yaml.safe_load(blocks[1]).items()
    assert ship.pop("driver") == "virtual_carrier"
    assert read(VirtualCarrierParameters, yaml.safe_dump(ship)).speed.value == 10.0
