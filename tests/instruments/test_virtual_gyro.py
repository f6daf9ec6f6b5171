"""The virtual flexure gyro against hand-worked pulses, the theory of its noise, and itself after a restart."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import InstrumentError, Resumable, StreamsSamples, Surroundings
from planrunner.instruments.virtual.flexure_gyro import VirtualFlexureGyro, VirtualFlexureGyroParameters
from planrunner.instruments.virtual.noise import Flicker, generator
from planrunner.instruments.virtual.streaming import BLOCK
from planrunner.instruments.virtual.table import VirtualTable, VirtualTableParameters
from planrunner.physics.earth import Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Cycle, Move, Rest, Rock, Segment, Spin

DEG = math.pi / 180
GYRO = {
    "scale_factor": "{x: 0.2 (deg/h)/(pulse/s), y: 0.25 (deg/h)/(pulse/s)}",
    "drift_x": "{F: 1 deg/h, X: 2 deg/h/g, Y: -3 deg/h/g, Z: 0.5 deg/h/g}",
    "drift_y": "{F: -2 deg/h, X: 4 deg/h/g, Y: 1 deg/h/g, Z: -0.25 deg/h/g}",
    "full_scale": "10000000 pulse/s",
    "sample_rate": "100 Hz",
    "thermometer_noise": "0 K",
}
AXES = """[{name: outer, direction: up, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2},
 {name: middle, direction: east, max_rate: 200 deg/s, max_acceleration: 100 deg/s^2},
 {name: inner, direction: north, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}]"""
X_UP = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # x up, y north, z west
LEVEL = np.eye(3)


def read(record, text):
    log = Findings()
    made = RecordOf(record).read(source.parse(text, "t"), log)
    assert list(log) == []
    return made


def bench(seed=1, latitude=30.0, table="", **changes):
    """A table and a gyro on it, standing at a site where 1 g is 9.80665 m/s^2."""
    surroundings = Surroundings(VirtualClock(), Site(latitude * DEG, 9.80665), seed=seed)
    moving = VirtualTable.connect(read(VirtualTableParameters, f"{{axes: {AXES}{table}}}"), surroundings)
    text = "\n".join(f"{name}: {value}" for name, value in (GYRO | changes).items())
    gyro = VirtualFlexureGyro.connect(read(VirtualFlexureGyroParameters, text), surroundings)
    return moving, gyro, surroundings.clock


def segment(dwell, index=0, motion=None, attitude=LEVEL):
    return Segment(index, f"S{index}", attitude, "", motion or Rest(), dwell)


def record(gyro, piece):
    blocks = list(gyro.stream(piece))
    return {name: np.concatenate([b.channels[name] for b in blocks]) for name in gyro.channels()}, blocks


def orient(table, clock, attitude):
    clock.sleep(table.orient(attitude))
    assert table.holding()


def test_it_can_do_what_a_sensor_must():
    _, gyro, _ = bench()
    assert isinstance(gyro, StreamsSamples)
    assert isinstance(gyro, Resumable)
    assert dict(gyro.channels()) == {"torquer_x": "pulse/s", "torquer_y": "pulse/s", "sensor_temperature": "degC"}


def test_pulses_by_hand_without_misalignment():
    # x up, y north, z west at latitude 30 deg: ω_X = 15.041067·sin 30 = 7.5205335, ω_Y = 15.041067·cos 30 = 13.02594611 deg/h,
    # a_X = 1 g, a_Y = a_Z = 0. D(X) = 1 + 2 = 3, D(Y) = −2 + 4 = 2 deg/h.
    # i_x = (13.02594611 + 3)/0.25 = 64.10378445 pulse/s; i_y = (7.5205335 + 2)/0.2 = 47.6026675 pulse/s.
    table, gyro, clock = bench()
    orient(table, clock, X_UP)
    data, _ = record(gyro, segment(1.0))
    assert data["torquer_x"] == pytest.approx(np.full(100, 64.10378445), abs=1e-7)
    assert data["torquer_y"] == pytest.approx(np.full(100, 47.6026675), abs=1e-9)
    assert data["sensor_temperature"] == pytest.approx(np.full(100, 25.0), abs=1e-9)


def test_pulses_by_hand_with_misalignment():
    # As above with ε = 30 deg, ξ = 30 deg, by the closed forms of the source: U1 = cos 60/(0.25·cos 30) = 2.309401077,
    # U2 = sin 60/(0.25·cos 30) = 4, V1 = −sin 30/(0.2·cos 30) = −2.886751346, V2 = cos 30/(0.2·cos 30) = 5 (pulse/s per deg/h).
    # r1 = 16.02594611, r2 = 9.5205335: i_x = 37.01033720 + 38.08213400 = 75.09247120, i_y = −46.26292150 + 47.60266750 = 1.33974600.
    table, gyro, clock = bench(epsilon="30 deg", xi="30 deg")
    orient(table, clock, X_UP)
    data, _ = record(gyro, segment(0.1))
    assert data["torquer_x"] == pytest.approx(np.full(10, 75.0924712), abs=1e-6)
    assert data["torquer_y"] == pytest.approx(np.full(10, 1.3397460), abs=1e-6)


def test_samples_are_whole_counts_and_clipped_at_full_scale():
    table, gyro, clock = bench(resolution="0.5 pulse/s", full_scale="66 pulse/s", white_noise="0.3 pulse/sqrt(s)")
    orient(table, clock, X_UP)
    data, _ = record(gyro, segment(100.0))
    x = data["torquer_x"]
    assert np.array_equal(np.round(x * 2), x * 2)
    assert x.max() == 66.0
    assert 0.1 < np.mean(x == 66.0) < 0.5  # 64.1 ± 3.0
    assert data["torquer_y"].max() <= 66.0


def test_white_noise_is_as_declared():
    _, gyro, _ = bench(white_noise="0.9 pulse/sqrt(s)")
    data, _ = record(gyro, segment(3000.0))
    x, y = data["torquer_x"], data["torquer_y"]
    # One sample of 0.01 s scatters by 0.9/√0.01 = 9; the estimate from 300 000 samples by 0.13 %.
    assert x.std() == pytest.approx(9.0, rel=0.008)
    # Means over 1 s scatter by 0.9; 3000 of them give that to 1.3 %.
    assert y.reshape(3000, 100).mean(axis=1).std() == pytest.approx(0.9, rel=0.06)
    assert abs(np.corrcoef(x, y)[0, 1]) < 5 / math.sqrt(x.size)
    assert abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 5 / math.sqrt(x.size)


def allan_deviation(means):
    """From consecutive means over τ: σ² = ⟨(m[k+1] − m[k])²⟩/2 (IEEE Std 952)."""
    return math.sqrt(0.5 * np.mean(np.diff(means) ** 2))


def test_bias_instability_lies_flat_at_the_floor_of_ieee_952():
    floor = math.sqrt(2 * math.log(2) / math.pi)
    flicker, draw = Flicker(1.0), generator(5, 0)
    flicker.begin(0.0, draw)
    series = flicker.advance(2_000_000, 1.0, draw)
    for tau in (64, 256, 1024):
        means = series[: series.size // tau * tau].reshape(-1, tau).mean(axis=1)
        # Neighbouring differences of flicker are nearly independent: relative scatter about 0.8/√n. The fastest process, of 2 s,
        # leaves 1.5 % at 64 s.
        assert allan_deviation(means) == pytest.approx(floor, rel=0.02 + 3 / math.sqrt(means.size)), tau


def test_flicker_goes_on_across_a_pause_as_its_processes_do():
    # Over a pause far beyond every correlation time nothing is remembered; over a short one nearly everything is.
    draw = generator(1, 0)

    def begun(flicker, time):
        flicker.begin(time, draw)
        assert flicker.state is not None
        return flicker.state.sum()

    far, near = [], []
    for _ in range(400):
        flicker = Flicker(1.0)
        before = begun(flicker, 0.0)
        soon = begun(flicker, 1.0)
        far.append((soon, begun(flicker, 1e8)))
        near.append((before, soon))
    assert abs(np.corrcoef(np.array(far).T)[0, 1]) < 0.25
    assert np.corrcoef(np.array(near).T)[0, 1] > 0.9
    # 15 processes of variance ln2/π each.
    assert np.var(np.array(far)) == pytest.approx(15 * math.log(2) / math.pi, rel=0.2)


def test_flicker_does_not_depend_on_how_it_is_cut_into_chunks_of_any_length():
    # A step of 100 s is beyond one running sum (500 correlation times); the variance must stay that of the processes.
    flicker, draw = Flicker(1.0), generator(2, 0)
    flicker.begin(0.0, draw)
    series = flicker.advance(50_000, 100.0, draw)
    assert np.all(np.isfinite(series))
    assert series.var() == pytest.approx(15 * math.log(2) / math.pi, rel=0.1)


def test_blocks_are_bounded_and_time_increases_by_the_sample_interval():
    table, gyro, clock = bench(white_noise="0.9 pulse/sqrt(s)", bias_instability="0.1 pulse/s")
    orient(table, clock, X_UP)
    start = clock.now()
    _, blocks = record(gyro, segment(2500.03))
    assert [b.time.size for b in blocks] == [BLOCK, BLOCK, 50_003]
    time = np.concatenate([b.time for b in blocks])
    assert np.diff(time) == pytest.approx(0.01, abs=1e-9)
    assert time[0] == start
    assert clock.now() == pytest.approx(start + 2500.03)


NOISY = {"white_noise": "0.9 pulse/sqrt(s)", "bias_instability": "0.5 pulse/s", "resolution": "1 pulse/s"}
STEPS = [(X_UP, Rest()), (LEVEL, Spin(10 * DEG)), (X_UP, Rock(2 * DEG, 0.2, (0.0, 1.0, 2.0), 30.0)), (LEVEL, Rest())]


def carry_out(table, gyro, clock, first, last):
    """Segments first … last − 1, and a checkpoint as JSON text after each."""
    data, checkpoints = [], []
    for index in range(first, last):
        attitude, motion = STEPS[index]
        orient(table, clock, attitude)
        clock.sleep(table.begin_motion(motion, 60.0))
        data.append(record(gyro, segment(60.0, index, motion, attitude))[0])
        clock.sleep(table.end_motion())
        checkpoints.append(json.dumps([clock.now(), table.checkpoint(), gyro.checkpoint()]))
    return data, checkpoints


@pytest.mark.parametrize("broken_after", [1, 2, 3])
def test_a_resumed_run_is_identical_bit_for_bit(broken_after):
    errors = ", position_error: 2 arcsec, rate_error: 5 ppm"
    table, gyro, clock = bench(table=errors, **NOISY)
    whole, checkpoints = carry_out(table, gyro, clock, 0, len(STEPS))
    table, gyro, clock = bench(table=errors, **NOISY)
    now, of_table, of_gyro = json.loads(checkpoints[broken_after - 1])
    clock.set(now)
    table.restore(of_table)
    gyro.restore(of_gyro)
    rest, later = carry_out(table, gyro, clock, broken_after, len(STEPS))
    for before, after in zip(whole[broken_after:], rest, strict=True):
        for name in before:
            assert np.array_equal(before[name], after[name])
    assert later == checkpoints[broken_after:]


def test_another_seed_or_segment_gives_other_noise():
    noise = {
        name: record(bench(seed=seed, **NOISY)[1], segment(1.0, index))[0]["torquer_x"].tolist()
        for name, seed, index in (("a", 1, 0), ("again", 1, 0), ("seed", 2, 0), ("segment", 1, 1))
    }
    assert noise["a"] == noise["again"]
    assert noise["a"] != noise["seed"]
    assert noise["a"] != noise["segment"]


def test_a_spin_is_felt_in_rate_and_in_the_turning_earth_rate():
    # z along east, x up: spinning about up at 1 deg/s puts ω_X = 3600 deg/h + Ω·sin φ; y turns from north towards west, so
    # ω_Y = Ω·cos φ·cos(1 deg/s·t).
    table, gyro, clock = bench()
    attitude = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    orient(table, clock, attitude)
    clock.sleep(table.begin_motion(Spin(1 * DEG), 360.0))
    assert table.holding()
    begin_angle = 0.5 * 1.0**2 / 200  # deg, covered while spinning up
    data, _ = record(gyro, segment(360.0, motion=Spin(1 * DEG), attitude=attitude))
    t = np.arange(36000) / 100
    omega_y = 13.02594611 * np.cos((begin_angle + t) * DEG)
    assert data["torquer_x"] == pytest.approx((omega_y + 3) / 0.25, abs=1e-5)
    assert data["torquer_y"] == pytest.approx(np.full(36000, (3600 + 7.5205335 + 2) / 0.2), rel=1e-9)


def test_rocking_is_felt_as_the_derivative_of_its_angle_and_as_tilt():
    # Level, only the inner ring (about north = y) rocks: ω_Y = θ' + Ω·cos φ; gravity tilts into x: a_X = −sin θ, a_Z = cos θ.
    table, gyro, clock = bench(latitude=90.0)
    orient(table, clock, LEVEL)
    motion = Rock(2 * DEG, 0.5, (0.0, 0.0, math.pi / 2), 20.0)
    clock.sleep(table.begin_motion(motion, 20.0))
    data, _ = record(gyro, segment(20.0, motion=motion))
    t = np.arange(2000) / 100
    outer = middle = 2 * DEG * np.sin(np.pi * t)
    inner = 2 * DEG * np.sin(np.pi * t + np.pi / 2)

    # The chain of rotations by matrices, sample by sample, and rates by central differences.
    def platform(k, dt):
        a, b, c = (2 * DEG * np.sin(np.pi * (t[k] + dt) + p) for p in motion.phases)
        rz = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])
        rx = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
        ry = np.array([[math.cos(c), 0, math.sin(c)], [0, 1, 0], [-math.sin(c), 0, math.cos(c)]])
        return rz @ rx @ ry

    assert np.abs([outer, middle, inner]).max() <= 2 * DEG + 1e-12
    for k in (0, 17, 123, 777, 1999):
        here = platform(k, 0.0)
        slope = (platform(k, 1e-6) - platform(k, -1e-6)) / 2e-6
        skew = here.T @ slope
        rate = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / DEG * 3600 + here.T @ [0, 0, 15.041067]
        force = here.T @ [0, 0, 1.0]
        drift_x = 1 + 2 * force[0] - 3 * force[1] + 0.5 * force[2]
        drift_y = -2 + 4 * force[0] + 1 * force[1] - 0.25 * force[2]
        assert data["torquer_x"][k] == pytest.approx((rate[1] + drift_x) / 0.25, abs=0.05)
        assert data["torquer_y"][k] == pytest.approx((rate[0] + drift_y) / 0.2, abs=0.05)


def test_rocking_stops_after_its_part_of_the_dwell():
    table, gyro, clock = bench()
    orient(table, clock, LEVEL)
    motion = Rock(2 * DEG, 0.5, (0.0,), 10.0)
    still, _ = record(gyro, segment(1.0))
    clock.sleep(table.begin_motion(motion, 30.0))
    data, _ = record(gyro, segment(30.0, motion=motion))
    assert np.ptp(data["torquer_x"][1200:]) < 1e-9
    assert data["torquer_x"][-1] == pytest.approx(still["torquer_x"][0], abs=1e-9)


def test_a_cycle_stops_and_turns_as_stated():
    # Spin axis x up about which the table turns by ±180 deg: at the stop B north-pointing y looks south.
    table, gyro, clock = bench()
    orient(table, clock, X_UP)
    cycle = Cycle({"A": 0.0, "B": math.pi}, (Move("A", math.pi, "B"), Move("B", -math.pi, "A")), 20 * DEG, 10.0)
    clock.sleep(table.begin_motion(cycle, 100.0))
    data, _ = record(gyro, segment(100.0, motion=cycle, attitude=X_UP))
    turn = 180 / 20 + 20 / 200  # s
    y, x = data["torquer_y"], data["torquer_x"]
    assert y[500] == pytest.approx((7.5205335 + 2) / 0.2, abs=1e-6)
    assert x[500] == pytest.approx((13.02594611 + 3) / 0.25, abs=1e-6)
    middle = round((10 + turn / 2) * 100)
    assert y[middle] == pytest.approx((20 * 3600 + 7.5205335 + 2) / 0.2, rel=1e-9)
    in_b = round((10 + turn + 5) * 100)
    assert x[in_b] == pytest.approx((-13.02594611 + 3) / 0.25, abs=1e-6)
    back = round((20 + 1.5 * turn) * 100)
    assert y[back] == pytest.approx((-20 * 3600 + 7.5205335 + 2) / 0.2, rel=1e-9)
    again = round((20 + 2 * turn + 5) * 100)
    assert x[again] == pytest.approx((13.02594611 + 3) / 0.25, abs=1e-6)


def test_a_slower_rate_scatters_less_a_sample():
    _, gyro, _ = bench(white_noise="0.9 pulse/sqrt(s)")
    piece = Segment(0, "S", LEVEL, "", Rest(), 10_000.0, sample_rate=1.0)
    data, _ = record(gyro, piece)
    assert data["torquer_x"].size == 10_000
    assert data["torquer_x"].std() == pytest.approx(0.9, rel=0.04)


@pytest.mark.parametrize(
    ("piece", "words"),
    [
        (Segment(0, "S", LEVEL, "", Rest(), None), "only possible with a recording"),
        (Segment(0, "S", LEVEL, "", Rest(), 1.0, sample_rate=1000.0), "100 Hz at most"),
    ],
)
def test_what_it_cannot_do_is_said(piece, words):
    with pytest.raises(InstrumentError, match=words):
        list(bench()[1].stream(piece))


def test_torquers_along_one_axis_cannot_work():
    with pytest.raises(InstrumentError, match="along one axis"):
        bench(xi="90 deg")


def test_in_real_time_samples_come_a_second_at_a_time():
    _, gyro, _ = bench()
    gyro.world.real_time = True
    assert [b.time.size for b in gyro.stream(segment(2.5))] == [100, 100, 50]


def test_flicker_over_steps_of_hours_is_finite() -> None:
    """The shortest process forgets between two samples: each is drawn anew, and the sum has the variance of all fifteen."""
    flicker, draw = Flicker(1.0), generator(9, 0)
    flicker.begin(0.0, draw)
    drawn = flicker.advance(4000, 1e7, draw)  # s, where even the longest has forgotten
    assert np.var(drawn) == pytest.approx(
        15 * math.log(2) / math.pi, rel=0.1
    )  # 4.5 standard deviations of a variance of 4000
