"""The virtual inertial sensor against hand-worked outputs, the theory of its noise, and itself after a restart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from inertial_bench import DEG, TRIAD, InertialBench, findings, read

from planrunner.base.findings import InputError
from planrunner.instruments.interfaces import HasModes, Resumable, StreamsSamples
from planrunner.instruments.virtual.imu import VirtualImu
from planrunner.instruments.virtual.imu_keys import VirtualImuParameters
from planrunner.plan.schedule import Spin

G = 9.80665
# At latitude 30 deg: 15.041067·cos 30 = 13.02594611 deg/h north, 15.041067·sin 30 = 7.5205335 deg/h up.
NORTH, UP = 13.02594611 / 3600, 7.5205335 / 3600
X_UP = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # x up, y north, z west


def one_gyro(keys, **how):
    return InertialBench(f"gyros: {{axes: {{x: {{{keys}}}}}}}", **how)


def one_accelerometer(keys, **how):
    return InertialBench(f"accelerometers: {{axes: {{z: {{{keys}}}}}}}", **how)


def first(bench, name="gyro_x", dwell=0.05, **how):
    return bench.record(dwell, **how)[name][0]


def spun(bench, degrees_per_second):
    """The mean output of a gyro whose axis is up, spun about up."""
    bench.orient(X_UP)
    if degrees_per_second:
        bench.move(Spin(degrees_per_second * DEG))
    return bench.record(1.0, motion=Spin(degrees_per_second * DEG))["gyro_x"].mean()


# -- what it is ------------------------------------------------------------------------------------------------------


def test_it_can_do_what_a_sensor_must():
    sensor = InertialBench(TRIAD + "reference: true").sensor
    for protocol in (StreamsSamples, Resumable, HasModes):
        assert isinstance(sensor, protocol)
    assert dict(sensor.channels()) == {
        **{f"gyro_{axis}": "deg/s" for axis in "xyz"},
        **{f"accel_{axis}": "m/s^2" for axis in "xyz"},
        "sensor_temperature": "degC",
        "reference_latitude": "deg",
        "reference_longitude": "deg",
        "reference_height": "m",
        "reference_velocity_east": "m/s",
        "reference_velocity_north": "m/s",
    }


def test_its_data_sheet_says_nothing_of_its_errors():
    text = """
kind: gyro-triad
sample_rate: 100 Hz
gyros:
  scale_factor: 1000 (pulse/s)/(deg/s)
  full_scale: 400 deg/s
  angle_random_walk: 0.06 deg/sqrt(h)
  bias_instability: 0.36 deg/h
  resolution: 1 arcsec
  axes: {a: {angle: 54.7 deg, azimuth: 0 deg, scale_factor_error: 1 %, bias: 5 deg/h}}
accelerometers:
  axes: {z: {resolution: 0.01 m/s^2, velocity_random_walk: 0.6 m/s/sqrt(h), bias_instability: 1 mg}}
