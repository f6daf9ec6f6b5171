"""Means over sampling intervals while the table moves: by hand, by adaptive quadrature, by dense sums of rotation matrices."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from inertial_bench import DEG, LEVEL, InertialBench

from planrunner.physics.earth import EARTH_RATE
from planrunner.plan.schedule import Cycle, Move, Rock, Spin

OMEGA = EARTH_RATE / DEG  # deg/s
G = 9.80665
NORTH, UP = OMEGA * math.cos(30 * DEG), OMEGA * math.sin(30 * DEG)


def test_time_is_the_end_of_the_interval_over_which_a_sample_is_the_mean():
    bench = InertialBench()
    bench.clock.sleep(7.0)
    data = bench.record(2.0)
    assert data["time"] == pytest.approx(7.0 + np.arange(1, 201) / 100, abs=1e-12)


@pytest.mark.parametrize("rate", [1.0, 100.0])
def test_spinning_through_parts_of_turns(rate):
    # About up at 30 deg/s, sampled over 30 deg or 0.3 deg: y starts at north and turns towards west, x from east towards north. With the
    # angle q from q0 to q1 the mean of cos q is (sin q1 − sin q0)/(q1 − q0), of sin q (cos q0 − cos q1)/(q1 − q0).
    bench = InertialBench()
    bench.orient(LEVEL)
    bench.move(Spin(30 * DEG))
    data = bench.record(12.0, motion=Spin(30 * DEG), rate=rate)
    q = 30**2 / 2 / 50 * DEG + 30 * DEG * np.arange(0, 12 * rate + 1) / rate  # spinning up covers ω²/2a
    width = np.diff(q)
    assert data["gyro_y"] == pytest.approx(NORTH * np.diff(np.sin(q)) / width, abs=1e-15)
    assert data["gyro_x"] == pytest.approx(-NORTH * np.diff(np.cos(q)) / width, abs=1e-15)
    assert data["gyro_z"] == pytest.approx(np.full(q.size - 1, 30 + UP), rel=1e-14)


def test_over_a_whole_turn_only_what_lies_along_the_axis_is_left():
    bench = InertialBench()
    bench.orient(LEVEL)
    bench.move(Spin(-30 * DEG))
    data = bench.record(120.0, motion=Spin(-30 * DEG), rate=1 / 12)
    assert data["gyro_x"] == pytest.approx(np.zeros(10), abs=1e-15)
    assert data["gyro_y"] == pytest.approx(np.zeros(10), abs=1e-15)
    assert data["gyro_z"] == pytest.approx(np.full(10, -30 + UP), rel=1e-14)


TURNS = (math.pi, math.pi / 2, -math.pi, -math.pi / 2)
PLACES = {"A": 0.0, "C": math.pi, "D": 1.5 * math.pi, "B": math.pi / 2}
CYCLE = Cycle(
    PLACES,
    tuple(Move(a, turn, b) for a, turn, b in zip("ACDB", TURNS, "CDBA", strict=True)),
    10 * DEG,
    3.003,
)


def cycle_angle(t):
    """Angle [rad] of the cycle above by its definition: stop 3.003 s, trapezoid at 10 deg/s and 50 deg/s² (0.2 s, 1 deg each ramp)."""
    while True:
        base = 0.0
        for turn in TURNS:
            size = abs(turn) / DEG
            lasting = 3.003 + size / 10 + 0.2
            if t < lasting:
                s = max(0.0, t - 3.003)
                end = size / 10 + 0.2
                if s < 0.2:
                    way = 25 * s * s
                elif s < end - 0.2:
                    way = 1 + 10 * (s - 0.2)
                else:
                    way = size - 25 * (end - s) ** 2
                return base + math.copysign(way * DEG, turn)
            t -= lasting
            base += turn


def test_a_cycle_of_turns_and_stops_with_ramps_within_intervals():
    quad = pytest.importorskip("scipy.integrate").quad
    bench = InertialBench()
    bench.orient(LEVEL)
    bench.move(CYCLE)
    one = 4 * 3.003 + 54 + 0.8
    data = bench.record(2 * one, motion=CYCLE, rate=7.0)
    edges = np.arange(data["time"].size + 1) / 7.0
    angles = np.array([cycle_angle(t) for t in edges])
    # The mean rate about up is the angle's difference over the interval.
    assert data["gyro_z"] - UP == pytest.approx(np.diff(angles) / DEG * 7.0, abs=1e-11)
    corners = []
    since = 0.0
    for turn in (*TURNS, *TURNS):
        begin = since + 3.003
        since = begin + abs(turn) / DEG / 10 + 0.2
        corners += [begin, begin + 0.2, since - 0.2, since]
    for k in range(0, edges.size - 1, 3):
        inside = [c for c in corners if edges[k] < c < edges[k + 1]]
        cuts = [edges[k], *inside, edges[k + 1]]
        mean = sum(quad(lambda t: math.cos(cycle_angle(t)), a, b, epsabs=1e-14)[0] for a, b in itertools.pairwise(cuts))
        assert data["gyro_y"][k] == pytest.approx(NORTH * mean * 7.0, abs=1e-12 * NORTH + 1e-15), edges[k]


def test_turns_add_up_over_a_day():
    bench = InertialBench("gyros: {axes: {z: {}}}", latitude=0.0, rate=50)
    bench.orient(LEVEL)
    stop = 291.0
    cycle = Cycle(PLACES, CYCLE.moves, 10 * DEG, stop)
    bench.clock.sleep(1e5 / 3)
    bench.move(cycle)
    one = 4 * stop + 54 + 0.8
    total, worst, time = 0.0, 0.0, bench.clock.now()
    start = time
    for block in bench.sensor.stream(bench.segment(71 * one, motion=cycle)):
        turned = total + np.cumsum(block.channels["gyro_z"]) / 50
        within = (block.time[::997] - start) % one
        expected = np.array([cycle_angle(_compressed(w, stop)) for w in within])
        worst = max(worst, float(np.max(np.abs(turned[::997] - expected / DEG))))
        total = turned[-1]
    assert worst < 1e-7  # deg; times of 1e5 s are known to 1.5e-11 s, at 10 deg/s


def _compressed(within, stop):
    """The time in the cycle with stops of 3.003 s at which it stands where that with stops of `stop` s does at `within`."""
    passed = 0.0
    for turn in TURNS:
        moving = abs(turn) / DEG / 10 + 0.2
        if within < stop + moving:
            return passed + (3.0 if within < stop else 3.003 + within - stop)
        within -= stop + moving
        passed += 3.003 + moving
    return passed


ROCK = Rock(3 * DEG, 0.6, (0.0, math.pi / 4, math.pi / 2), 40.0)


def platform(t):
    """Attitude matrices (…, 3, 3) of the rocking table by multiplication, at times after its phase zero."""
    a, b, c = (ROCK.amplitude * np.sin(2 * np.pi * ROCK.frequency * t + p) for p in ROCK.phases)
    zero, one = np.zeros_like(t), np.ones_like(t)
    about_up = [[np.cos(a), -np.sin(a), zero], [np.sin(a), np.cos(a), zero], [zero, zero, one]]
    about_east = [[one, zero, zero], [zero, np.cos(b), -np.sin(b)], [zero, np.sin(b), np.cos(b)]]
    about_north = [[np.cos(c), zero, np.sin(c)], [zero, one, zero], [-np.sin(c), zero, np.cos(c)]]
    z, x, y = (np.moveaxis(np.array(m), (0, 1), (-2, -1)) for m in (about_up, about_east, about_north))
    return z @ x @ y


def rocking(rate, fastest=100):
    bench = InertialBench(rate=fastest)
    bench.orient(LEVEL)
    bench.move(ROCK)
    return bench.record(20.0, motion=ROCK, rate=rate)


def test_rocking_of_three_rings_against_dense_sums():
    data = rocking(5.0)
    fine = 4000  # steps an interval; Simpson's rule leaves (h/fine)⁴
    for k in (0, 3, 17, 58, 99):
        t = (k + np.arange(fine + 1) / fine) / 5.0
        here = platform(t)
        slope = (-platform(t + 2e-4) + 8 * platform(t + 1e-4) - 8 * platform(t - 1e-4) + platform(t - 2e-4)) / 12e-4
        skew = np.swapaxes(here, -1, -2) @ slope
        turning = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)
        rate = turning + np.array([0, NORTH * DEG, UP * DEG]) @ here
        force = np.array([0, 0, G]) @ here
        weights = np.ones(fine + 1)
        weights[1:-1:2], weights[2:-1:2] = 4, 2
        weights /= 3 * fine
        for axis, (omega, f) in enumerate(zip((weights @ rate) / DEG, weights @ force, strict=True)):
            assert data[f"gyro_{'xyz'[axis]}"][k] == pytest.approx(omega, abs=2e-10)
            assert data[f"accel_{'xyz'[axis]}"][k] == pytest.approx(f, abs=1e-11)


def test_rocking_has_converged():
    # Means over intervals of 0.2 s are the means of what was found over 1 ms with points of its own.
    coarse, fine = rocking(5.0), rocking(1000.0, fastest=1000)
    for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"):
        assert coarse[name] == pytest.approx(fine[name].reshape(100, 200).mean(axis=1), abs=1e-11 * G)


@pytest.mark.parametrize(("rate", "bound"), [(50.0, 4e-7), (100.0, 3e-8)])
def test_coning_is_in_the_increments(rate, bound):
    """Attitude from increments alone, with the two-sample coning correction, follows the table; its error is of fourth order.

    Without the correction the attitude drifts by ½·∫α × dα: the increments are those of a body that cones, not of one that turns about
    one axis at a time.
    """
    bench = InertialBench("gyros: {axes: {x: {}, y: {}, z: {}}}")
    bench.world.site = type(bench.world.site)(0.5, earth_rate=0.0)
    bench.orient(LEVEL)
    bench.move(ROCK)
    data = bench.record(20.0, motion=ROCK, rate=rate)
    increments = np.stack([data[f"gyro_{axis}"] for axis in "xyz"], axis=-1) * DEG / rate
    pairs = increments.reshape(-1, 2, 3)
    attitude = {True: platform(np.zeros(1))[0], False: platform(np.zeros(1))[0]}
    for first, second in pairs:
        for corrected in attitude:
            vector = first + second + (2 / 3 * np.cross(first, second) if corrected else 0)
            attitude[corrected] = attitude[corrected] @ _rotation(vector)
    true = platform(np.array([20.0]))[0]
    errors = {corrected: float(np.linalg.norm(found - true)) for corrected, found in attitude.items()}
    assert errors[True] < bound
    assert errors[False] > 100 * errors[True]


def _rotation(vector):
    angle = np.linalg.norm(vector)
    k = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]]) / angle
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def test_on_a_carrier_means_are_those_of_what_is_felt_meanwhile():
    keys = {"carrier": "{speed: 10 m/s, heading: 60 deg, period: 7 s, start: 1.03 s}", "rate": 10}
    bench = InertialBench(**keys)
    data = bench.record(20.0)
    fine = 2000
    assert bench.world.track is not None
    for k in (0, 10, 55, 199):
        t = (k + (np.arange(fine) + 0.5) / fine) / 10
        _, force = bench.world.track.felt(t, EARTH_RATE)
        # The midpoint rule leaves 1e-11 where it is smooth, and half a step where the carrier starts.
        assert data["accel_x"][k] == pytest.approx(force[0].mean(), abs=2e-3 if k == 10 else 1e-8)
    place = bench.world.position(data["time"])
    assert bench.world.track.place(np.array([1.0])).latitude == pytest.approx(np.array([30 * DEG]), abs=1e-13)
    # What the accelerometers feel in 1 s adds up to the velocity gained, but for Coriolis forces of 1.5e-4·v.
    gained = np.diff(np.asarray(place[3])[9::10])
    summed = data["accel_x"].reshape(-1, 10).sum(axis=1)[1:] / 10
    assert summed == pytest.approx(gained, abs=2e-3)
