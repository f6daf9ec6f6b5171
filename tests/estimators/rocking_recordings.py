"""Recordings of rocking tests made apart from planrunner: attitudes are quaternions of scipy, drawn noise is added to what they give.

An element's attitude takes its own components to those of an inertial frame that is the site's at the beginning of the record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from recorded import from_samples
from scipy.spatial.transform import Rotation

from planrunner.archive.recording import RecordedSegment
from planrunner.base.findings import Findings
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.estimators.rocking.rocking_drift import RockingDrift
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel, TableModel
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Motion, Rest, Rock, Segment

DEG, ARCSEC = math.pi / 180, math.pi / 180 / 3600
PER_HOUR = DEG / 3600
G0 = 9.80665
LATITUDE, GRAVITY = 40 * DEG, 9.80154
OMEGA = 7.2921151e-5  # rad/s, 15.041067 deg/h
EARTH = OMEGA * np.array([0.0, math.cos(LATITUDE), math.sin(LATITUDE)])
VERTICAL = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # x north, y up, z east
HORIZONTAL = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])  # x up, y south, z east
RING_AXES = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
RINGS_AT = {"vertical": (90 * DEG, 0.0, 90 * DEG), "horizontal": (90 * DEG, 0.0, 180 * DEG)}
ATTITUDES = {"vertical": VERTICAL, "horizontal": HORIZONTAL}
ROCKING = Rock(3 * DEG, 0.2, (0.0, 45 * DEG, 90 * DEG), 480.0)
SITE = Site(LATITUDE, GRAVITY, 0.0, OMEGA)
TABLE = TableModel(
    tuple(TableAxis(name, axis, 1.0, 1.0) for name, axis in zip(("o", "m", "i"), RING_AXES, strict=True))
)
ACCELEROMETERS = ("accel_x", "accel_y", "accel_z")
ENCODERS = ("table_outer", "table_middle", "table_inner", "gimbal_outer", "gimbal_middle", "gimbal_inner")


@dataclass
class World:
    """What is true of one run. Angles in rad, rates in rad/s, accelerations in m/s^2."""

    drift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rocking: np.ndarray = field(default_factory=lambda: np.zeros(3))
    caged: np.ndarray = field(default_factory=lambda: np.zeros(3))
    installation: np.ndarray = field(default_factory=lambda: np.zeros(6))
    bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bias_walk: float = 0.0
    white: float = 0.0
    angle_walk: float = 0.0
    count: float = 0.0
    shaking: float = 0.0
    return_error: float = 0.0
    latitude: float = LATITUDE
    gravity: float = GRAVITY
    release: float = 0.0  # s before the record begins
    rest: float = 0.0  # s of a dynamic record before the base begins to rock


def samples(
    state: str, dynamic: bool, world: World, rate: float, dwell: float, draw: np.random.Generator
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time and channels of one run."""
    time = np.arange(round(dwell * rate)) / rate
    earth = OMEGA * np.array([0.0, math.cos(world.latitude), math.sin(world.latitude)])
    turned = Rotation.from_rotvec(np.outer(time, earth))
    released = Rotation.from_rotvec(-world.release * earth)
    rocked = time - (world.rest + 5.0 if world.rest else 0.0)  # s since the rocking has its full amplitude
    fade = np.clip(1 + rocked / 5.0, 0.0, 1.0) * np.clip((ROCKING.duration + 5.0 - rocked) / 5.0, 0.0, 1.0) * dynamic
    angle = np.outer(time + world.release, world.drift) + np.outer(
        np.clip(rocked, 0.0, ROCKING.duration) * dynamic, world.rocking
    )
    if world.angle_walk:
        angle = angle + np.cumsum(world.angle_walk / math.sqrt(rate) * draw.standard_normal(angle.shape), axis=0)
    start = Rotation.from_matrix(ATTITUDES[state].T) * Rotation.from_rotvec(world.caged)
    element = released * start * Rotation.from_rotvec(angle)
    wobble = [fade * ROCKING.amplitude * np.sin(2 * math.pi * 0.2 * time + phase) for phase in ROCKING.phases]
    shake = np.outer(np.sin(2 * math.pi * 0.2 * time + 0.3) * fade * world.shaking, [1.0, 0.4, -0.7])
    force = element.inv().apply(turned.apply(np.array([0.0, 0.0, world.gravity]) + shake))
    readings = np.column_stack([force @ axis for axis in input_axes(world.installation)]) + world.bias
    if world.bias_walk:
        readings += np.cumsum(world.bias_walk / math.sqrt(rate) * draw.standard_normal(readings.shape), axis=0)
    readings = (readings + world.white * math.sqrt(rate) * draw.standard_normal(readings.shape)) / G0
    if world.count:
        readings = np.rint(readings / world.count) * world.count
    channels = dict(zip(ACCELEROMETERS, readings.T, strict=True))
    off = np.zeros((3, time.size))
    if world.return_error:
        before, after = world.return_error * draw.standard_normal((2, 3, 1))
        off = np.where(fade > 0, before, after) if dynamic else np.broadcast_to(before, off.shape)
    rings = [middle + part for middle, part in zip(RINGS_AT[state], wobble, strict=True)]
    base = turned
    for axis, ring in zip(RING_AXES, rings, strict=True):
        base = base * Rotation.from_rotvec(np.outer(ring, axis))
    gimbals = (base.inv() * element).as_euler("XYZ")
    shown = [*(ring - wrong for ring, wrong in zip(rings, off, strict=True)), *gimbals.T]
    channels |= {name: np.degrees(value) for name, value in zip(ENCODERS, shown, strict=True)}
    return time, channels


