"""What rotation cycles leave, against hand-worked figures, Fresnel integrals, the virtual table's course and an integrated Schuler loop."""

from __future__ import annotations

import cmath
import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp
from scipy.special import fresnel

from planrunner.instruments.virtual.courses import Cycling
from planrunner.physics.earth import Site
from planrunner.physics.modulation import forced_velocity, schuler_drive, schuler_rate
from planrunner.physics.rotation_cycle import RotationCycle

DEG = math.pi / 180
PRINTED = (180, 90, -180, -90, -180, -90, 180, 90)
MIRRORED = (-180, 90, 180, -90, 180, -90, -180, 90)
EIGHT = (90, 90, -90, -90, -90, -90, 90, 90)


def cycle(
    turns: tuple[int, ...], stop: float = 300.0, rate: float = 10.0, acceleration: float = math.inf
) -> RotationCycle:
    return RotationCycle(tuple(turn * DEG for turn in turns), stop, rate * DEG, acceleration * DEG)


@pytest.mark.parametrize(("turns", "sign"), [(PRINTED, -1), (MIRRORED, 1)])
def test_the_printed_cycle_leaves_four_over_the_turn_rate(turns: tuple[int, ...], sign: int) -> None:
    # Turning from a to b at rate w leaves (e^ib − e^ia)/(iw). Of the printed cycle the quarter turns C→D, B→A, C→B, D→A leave
    # 1−i, −1−i, 1+i … in units of 1/w that cancel; the half turns leave 2i − 2 − 2i − 2, hence −4/w = −22.918 s at 10 deg/s.
    stops, left = cycle(turns).integral()
    assert abs(stops) < 1e-9
    assert left == pytest.approx(sign * 4 / (10 * DEG), abs=1e-9)
    assert left.real == pytest.approx(sign * 22.918, abs=5e-4)


def half_turn(rate: float, acceleration: float) -> float:
    """∫ sin θ dt over 0 → π with ramps, by Fresnel integrals: twice a ramp from rest, and steady turning between."""
    ramp = rate / acceleration
    covered = rate**2 / (2 * acceleration)
    scale = math.sqrt(math.pi / acceleration)
    ramps = 2 * scale * fresnel(ramp / scale)[0]  # ∫ sin(a·t²/2) dt
    return float(ramps + 2 * math.cos(covered) / rate)


def test_ramps_by_fresnel_integrals() -> None:
    # Both quarter turns of each kind still cancel by symmetry; two half turns leave −half_turn each.
    _, left = cycle(PRINTED, acceleration=5).integral()
    assert left == pytest.approx(-2 * half_turn(10 * DEG, 5 * DEG), abs=1e-10)
    assert left.real == pytest.approx(-23.03, abs=5e-3)


@pytest.mark.parametrize("acceleration", [0.05, 0.5, 5, 50])
def test_a_turn_by_adaptive_quadrature(acceleration: float) -> None:
    # 0.05 and 0.5 deg/s² never reach the rate: two ramps of 85 deg, of up to 41 s each.
    size, rate, acc = 170 * DEG, 10 * DEG, acceleration * DEG
    one = RotationCycle((size, -size), 7.0, rate, acc)
    peak = min(rate, math.sqrt(size * acc))
    ramp, whole = peak / acc, peak / acc + size / peak

    def angle(time: float) -> float:
        late = whole - time
        if time < ramp:
            return acc * time**2 / 2
        return size - acc * late**2 / 2 if late < ramp else peak * (time - ramp / 2)

    frequency = 0.013
    expected = 0j
    for part, turn in ((7.0, angle), (14.0 + whole, lambda time: size - angle(time))):
        for of, unit in ((math.cos, 1), (math.sin, 1j)):
            expected += unit * quad(
                lambda time, of=of, turn=turn, part=part: of(turn(time) - frequency * (part + time)),
                0, whole, points=[ramp, whole - ramp], epsabs=1e-12, limit=400,
            )[0]  # fmt: skip
    assert one.period == pytest.approx(2 * (7 + whole))
    assert one.integral(frequency)[1] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("acceleration", [math.inf, 5, 0.7])
