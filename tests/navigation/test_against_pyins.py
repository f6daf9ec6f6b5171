"""The mechanisation beside that of python-ins on the same increments, and both beside a truth.

Where the two part, the truth says who is right: python-ins takes latitude and velocity of the beginning of an interval for its transport
and Coriolis terms, an error of first order in the interval; ours takes those of its middle.
"""

from __future__ import annotations

import numpy as np
import pytest
from increments import DEG_H, EARTH_RATE, MICRO_G, at_rest, turn
from pyins import sim, strapdown, transform
from pyins._numba_integrate import integrate
from pyins.util import ACCEL_COLS, GYRO_COLS, LLA_COLS, VEL_COLS

from planrunner.navigation import attitude
from planrunner.navigation.mechanisation import Navigator
from planrunner.navigation.wgs84 import normal_gravity, separation

Array = np.ndarray

SWAP = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""North-East-Down to East-North-Up, and forward-right-down to right-forward-up."""
LATITUDE = np.radians(50.0)


def ours(samples: Array, dt: float, rotation: Array, velocity: Array, latitude: float, last: Array) -> Navigator:
    """samples: (6, n), in our axes; last: the increments before the first."""
    unit = Navigator(
        attitude.quaternion(rotation), velocity, (latitude, 0.0, 0.0), earth_rate=EARTH_RATE, every=10**9, last=last
    )
    unit.advance(samples, np.full(samples.shape[1], dt))
    return unit


def theirs(samples: Array, dt: float, rotation: Array, velocity: Array, latitude: float, last: Array) -> Array:
    """Latitude, longitude [rad] by the bare kernel of python-ins, with its own coning and sculling formula."""
    gyro, force = (np.vstack([last[part], samples[part].T]) @ SWAP.T for part in (slice(0, 3), slice(3, 6)))
    theta = gyro[1:] + np.cross(gyro[:-1], gyro[1:]) / 12
    change = force[1:] + (np.cross(gyro[:-1], force[1:]) + np.cross(force[:-1], gyro[1:])) / 12
    change += np.cross(gyro[1:], force[1:]) / 2
    n = len(theta)
    place, speed, attitudes = np.empty((n + 1, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3, 3))
    place[0], speed[0] = [np.degrees(latitude), 0, 0], SWAP @ velocity
    attitudes[0] = SWAP @ rotation @ SWAP.T
    integrate(np.full(n, dt), place, speed, attitudes, theta, change, 0, False)
    return np.radians(place[-1, :2])


def apart(one: Array, other: Array) -> float:
    return float(np.hypot(*separation(one[0], one[1], other[0], other[1])))


@pytest.mark.slow
def test_at_rest_for_an_hour() -> None:
    """Tilted, with gyro errors of some 0.01 deg/h and accelerometer errors of some 50 µg: errors of some hundred metres."""
    dt, n = 0.01, 360_000
    rotation = turn("z", 30) @ turn("x", 3)
    gyro, force = np.array([0.01, -0.02, 0.015]) * DEG_H, np.array([50, -30, 20]) * MICRO_G
    sample = at_rest(LATITUDE, float(normal_gravity(LATITUDE)), rotation, dt, gyro, force)
    samples = np.repeat(sample[:, None], n, axis=1)
    unit = ours(samples, dt, rotation, np.zeros(3), LATITUDE, sample)
    other = theirs(samples, dt, rotation, np.zeros(3), LATITUDE, sample)
    assert apart(np.array([LATITUDE, 0.0]), other) > 100
    assert apart(np.array(unit.position[:2]), other) < 1e-3


def moving(dt: float, seconds: float, mean: tuple[float, float], swing: tuple[float, float]) -> tuple[Array, ...]:
    """A carrier at a mean velocity (north, east) [m/s] that swings with a period of 5 min, simulated by python-ins: samples (6, n) and
    the last before them in our axes, start attitude and velocity, true end (latitude, longitude)."""
    trajectory, imu = sim.generate_sine_velocity_motion(
        dt,
        seconds,
        [np.degrees(LATITUDE), 0, 0],
        [*mean, 0],
        [*swing, 0],
        velocity_change_period=300,
        sensor_type="increment",
    )
    first, end = trajectory.iloc[0], trajectory.iloc[-1]
    increments = np.hstack([imu[columns].to_numpy() @ SWAP.T for columns in (GYRO_COLS, ACCEL_COLS)])
    rotation = SWAP @ transform.mat_from_rph(first[["roll", "pitch", "heading"]]) @ SWAP.T
    velocity = SWAP @ first[VEL_COLS].to_numpy()
    return increments[1:].T, increments[0], rotation, velocity, np.radians(end[LLA_COLS].to_numpy()[:2])


def test_a_carrier_along_a_parallel_for_an_hour() -> None:
    """10 m/s to the east: rate and force are constant, and python-ins is right to all orders but those of its Coriolis terms."""
    dt, n = 0.02, 180_000
    prime = 6378137.0 / np.sqrt(1 - 0.00669437999014 * np.sin(LATITUDE) ** 2)
    transport = 10.0 / prime * np.array([0.0, 1.0, np.tan(LATITUDE)])
    earth = EARTH_RATE * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    force = np.cross(2 * earth + transport, [10.0, 0, 0])
    force[2] += float(normal_gravity(LATITUDE))
    sample = np.concatenate([earth + transport, force]) * dt
    samples = np.repeat(sample[:, None], n, axis=1)
    velocity = np.array([10.0, 0.0, 0.0])
    unit = ours(samples, dt, np.eye(3), velocity, LATITUDE, sample)
    other = theirs(samples, dt, np.eye(3), velocity, LATITUDE, sample)
    assert apart(np.array([LATITUDE, 36_000.0 / prime / np.cos(LATITUDE)]), np.array(unit.position[:2])) < 1e-3
    assert apart(np.array(unit.position[:2]), other) < 1e-3


@pytest.mark.slow
def test_a_carrier_that_manoeuvres_for_an_hour_shows_whose_error_it_is() -> None:
    """Velocity changes of several m/s: python-ins departs from the truth in proportion to the interval, ours by less than a hundredth of
    that. Carried to an interval of zero on a straight line, it comes to the truth."""
    ends, ours_found, theirs_found = [], [], []
    for dt in (0.02, 0.01):
        samples, last, rotation, velocity, end = moving(dt, 3600.0, (8.0, 2.0), (3.0, 3.0))
        ends.append(end)
        ours_found.append(np.array(ours(samples, dt, rotation, velocity, LATITUDE, last).position[:2]))
        theirs_found.append(theirs(samples, dt, rotation, velocity, LATITUDE, last))
    their_coarse, their_fine = map(apart, ends, theirs_found)
    our_coarse, our_fine = map(apart, ends, ours_found)
    assert their_coarse / their_fine == pytest.approx(2, rel=0.05)
    assert our_fine < their_fine / 100
    assert our_coarse < 1e-4
    coarse, fine = (
        np.array(separation(*end, *found)) for end, found in zip(ends, theirs_found, strict=True)
    )  # each against its own truth, which the simulation makes anew for each interval
    assert np.hypot(*(2 * fine - coarse)) < 1e-3


def test_a_carrier_for_ten_minutes_follows_the_truth() -> None:
    dt = 0.02
    samples, last, rotation, velocity, end = moving(dt, 600.0, (8.0, 2.0), (3.0, 3.0))
    unit = ours(samples, dt, rotation, velocity, LATITUDE, last)
    assert apart(end, np.array(unit.position[:2])) < 1e-3
    # The public Integrator of python-ins and the bare kernel used here are the same computation.
    bare = theirs(samples, dt, rotation, velocity, LATITUDE, last)
    assert apart(bare, end) < 0.05


def test_python_ins_integrator_is_its_bare_kernel() -> None:
    dt = 0.05
    trajectory, imu = sim.generate_sine_velocity_motion(
        dt, 60.0, [50, 0, 0], [3, 1, 0], [1, 1, 0], sensor_type="increment"
    )
    increments = strapdown.compute_increments_from_imu(imu, "increment")
    end = strapdown.Integrator(trajectory.iloc[0], False).integrate(increments).iloc[-1]
    samples = np.hstack([imu[columns].to_numpy() @ SWAP.T for columns in (GYRO_COLS, ACCEL_COLS)])
    first = trajectory.iloc[0]
    rotation = SWAP @ transform.mat_from_rph(first[["roll", "pitch", "heading"]]) @ SWAP.T
    bare = theirs(samples[1:].T, dt, rotation, SWAP @ first[VEL_COLS].to_numpy(), LATITUDE, samples[0])
    assert np.allclose(np.degrees(bare), end[LLA_COLS].to_numpy()[:2], rtol=0, atol=1e-10)


# -- rounding ----------------------------------------------------------------------------------------------------------


def _extended(sample: Array, dt: float, n: int, rotation: Array) -> tuple[float, float]:
    """The same increments in 80-bit arithmetic and by a direction cosine matrix, North-East-Down, midpoint rule; at rest."""
    real = np.longdouble
    a, e2, rate = real(6378137.0), real(2) / real("298.257223563") - 1 / real("298.257223563") ** 2, real(EARTH_RATE)
    gyro, force = SWAP.astype(real) @ sample[:3].astype(real), SWAP.astype(real) @ sample[3:].astype(real)
    c = (SWAP @ rotation @ SWAP.T).astype(real)
    h = real(dt)

    def turned(v: Array) -> Array:
        angle = np.sqrt(v @ v)
        skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]], dtype=real)
        return np.eye(3, dtype=real) + np.sin(angle) / angle * skew + (1 - np.cos(angle)) / angle**2 * (skew @ skew)

    turning = np.cross(gyro, force)
    body, change = turned(gyro), force + turning / 2 + np.cross(gyro, turning) / 6
    lat, lon, v = real(LATITUDE), real(0), np.zeros(2, dtype=real)
    for _ in range(n):
        dv = c @ change
        s, k = np.sin(lat + v[0] * h / 2 / a), np.cos(lat + v[0] * h / 2 / a)
        w = 1 - e2 * s * s
        north, east = a * (1 - e2) / w ** real(1.5), a / np.sqrt(w)
        earth = np.array([rate * k, 0, -rate * s])
        middle = v
        for _ in range(2):
            full = earth + np.array([middle[1] / east, -middle[0] / north, -middle[1] * s / k / east])
            coriolis = np.cross(full + earth, np.array([middle[0], middle[1], 0], dtype=real))
            new = v + (dv - h / 2 * np.cross(full, dv) - h * coriolis)[:2]
            middle = (v + new) / 2
        lat, lon, v = lat + h * middle[0] / north, lon + h * middle[1] / east / k, new
        c = turned(-full * h) @ c @ body
    return float(lat), float(lon)


@pytest.mark.skipif(bool(np.finfo(np.longdouble).eps > 1e-18), reason="needs a long double of more than 64 bits")
def test_rounding_is_below_a_hundredth_of_a_millimetre() -> None:
    """At rest with errors: what double precision costs us lies far below what departs the two, which is their interval."""
    dt, n = 0.2, 6_000
    rotation = turn("z", 30) @ turn("x", 3)
    gyro, force = np.array([0.01, -0.02, 0.015]) * DEG_H, np.array([50, -30, 20]) * MICRO_G
    sample = at_rest(LATITUDE, float(normal_gravity(LATITUDE)), rotation, dt, gyro, force)
    samples = np.repeat(sample[:, None], n, axis=1)
    reference = np.array(_extended(sample, dt, n, rotation))
    unit = ours(samples, dt, rotation, np.zeros(3), LATITUDE, sample)
    assert apart(np.array(unit.position[:2]), reference) < 1e-5
    other = theirs(samples, dt, rotation, np.zeros(3), LATITUDE, sample)
    assert apart(other, reference) == pytest.approx(apart(other, np.array(unit.position[:2])), rel=1e-2)
