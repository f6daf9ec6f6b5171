"""Recorded segments of a simulated unit that stands or is turned about the vertical, made without the package's navigation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from recorded import from_samples, segment

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.interface import EstimateRequest, Setup
from planrunner.estimators.strapdown.navigating import StrapdownNavigationParameters
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Motion

Array = np.ndarray

SITE = Site(np.radians(45.0), 9.806, longitude=np.radians(120.0), height=100.0)
CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
UNITS = {name: "deg/h" if name.startswith("gyro") else "g" for name in CHANNELS}
SCALE = np.array([180 * 3600 / np.pi] * 3 + [1 / 9.80665] * 3)
DEG_H = np.pi / 180 / 3600
RATE = 10.0  # Hz


def samples(
    seconds: float,
    rate: float = RATE,
    angle: Array | float = 0.0,
    errors: tuple[float, ...] = (0.0,) * 6,
    noise: float = 0.0,
    seed: int = 0,
    site: Site = SITE,
) -> dict[str, Array]:
    """Channels of a level unit turned by `angle` [rad] (or (n + 1,), at the ends of the intervals) from east-north-up. errors: deg/h
    and µg. noise: deg/√h of the gyros; the accelerometers have 10 times as many mm/s/√h."""
    n = round(seconds * rate)
    ends = np.broadcast_to(np.asarray(angle, dtype=float), n + 1)
    middle = (ends[1:] + ends[:-1]) / 2
    north, up = site.earth_rate * np.cos(site.latitude), site.earth_rate * np.sin(site.latitude)
    values = np.array(
        [
            north * np.sin(middle),
            north * np.cos(middle),
            up + np.diff(ends) * rate,
            np.zeros(n),
            np.zeros(n),
            np.full(n, site.gravity),
        ]
    )
    values += np.array([DEG_H] * 3 + [9.80665e-6] * 3)[:, None] * np.asarray(errors)[:, None]
    if noise:
        white = np.array([np.radians(noise) / 60] * 3 + [noise / 100 / 60] * 3)
        values += white[:, None] * np.sqrt(rate) * np.random.default_rng(seed).standard_normal((6, n))
    return dict(zip(CHANNELS, values * SCALE[:, None], strict=True))


def recorded(
    label: str,
    channels: dict[str, Array],
    start: float,
    rate: float = RATE,
    motion: Motion | None = None,
    attitude: Array | None = None,
    more_units: dict[str, str] | None = None,
    rows: int = 997,
) -> RecordedSegment:
    n = len(channels["gyro_x"])
    planned = replace(
        segment(label, np.eye(3) if attitude is None else attitude, motion, dwell=n / rate),
        sample_rate=rate,
        start=start,
    )
    time = start + np.arange(1, n + 1) / rate
    return from_samples(planned, time, channels, {**UNITS, **(more_units or {})}, rows)


def sensor(noise: float = 0.0, rate: float = RATE) -> SensorModel:
    white = {"deg/h": noise * 60, "g": noise / 100 / 60 / 9.80665}
    outputs = tuple(OutputModel(name, UNITS[name], noise=NoiseModel(white[UNITS[name]])) for name in CHANNELS)
    return SensorModel("imu", outputs, rate)


def request(
    *segments: RecordedSegment, site: Site = SITE, setup: Setup | None = None, **parameters: Any
) -> EstimateRequest:
    made = StrapdownNavigationParameters(**parameters)
    return EstimateRequest("free", segments, made, site, sensor(), setup=setup or Setup())
