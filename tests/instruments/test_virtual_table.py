"""The virtual table and chamber: moves, limits, errors that stay, and temperatures by an independent integration."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import (
    HoldsOrientation,
    HoldsTemperature,
    InstrumentError,
    Moves,
    Readable,
    Resumable,
    Surroundings,
)
from planrunner.instruments.virtual.chamber import VirtualChamber, VirtualChamberParameters
from planrunner.instruments.virtual.courses import trapezoid
from planrunner.instruments.virtual.table import VirtualTable, VirtualTableParameters
from planrunner.instruments.virtual.thermal import Command, Lags, temperatures
from planrunner.physics.earth import EARTH_RATE, Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Cycle, Move, Rock, Spin

DEG = math.pi / 180
LEVEL = np.eye(3)
AXES = """[{name: outer, direction: up, max_rate: 10 deg/s, max_acceleration: 5 deg/s^2}, {name: middle, direction:
 east, max_rate: 10 deg/s, max_acceleration: 5 deg/s^2, lowest: -LIMIT deg, highest: LIMIT deg}, {name: inner,
 direction: north, max_rate: 10 deg/s, max_acceleration: 5 deg/s^2}]"""


def read(record, text):
    log = Findings()
    made = RecordOf(record).read(source.parse(text, "t"), log)
    assert list(log) == []
    return made


def table(seed=1, more="", limit=100):
    surroundings = Surroundings(VirtualClock(), Site(0.7), seed=seed)
    return VirtualTable.connect(
        read(VirtualTableParameters, f"{{axes: {AXES}{more}}}".replace("LIMIT", str(limit))), surroundings
    ), surroundings.clock


def chamber():
    surroundings = Surroundings(VirtualClock(), Site(0.7))
    text = "{lowest: -40 degC, highest: 60 degC, ramp: 3 K/min, lag: 2 min, tolerance: 0.5 K}"
    return VirtualChamber.connect(read(VirtualChamberParameters, text), surroundings), surroundings.clock


def test_they_can_do_what_they_must():
    for of_a_table in (HoldsOrientation, Moves, Readable, Resumable):
        assert isinstance(table()[0], of_a_table)
    for of_a_chamber in (HoldsTemperature, Readable, Resumable):
        assert isinstance(chamber()[0], of_a_chamber)


def test_a_move_takes_its_trapezoid_and_holds_only_then():
    moving, clock = table()
    quarter = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # x north: 90 deg about up
    assert moving.orient(quarter) == pytest.approx(11.0)  # 2 s up, 7 s at 10 deg/s, 2 s down
    clock.sleep(10.9)
    assert not moving.holding()
    assert moving.read()["outer_deg"] == pytest.approx(90 - 0.5 * 5 * 0.1**2)
    clock.sleep(0.1)
    assert moving.holding()
    assert moving.read() == pytest.approx({"outer_deg": 90, "middle_deg": 0, "inner_deg": 0})


def test_the_trapezoid_is_the_integral_of_its_rate():
    t = np.linspace(0, 30, 30_001)
    for distance in (170 * DEG, -4 * DEG, 0.0):
        angle, rate = trapezoid(t, distance, 10 * DEG, 5 * DEG)
        integral = np.concatenate(([0], np.cumsum((rate[1:] + rate[:-1]) / 2 * 1e-3)))
        assert np.abs(angle - integral).max() < 1e-6
        assert angle[-1] == pytest.approx(distance, abs=1e-12)
        assert np.abs(np.diff(rate)).max() <= 5 * DEG * 1e-3 + 1e-12


def test_an_orientation_beyond_its_limits_is_refused():
    # y up: the middle axis would have to be at ±90 deg, whichever way the others turn.
    limited, _ = table(limit=45)
    with pytest.raises(
        InstrumentError, match=r"cannot take this orientation: the axis 'middle' .* 90 deg; .* -45 to 45 deg"
    ):
        limited.orient(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))


def test_a_spin_about_a_direction_without_an_axis_is_refused():
    moving, clock = table()
    clock.sleep(moving.orient(np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]])))
    with pytest.raises(InstrumentError, match="cannot spin about this direction"):
        moving.begin_motion(Spin(1 * DEG, (0.0, 1.0, 0.0)), 10.0)


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        (Spin(20 * DEG), "spinning needs 20 deg/s; the outer axis reaches at most 10 deg/s"),
        (Rock(10 * DEG, 1.0, (0.0,), 10.0), "rocking needs .* deg/s; the outer axis reaches"),
        (
            Rock(0.2 * DEG, 1.0, (0.0,), 10.0),
            r"rocking needs .* deg/s\^2; the outer axis reaches at most 5 deg/s\^2",
        ),
        (Rock(0.1 * DEG, 0.1, (0.0,) * 4, 10.0), "4 rings are planned to rock, but the table has 3"),
        (
            Rock(101 * DEG, 0.001, (0.0, 0.0), 10.0),
            "rocking turns the middle axis from -101 to 101 deg; the axis can turn only from -100 to 100 deg",
        ),
        (Cycle({"A": 0.0}, (Move("A", math.pi, "A"),), 30 * DEG, 1.0), "turning needs 30 deg/s"),
    ],
)
def test_motions_beyond_it_are_refused(motion, words):
    moving, _ = table()
    with pytest.raises(InstrumentError, match=words):
        moving.begin_motion(motion, 10.0)


def test_it_does_not_take_an_orientation_while_it_spins():
    moving, clock = table()
    clock.sleep(moving.begin_motion(Spin(10 * DEG), 10.0))
    with pytest.raises(InstrumentError, match="still moving"):
        moving.orient(LEVEL)
    assert moving.end_motion() == pytest.approx(2.0)
    clock.sleep(2.0)
    clock.sleep(moving.orient(LEVEL))
    assert moving.holding()


def test_made_safe_it_stops_however_often():
    moving, clock = table()
    clock.sleep(moving.begin_motion(Spin(-10 * DEG), 10.0))
    moving.make_safe()
    moving.make_safe()
    clock.sleep(2.0)
    at_rest = moving.read()
    clock.sleep(100.0)
    assert moving.read() == at_rest
    # 10 deg while spinning up, 10 deg while slowing down.
    assert at_rest["outer_deg"] == pytest.approx(-20.0)


def test_the_pointing_error_stays_with_the_orientation_and_has_the_declared_size():
    first, clock = table(more=", position_error: 10 arcsec")
    other = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    skews = []
    for attitude in (LEVEL, other, LEVEL):
        clock.sleep(first.orient(attitude))
        skews.append(first.world.skew.copy())
    assert np.array_equal(skews[0], skews[2])
    assert not np.array_equal(skews[0], skews[1])
    again, _ = table(more=", position_error: 10 arcsec")
    again.orient(LEVEL)
    assert np.array_equal(again.world.skew, skews[0])
    angles = []
    for seed in range(300):
        drawn, _ = table(seed=seed, more=", position_error: 10 arcsec")
        drawn.orient(LEVEL)
        skew = drawn.world.skew
        angles += [skew[2, 1] / DEG * 3600, skew[0, 2] / DEG * 3600, skew[1, 0] / DEG * 3600]
    assert np.std(angles) == pytest.approx(10.0, rel=0.1)
    assert abs(np.mean(angles)) < 1.5


def test_what_it_declares_is_kept_apart_from_what_is_simulated():
    parameters = read(
        VirtualTableParameters,
        f"{{axes: {AXES}, position_uncertainty: 3 arcsec, rate_stability: 10 ppm}}".replace("LIMIT", "100"),
    )
    model = VirtualTable.model(parameters)
    assert model.position_uncertainty == pytest.approx(3 * DEG / 3600)
    assert model.rate_stability == pytest.approx(1e-5)
    assert model.axes[1].lowest == pytest.approx(-100 * DEG)


def by_small_steps(command, lags, end, step=0.01):
    """Both lags integrated by the midpoint rule."""
    air, sensor, t = command.air, command.sensor, 0.0
    for _ in range(round(end / step)):

        def setpoint(at):
            change = command.target - command.setpoint
            return command.setpoint + math.copysign(min(lags.ramp * at, abs(change)), change)

        half_air = air + step / 2 * (setpoint(t) - air) / lags.air
        half_sensor = sensor + step / 2 * (air - sensor) / lags.sensor
        air += step * (setpoint(t + step / 2) - half_air) / lags.air
        sensor += step * (half_air - half_sensor) / lags.sensor
        t += step
    return air, sensor


@pytest.mark.parametrize("sensor_lag", [40.0, 600.0, 120.0])
@pytest.mark.parametrize("end", [50.0, 300.0])
def test_temperatures_follow_their_equations(sensor_lag, end):
    command = Command(1000.0, 300.0, 298.0, 297.0, 306.0)
    lags = Lags(0.05, 120.0, sensor_lag)
    _, air, sensor = temperatures(command, lags, np.array([1000.0, 1000.0 + end]))
    expected = by_small_steps(command, lags, end)
    assert (air[0], sensor[0]) == pytest.approx((298.0, 297.0))
    # With equal time constants the closed form is taken a millionth apart.
    assert (air[1], sensor[1]) == pytest.approx(expected, abs=1e-5)


def test_the_chamber_says_how_long_it_takes_and_is_there_then():
    warm, clock = chamber()
    seconds = warm.set_temperature(313.15)
    # 15 K at 3 K/min are 300 s; the air then lags by 0.05·120·(1 − e^(−300/120)) = 5.5075 K, and comes within 0.5 K after
    # 120·ln(5.5075/0.5) = 287.9 s.
    assert seconds == pytest.approx(300 + 287.9, abs=0.1)
    clock.sleep(seconds - 1)
    assert not warm.at_temperature()
    clock.sleep(1)
    assert warm.at_temperature()
    assert warm.read()["air_degC"] == pytest.approx(39.5)
    assert warm.set_temperature(313.15) == 0.0 or warm.at_temperature()


def test_the_chamber_refuses_what_it_cannot_reach_and_goes_home():
    warm, clock = chamber()
    with pytest.raises(InstrumentError, match="61 degC is outside the chamber's range of -40 to 60 degC"):
        warm.set_temperature(334.15)
    clock.sleep(warm.set_temperature(320.0))
    warm.make_safe()
    clock.sleep(3600.0)
    assert warm.read()["air_degC"] == pytest.approx(25.0, abs=1e-3)
    state = json.dumps(warm.checkpoint())
    again, later = chamber()
    later.set(clock.now())
    again.restore(json.loads(state))
    assert again.read() == warm.read()


def test_temperature_does_not_depend_on_how_often_it_is_asked():
    asked, clock = chamber()
    quiet, other = chamber()
    asked.set_temperature(310.0)
    quiet.set_temperature(310.0)
    for _ in range(50):
        clock.sleep(3.7)
        asked.read()
    other.set(clock.now())
    assert asked.read() == quiet.read()


def test_words_mean_true_directions_wherever_the_table_looks():
    # The table's reference direction lies 20 deg east of north; x east, y north, z up still feel (0, cos 30°, sin 30°) of the Earth's
    # rate.
    surroundings = Surroundings(VirtualClock(), Site(30 * DEG, azimuth=20 * DEG))
    text = f"{{axes: {AXES}}}".replace("LIMIT", "100")
    turned = VirtualTable.connect(read(VirtualTableParameters, text), surroundings)
    surroundings.clock.sleep(turned.orient(LEVEL))
    rate, _ = turned.world.stimulus(np.array([surroundings.clock.now()]))
    assert np.array(rate) / EARTH_RATE == pytest.approx([0.0, math.sqrt(0.75), 0.5], abs=1e-12)


def followed(moving, begin, end, count=20_001):
    """Times and the outermost joint's angle and rate, rad and rad/s."""
    times = np.linspace(begin, end, count)
    angle, rate = moving.world.course.follow(times)[0]
    return times, np.broadcast_to(angle, times.shape), np.broadcast_to(rate, times.shape)


