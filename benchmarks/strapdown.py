"""Compares strapdown mechanisation over 10 h at 100 Hz with the bare kernel and the Integrator of python-ins. Also measures the memory.

The mechanisation of planrunner receives raw increments and corrects coning and sculling. The two programs of python-ins receive
increments that are already corrected; the time for this correction is not counted. All three receive the same noisy increments of a
unit at rest. The smallest of several measurements counts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import pandas as pd
from pyins import strapdown
from pyins._numba_integrate import integrate

from benchmarks.measuring import Figures, counted, figures_of, peak_memory
from planrunner.navigation.mechanisation import Navigator

HERTZ = 100
LATITUDE, GRAVITY, EARTH = np.radians(45.0), 9.80619, 7.292115e-5
BLOCK = 360_000


@dataclass(frozen=True, slots=True)
class Size:
    """Number of steps of the comparison, number of measurements, and the two numbers of steps whose memory is compared."""

    steps: int
    turns: int
    few: int
    many: int
    separate: bool = True


FULL, SMALL = Size(3_600_000, 3, 1_440_000, 14_400_000), Size(2000, 1, 2000, 4000, separate=False)


def increments(steps: int, seed: int, hertz: float = HERTZ) -> np.ndarray:
    """Returns noisy increments (6, steps) of a level unit whose axes point east, north and up."""
    rest = np.array([0.0, EARTH * np.cos(LATITUDE), EARTH * np.sin(LATITUDE), 0.0, 0.0, GRAVITY]) / hertz
    white = np.array([3e-7] * 3 + [3e-5] * 3) / np.sqrt(hertz)
    return rest[:, None] + white[:, None] * np.random.default_rng(seed).standard_normal((6, steps))


def navigator(every: int) -> Navigator:
    return Navigator(np.array([1.0, 0, 0, 0]), np.zeros(3), (LATITUDE, 0.0, 0.0), earth_rate=EARTH, every=every)


def ours(values: np.ndarray, interval: np.ndarray) -> tuple[float, Navigator]:
    unit = navigator(HERTZ)
    began = time.perf_counter()
    for low in range(0, interval.size, BLOCK):
        unit.advance(values[:, low : low + BLOCK], interval[low : low + BLOCK])
    return time.perf_counter() - began, unit


def corrected(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns rotation vectors and velocity increments (n, 3) in forward-right-down axes. Coning and sculling are corrected as in
    python-ins."""
    gyro, force = (np.ascontiguousarray(part[[1, 0, 2]].T) * [1.0, 1, -1] for part in (values[:3], values[3:]))
    before_gyro, before_force = np.vstack([np.zeros(3), gyro[:-1]]), np.vstack([np.zeros(3), force[:-1]])
    theta = gyro + np.cross(before_gyro, gyro) / 12
    sculling = (np.cross(before_gyro, force) + np.cross(before_force, gyro)) / 12
    return theta, force + sculling + np.cross(gyro, force) / 2


def bare(interval: np.ndarray, theta: np.ndarray, change: np.ndarray) -> tuple[float, np.ndarray]:
    n = interval.size
    place, speed, attitudes = np.empty((n + 1, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))
    place[0], speed[0], attitudes[0] = [np.degrees(LATITUDE), 0, 0], 0, np.eye(3)
    began = time.perf_counter()
    integrate(interval, place, speed, attitudes, theta, change, 0, False)
    return time.perf_counter() - began, place[-1]


def public(table: pd.DataFrame) -> float:
    start = pd.Series(
        [np.degrees(LATITUDE), 0, 0, 0, 0, 0, 0, 0, 0.0],
        ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"],
    )
    start.name = 0.0
    unit = strapdown.Integrator(start, False)
    began = time.perf_counter()
    unit.integrate(table)
    return time.perf_counter() - began


def memory(steps: int) -> Figures:
    """Navigates this number of steps, block by block. Returns the peak memory [MB]."""
    unit = navigator(400)
    for start in range(0, steps, BLOCK):
        length = min(BLOCK, steps - start)
        unit.advance(increments(length, start // BLOCK, 400), np.full(length, 1 / 400))
    return {"peak": peak_memory()}


def run(size: Size = FULL) -> dict[str, object]:
    steps = size.steps
    values, interval = increments(steps, 1), np.full(steps, 1 / HERTZ)
    theta, change = corrected(values)
    names = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    table = pd.DataFrame(np.column_stack([interval, theta, change]), index=np.cumsum(interval), columns=names)
    ours(values[:, :1000], interval[:1000])  # compiled before it is timed
    bare(interval[:10], theta[:10], change[:10])
    times: dict[str, list[float]] = {"ours": [], "bare": [], "public": []}
    for _ in range(size.turns):
        taken, unit = ours(values, interval)
        times["ours"].append(taken)
        taken, end = bare(interval, theta, change)
        times["bare"].append(taken)
        times["public"].append(public(table))
    apart = (
        np.hypot(unit.position[0] - np.radians(end[0]), (unit.position[1] - np.radians(end[1])) * np.cos(LATITUDE))
        * 6.371e6
    )
    own, kernel, integrator = (min(times[name]) for name in ("ours", "bare", "public"))
    few, many = (figures_of(memory, length, separate=size.separate)["peak"] for length in (size.few, size.many))
    return {
        f"{counted(steps)} steps [s]": own,
        "time of one step [ns]": own / steps * 1e9,
        "bare kernel of python-ins [s]": kernel,
        "ratio (target ≥ 2)": kernel / own,
        "public Integrator of python-ins [s]": integrator,
        "ratio (target ≥ 10)": integrator / own,
        f"position difference of the two programs after {steps / HERTZ / 3600:.3g} h [m]": float(apart),
        f"peak memory at {counted(size.few)} steps [MB]": few,
        f"peak memory at {counted(size.many)} steps ({size.many / 400 / 3600:.3g} h at 400 Hz) [MB]": many,
    }
