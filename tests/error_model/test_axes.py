"""One rule gives the axis of a channel: a recording, a schedule and a simulation of the same sensor agree."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.bench.clock import VirtualClock
from planrunner.error_model.observed import Channel
from planrunner.error_model.scheduled import scheduled, sensor_channels
from planrunner.error_model.virtual_instrument import AddedEffects, AddedEffectsParameters
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.virtual.added import Gives, Moments
from planrunner.instruments.virtual.world import World
from planrunner.observation.samples import observed
from planrunner.plan.schedule import Rest, Segment
from tests.gap.turntable import SITE

AXES = {"gyro_x": 0, "y_rate": 1, "Gyro_Z_filtered": 2, "accel_z": 2, "x": 0}
UNITS = {name: "m/s^2" if name.startswith("accel") else "deg/s" for name in AXES}
OTHERS = {"rate": "deg/s", "accelx": "m/s^2", "temperature_x": "degC"}
NOISE = NoiseModel(white=1e-3, resolution=2e-3)
SENSOR = SensorModel(
    "imu", tuple(OutputModel(name, text, noise=NOISE) for name, text in {**UNITS, **OTHERS}.items()), 10.0
)
SEGMENT = Segment(0, "P0", np.eye(3), "given", Rest(), 5.0)
TIME = np.arange(50) / 10


def of_recording() -> tuple[Channel, ...]:
    def blocks(names: Sequence[str]) -> Iterator[Block]:
        yield Block(TIME, {name: np.ones(50) for name in names})

    units = {**UNITS, **OTHERS}
    recorded = RecordedSegment(SEGMENT, units, statistics_of(blocks(tuple(units)), tuple(units), 50), blocks)
    return observed([recorded], SITE, SENSOR).channels


def of_schedule() -> tuple[Channel, ...]:
    return scheduled([SEGMENT], SITE, sensor_channels(SENSOR), 10.0).channels


def of_simulation() -> tuple[Channel, ...]:
    instrument = AddedEffects(AddedEffectsParameters(effects={}), World(VirtualClock(), SITE))
    zero = np.zeros(50)
    moments = Moments(SEGMENT, TIME, 0.0, 10.0, zero, zero, zero, np.full(50, 298.15), zero, zero)
    gives = {name: Gives(text, NOISE.white, NOISE.resolution) for name, text in {**UNITS, **OTHERS}.items()}
    return instrument._observed(moments, gives).channels


@pytest.mark.parametrize("channels", [of_recording, of_schedule, of_simulation])
def test_axes_are_the_same_wherever_they_are_asked_for(channels: Callable[[], tuple[Channel, ...]]) -> None:
    found = {one.name: one for one in channels()}
    assert {name: one.axis for name, one in found.items()} == AXES
    assert {name: one.kind for name, one in found.items()} == {
        name: "accel" if name == "accel_z" else "gyro" for name in AXES
    }
    assert found == {one.name: one for one in of_schedule()}