"""
    model = VirtualImu.model(read(VirtualImuParameters, text))
    assert model.kind == "gyro-triad"
    assert model.sample_rate == 100
    assert model.modes == ("powered", "unpowered")
    assert model.nominal == {"K_gyro_a": pytest.approx(1000 * 180 / math.pi), "K_accel_z": 1.0}
    gyro, accelerometer = model.output("gyro_a"), model.output("accel_z")
    assert gyro is not None and accelerometer is not None
    assert gyro.unit == "pulse/s" and gyro.full_scale == pytest.approx(400_000)
    # 0.06 deg/√h is 0.001 deg/√s; an arc second in 0.01 s is 100 arcsec/s or 1/36 deg/s.
    assert gyro.noise.white == pytest.approx(1.0)
    assert gyro.noise.bias_instability == pytest.approx(0.1)
    assert gyro.noise.resolution == pytest.approx(1000 / 36)
    assert accelerometer.unit == "m/s^2"
    assert accelerometer.noise.white == pytest.approx(0.01)
    assert accelerometer.noise.bias_instability == pytest.approx(0.00980665)
    assert accelerometer.noise.resolution == pytest.approx(0.01)


# -- where its axes point --------------------------------------------------------------------------------------------


def test_a_triad_at_home_feels_the_earth_and_gravity_along_its_axes():
    data = InertialBench().record(0.1)
    expected = {"gyro_x": 0.0, "gyro_y": NORTH, "gyro_z": UP, "accel_x": 0.0, "accel_y": 0.0, "accel_z": G}
    for name, value in expected.items():
        assert data[name] == pytest.approx(np.full(10, value), abs=1e-11), name
    assert data["sensor_temperature"] == pytest.approx(np.full(10, 25.0), abs=1e-9)


def test_a_tilted_axis_points_where_its_fixture_says():
    # 60 deg from z, azimuth 120 deg from x: (sin 60·cos 120, sin 60·sin 120, cos 60) = (−0.4330127019, 0.75, 0.5).
    text = "gyros: {axes: {s: {angle: 60 deg, azimuth: 120 deg}}}\naccelerometers: {axes: {s: {angle: 60 deg, azimuth: 120 deg}}}"
    bench = InertialBench(text)
    data = bench.record(0.1)
    assert data["gyro_s"][0] == pytest.approx(0.75 * NORTH + 0.5 * UP, abs=1e-11)
    assert data["accel_s"][0] == pytest.approx(0.5 * G, rel=1e-12)
    bench.orient(X_UP)  # x up, y north, z west
    data = bench.record(0.1)
    assert data["gyro_s"][0] == pytest.approx(-0.4330127019 * UP + 0.75 * NORTH, abs=1e-11)
    assert data["accel_s"][0] == pytest.approx(-0.4330127019 * G, rel=1e-9)


def test_misalignments_lean_towards_the_other_axes():
    # x leans by 1 mrad towards y and −2 mrad towards z; the axis named `spare` lies along y and leans towards x.
    text = "{axes: {x: {towards: {y: 1e-3 rad, z: -2e-3 rad}}, spare: {axis: y, towards: {z: 3e-3 rad}}}}"
    data = InertialBench(f"gyros: {text}\naccelerometers: {text}").record(0.1)
    assert data["gyro_x"][0] == pytest.approx(1e-3 * NORTH - 2e-3 * UP, abs=1e-11)
    assert data["gyro_spare"][0] == pytest.approx((NORTH + 3e-3 * UP) * (1 - 4.5e-6), rel=2e-8)
    assert data["accel_x"][0] == pytest.approx(-2e-3 * G, rel=5e-6)


# -- how it errs -----------------------------------------------------------------------------------------------------


def test_bias_and_scale_factor_by_hand():
    # (7.5205335 + 3) deg/h · 1000·(1 + 0.001) pulse/s per deg/s.
    bench = one_gyro("scale_factor: 1000 (pulse/s)/(deg/s), scale_factor_error: 1000 ppm, bias: 3 deg/h")
    assert spun(bench, 0) == pytest.approx(10.5205335 / 3600 * 1001, rel=1e-9)
    # Accelerometer: (9.80665 + 0.001·9.80665)·(1 − 0.0005) m/s².
    assert first(one_accelerometer("bias: 1 mg, scale_factor_error: -500 ppm"), "accel_z") == pytest.approx(
        9.80665 * 1.001 * 0.9995, rel=1e-12
    )


def test_what_an_axis_says_comes_before_what_is_said_of_all():
    data = InertialBench("gyros: {bias: 2 deg/h, axes: {x: {}, y: {bias: 0 deg/h}, z: {bias: -1 deg/h}}}").record(0.1)
    assert data["gyro_x"][0] * 3600 == pytest.approx(2.0, abs=1e-9)
    assert data["gyro_y"][0] == pytest.approx(NORTH, abs=1e-11)
    assert data["gyro_z"][0] * 3600 == pytest.approx(7.5205335 - 1.0, abs=1e-7)


@pytest.mark.parametrize("rate", [100.0, -100.0, 20.0])
def test_nonlinearity_and_asymmetry_by_hand(rate):
    # u = rate + Ω·sin φ; a = 200 ppm, q₂ = 1e-8 and q₃ = −2e-9 of deg/s.
    keys = "scale_factor_asymmetry: 200 ppm, quadratic: 0.01 ppm/(deg/s), cubic: -0.002 ppm/dps^2"
    u = rate + UP
    expected = u + 1e-4 * abs(u) + 1e-8 * u**2 - 2e-9 * u**3
    assert spun(one_gyro(keys), rate) == pytest.approx(expected, rel=1e-12)


def test_accelerometer_nonlinearity_by_hand():
    # 1 g with 30 µg/g² and 5 µg/g³: 1.000035 g; −1 g: −1 + 30e-6 − 5e-6 g.
    bench = one_accelerometer("quadratic: 30 ug/g^2, cubic: 5 ug/g^3")
    assert first(bench, "accel_z") == pytest.approx(G * 1.000035, rel=1e-12)
    bench.orient(np.diag([1.0, -1.0, -1.0]))
    assert first(bench, "accel_z") == pytest.approx(-G * (1 - 25e-6), rel=1e-12)


def test_g_sensitivity_by_hand():
    # x up: 1 g along x; home: 1 g along z.
    bench = one_gyro("g_sensitivity: {x: 4 deg/h/g, z: -2 deg/h/g}")
    assert first(bench) * 3600 == pytest.approx(-2.0, abs=1e-9)
    bench.orient(X_UP)
    assert first(bench) * 3600 == pytest.approx(7.5205335 + 4.0, abs=1e-7)


def test_dead_zone_and_full_scale():
    assert spun(one_gyro("dead_zone: 8 deg/h"), 0) == 0.0
    assert spun(one_gyro("dead_zone: 7 deg/h"), 0) == pytest.approx(UP, abs=1e-11)
    assert spun(one_gyro("full_scale: 50 deg/s"), 100) == 50.0
    assert spun(one_gyro("full_scale: 50 deg/s"), -100) == -50.0


CHAMBER = "{lowest: -50 degC, highest: 80 degC, ramp: 60 K/min, lag: 10 s, ambient: 20 degC}"


def test_temperature_changes_bias_and_scale_factor_by_hand():
    # 5 degC is 15 K below the reference: bias 1 + 0.02·(−15) + 0.001·225 = 0.925 deg/h, K·(1 − 15·100 ppm + 225·2 ppm) = 0.99895·K.
    keys = "bias: 1 deg/h, bias_temperature: [0.02 deg/h/K, 0.001 deg/h/K^2], scale_factor_temperature: [100 ppm/K, 2 ppm/K^2]"
    text = f"gyros: {{axes: {{x: {{{keys}}}}}}}\nreference_temperature: 20 degC\nthermal_lag: 10 s"
    bench = InertialBench(text, chamber=CHAMBER)
    bench.orient(X_UP)
    assert first(bench) == pytest.approx(UP + 1 / 3600, abs=1e-11)
    bench.chamber.set_temperature(273.15 + 5)
    bench.clock.sleep(3600)
    assert first(bench) == pytest.approx((UP + 0.925 / 3600) * 0.99895, rel=1e-9)


def test_the_sensor_lags_behind_the_air_and_its_bias_with_it():
    text = "gyros: {axes: {x: {bias_temperature: [0.1 deg/h/K]}}}\nreference_temperature: 20 degC\nthermal_lag: 5 min"
    bench = InertialBench(text, chamber=CHAMBER)
    bench.chamber.set_temperature(273.15 + 60)
    data = bench.record(1800.0, rate=10.0)
    # An independent integration: setpoint 1 K/s up to 60 degC, air 10 s behind it, sensor 5 min behind the air.
    air = sensor = 20.0
    step, found = 0.05, []
    for k in range(36_000):
        now = k * step
        middle_air = air + step / 2 * (min(60.0, 20.0 + now) - air) / 10
        middle_sensor = sensor + step / 2 * (air - sensor) / 300
        air += step * (min(60.0, 20.0 + now + step / 2) - middle_air) / 10
        sensor += step * (middle_air - middle_sensor) / 300
        found.append(sensor)
    at_middles = np.array(found)[9::20]  # at 0.5 s, 1.5 s, …
    assert data["sensor_temperature"][::10] == pytest.approx(at_middles, abs=2e-4)
    assert data["gyro_x"][::10] * 3600 == pytest.approx(0.1 * (at_middles - 20), abs=2e-5)
    assert data["gyro_x"][600 * 10] * 3600 < 0.1 * 40 * 0.9  # ten minutes on it is still on its way


def test_warm_up_decays_from_each_switch_on():
    bench = one_gyro("warm_up: 10 deg/h, warm_up_time: 100 s")
    bench.clock.sleep(50.0)
    data = bench.record(300.0, rate=1.0)
    assert data["gyro_x"] * 3600 == pytest.approx(10 * np.exp(-(50.5 + np.arange(300)) / 100), rel=1e-9)
    bench.sensor.set_mode("unpowered")
    assert np.all(bench.record(10.0)["gyro_x"] == 0.0)
    bench.sensor.set_mode("powered")
    assert first(bench, rate=1.0, dwell=1.0) * 3600 == pytest.approx(10 * math.exp(-0.005), rel=1e-9)
    bench.sensor.set_mode("powered")  # it is on already
    assert bench.sensor.times_switched_on == 1


def test_every_switch_on_draws_bias_and_scale_factor_anew():
    bench = one_gyro("bias_repeatability: 0.5 deg/h, scale_factor_repeatability: 100 ppm, axis: z")
    found = []
    for _ in range(400):
        bench.sensor.set_mode("unpowered")
        bench.sensor.set_mode("powered")
        still = first(bench)
        assert first(bench) == still  # it stays while it is on
        bench.move(Spin(100 * DEG))
        found.append((still - UP, first(bench, motion=Spin(100 * DEG)) - 100 - still))
        bench.clock.sleep(bench.table.end_motion())
    bias, scale = np.array(found).T
    # 400 draws give a standard deviation to 1/√800 = 3.5 % and a mean to 5 % of it.
    assert (bias * 3600).std() == pytest.approx(0.5, rel=0.15)
    assert abs((bias * 3600).mean()) < 4 * 0.5 / 20
    assert (scale / 100).std() == pytest.approx(100e-6, rel=0.15)
    assert abs(np.corrcoef(bias, scale)[0, 1]) < 4 / 20


# -- noise and counting ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [10.0, 100.0])
def test_means_scatter_by_n_over_root_t_at_any_sample_rate(rate):
    # N = 0.06 deg/√h = 0.001 deg/√s: means over 1 s scatter by 0.001 deg/s; 4000 of them give that to 1.1 %.
    data = one_gyro("angle_random_walk: 0.06 deg/sqrt(h)").record(4000.0, rate=rate)["gyro_x"]
    assert data.std() == pytest.approx(0.001 * math.sqrt(rate), rel=4.5 / math.sqrt(2 * data.size))
    assert data.reshape(4000, -1).mean(axis=1).std() == pytest.approx(0.001, rel=0.05)
    z = one_accelerometer("velocity_random_walk: 0.06 m/s/sqrt(h)").record(4000.0, rate=rate)["accel_z"]
    assert z.reshape(4000, -1).mean(axis=1).std() == pytest.approx(0.001, rel=0.05)


def test_bias_instability_lies_at_the_floor_of_ieee_952():
    data = one_gyro("bias_instability: 3600 deg/h", rate=1).record(1_000_000.0)["gyro_x"]
    means = data.reshape(-1, 100).mean(axis=1)
    allan = math.sqrt(0.5 * np.mean(np.diff(means) ** 2))
    assert allan == pytest.approx(math.sqrt(2 * math.log(2) / math.pi), rel=0.05)


def test_a_random_walk_of_the_bias_grows_with_the_root_of_time():
    # K = 60 deg/h/√h = 1 deg/h/√s. Across a pause of 100 s and within a segment of 400 s.
    ends = []
    for seed in range(300):
        bench = one_gyro("rate_random_walk: 60 deg/h/sqrt(h)", seed=seed, rate=1)
        bench.clock.sleep(100.0)
        data = bench.record(400.0)["gyro_x"] * 3600
        ends.append((data[0], data[-1] - data[0]))
    begin, gained = np.array(ends).T
    # 300 draws: 4.1 %.
    assert begin.std() == pytest.approx(10.0, rel=0.17)
    assert gained.std() == pytest.approx(math.sqrt(399), rel=0.17)
    assert abs(np.corrcoef(begin, gained)[0, 1]) < 4 / math.sqrt(300)


def test_angles_are_counted_without_loss_and_rates_are_rounded():
    # 7.5205335 deg/h is 0.075205 arcsec a sample of 0.01 s: of counts of 1 arcsec, 7520 in 1000 s and none lost over 250 000 samples.
    bench = one_gyro("resolution: 1 arcsec, axis: z")
    data = bench.record(2500.0)["gyro_x"]
    counts = data * 3600 * 0.01
    assert np.array_equal(counts.round(6), np.rint(counts))
    turned = np.cumsum(counts)
    assert np.max(np.abs(turned - 0.075205335 * np.arange(1, 250_001))) <= 0.5 + 1e-6
    # A rate of 0.0021 deg/s in steps of 0.005 is always rounded to nothing.
    assert np.all(one_gyro("resolution: 0.005 deg/s, axis: z").record(1.0)["gyro_x"] == 0.0)
    z = one_accelerometer("resolution: 0.01 m/s^2").record(0.1)["accel_z"]
    assert z == pytest.approx(np.full(10, 9.81), abs=1e-12)
    counted = one_accelerometer("resolution: 0.01 m/s").record(1.0)["accel_z"]
    assert counted.sum() / 100 == pytest.approx(G, abs=0.005)
    assert set(np.rint(counted)) == {9.0, 10.0}


def test_axes_and_segments_have_noise_of_their_own():
    bench = InertialBench("gyros: {angle_random_walk: 0.1 deg/sqrt(h), axes: {x: {}, y: {}}}")
    data = bench.record(100.0, index=0)
    assert abs(np.corrcoef(data["gyro_x"], data["gyro_y"])[0, 1]) < 5 / 100
    assert not np.array_equal(data["gyro_x"], bench.record(100.0, index=1)["gyro_x"])


def test_a_mean_of_counts_is_as_good_as_is_declared():
    # Counts of 1 arcsec at 100 Hz: a mean over 10 s is off by two roundings of ±½ arcsec, 1/√6/10 arcsec/s.
    bench = one_gyro("resolution: 1 arcsec, axis: z")
    declared = bench.sensor.model(bench.sensor.parameters).output("gyro_x").noise.standard_error(10.0, 100.0)
    assert declared * 3600 == pytest.approx(1 / math.sqrt(6) / 10)
    found = bench.record(10_000.0)["gyro_x"].reshape(-1, 1000).mean(axis=1) - UP
    # Roundings of neighbouring means are shared, and evenly spread: 1000 of them give their deviation to some per cent.
    assert found.std() == pytest.approx(declared, rel=0.1)


# -- bad keys ---------------------------------------------------------------------------------------------------------


def test_a_sensor_has_axes():
    with pytest.raises(InputError, match=r"neither 'gyros' nor 'accelerometers'"):
        VirtualImu.model(read(VirtualImuParameters, "sample_rate: 1 Hz"))


@pytest.mark.parametrize(
    ("keys", "code", "words"),
    [
        ("gyros: {axes: {}}", "form-size", "0 axes are given"),
        (
            f"gyros: {{axes: {{{', '.join(f'g{k}: {{axis: x}}' for k in range(13))}}}}}",
            "form-size",
            "13 axes are given",
        ),
        ("gyros: {axes: {a: {}}}", "meaning-input-axis", "the axis 'a' has no direction"),
        ("gyros: {axes: {a: {angle: 3 deg}}}", "meaning-input-axis", "has an angle but no azimuth"),
        ("gyros: {axes: {a: {azimuth: 3 deg}}}", "meaning-input-axis", "has an azimuth but no angle"),
        (
            "gyros: {axes: {a: {angle: 3 deg, azimuth: 0 deg, axis: x}}}",
            "meaning-input-axis",
            "is placed twice",
        ),
        ("gyros: {axes: {x: {towards: {x: 1 arcsec}}}}", "meaning-input-axis", "cannot be tilted towards x"),
        ("gyros: {axes: {x: {towards: {y: 30 deg}}}}", "meaning-input-axis", "not a small angle"),
        ("gyros: {axes: {x: {bias: 1 ug}}}", "meaning-dimension", "a unit of angular rate is needed"),
        ("gyros: {axes: {x: {resolution: 1 V}}}", "meaning-dimension", "a unit such as arcsec or deg/s is needed"),
        ("gyros: {axes: {x: {scale_factor: 2 (pulse/s)/g}}}", "meaning-dimension", "(pulse/s)/(deg/s) or 1 is needed"),
        ("gyros: {axes: {x: {scale_factor: 0}}}", "meaning-range", "must be positive"),
        ("gyros: {axes: {x: {bias_temperature: 0.1 deg/h/K}}}", "form-type", "a list of one to three"),
        ("gyros: {axes: {x: {bias_temperature: [0.1 deg/h]}}}", "meaning-dimension", "such as deg/h/K is needed"),
        ("gyros: {axes: {x: {g_sensitivity: {w: 1 deg/h/g}}}}", "form-unknown-key", "unknown name 'w'"),
        ("gyros: {axes: {x: {angle_random_walk: -1 deg/sqrt(h)}}}", "meaning-range", "must not be negative"),
        ("accelerometers: {axes: {x: {g_sensitivity: {x: 1 deg/h/g}}}}", "form-unknown-key", "g_sensitivity"),
        ("kind: IMU", "form-text", "is not a kind of sensor"),
    ],
)
def test_bad_keys_are_clear_errors(keys, code, words):
    found = findings(f"sample_rate: 1 Hz\n{keys}")
    assert [item[0] for item in found] == [code]
    assert words in found[0][1]
