"""A virtual bench with an inertial sensor, for the tests of that sensor."""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import Surroundings
from planrunner.instruments.virtual.carrier import VirtualCarrier, VirtualCarrierParameters
from planrunner.instruments.virtual.chamber import VirtualChamber, VirtualChamberParameters
from planrunner.instruments.virtual.imu import VirtualImu
from planrunner.instruments.virtual.imu_keys import VirtualImuParameters
from planrunner.instruments.virtual.table import VirtualTable, VirtualTableParameters
from planrunner.physics.earth import Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment

DEG = math.pi / 180
LEVEL = np.eye(3)
AXES = """[{name: outer, direction: up, max_rate: 400 deg/s, max_acceleration: 50 deg/s^2},
 {name: middle, direction: east, max_rate: 200 deg/s, max_acceleration: 100 deg/s^2},
 {name: inner, direction: north, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}]"""
TRIAD = "gyros: {axes: {x: {}, y: {}, z: {}}}\naccelerometers: {axes: {x: {}, y: {}, z: {}}}\n"


def read(record, text):
    log = Findings()
    made = RecordOf(record).read(source.parse(text, "t"), log)
    assert list(log) == []
    return made


def findings(text):
    log = Findings()
    RecordOf(VirtualImuParameters).read(source.parse(text, "b.yaml"), log)
    return [(item.code, item.message) for item in log.errors]


class InertialBench:
    """text: the sensor's keys; carrier, chamber: theirs, where there is one."""

    def __init__(self, text=TRIAD, *, latitude=30.0, seed=1, rate=100, carrier=None, chamber=None):
        site = Site(latitude * DEG, 9.80665, longitude=10 * DEG, height=100.0)
        self.clock = VirtualClock()
        surroundings = Surroundings(self.clock, site, seed=seed)
        self.table = VirtualTable.connect(read(VirtualTableParameters, f"axes: {AXES}"), surroundings)
        self.chamber = chamber and VirtualChamber.connect(read(VirtualChamberParameters, chamber), surroundings)
        if carrier is not None:
            VirtualCarrier.connect(read(VirtualCarrierParameters, carrier), surroundings)
        keys = f"{text}\nsample_rate: {rate} Hz\nthermometer_noise: 0 K\n"
        self.sensor = VirtualImu.connect(read(VirtualImuParameters, keys), surroundings)
        self.world = self.table.world
        self.index = 0

    def orient(self, attitude):
        self.clock.sleep(self.table.orient(attitude))

    def move(self, motion, seconds=100.0):
        self.clock.sleep(self.table.begin_motion(motion, seconds))

    def segment(self, dwell, motion=None, rate=None, index=None):
        self.index += 1
        return Segment(
            self.index if index is None else index, "S", LEVEL, "", motion or Rest(), dwell, sample_rate=rate
        )

    def blocks(self, dwell, **how):
        return list(self.sensor.stream(self.segment(dwell, **how)))

    def record(self, dwell, **how):
        """Channels by name, and `time`."""
        blocks = self.blocks(dwell, **how)
        data = {name: np.concatenate([b.channels[name] for b in blocks]) for name in self.sensor.channels()}
        return data | {"time": np.concatenate([b.time for b in blocks])}
