"""Each effect of the generator on one simple segment, against numbers worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.device import SENSORS, accel_noise_factor, clean_output, fault, ideal, recorded
from tests.blind.motion import Schedule, Site, stimulus
from tests.blind.plans import X_UP, Y_UP, Axes, Segment

MEMS = SENSORS["mems"]
EAST_RATE = 15.041067 / 3600
UP = EAST_RATE * np.sin(np.radians(39.98))
NORTH = EAST_RATE * np.cos(np.radians(39.98))
G = 9.80154
STILL_EARTH = Site(earth_rate=0.0)


def rest(chamber: float = 25.0, ramp: bool = False) -> Segment:
    return Segment("s", "static", X_UP, 4.0, chamber=chamber, ramp=ramp, start=600.0)


def turn(rate: float = 60.0, axes: Axes = X_UP, chamber: float = 25.0) -> Segment:
    return Segment("r", "rate", axes, 6.0, rate, chamber=chamber, start=600.0)


def rock(amplitude: float = 4.0, frequency: float = 1.0) -> Segment:
    return Segment("k", "rock", X_UP, 4.0, 0.0, amplitude, frequency, start=600.0)


def outputs(*segments: Segment, faults: dict | None = None, site: Site | None = None) -> np.ndarray:
    return clean_output(Schedule(segments, 50.0, site or Site()), MEMS, ideal(MEMS), faults or {})


def changed(*segments: Segment, faults: dict, site: Site | None = None) -> np.ndarray:
    return outputs(*segments, faults=faults, site=site) - outputs(*segments, site=site)


def test_at_rest_it_feels_the_earth_alone() -> None:
    assert outputs(rest())[7] == pytest.approx([UP, NORTH, 0, G, 0, 0], abs=1e-9)


def test_turning_it_feels_the_table_and_the_turning_earth() -> None:
    values = outputs(turn())
    assert values[0, :3] == pytest.approx([60 + UP, NORTH, 0], abs=1e-6)
    assert values[75, :3] == pytest.approx([60 + UP, 0, -NORTH], abs=1e-6)  # a quarter turn: y points west, z south
    assert values[75, 3:] == pytest.approx([G, 0, 0], abs=1e-9)


def test_a_turn_about_y_is_positive_about_up() -> None:
    assert outputs(turn(-30.0, Y_UP))[0, 1] == pytest.approx(-30 + UP, abs=1e-6)


def test_rocking_is_the_derivative_of_its_sine() -> None:
    felt = stimulus(Schedule((rock(),), 50.0, STILL_EARTH), {})
    t = np.arange(200) / 50
    assert felt.angle == pytest.approx(4 * np.sin(2 * np.pi * t), abs=1e-9)
    assert felt.rate[:, 0] == pytest.approx(8 * np.pi * np.cos(2 * np.pi * t), abs=1e-6)


def test_tilt_leans_gravity_into_a_level_axis() -> None:
    values = outputs(rest(), faults=fault("table_tilt", 0.01, 0.0))
    assert values[0, 3:] == pytest.approx([G * np.cos(0.01), G * np.sin(0.01), 0], abs=1e-9)


def test_azimuth_turns_north_away() -> None:
    values = outputs(rest(), faults=fault("table_azimuth", 0.1))
    assert values[0, :3] == pytest.approx([UP, NORTH * np.cos(0.1), -NORTH * np.sin(0.1)], abs=1e-9)


def test_an_error_of_placing_belongs_to_its_orientation() -> None:
    other = Segment("o", "static", Y_UP, 4.0, start=700.0)
    values = changed(rest(), other, faults=fault("table_position_error", 0, 0, 0, 0.02, 0, 0))
    assert np.abs(values[:200]).max() == 0
    assert values[200, 3:] == pytest.approx([G * np.sin(0.02), G * (np.cos(0.02) - 1), 0], abs=1e-9)


def test_ripple_comes_once_a_turn_and_spares_the_encoder() -> None:
    ripple = fault("table_rate_ripple", 1e-3, 0.0, shape=(1.0,))
    values = changed(turn(), faults=ripple, site=STILL_EARTH)
    assert values[[0, 75, 150], 0] == pytest.approx([0.06, 0, -0.06], abs=1e-6)
    schedule = Schedule((turn(),), 50.0)
    assert np.array_equal(stimulus(schedule, ripple).angle, stimulus(schedule, {}).angle)


def test_three_per_turn_has_three_maxima() -> None:
    values = changed(turn(), faults=fault("ripple_three_per_turn", 1e-3, 0.0, shape=(3.0,)), site=STILL_EARTH)
    assert values[[0, 100, 200], 0] == pytest.approx([0.06] * 3, abs=1e-6)


def test_wobble_is_a_constant_tilt_while_turning() -> None:
    wobble = fault("table_wobble", 0.01, 0.0)
    values = changed(rest(), turn(), faults=wobble, site=STILL_EARTH)
    assert np.abs(values[:200]).max() == 0
    assert values[200:, 1] == pytest.approx(np.full(300, 60 * np.sin(0.01)), abs=1e-6)
    assert values[200:, 4] == pytest.approx(np.full(300, G * np.sin(0.01)), abs=1e-9)


def test_rate_error_scales_the_table_alone() -> None:
    assert outputs(turn(), faults=fault("table_rate_error", 1e-3))[0, 0] == pytest.approx(60.06 + UP, abs=1e-6)


def test_latitude_moves_the_earth_rate() -> None:
    values = outputs(rest(), faults=fault("site_latitude", np.radians(10.0)))
    assert values[0, 0] == pytest.approx(EAST_RATE * np.sin(np.radians(49.98)), abs=1e-9)


def test_lever_arm_adds_centripetal_and_tangential_acceleration() -> None:
    pull = np.radians(60.0) ** 2 * 0.1
    assert changed(turn(), faults=fault("lever_arm", 0, 0.1, 0))[50, 3:] == pytest.approx([0, -pull, 0], abs=1e-6)
    swing = changed(rock(), faults=fault("lever_arm", 0, 0.1, 0))
    peak = -np.radians(4.0) * (2 * np.pi) ** 2 * 0.1  # at a quarter of the period, along x × y = z
    assert swing[12:14, 5].mean() == pytest.approx(peak * np.cos(2 * np.pi * 0.01), rel=1e-4)


def test_latency_shows_what_was() -> None:
    t = np.arange(200) / 50 - 0.01
    late = outputs(rock(), faults=fault("time_latency", 0.01), site=STILL_EARTH)
    assert late[:, 0] == pytest.approx(8 * np.pi * np.cos(2 * np.pi * t), abs=1e-6)


def test_bandwidth_is_a_first_order_lag() -> None:
    late = outputs(rock(), faults=fault("gyro_bandwidth", 0.02), site=STILL_EARTH)
    w, t = 2 * np.pi, np.arange(200) / 50
    response = (np.cos(w * t) + w * 0.02 * np.sin(w * t)) / (1 + (w * 0.02) ** 2)
    assert late[:, 0] == pytest.approx(8 * np.pi * response, abs=1e-5)
    assert late[:, 3:] == pytest.approx(outputs(rock(), site=STILL_EARTH)[:, 3:])


def test_dead_zone_and_saturation() -> None:
    assert outputs(turn(0.5), faults=fault("gyro_dead_zone", 0.3), site=STILL_EARTH)[0, 0] == pytest.approx(0.4)
    assert outputs(turn(0.2), faults=fault("gyro_dead_zone", 0.3), site=STILL_EARTH)[0, 0] == 0
    clipped = outputs(turn(-60), turn(50), faults=fault("gyro_saturation", 5.0), site=STILL_EARTH)
    assert clipped[[0, 300], 0] == pytest.approx([-55, 50], abs=1e-6)


def test_limits_of_one_side_and_a_gradual_one() -> None:
    one = fault("gyro_saturation_asymmetric", 5.0, shape=(-1.0,))
    clipped = outputs(turn(-60), turn(60), faults=one, site=STILL_EARTH)
    assert clipped[[0, 300], 0] == pytest.approx([-55, 60], abs=1e-6)
    soft = outputs(turn(-60), turn(1e-9), faults=fault("gyro_soft_saturation", 0.01), site=STILL_EARTH)
    assert soft[0, 0] == pytest.approx(-53.7049567, abs=1e-6) and abs(soft[300, 0]) < 1e-6  # 100·tanh(0.6)
    free = outputs(turn(-60), turn(60), site=STILL_EARTH)
    noisy = recorded(MEMS, free, one, np.random.default_rng(1).normal(0, 0.01, free.shape))
    assert noisy[:, 0].min() >= -55.0 and noisy[:, 0].max() > 60.0


@pytest.mark.parametrize(
    ("effect", "theta", "expected"),
    [
        ("gyro_scale_nonlinearity", (1e-9, 0, 0), -2.16e-4),
        ("gyro_scale_asymmetry", (1e-4, 0, 0), 6e-3),
        ("gyro_scale_temperature", (1e-4, 0, 0), -1e-4 * 10 * 60),
        ("gyro_bias_temperature", (1e-3, 0, 0, 1e-4, 0, 0), 1e-2 + 1e-2),
        ("gyro_g_sensitivity", (0.02, 0, 0, 0, 0, 0, 0, 0, 0), 0.02),
        ("gyro_g2_sensitivity", (0.03, *(0,) * 17), 0.03),
        ("magnetic_sensitivity", (0.1, 0, 0, 0, 0, 0, 0, 0, 0), -0.083),
        ("magnetic_times_temperature", (0.1, 0, 0), -0.83),
    ],
)
def test_terms_of_the_gyro(effect: str, theta: tuple[float, ...], expected: float) -> None:
    values = changed(turn(-60.0, chamber=35.0), faults=fault(effect, *theta), site=STILL_EARTH)
    assert values[0, 0] == pytest.approx(expected, rel=1e-5)
    assert np.abs(values[0, 1:]).max() < 1e-12


@pytest.mark.parametrize(
    ("effect", "expected"),
    [("accel_bias_temperature", 0.1), ("accel_scale_temperature", 0.1 * G), ("accel_second_order", 0.01)],
)
def test_terms_of_the_accelerometer(effect: str, expected: float) -> None:
    assert changed(rest(35.0), faults=fault(effect, 0.01, 0, 0))[0] == pytest.approx([0, 0, 0, expected, 0, 0])


def test_a_ramp_is_exponential_and_remembered() -> None:
    plan = (rest(), rest(-20.0, ramp=True), Segment("e", "static", X_UP, 4.0, chamber=-20.0, start=900.0))
    felt = stimulus(Schedule(plan, 50.0), {})
    assert felt.temperature[[0, 200, 399, 400]] == pytest.approx([25, 25, -20 + 45 * np.exp(-3.98 / 90), -20])
    gradient = changed(*plan, faults=fault("gyro_thermal_gradient", 0.1, 0, 0))
    assert gradient[[0, 200, 400], 0] == pytest.approx([0, -0.05, 0], abs=1e-5)
    product = changed(turn(), Segment("t", "rate", X_UP, 4.0, 40.0, chamber=-20.0, ramp=True, start=700.0),
                      faults=fault("temperature_rate_times_rate", 0.1, 0, 0), site=STILL_EARTH)  # fmt: skip
    assert product[[0, 300], 0] == pytest.approx([0, -0.05 * 40], abs=1e-3)
    hysteresis = changed(*plan, faults=fault("gyro_thermal_hysteresis", 0.2, 0, 0))
    assert hysteresis[[0, 200, 400], 0] == pytest.approx([0, -0.2, -0.2])


def test_what_oscillation_leaves_in_the_mean() -> None:
    """4 deg at 1 Hz: mean squares (8π)²/2 of the rate in deg/s, and (A·p²)²/2 of the acceleration in rad/s²."""
    shaken = changed(rest(), turn(), rock(), faults=fault("gyro_vibration_rectification", 1e-5, 0, -2e-5))
    assert np.abs(shaken[:500]).max() < 1e-12
    assert shaken[500:, 0] == pytest.approx(np.full(200, 1e-5 * (8 * np.pi) ** 2 / 2), rel=1e-6)
    assert shaken[500:, 2] == pytest.approx(np.full(200, -2e-5 * (8 * np.pi) ** 2 / 2), rel=1e-6)
    shaken = changed(rest(), rock(), faults=fault("accel_vibration_rectification", 0, 1e-4, 0))
    expected = 1e-4 * (np.radians(4) * 4 * np.pi**2) ** 2 / 2
    assert shaken[200:, 4] == pytest.approx(np.full(200, expected), rel=1e-4) and not shaken[:200].any()


def test_axes_are_late_one_by_one() -> None:
    t = np.arange(200) / 50
    late = outputs(rock(), faults=fault("gyro_axis_delay", 0.01, 0.5, 0), site=STILL_EARTH)
    assert late[:, 0] == pytest.approx(8 * np.pi * np.cos(2 * np.pi * (t - 0.01)), abs=1e-6)
    assert np.abs(late[:, 1:3]).max() < 1e-9


def test_what_was_lost_is_shown_earlier() -> None:
    t = np.arange(200) / 50
    early = outputs(rock(), faults=fault("samples_dropped", 0.02, shape=(602.0,)), site=STILL_EARTH)
    expected = 8 * np.pi * np.cos(2 * np.pi * (t + 0.02 * (t >= 2.0)))
    assert early[:, 0] == pytest.approx(expected, abs=1e-6)


def test_a_mount_slips_at_one_moment() -> None:
    values = changed(rest(), faults=fault("mount_shift", 0, 0, 0.02, shape=(602.0,)))
    assert not values[:100].any()
    assert values[100, 3:] == pytest.approx([G * (np.cos(0.02) - 1), -G * np.sin(0.02), 0], abs=1e-9)


def test_a_body_behind_the_chamber() -> None:
    """Behind T₁ + D·exp(−t/90), a body with τ = 30 s has D·(90/60)·(exp(−t/90) − exp(−t/30)) + D·exp(−t/30)."""
    plan = (rest(), Segment("r", "static", X_UP, 100.0, chamber=-20.0, ramp=True, start=650.0))
    late = changed(*plan, faults=fault("gyro_bias_temperature_lagged", 0.01, 0, 0, shape=(30.0,)))
    t = np.arange(5000) / 50
    body = 45 * (1.5 * (np.exp(-t / 90) - np.exp(-t / 30)) + np.exp(-t / 30))
    assert late[200:, 0] == pytest.approx(0.01 * (body - 45 * np.exp(-t / 90)), abs=2e-3) and not late[:200].any()


def test_drifts_over_time() -> None:
    warm = changed(rest(), faults=fault("gyro_warm_up", 0.1, 0, 0, shape=(300.0,)))
    assert warm[0, 0] == pytest.approx(0.1 * np.exp(-2.0))
    saw = changed(rest(), faults=fault("sawtooth_bias", 0.1, 0, 0, shape=(1.0,)))
    assert saw[[0, 25, 49, 50], 0] == pytest.approx([0, 0.05, 0.098, 0], abs=1e-9)
    tone = changed(rest(), faults=fault("vibration_tone", 0.1, 0, 0, shape=(1.25, 0.0)))
    assert tone[10, 0] == pytest.approx(0.1, abs=1e-9)  # 0.2 s into a period of 0.8 s
    slow = changed(rest(), faults=fault("slow_sine_bias", 0.1, 0, 0, shape=(2400.0, 0.0)))
    assert slow[0, 0] == pytest.approx(0.1, abs=1e-9)  # 600 s into a period of 2400 s


def test_a_random_walk_grows_with_the_root_of_time() -> None:
    late = Segment("l", "static", X_UP, 4.0, start=700.0)
    ends = [
        changed(rest(), late, faults=fault("gyro_bias_random_walk", 1, 0, 0, shape=(s,)))[200, 0] for s in range(400)
    ]
    assert np.std(ends) == pytest.approx(10.0, rel=0.15)  # 100 s after the first sample


def test_backlash_holds_the_payload_after_a_reversal() -> None:
    play = fault("backlash", np.radians(1.0))
    rates = outputs(rock(), faults=play, site=STILL_EARTH)[:, 0]
    t = np.arange(200) / 50
    held = 4 * np.sin(2 * np.pi * t) > 3.0  # falling, until 1 deg is taken up
    falling = (t % 1 > 0.26) & (t % 1 < 0.74)
    assert np.abs(rates[held & falling]).max() < 1e-9
    assert rates[~held & falling] == pytest.approx(outputs(rock(), site=STILL_EARTH)[~held & falling, 0], abs=1e-6)


def test_bursts_offsets_resonance_and_rectification() -> None:
    burst = changed(*[turn(start) for start in (10, 20)], faults=fault("emi_bursts", 0.1, 0, 0, shape=(3.0,)))[:, 0]
    assert burst.max() > 0.05
    jump = changed(rest(), turn(), faults=fault("segment_offsets", 0.1, 0, 0, shape=(3.0,)))[:, 0]
    assert np.ptp(jump[:200]) < 1e-12 and np.ptp(jump[200:]) < 1e-12 and abs(jump[0] - jump[200]) > 1e-3
    bump = changed(
        turn(60), turn(-60), turn(120), faults=fault("rate_resonance", 0.1, 0, 0, shape=(60.0,)), site=STILL_EARTH
    )
    assert bump[[0, 300, 600], 0] == pytest.approx([0.1, 0.1, 0.1 * np.exp(-12.5)], abs=1e-6)
    shaken = changed(rest(), turn(-60), faults=fault("vibration_rectification", 1e-3, 0, 0))
    assert shaken[[0, 200], 3] == pytest.approx([0, 0.06], abs=1e-6)


def test_clipping_and_resolution_of_what_is_recorded() -> None:
    clean = np.zeros((1000, 6))
    noise = np.random.default_rng(1).normal(0, 0.01, clean.shape)
    fine = recorded(MEMS, clean, {}, noise)
    coarse = recorded(MEMS, clean, fault("gyro_quantization", 0.02), noise)
    assert np.abs(fine - noise).max(axis=0)[0] <= 2.5e-4 + 1e-12
    coarser = recorded(MEMS, clean, fault("accel_quantization", 0.02), noise)
    assert np.array_equal(coarser[:, :3], fine[:, :3]) and set(np.round(coarser[:, 4] / 0.02)) <= {-2, -1, 0, 1, 2}
    assert accel_noise_factor(fault("accel_noise_excess", 2.0)) == 3.0
    assert set(np.round(coarse[:, 0] / 0.02, 9)) <= {-2.0, -1.0, 0.0, 1.0, 2.0}
    assert np.array_equal(coarse[:, 3:], fine[:, 3:])
    clipped = recorded(MEMS, clean + 1.0, fault("gyro_saturation", 0.1), noise)
    assert clipped[:, 0] == pytest.approx(
        np.full(1000, 0.9), abs=2.5e-4
    )  # ten standard deviations above the limit: no noise