@pytest.mark.parametrize("dwell", [2.0, 2.13, 5.777])
def test_rocking_that_is_ended_fades_out_and_the_table_takes_the_next_motion(dwell):
    moving, clock = table()
    motion = Rock(0.1 * DEG, 0.5, (0.3,), dwell)
    for _ in range(3):
        clock.sleep(moving.orient(LEVEL))
        clock.sleep(moving.begin_motion(motion, dwell))
        clock.sleep(dwell)
        here, now = moving.world.joints(clock.now()), clock.now()
        left = moving.end_motion()
        assert left == pytest.approx(2.0)  # one period
        times, angle, rate = followed(moving, now, now + left)
        assert angle[0] == pytest.approx(here[0][0], abs=1e-12)
        assert rate[0] == pytest.approx(here[1][0], abs=1e-12)  # no jump
        assert np.abs(np.diff(rate)).max() < 5 * DEG * (times[1] - times[0])  # within the acceleration of the axis
        clock.sleep(left)
        assert moving.holding()
    assert moving.orient(LEVEL) == 0.0


def test_a_cycle_that_is_ended_within_a_turn_brakes():
    moving, clock = table()
    clock.sleep(
        moving.begin_motion(Cycle({"A": 0.0}, (Move("A", math.pi, "A"), Move("A", -math.pi, "A")), 10 * DEG, 1.0), 60.0)
    )
    clock.sleep(10.0)  # 1 s at rest, 2 s of ramp, then 10 deg/s
    angle = moving.world.joints(clock.now())[0][0]
    left = moving.end_motion()
    assert left == pytest.approx(2.0)  # from 10 deg/s at 5 deg/s^2
    clock.sleep(left)
    assert moving.holding()
    assert moving.world.joints(clock.now())[0][0] - angle == pytest.approx(10 * DEG)  # 10 deg/s for 2 s, halved
    moving.orient(LEVEL)


def test_a_spin_that_would_wind_up_cables_is_refused_with_its_ramps():
    moving, _ = table(limit=100)
    with pytest.raises(InstrumentError, match="turns the middle axis by 101 deg"):
        # 8.1 s at 10 deg/s and two ramps of 2 s, each worth 10 deg
        moving.begin_motion(Spin(10 * DEG, (1.0, 0.0, 0.0)), 8.1)
    moving.begin_motion(Spin(10 * DEG, (1.0, 0.0, 0.0)), 7.9)