def test_alternating_both_leaves_nothing(acceleration: float) -> None:
    both = cycle(PRINTED + MIRRORED, acceleration=acceleration)
    stops, turns = both.integral()
    assert abs(stops) < 1e-9
    assert abs(turns) < 1e-9
    assert both.balanced
    assert both.net_turn == pytest.approx(0, abs=1e-12)
    assert np.degrees(both.reach) == pytest.approx((-270, 270))
    assert both.mean_angle == pytest.approx(0, abs=1e-12)


def test_eight_moves_suffice_in_another_order_of_stops() -> None:
    eight = cycle(EIGHT, acceleration=5)
    assert eight.balanced
    assert np.degrees(eight.reach) == pytest.approx((-180, 180))
    assert eight.net_turn == 0
    assert eight.mean_angle == pytest.approx(0, abs=1e-12)
    visits = [round(angle) % 360 for angle in np.degrees(eight.stops)]
    assert sorted(visits) == [0, 0, 90, 90, 180, 180, 270, 270]


@pytest.mark.parametrize("acceleration", [math.inf, 5])
def test_with_the_printed_order_every_cycle_that_leaves_nothing_winds_up(acceleration: float) -> None:
    found = []
    halves = [index for index, turn in enumerate(PRINTED) if abs(turn) == 180]
    for signs in itertools.product((1, -1), repeat=len(halves)):
        turns = list(PRINTED)
        for index, sign in zip(halves, signs, strict=True):
            turns[index] = 180 * sign
        one = cycle(tuple(turns), acceleration=acceleration)
        if one.balanced:
            found.append(round(math.degrees(one.net_turn)))
    assert found
    assert set(found) <= {360, -360}


def test_asymmetric_stops_and_mean_angle() -> None:
    # Stops at 0, 90, 0 (three, of 10 s): 20 s along and 10 s across; no turning time worth mentioning at 1e9 deg/s.
    one = cycle((90, -90, 0), stop=10, rate=1e9)
    stops, turns = one.integral()
    assert stops == pytest.approx(20 + 10j)
    assert abs(turns) < 1e-6
    assert math.degrees(one.mean_angle) == pytest.approx(30)
    # Turning there and back without stops: the mean of a full turn is half of it, and nothing is left without ramps.
    there_and_back = cycle((360, -360), stop=0)
    assert math.degrees(there_and_back.mean_angle) == pytest.approx(180)
    assert abs(there_and_back.residual) < 1e-9
    assert there_and_back.period == pytest.approx(72)


def test_three_positions_balance_without_opposites() -> None:
    one = cycle((120, 120, -240, 240, -120, -120), stop=60, rate=1e9)
    assert abs(one.integral()[0]) < 1e-9


def test_a_cycle_that_takes_no_time() -> None:
    with pytest.raises(ValueError, match="takes no time"):
        cycle((0, 0), stop=0)


def test_the_course_by_hand() -> None:
    # 180 deg at 10 deg/s with 5 deg/s²: ramps of 2 s over 10 deg each, 16 s of steady turning, 20 s in all.
    one = cycle((180, -180), stop=100, acceleration=5)
    assert one.period == pytest.approx(240)
    times = np.array([0.0, 100, 101, 102, 110, 118, 119, 120, 219.9, 221, 230, 240, 341, 580])
    degrees = [0, 0, 2.5, 10, 90, 170, 177.5, 180, 180, 177.5, 90, 0, 2.5, 0]
    assert np.degrees(one.angle(times)) == pytest.approx(degrees)
    # 9 deg is too short to reach 10 deg/s: the peak is √45 deg/s.
    short = cycle((9, -9), stop=0, acceleration=5)
    assert short.period == pytest.approx(4 * math.sqrt(9 / 5))
    assert math.degrees(short.angle(np.array([math.sqrt(9 / 5)]))[0]) == pytest.approx(4.5)


@pytest.mark.parametrize("acceleration", [5, 0.7, 200])
def test_the_virtual_table_keeps_the_same_time(acceleration: float) -> None:
    turns = tuple(turn * DEG for turn in (*PRINTED, 7, -7))
    one = RotationCycle(turns, 30.0, 10 * DEG, acceleration * DEG)
    course = Cycling(12.0, (0.4, 0.1), 0, turns, 10 * DEG, acceleration * DEG, 30.0)
    times = np.linspace(0, 2.7 * one.period, 5001)
    joint = course.follow(12.0 + times)[0][0]
    assert np.max(np.abs(joint - 0.4 - one.angle(times))) < 1e-9


