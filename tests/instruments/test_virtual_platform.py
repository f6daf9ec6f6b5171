"""The virtual platform against attitudes by quaternions, hand-worked figures, and itself after a restart."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import HasModes, InstrumentError, Resumable, StreamsSamples, Surroundings
from planrunner.instruments.virtual.base_motion import base_axes, shaking
from planrunner.instruments.virtual.platform import RingEncoders, VirtualPlatform, gimbal_angles
from planrunner.instruments.virtual.platform_parameters import VirtualPlatformParameters
from planrunner.instruments.virtual.table import VirtualTable, VirtualTableParameters
from planrunner.physics.earth import EARTH_RATE, Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Rock, Segment, Spin

DEG = math.pi / 180
ARCSEC = DEG / 3600
PER_HOUR = DEG / 3600
G0 = 9.80665
GRAVITY = 9.80154
LATITUDE = 40 * DEG
EARTH = EARTH_RATE * np.array([0.0, math.cos(LATITUDE), math.sin(LATITUDE)])
AXES = """[{name: outer, direction: north, max_rate: 60 deg/s, max_acceleration: 100 deg/s^2},
 {name: middle, direction: east, max_rate: 60 deg/s, max_acceleration: 100 deg/s^2},
 {name: inner, direction: up, max_rate: 60 deg/s, max_acceleration: 100 deg/s^2}]"""
VERTICAL = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # x north, y up, z east
ROCKING = Rock(3 * DEG, 0.2, (0.0, 45 * DEG, 90 * DEG), 60.0)
PERFECT = {
    "sample_rate": "50 Hz",
    "accelerometers": "{bits: 32}",
    "table_encoders": "{resolution: 0 arcsec}",
}


def read(record, text):
    log = Findings()
    made = RecordOf(record).read(source.parse(text, "t"), log)
    assert list(log) == []
    return made


def bench(seed=1, azimuth=0.0, **changes):
    surroundings = Surroundings(VirtualClock(), Site(LATITUDE, GRAVITY, azimuth), seed=seed)
    table = VirtualTable.connect(read(VirtualTableParameters, f"{{axes: {AXES}}}"), surroundings)
    text = "\n".join(f"{name}: {value}" for name, value in (PERFECT | changes).items())
    platform = VirtualPlatform.connect(read(VirtualPlatformParameters, text), surroundings)
    surroundings.clock.sleep(table.orient(VERTICAL))
    return table, platform, surroundings.clock


def segment(dwell, index=0, motion=None):
    return Segment(index, f"S{index}", VERTICAL, "", motion or Rest(), dwell)


def record(platform, piece):
    blocks = list(platform.stream(piece))
    time = np.concatenate([block.time for block in blocks])
    return time, {name: np.concatenate([b.channels[name] for b in blocks]) for name in platform.channels()}


def released(platform, clock):
    clock.sleep(platform.set_mode("caged"))
    assert platform.set_mode("navigation") == 0.0
    return clock.now()


def run(table, platform, clock, dwell, motion=None, index=0):
    if motion is not None:
        clock.sleep(table.begin_motion(motion, dwell))
    made = record(platform, segment(dwell, index, motion))
    if motion is not None:
        clock.sleep(table.end_motion())
    return made


def forces(channels):
    return np.column_stack([channels[f"accel_{axis}"] for axis in "xyz"]) * G0


def element_of(channels):
    """The element's attitude from its own encoders and the table's, by quaternions: element → site components."""
    made = Rotation.identity(len(channels["accel_x"]))
    for name, axis in (("outer", [0, 1, 0]), ("middle", [1, 0, 0]), ("inner", [0, 0, 1])):
        made = made * Rotation.from_rotvec(np.outer(np.radians(channels[f"table_{name}"]), axis))
    gimbals = np.radians(np.column_stack([channels[f"gimbal_{name}"] for name in ("outer", "middle", "inner")]))
    return made * Rotation.from_euler("XYZ", gimbals)


def test_it_can_do_what_a_platform_must():
    _, platform, _ = bench()
    assert all(isinstance(platform, able) for able in (StreamsSamples, Resumable, HasModes))
    model = VirtualPlatform.model(platform.parameters)
    assert model.kind == "stabilised-platform"
    assert model.modes == ("caged", "navigation")
    assert [output.name for output in model.outputs] == list(platform.channels())


@pytest.mark.parametrize("motion", [None, ROCKING])
def test_a_perfect_element_is_fixed_in_inertial_space_whatever_the_base_does(motion):
    table, platform, clock = bench()
    start = released(platform, clock)
    time, channels = run(table, platform, clock, 120.0, motion)
    turned = Rotation.from_rotvec(np.outer(time - start, EARTH))
    expected = (Rotation.from_matrix(VERTICAL).as_matrix() @ turned.apply([0, 0, GRAVITY]).T).T
    np.testing.assert_allclose(forces(channels), expected, atol=2e-8)
    # Encoders and gimbals tell the same attitude: element → site, seen from inertial space it stays.
    in_space = turned * element_of(channels)
    off = (in_space * Rotation.from_matrix(VERTICAL.T).inv()).magnitude()
    assert off.max() < 1e-9
    if motion is not None:
        assert np.ptp(channels["gimbal_outer"]) > 3.0


def test_on_a_table_that_looks_elsewhere_than_north_directions_are_true_ones():
    _, platform, clock = bench(azimuth=0.5)
    np.testing.assert_allclose(base_axes(platform.world, np.array([clock.now()]))[0], VERTICAL, atol=1e-9)


def test_while_caged_it_goes_with_the_base():
    table, platform, clock = bench()
    clock.sleep(platform.set_mode("caged"))
    _, channels = run(table, platform, clock, 20.0, ROCKING)
    assert max(np.abs(channels[f"gimbal_{name}"]).max() for name in ("outer", "middle", "inner")) < 1e-9
    assert np.ptp(channels["accel_x"]) > 0.05


def test_each_caging_is_a_draw_within_the_dead_region():
    _, platform, clock = bench(caging="{dead_region: 1 arcmin, azimuth: 30 arcsec, duration: 20 s}")
    assert platform.set_mode("caged") == 20.0
    seen = []
    for index in range(60):
        clock.sleep(platform.set_mode("caged"))
        _, channels = record(platform, segment(0.1, index))
        seen.append([channels[f"gimbal_{name}"][0] * 3600 for name in ("outer", "middle", "inner")])
    x, y, z = np.array(seen).T
    assert np.abs(x).max() < 61 and np.abs(z).max() < 61
    assert x.std() == pytest.approx(60 / math.sqrt(3), rel=0.3)  # rectangular
    assert y.std() == pytest.approx(30, rel=0.3)  # azimuth: y is up


def test_drift_is_constant_or_follows_the_square_of_the_base_rate():
    drift = "{x: 0.3 deg/h, y: -0.2 deg/h, z: 0.1 deg/h}"
    rocking = "{rms_rate: 4 deg/s, x: 1 deg/h, z: -2 deg/h}"
    rates = []
    for motion in (None, Rock(3 * DEG, 0.2, (0.0, 45 * DEG, 90 * DEG), 400.0)):
        table, platform, clock = bench(drift=drift, rocking_drift=rocking)
        start = released(platform, clock)
        time, channels = run(table, platform, clock, 300.0, motion)
        since = Rotation.from_rotvec(np.outer(time - start, EARTH)) * element_of(channels)
        turned = (Rotation.from_matrix(VERTICAL.T).inv() * since).as_rotvec()
        rates.append((turned[-1] - turned[0]) / (time[-1] - time[0]) / PER_HOUR)
    np.testing.assert_allclose(rates[0], [0.3, -0.2, 0.1], atol=2e-4)
    # Three rings of 3 deg at 0.2 Hz have 3·(3.770 deg/s)²/2 = 21.3 (deg/s)² when at right angles; 4 deg/s has 16.
    share = 3 * (3 * 2 * math.pi * 0.2) ** 2 / 2 / 16
    np.testing.assert_allclose(rates[1] - rates[0], [share, 0.0, -2 * share], rtol=0.05, atol=5e-3)


def test_it_leaves_the_dead_region_in_the_first_minute():
    table, platform, clock = bench(caging="{leaving: 20 arcsec, leaving_time: 12 s}")
    start = released(platform, clock)
    time, channels = run(table, platform, clock, 120.0)
    since = Rotation.from_rotvec(np.outer(time - start, EARTH)) * element_of(channels)
    turned = np.linalg.norm((Rotation.from_matrix(VERTICAL.T).inv() * since).as_rotvec(), axis=1) / ARCSEC
    ends = turned[-1]
    assert ends > 5
    assert turned[600] / ends == pytest.approx(1 - math.exp(-1), abs=0.02)  # 12 s
    assert turned[3000] / ends == pytest.approx(1.0, abs=0.01)  # 60 s


def test_random_walk_and_repeatability_of_the_drift():
    _, platform, clock = bench(random_walk="0.1 deg/sqrt(h)", drift_repeatability="3 deg/h")
    drifts, walks = [], []
    for index in range(40):
        clock.sleep(platform.set_mode("caged"))
        drifts.append(platform.drift / PER_HOUR)
        platform.set_mode("navigation")
        record(platform, segment(36.0, index))
        walks.append((platform.element.drifted - platform.drift * 36.0) / DEG)
    assert np.std(drifts) == pytest.approx(3.0, rel=0.2)
    assert np.std(walks) == pytest.approx(0.1 * math.sqrt(0.01), rel=0.2)


def test_counts_clipping_and_installation_angles():
    _, fine, clock = bench(accelerometers="{bits: 21}")
    record(fine, segment(1.0))
    count = 2 * 1.25 / 2**21
    _, channels = record(fine, segment(1.0, 1))
    np.testing.assert_allclose(channels["accel_y"] / count, np.rint(channels["accel_y"] / count), atol=1e-6)
    coarse = VirtualPlatform.model(
        read(VirtualPlatformParameters, "{sample_rate: 50 Hz, accelerometers: {range: 20 g}}")
    )
    assert coarse.outputs[0].full_scale == 20.0
    assert coarse.outputs[0].noise.resolution == pytest.approx(40 / 2**21)
    angles = "{xz: 600 arcsec, xy: -300 arcsec, yx: 200 arcsec, zx: 400 arcsec}"
    _, crooked, clock = bench(accelerometers=f"{{bits: 32, installation: {angles}}}")
    clock.sleep(crooked.set_mode("caged"))
    _, channels = record(crooked, segment(0.2))
    # y up: x turned about z by q reads g·sin q; z turned about x by q reads −g·sin q.
    assert channels["accel_x"][0] * G0 / GRAVITY == pytest.approx(math.sin(600 * ARCSEC), rel=1e-5)
    assert channels["accel_z"][0] * G0 / GRAVITY == pytest.approx(-math.sin(400 * ARCSEC), rel=1e-5)


def test_bias_noise_and_walk():
    biases, walks = [], []
    for seed in range(80):
        _, platform, clock = bench(seed=seed, accelerometers="{bits: 32, bias: 50 ug, white_noise: 5 ug*sqrt(s)}")
        clock.sleep(platform.set_mode("caged"))
        _, channels = record(platform, segment(2.0))
        biases.append(channels["accel_x"].mean() * 1e6)
        assert np.diff(channels["accel_x"]).std() * 1e6 == pytest.approx(5 * math.sqrt(50) * math.sqrt(2), rel=0.35)
        _, platform, _ = bench(seed=seed, accelerometers="{bits: 32, bias_walk: 600 ug/sqrt(h)}")
        record(platform, segment(36.0))
        walks.append(platform.bias_walk / G0 * 1e6)
    assert np.std(biases) == pytest.approx(50, rel=0.25)
    assert np.std(walks) == pytest.approx(600 * math.sqrt(platform.walked_until / 3600), rel=0.15)


def test_away_from_the_centre_rocking_shakes_it():
    """One ring of amplitude A rocks a point at r with r·A·ω² across and r·(Aω)² inwards, at most."""
    table, platform, clock = bench(lever_arm="[0 m, 0.1 m, 0 m]")
    released(platform, clock)
    clock.sleep(table.begin_motion(Rock(3 * DEG, 0.2, (0.0,), 60.0), 60.0))
    times = clock.now() + np.arange(500) / 50
    felt = shaking(platform.world, times, (0.0, 0.1, 0.0))
    circular = 2 * math.pi * 0.2
    arm = base_axes(platform.world, times)[:, 1] * 0.1
    assert np.abs(felt).max() == pytest.approx(0.1 * 3 * DEG * circular**2, rel=0.02)
    inwards = -np.sum(felt * arm, axis=1) / 0.1
    assert inwards.max() == pytest.approx(0.1 * (3 * DEG * circular) ** 2, rel=0.02)
    assert np.abs(shaking(platform.world, times + 200.0, (0.0, 0.1, 0.0))).max() == 0.0


def test_rings_stand_off_after_they_have_moved():
    table, platform, clock = bench(table_encoders="{return_error: 20 arcsec, lag: 1 ms}")
    released(platform, clock)
    clock.sleep(table.begin_motion(ROCKING, 90.0))
    begin = clock.now()
    time, channels = record(platform, segment(90.0, 3, ROCKING))
    still, stepped = time - begin > 66.0, []
    for name, (angle, rate) in zip(("outer", "middle", "inner"), platform.world.course.follow(time), strict=True):
        off = (np.degrees(angle) - channels[f"table_{name}"]) * 3600
        assert np.ptp(off[still]) < 1e-6
        before = (off - np.degrees(rate) * 3600 * 1e-3)[time - begin < 60.0]
        assert np.ptp(before) < 1e-6
        stepped.append(abs(off[still][0] - before[0]))
    assert max(stepped) > 1.0
    draw = np.random.default_rng(1)
    many = np.array([RingEncoders.drawn(3, 20 * ARCSEC, 0.0, 0.0, draw).after for _ in range(400)]) / ARCSEC
    assert many.std() == pytest.approx(20, rel=0.1)


def test_gimbal_angles_against_euler_angles():
    draw = np.random.default_rng(2)
    base, between = Rotation.random(100, rng=draw), draw.uniform(-0.5, 0.5, (100, 3))
    element = base * Rotation.from_euler("XYZ", between)
    rows = [np.swapaxes(item.as_matrix(), 1, 2) for item in (base, element)]
    np.testing.assert_allclose(np.column_stack(gimbal_angles(*rows)), between, atol=1e-12)


def test_a_restart_repeats_it_bit_for_bit():
    noisy = {
        "drift": "{x: 1 deg/h}",
        "random_walk": "0.01 deg/sqrt(h)",
        "drift_repeatability": "0.1 deg/h",
        "caging": "{dead_region: 1 arcmin, azimuth: 1 arcmin, leaving: 20 arcsec}",
        "accelerometers": "{bias: 50 ug, bias_walk: 10 ug/sqrt(h), white_noise: 5 ug*sqrt(s)}",
        "table_encoders": "{return_error: 15 arcsec, wander: 5 arcsec/sqrt(h)}",
    }
    _, platform, clock = bench(**noisy)
    released(platform, clock)
    record(platform, segment(30.0, 1))
    state, at = json.loads(json.dumps(platform.checkpoint())), clock.now()
    _, first = record(platform, segment(30.0, 2))
    clock.sleep(platform.set_mode("caged"))
    _, second = record(platform, segment(5.0, 3))
    _, again, later = bench(**noisy)
    again.restore(state)
    later.set(at)
    _, repeated = record(again, segment(30.0, 2))
    later.sleep(again.set_mode("caged"))
    _, after = record(again, segment(5.0, 3))
    for name in first:
        np.testing.assert_array_equal(first[name], repeated[name])
        np.testing.assert_array_equal(second[name], after[name])


def test_what_cannot_be_is_reported():
    _, platform, _ = bench()
    with pytest.raises(InstrumentError, match="no mode 'north'"):
        platform.set_mode("north")
    with pytest.raises(InstrumentError, match="gives 50 Hz at most"):
        list(platform.stream(Segment(0, "fast", VERTICAL, "", Rest(), 1.0, sample_rate=100.0)))
    with pytest.raises(InstrumentError, match="only possible with a recording"):
        list(platform.stream(Segment(0, "open", VERTICAL, "", Rest(), None)))
    _, two, _ = bench(rings="2")
    with pytest.raises(InstrumentError, match="2 rings for the platform, but the table has 3"):
        two.channels()


def test_it_may_spin_under_the_element():
    """A turn of the base about up goes into the gimbals alone."""
    table, platform, clock = bench()
    start = released(platform, clock)
    clock.sleep(table.begin_motion(Spin(1 * DEG), 10.0))
    time, channels = record(platform, segment(10.0, 0, Spin(1 * DEG)))
    expected = (VERTICAL @ Rotation.from_rotvec(np.outer(time - start, EARTH)).apply([0, 0, GRAVITY]).T).T
    np.testing.assert_allclose(forces(channels), expected, atol=2e-8)
