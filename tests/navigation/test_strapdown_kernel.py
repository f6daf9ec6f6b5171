"""The kernel against motions whose course is known in closed form or by another road."""

from __future__ import annotations

import numpy as np
import pytest
from increments import EARTH_RATE, MICRO_G, at_rest, navigator, stand, turn
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from planrunner.navigation import attitude
from planrunner.navigation.mechanisation import Navigator
from planrunner.navigation.wgs84 import normal_gravity

Array = np.ndarray


# -- how samples are cut does not matter -------------------------------------------------------------------------------


def test_blocks_change_no_bit() -> None:
    draw = np.random.default_rng(3)
    n, dt = 5000, 0.005
    increments = np.vstack([draw.normal(0, 1e-3, (3, n)), draw.normal(0, 1e-2, (3, n))])
    increments[5] += 9.8 * dt
    interval = np.full(n, dt) + draw.uniform(-1e-5, 1e-5, n)
    height = 100 + draw.normal(0, 1, n)

    def run(cuts: list[int]) -> tuple[Array, Array]:
        unit = Navigator(
            attitude.quaternion(turn("x", 20)), np.array([3.0, -4, 1]), (0.7, 1.0, 100.0), vertical="damped", every=7
        )
        knots = [
            unit.advance(increments[:, low:high], interval[low:high], height[low:high])
            for low, high in zip([0, *cuts], [*cuts, n], strict=True)
        ]
        return unit.state, np.concatenate([piece.attitude for piece in knots])

    whole, whole_knots = run([])
    for cuts in ([1], [2500], list(range(1, n, 13)), [6, 7, 8, 4999]):
        state, knots = run(cuts)
        assert np.array_equal(state, whole)
        assert np.array_equal(knots, whole_knots)


def test_memory_is_that_of_the_knots() -> None:
    unit = navigator(0.7, np.eye(3), every=100)
    knots = unit.advance(np.zeros((6, 1050)), np.full(1050, 0.01))
    assert knots.attitude.shape == (10, 4)
    assert unit.steps == 1050


# -- attitude ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "dt"), [(300.0, 0.005), (10.0, 0.01), (30000.0, 0.005)])
def test_constant_rate_turns_exactly(rate: float, dt: float) -> None:
    """About a fixed axis rotation vectors add, whatever their size; without Earth rate and force nothing else happens."""
    axis, n = np.array([2.0, -1, 2]) / 3, 20_000
    sample = np.concatenate([np.radians(rate) * dt * axis, np.zeros(3)])
    unit = navigator(0.7, turn("z", 30), earth_rate=0.0, every=n)
    unit.advance(np.repeat(sample[:, None], n, axis=1), np.full(n, dt))
    wanted = turn("z", 30) @ Rotation.from_rotvec(np.fmod(np.radians(rate) * dt * n, 2 * np.pi) * axis).as_matrix()
    assert np.allclose(unit.rotation, wanted, atol=1e-10)


@pytest.mark.parametrize("beta", [0.05, 0.2, 0.6])
def test_drift_in_coning_is_that_of_the_algorithm(beta: float) -> None:
    """Classical coning: the z axis draws a cone of half angle a, turning by β = Ω·dt in each interval. To order a² each step leaves
    (a²/3)·sin²(β/2)·sin β − a²·(β − sin β)/2 about z (Ignagni, J. Guidance, Control, and Dynamics 19, 1996: −a²·β⁵/60 for small β)."""
    a, n = 2e-3, 4000
    angle = beta * np.arange(n + 1)
    # Attitude exp(a·(cos, sin, 0)×): with half angles its quaternion is exact, and so are the increments of the body rate.
    half = a / 2
    axis = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n + 1)])
    attitudes = Rotation.from_rotvec(a * axis)
    # Body rate of that motion: Ω·(−sin a·sin, sin a·cos, −2·sin²(a/2)); integrated over each interval.
    increments = np.zeros((6, n))
    increments[0] = np.sin(a) * np.diff(np.cos(angle))
    increments[1] = np.sin(a) * np.diff(np.sin(angle))
    increments[2] = -2 * np.sin(half) ** 2 * beta
    unit = navigator(0.7, attitudes[0].as_matrix(), earth_rate=0.0, every=1)
    unit = Navigator(
        unit.quaternion,
        np.zeros(3),
        (0.7, 0.0, 0.0),
        earth_rate=0.0,
        last=np.array([*np.sin(a) * np.array([1 - np.cos(-beta), -np.sin(-beta)]), increments[2, 0], 0, 0, 0]),
    )
    unit.advance(increments, np.ones(n))
    error = (Rotation.from_matrix(unit.rotation) * attitudes[-1].inv()).as_rotvec()
    step = a**2 / 3 * np.sin(beta / 2) ** 2 * np.sin(beta) - a**2 * (beta - np.sin(beta)) / 2
    assert error[2] == pytest.approx(n * step, rel=2e-3)
    uncorrected = n * a**2 * (beta - np.sin(beta)) / 2
    assert abs(error[2]) < 0.3 * beta**2 * uncorrected