SITE = Site(0.0, 9.79)  # on the equator the Earth's rotation leaves the Schuler oscillation's plane alone


def oscillation(one: RotationCycle, count: int) -> float:
    """Size of the free oscillation left after `count` cycles of a unit gyro error, over that of a constant one, from the Schuler loop
    integrated numerically and then left to itself."""
    natural = schuler_rate(SITE)

    def slope(time: float, state: NDArray[np.complex128]) -> list[complex]:
        return [state[1], -(natural**2) * state[0] + cmath.exp(1j * float(one.angle(np.array([time]))[0]))]

    whole = count * one.period

    solved = solve_ivp(slope, (0, whole), [0j, 0j], t_eval=[whole], rtol=1e-8, atol=1e-4, max_step=4.0)
    velocity, change = solved.y[:, -1]
    forward, backward = (velocity + change / (1j * natural)) / 2, (velocity - change / (1j * natural)) / 2
    return float((abs(forward) + abs(backward)) * natural**2)


@pytest.mark.slow
@pytest.mark.parametrize(("turns", "stop", "count"), [(PRINTED + MIRRORED, 300.0, 4), (PRINTED, 600.0, 4)])
def test_resonance_with_the_schuler_period(turns: tuple[int, ...], stop: float, count: int) -> None:
    one = cycle(turns, stop=stop, acceleration=200)
    predicted = schuler_drive(one, count * one.period, SITE)
    assert predicted == pytest.approx(oscillation(one, count), rel=1e-3)


def test_resonance_grows_with_every_cycle_and_is_absent_far_from_it() -> None:
    near, far = cycle(PRINTED + MIRRORED, acceleration=200), cycle(PRINTED + MIRRORED, stop=180, acceleration=200)
    assert schuler_drive(near, 24 * 3600, SITE) > 4 * schuler_drive(near, 5 * 3600, SITE)
    assert schuler_drive(far, 72 * 3600, SITE) < 0.2


def test_forced_velocity_of_the_mean_is_that_of_a_constant_drift() -> None:
    # What is left of the printed cycle is a drift of −22.918/2508 of the error: a constant east drift ε moves north at −R·ε.
    one = cycle(PRINTED)
    drift = 0.01 * DEG / 3600
    mean, _ = forced_velocity(one, complex(drift), 0j, SITE, 0)
    share = -4 / (10 * DEG) / 2508
    assert mean == pytest.approx(-1j * 6_371_009.0 * drift * share)


def test_forced_velocity_at_the_cycles_frequency_against_the_loop() -> None:
    # The loop integrated from rest over a cycle gives p; the motion that repeats begins at s with s = Φ·s + p, Φ the free motion.
    one = cycle(EIGHT, stop=60, acceleration=200)
    natural, gravity = schuler_rate(SITE), SITE.gravity
    gyro, accelerometer = 3e-8 - 1e-8j, 2e-4 + 4e-4j

    def slope(time: float, state: NDArray[np.complex128]) -> list[complex]:
        turned = cmath.exp(1j * float(one.angle(np.array([time]))[0]))
        return [-1j * gravity * state[1] + accelerometer * turned, gyro * turned - 1j * natural**2 / gravity * state[0]]

    times = np.linspace(0, one.period, 600, endpoint=False)
    settings = {"rtol": 1e-9, "atol": 1e-12, "max_step": 1.0}
    (end,) = solve_ivp(slope, (0, one.period), [0j, 0j], t_eval=[one.period], **settings).y.T
    c, s = math.cos(natural * one.period), math.sin(natural * one.period)
    free = np.array([[c, -1j * gravity / natural * s], [-1j * natural / gravity * s, c]])
    begin = np.linalg.solve(np.eye(2) - free, end)
    velocity = solve_ivp(slope, (0, one.period), begin, t_eval=times, **settings).y[0]
    for harmonic in (1, 2, 3):
        turning = np.exp(2j * math.pi * harmonic * times / one.period)
        forward, backward = forced_velocity(one, gyro, accelerometer, SITE, harmonic)
        assert np.mean(velocity / turning) == pytest.approx(forward, rel=1e-4, abs=1e-6)
        assert np.mean(velocity * turning) == pytest.approx(backward, rel=1e-4, abs=1e-6)