def input_axes(angles: Sequence[float] | np.ndarray) -> list[np.ndarray]:
    """Unit vectors of the accelerometers' input axes, each turned about one axis and then about the other."""
    xz, xy, yz, yx, zy, zx = angles
    x, y, z = np.eye(3)

    def turned(own: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return Rotation.from_rotvec(second).apply(Rotation.from_rotvec(first).apply(own))

    return [turned(x, xz * z, xy * y), turned(y, yz * z, yx * x), turned(z, zy * y, zx * x)]


def planned(state: str, name: str, index: int, dwell: float, mode: str = "navigation", rest: float = 0.0) -> Segment:
    motion: Motion = replace(ROCKING, delay=rest) if name.startswith("dynamic") else Rest()
    label = f"{state}/{name}"
    return Segment(index, label, ATTITUDES[state], state, motion, dwell, mode=mode)


def recordings(
    worlds: Sequence[tuple[str, Sequence[World]]], rate: float = 5.0, dwell: float = 600.0, seed: int = 1
) -> list[Any]:
    """Recorded segments of quadruples: (state, four worlds) each, a short caged segment before each run."""
    draw = np.random.default_rng(seed)
    recorded: list[RecordedSegment] = []
    for number, (state, four) in enumerate(worlds, start=1):
        for name, world in zip(("static-1", "dynamic-1", "dynamic-2", "static-2"), four, strict=True):
            caged = planned(f"{state}", f"r{number}/cage", len(recorded), 10.0, "caged")
            still = np.arange(50) / 5.0
            channels = {channel: np.zeros(50) for channel in (*ACCELEROMETERS, *ENCODERS)}
            recorded.append(from_samples(caged, still, channels, units()))
            segment = planned(state, name, len(recorded), dwell, rest=world.rest)
            time, channels = samples(state, name.startswith("dynamic"), world, rate, dwell, draw)
            recorded.append(from_samples(segment, time + 1000.0 * len(recorded), channels, units()))
    return recorded


def units() -> dict[str, str]:
    return {**dict.fromkeys(ACCELEROMETERS, "g"), **dict.fromkeys(ENCODERS, "deg")}


def parameters(text: str = "{}") -> Any:
    log = Findings()
    made = RecordOf(RockingDrift.Parameters).read(source.parse(text, "t"), log)
    assert list(log) == []
    return made


def sensor(count: float = 0.0, full_scale: float = 1.25) -> SensorModel:
    noise = NoiseModel(0.0, 0.0, count)
    outputs = tuple(OutputModel(name, "g", full_scale, noise) for name in ACCELEROMETERS)
    return SensorModel("stabilised-platform", outputs, 5.0, modes=("caged", "navigation"))


def estimate(recorded: Sequence[Any], text: str = "{}", setup: Setup | None = None, count: float = 0.0) -> Estimate:
    request = EstimateRequest(
        "rocking", tuple(recorded), parameters(text), SITE, sensor(count), setup=setup or Setup(TABLE)
    )
    return RockingDrift().estimate(request)