# -- courses over the Earth --------------------------------------------------------------------------------------------


def _level(latitude: Array, north_velocity: float, east_velocity: float) -> tuple[Array, Array]:
    """Rate and specific force (3, n) of a unit that is carried level with its y axis north at constant velocity, in its own axes, which
    are East-North-Up. Radii from the axes of the ellipsoid."""
    a, b = 6378137.0, 6356752.314245
    w = (a * np.cos(latitude)) ** 2 + (b * np.sin(latitude)) ** 2
    meridian, prime = (a * b) ** 2 / w**1.5, a**2 / np.sqrt(w)
    transport = np.array(
        [
            np.broadcast_to(-north_velocity / meridian, latitude.shape),
            east_velocity / prime,
            east_velocity * np.tan(latitude) / prime,
        ]
    )
    earth = EARTH_RATE * np.array([np.zeros_like(latitude), np.cos(latitude), np.sin(latitude)])
    velocity = np.array([east_velocity, north_velocity, 0.0])
    coriolis = np.cross((2 * earth + transport).T, velocity).T
    gravity = np.array([np.zeros_like(latitude), np.zeros_like(latitude), normal_gravity(latitude)])
    return earth + transport, coriolis + gravity


@pytest.mark.parametrize("vertical", ["held", "damped"])
def test_along_a_parallel(vertical: str) -> None:
    """At constant speed along a parallel everything is constant: rate, force, latitude; longitude grows evenly."""
    latitude, speed, dt, n = np.radians(50.0), 250.0, 0.01, 360_000
    rate, force = _level(np.array([latitude]), 0.0, speed)
    sample = np.concatenate([rate, force])[:, 0] * dt
    unit = Navigator(
        attitude.quaternion(np.eye(3)),
        np.array([speed, 0.0, 0.0]),
        (latitude, 0.0, 0.0),
        vertical=vertical,
        earth_rate=EARTH_RATE,
        every=n,
    )
    unit.advance(np.repeat(sample[:, None], n, axis=1), np.full(n, dt))
    prime = 6378137.0 / np.sqrt(1 - 0.00669437999014 * np.sin(latitude) ** 2)
    found = unit.position
    assert (found[0] - latitude) * 6.37e6 == pytest.approx(0.0, abs=1e-3)
    assert (found[1] - speed * n * dt / prime / np.cos(latitude)) * 4.1e6 == pytest.approx(0.0, abs=1e-3)
    assert found[2] == pytest.approx(0.0, abs=1e-3)
    assert np.allclose(unit.velocity, [speed, 0, 0], atol=1e-6)


def test_along_a_meridian_which_is_a_great_circle() -> None:
    """One hour north at 250 m/s: latitude follows the meridian's arc, by quadrature. What is left falls with the square of the interval."""
    coarse, fine = _meridian_error(0.08), _meridian_error(0.04)
    assert np.all(np.abs(coarse) < 1e-3)
    assert coarse[0] / fine[0] == pytest.approx(4, rel=0.1)


def _meridian_error(dt: float) -> Array:
    """North and east error [m] after an hour; rate and force are integrated over each interval."""
    start, speed, n = np.radians(20.0), 250.0, round(3600 / dt)
    solution = solve_ivp(
        lambda t, y: [speed / ((6378137.0 * 6356752.314245) ** 2 / _w(y[0]) ** 1.5)],
        (0, 3600),
        [start],
        rtol=1e-13,
        atol=1e-15,
        dense_output=True,
        method="DOP853",
    )
    nodes, weights = np.polynomial.legendre.leggauss(3)
    moments = (np.arange(n)[:, None] + (nodes + 1) / 2) * dt
    rate, force = _level(solution.sol(moments.ravel())[0], speed, 0.0)
    samples = (np.vstack([rate, force]).reshape(6, n, 3) * weights).sum(axis=2) * dt / 2
    unit = Navigator(
        attitude.quaternion(np.eye(3)), np.array([0.0, speed, 0.0]), (start, 0.5, 0.0), earth_rate=EARTH_RATE, every=n
    )
    unit.advance(samples, np.full(n, dt))
    end = float(solution.sol(3600)[0])
    arc, _ = quad(lambda phi: (6378137.0 * 6356752.314245) ** 2 / _w(phi) ** 1.5, start, end, epsabs=1e-4)
    assert arc == pytest.approx(speed * 3600, abs=1e-3)
    return np.array([(unit.position[0] - end) * 6.37e6, (unit.position[1] - 0.5) * 6.378e6 * np.cos(end)])


def _w(latitude: float) -> float:
    return (6378137.0 * np.cos(latitude)) ** 2 + (6356752.314245 * np.sin(latitude)) ** 2


