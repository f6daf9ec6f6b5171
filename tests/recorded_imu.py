"""A recording such as a laboratory hands over: a Parquet file of an IMU on a turned, rocked and heated table, and a table of segments.

Written apart from planrunner, kinematics by hand. The device has a bias and a matrix a triad; an effect may be added.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.directions import WORDS

RATE = 50.0
LATITUDE, GRAVITY, EARTH = np.radians(39.98), 9.80154, 15.041067 / 3600
POSITIONS = """up north west, up south east, down north east, down south west, north up east, north down west,
south up west, south down east, east north up, west north down, east up south, west down south""".replace("\n", " ")
TURNED = {"x": "up north west", "y": "north up east", "z": "north west up"}
SHORT = "up north west, down north east, north up east, south down east, east north up, west north down"


@dataclass(frozen=True)
class Row:
    """One line of the table of segments."""

    label: str
    axes: str
    seconds: float
    rate: float = 0.0
    rock: tuple[float, float] | None = None
    celsius: float = 25.0
    ramp: bool = False
    start: float = 0.0


def rows() -> list[Row]:
    """The segments in order, with their beginnings in s since power-on."""
    listed = [Row(f"S{n:02}", axes, 30) for n, axes in enumerate(POSITIONS.split(", "), 1)]
    for axis, axes in TURNED.items():
        for rate in (10, 30, 60, 120, 200, 300):
            listed += [Row(f"R{axis}{sign * rate:+d}", axes, 36 if rate == 10 else 12, sign * rate) for sign in (1, -1)]
    for axis, axes in TURNED.items():
        listed += [Row(f"K{axis}{f:g}", axes, 20, rock=(amplitude, f)) for amplitude, f in ((8, 0.5), (4, 1.5), (2, 4))]
    for celsius in (-20, 60):
        listed.append(Row(f"ramp{celsius:+d}", TURNED["x"], 120, celsius=celsius, ramp=True))
        listed += [Row(f"S{celsius:+d}_{n}", axes, 24, celsius=celsius) for n, axes in enumerate(SHORT.split(", "), 1)]
        for axis, axes in TURNED.items():
            for rate, seconds in ((20, 18), (150, 12)):
                for sign in (1, -1):
                    label = f"R{axis}{sign * rate:+d}@{celsius:+d}"
                    listed.append(Row(label, axes, seconds, sign * rate, celsius=celsius))
    listed.append(Row("ramp+25", TURNED["x"], 120, ramp=True))
    listed += [Row(f"E{n:02}", axes, 30) for n, axes in enumerate(SHORT.split(", "), 1)]
    time, timed = 600.0, []
    for row in listed:
        time += 20 if row.ramp else 15
        timed.append(Row(**{**row.__dict__, "start": time}))
        time += row.seconds + (1800 if row.ramp else 0)
    return timed


@dataclass(frozen=True)
class Felt:
    """What one segment's samples felt. rate: deg/s, force: m/s^2, both (n, 3) in sensor axes; angle: deg, time: s, celsius, (n,)."""

    time: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    angle: np.ndarray
    celsius: np.ndarray


def felt(row: Row, before: float) -> Felt:
    """before: degC when the segment began, for ramps."""
    t = np.arange(round(row.seconds * RATE)) / RATE
    angle, speed = row.rate * t, np.full(t.size, row.rate)
    if row.rock is not None:
        amplitude, f = row.rock
        angle = amplitude * np.sin(2 * np.pi * f * t)
        speed = amplitude * 2 * np.pi * f * np.cos(2 * np.pi * f * t)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    north, up = EARTH * np.cos(LATITUDE), EARTH * np.sin(LATITUDE)
    # The payload turned by +angle about up sees the site turned by -angle.
    seen = np.stack([north * s, north * c, up + speed], axis=1)
    axes = np.array([WORDS[word] for word in row.axes.split()], dtype=float)
    force = np.tile(axes @ np.array([0, 0, GRAVITY]), (t.size, 1))
    celsius = np.full(t.size, row.celsius)
    if row.ramp:
        celsius = row.celsius + (before - row.celsius) * np.exp(-t / 90)
    return Felt(row.start + t, seen @ axes.T, force, angle, celsius)


Effect = Callable[[Felt], tuple[np.ndarray, np.ndarray]]


def write_recording(
    folder: Path, seed: int = 1, effect: Effect | None = None, noise: float = 1.0, listed: list[Row] | None = None
) -> Path:
    """`recording.parquet` and `segments.csv` in `folder`. effect: what it adds to the gyros [deg/s] and accelerometers [m/s^2]. listed:
    segments, all of `rows()` without it."""
    listed = rows() if listed is None else listed
    rng = np.random.default_rng(seed)
    matrices = np.eye(3) + rng.normal(0, 2e-3, (2, 3, 3))
    biases = rng.normal(0, 1, (2, 3)) * np.array([[0.05], [0.02]])
    columns: dict[str, list[np.ndarray]] = {}
    before = 25.0
    for row in listed:
        sensed = felt(row, before)
        before = row.celsius
        n = sensed.time.size
        gyro = sensed.rate @ matrices[0].T + biases[0] + noise * rng.normal(0, 0.002 * np.sqrt(RATE / 2), (n, 3))
        accel = sensed.force @ matrices[1].T + biases[1]
        accel += noise * rng.normal(0, 50e-6 * 9.80665 * np.sqrt(RATE / 2), (n, 3))
        if effect is not None:
            more_rate, more_force = effect(sensed)
            gyro, accel = gyro + more_rate, accel + more_force
        gyro = np.round(gyro / 0.0005) * 0.0005
        accel = np.round(accel / (20e-6 * 9.80665)) * (20e-6 * 9.80665)
        values = {
            "time_s": sensed.time,
            "table_angle_deg": sensed.angle,
            "temperature_degC": sensed.celsius + rng.normal(0, 0.02, n),
        }
        values |= {f"gyro_{axis}_deg_per_s": gyro[:, i] for i, axis in enumerate("xyz")}
        values |= {f"accel_{axis}_m_per_s2": accel[:, i] for i, axis in enumerate("xyz")}
        for name, column in values.items():
            columns.setdefault(name, []).append(column)
    pq.write_table(
        pa.table({name: np.concatenate(parts) for name, parts in columns.items()}), folder / "recording.parquet"
    )
    with (folder / "segments.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("label", "start_s", "end_s"))
        writer.writerows((row.label, f"{row.start:.3f}", f"{row.start + row.seconds:.3f}") for row in listed)
    return folder