def test_free_fall_as_seen_from_space() -> None:
    """No force, no turn: the unit falls as a mass does in an inertial frame, integrated there with gravity along the ellipsoid's normal."""
    latitude, longitude, height, seconds, dt = np.radians(40.0), 0.3, 20_000.0, 50.0, 0.01
    start, rotation = _inertial(latitude, longitude, height, 0.0)
    spin = np.array([0.0, 0.0, EARTH_RATE])
    velocity = rotation @ np.array([120.0, -80.0, 30.0])

    def pulled(t: float, y: Array) -> Array:
        phi, lam, h = _geodetic(y[:3], t)
        up = _inertial(phi, lam, h, t)[1][:, 2]
        gravitation = -up * float(normal_gravity(phi, h)) + np.cross(spin, np.cross(spin, y[:3]))
        return np.concatenate([y[3:], gravitation])

    begin = np.concatenate([start, velocity + np.cross(spin, start)])
    fallen = solve_ivp(pulled, (0, seconds), begin, rtol=1e-12, atol=1e-7, method="DOP853").y[:3, -1]
    wanted = _geodetic(fallen, seconds)
    unit = Navigator(
        attitude.quaternion(np.eye(3)),
        np.array([120.0, -80.0, 30.0]),
        (latitude, longitude, height),
        vertical="free",
        earth_rate=EARTH_RATE,
    )
    n = round(seconds / dt)
    unit.advance(np.zeros((6, n)), np.full(n, dt))
    assert wanted[2] < 10_000
    assert np.allclose((np.array(unit.position) - wanted) * [6.37e6, 4.9e6, 1.0], 0.0, atol=2e-3)
    # Body axes stay where they were among the stars.
    final = _inertial(*unit.position, seconds)[1] @ unit.rotation
    assert np.allclose(final, rotation, atol=1e-9)


def _inertial(latitude: float, longitude: float, height: float, t: float) -> tuple[Array, Array]:
    """Position and East-North-Up axes (columns) in a frame that does not turn."""
    a, e2 = 6378137.0, 0.00669437999014132
    lam = longitude + EARTH_RATE * t
    cl, sl, cp, sp = np.cos(lam), np.sin(lam), np.cos(latitude), np.sin(latitude)
    n = a / np.sqrt(1 - e2 * sp * sp)
    place = np.array([(n + height) * cp * cl, (n + height) * cp * sl, (n * (1 - e2) + height) * sp])
    return place, np.array([[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [0.0, cp, sp]])


def _geodetic(place: Array, t: float) -> tuple[float, float, float]:
    a, e2 = 6378137.0, 0.00669437999014132
    p = np.hypot(place[0], place[1])
    phi = np.arctan2(place[2], p * (1 - e2))
    for _ in range(8):
        n = a / np.sqrt(1 - e2 * np.sin(phi) ** 2)
        phi = np.arctan2(place[2] + e2 * n * np.sin(phi), p)
    return phi, np.arctan2(place[1], place[0]) - EARTH_RATE * t, p / np.cos(phi) - n


# -- vertical channel ----------------------------------------------------------------------------------------------------


def test_vertical_channel_held_keeps_height() -> None:
    unit = navigator(0.7, np.eye(3))
    stand(unit, at_rest(0.7, 9.7, np.eye(3), 0.1), 0.1, 3600)
    assert unit.position[2] == 0.0
    assert unit.velocity[2] == 0.0


def test_free_vertical_channel_runs_away_exponentially() -> None:
    """δḧ = 2·g/R·δh + ∇: δh = ∇/k²·(cosh kt − 1) with k² = 2·g/R."""
    gravity = float(normal_gravity(0.7))
    unit = navigator(0.7, np.eye(3), vertical="free")
    sample = at_rest(0.7, gravity, np.eye(3), 0.1, accelerometer=(0, 0, 100 * MICRO_G), rate=0.0)
    unit = Navigator(unit.quaternion, np.zeros(3), (0.7, 0.0, 0.0), vertical="free", earth_rate=0.0)
    stand(unit, sample, 0.1, 1800)
    k = np.sqrt(2 * gravity / 6378137.0)
    assert unit.position[2] == pytest.approx(100 * MICRO_G / k**2 * (np.cosh(k * 1800) - 1), rel=5e-3)


def test_damped_vertical_channel_learns_the_accelerometer_error() -> None:
    gravity = float(normal_gravity(0.7))
    unit = navigator(0.7, np.eye(3), vertical="damped")
    sample = at_rest(0.7, gravity, np.eye(3), 0.1, accelerometer=(0, 0, 500 * MICRO_G))
    stand(unit, sample, 0.1, 2 * 3600)
    # While it learns, the loop moves 3/τ·∇·τ³ = 150 m of vertical path past the height; its Coriolis acceleration starts a Schuler
    # oscillation of 0.016 m/s, whose Eötvös effect the loop follows some millimetres behind.
    assert unit.position[2] == pytest.approx(0.0, abs=5e-3)
    assert unit.velocity[2] == pytest.approx(0.0, abs=2e-4)
    assert unit.state[10] == pytest.approx(500 * MICRO_G, rel=1e-3)
