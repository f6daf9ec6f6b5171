"""Effects' columns against the same physics simulated for a finite amplitude, with rotations by scipy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planrunner.base import plugins
from planrunner.error_model.effects.gyro_output import lagging
from planrunner.error_model.effects.interface import Column, Explained
from planrunner.error_model.effects.surroundings import TimeLatency
from planrunner.error_model.observed import Observed
from planrunner.error_model.segment_columns import estimable
from planrunner.gap.answer.diagnosis import hypotheses
from planrunner.plan.schedule import Rock
from tests.gap.turntable import DEG, SITE, G, record

Array = np.ndarray
IDS = [
    "gyro_bias_temperature",
    "gyro_scale_temperature",
    "gyro_scale_nonlinearity",
    "gyro_scale_asymmetry",
    "gyro_g_sensitivity",
    "gyro_g2_sensitivity",
    "gyro_bandwidth",
    "gyro_dead_zone",
    "gyro_saturation",
    "gyro_bias_random_walk",
    "accel_bias_step",
    "gyro_bias_step",
    "gyro_warm_up",
    "gyro_thermal_hysteresis",
    "gyro_thermal_gradient",
    "gyro_noise_excess",
    "gyro_quantization",
    "magnetic_sensitivity",
    "accel_bias_temperature",
    "accel_scale_temperature",
    "accel_second_order",
    "table_tilt",
    "table_azimuth",
    "table_position_error",
    "table_rate_ripple",
    "table_wobble",
    "table_rate_error",
    "site_latitude",
    "lever_arm",
    "time_latency",
    "gyro_vibration_rectification",
    "accel_vibration_rectification",
    "gyro_bias_temperature_lagged",
    "gyro_axis_delay",
    "accel_noise_excess",
    "accel_quantization",
    "samples_stuck",
    "gyro_line_interference",
    "accel_line_interference",
    "gyro_soft_saturation",
    "mount_shift",
    "gyro_bias",
    "gyro_scale_factor",
    "gyro_misalignment",
    "earth_rate",
    "accel_bias",
    "accel_scale_factor",
    "accel_misalignment",
]
FOR_ESTIMATES = [
    "gyro_scale_quadratic",
    "gyro_bias_temperature_cubic",
    "gyro_misalignment_temperature",
    "gyro_bias_drift",
    "accel_third_order",
    "accel_asymmetry",
    "accel_cross_coupling",
    "accel_misalignment_temperature",
    "accel_thermal_gradient",
    "accel_bias_drift",
    "accel_magnetic_sensitivity",
    "reference_latency",
    "accel_thermal_hysteresis",
    "accel_warm_up",
    "accel_bias_temperature_lagged",
    "gyro_angular_acceleration",
    "gyro_fold_over",
    "samples_dropped",
    "gyro_saturation_asymmetric",
    "accel_bias_random_walk",
    "gyro_bias_gauss_markov",
    "accel_bias_gauss_markov",
    *(
        f"{kind}_{what}_{cause}"
        for kind in ("gyro", "accel")
        for what in ("bias", "scale")
        for cause in ("supply", "pressure")
    ),
]
"""Effects that the diagnosis does not weigh unless they are named."""
DECLARATIONS = [
    "axis_reversed",
    "axes_mirrored",
    "axes_exchanged",
    "unit_wrong",
    "table_sense_reversed",
    "mount_turned",
]
"""Wrong declarations, which are found before effects are weighed."""
EARTH = 15.041067 * DEG / 3600 * np.array([0, np.cos(SITE.latitude), np.sin(SITE.latitude)])
EAST, NORTH, UP = np.eye(3)


@pytest.fixture(scope="module")
def observed() -> Observed:
    return record()


def test_the_whole_catalogue_is_installed() -> None:
    assert set(plugins.names("planrunner.effects")) == {*IDS, *FOR_ESTIMATES, *DECLARATIONS}
    for name in (*IDS, *FOR_ESTIMATES, *DECLARATIONS):
        effect = plugins.load("planrunner.effects", name)()
        assert effect.id == name
        assert effect.stage in ("stimulus", "sensor", "output", "acquisition", "covariance")
        assert effect.__doc__


def test_the_page_for_estimates_has_a_row_for_each_of_them() -> None:
    page = (Path(__file__).parents[2] / "docs/error-models.md").read_text(encoding="utf-8")
    for name in (*IDS, *FOR_ESTIMATES):
        effect = plugins.load("planrunner.effects", name)()
        if not estimable(effect):
            assert isinstance(effect, Explained)
            assert f"| `{name}` | {effect.shown_by} |" in page
    assert all(f"`{name}`" in page.partition("not hypotheses")[2] for name in FOR_ESTIMATES)


def test_effects_for_estimates_are_hypotheses_only_where_they_are_named() -> None:
    assert {effect.id for effect in hypotheses(None)} == set(IDS)
    assert [effect.id for effect in hypotheses(["accel_asymmetry"])] == ["accel_asymmetry"]


@pytest.mark.parametrize("name", IDS)
def test_columns_are_whole_and_named_apart(observed: Observed, name: str) -> None:
    for variant in plugins.load("planrunner.effects", name)().variants(observed):
        names = [column.name for column in variant.columns]
        assert len(set(names)) == len(names)
        for column in variant.columns:
            assert column.magnitude > 0
            assert column.factor > 0
            for index, part in column.parts.items():
                assert 0 <= index < 6
                assert part.shape == observed.time.shape
                assert np.isfinite(part).all()


def _columns(observed: Observed, name: str) -> dict[str, Column]:
    (variant,) = plugins.load("planrunner.effects", name)().variants(observed)
    return {column.name: column for column in variant.columns}


def _part(column: Column, observed: Observed) -> Array:
    mask = 1.0 if column.segments is None else column.segments[observed.owner][:, None]
    return (
        np.column_stack([column.parts[i] if i in column.parts else np.zeros(len(observed.time)) for i in range(6)])
        * mask
    )


def _simulated(observed: Observed, attitude: Callable[[Rotation], Rotation], rate: Callable[[Array], Array]) -> Array:
    """Rate and specific force with the platform's rotation (site from platform) and its rate [site axes] changed."""
    platform = Rotation.from_rotvec(observed.angle[:, None] * UP)
    turned = attitude(platform)
    omega = turned.inv().apply(EARTH + rate(observed.rate[:, None] * UP))
    force = turned.inv().apply(G * UP)
    fixed = observed.attitude[observed.owner]
    return np.hstack([np.einsum("nij,nj->ni", fixed, omega), np.einsum("nij,nj->ni", fixed, force)])


def _close(found: Array, expected: Array) -> None:
    for columns in (slice(0, 3), slice(3, 6)):
        size = np.abs(expected[:, columns]).max()
        assert found[:, columns] == pytest.approx(expected[:, columns], abs=2e-5 * size + 2e-9)


@pytest.mark.parametrize(
    ("name", "axis", "column"),
    [("table_tilt", EAST, "about_east"), ("table_tilt", NORTH, "about_north"), ("table_azimuth", UP, "about_up")],
)
def test_a_turned_base(observed: Observed, name: str, axis: Array, column: str) -> None:
    small = 1e-5
    base = Rotation.from_rotvec(small * axis)
    changed = _simulated(observed, lambda platform: base * platform, base.apply)
    plain = _simulated(observed, lambda platform: platform, lambda rate: rate)
    _close(_part(_columns(observed, name)[column], observed), (changed - plain) / small)


@pytest.mark.parametrize(
    ("name", "turned"),
    [("table_tilt", (0.1, -0.06, 0.0)), ("table_azimuth", (0.0, 0.0, 0.4)), ("table_azimuth", (0.0, 0.0, 0.0))],
)
def test_secants_of_a_base_turned_far(observed: Observed, name: str, turned: tuple[float, float, float]) -> None:
    """Multiplied by the angles that they were made for, the columns give the whole change."""
    base = Rotation.from_rotvec(turned)
    changed = _simulated(observed, lambda platform: base * platform, base.apply)
    plain = _simulated(observed, lambda platform: platform, lambda rate: rate)
    angles = np.array(turned)[:2] if name == "table_tilt" else np.array(turned)[2:]
    (secant,) = plugins.load("planrunner.effects", name)().around(observed, angles)
    found = sum(angle * _part(column, observed) for angle, column in zip(angles, secant.columns, strict=True))
    assert found == pytest.approx(changed - plain, abs=1e-9)


def test_secant_of_a_latitude_far_off(observed: Observed) -> None:
    error = 0.3
    moved = 15.041067 * DEG / 3600 * np.array([0, np.cos(SITE.latitude + error), np.sin(SITE.latitude + error)])
    back = Rotation.from_rotvec(-observed.angle[:, None] * UP)
    expected = np.einsum("nij,nj->ni", observed.attitude[observed.owner], back.apply(moved - EARTH))
    (secant,) = plugins.load("planrunner.effects", "site_latitude")().around(observed, np.array([error]))
    assert error * _part(secant.columns[0], observed)[:, :3] == pytest.approx(expected, abs=1e-11)


def test_wobble_is_the_matrix_of_its_definition_with_the_rate_that_goes_with_it(observed: Observed) -> None:
    """C = (I + [δ×])·R, its rate by numerical differentiation of the rotation."""
    a, phase, step = 1e-5, 0.7, 1e-4
    part = observed.segments()[14]
    angle, rate = observed.angle[part], float(observed.rate[part][0])

    def attitude(theta: Array) -> Rotation:
        delta = a * np.column_stack([np.cos(theta + phase), np.sin(theta + phase), 0 * theta])
        return Rotation.from_rotvec(delta) * Rotation.from_rotvec(theta[:, None] * UP)

    own = (attitude(angle - rate * step).inv() * attitude(angle + rate * step)).as_rotvec() / (2 * step)
    omega = attitude(angle).inv().apply(EARTH) + own
    force = attitude(angle).inv().apply(G * UP)
    fixed = observed.attitude[14]
    columns = _columns(observed, "table_wobble")
    found = (
        a * (np.cos(phase) * _part(columns["cos"], observed) + np.sin(phase) * _part(columns["sin"], observed))[part]
    )
    assert found[:, :3] == pytest.approx(omega @ fixed.T - observed.omega[part], abs=1e-4 * a * rate)
    assert found[:, 3:] == pytest.approx(force @ fixed.T - observed.force[part], abs=1e-4 * a * G)
    still = observed.segments()[0]
    assert not _part(columns["cos"], observed)[still].any()


def test_lever_arm_is_the_acceleration_of_its_path(observed: Observed) -> None:
    """Second differences of the position of a point carried round, on rocking segments."""
    arm, step = np.array([0.02, -0.01, 0.03]), 1e-3
    index = next(i for i, p in enumerate(observed.segments()) if observed.acceleration[p].any())
    part, motion = observed.segments()[index], observed.motions[index]
    assert isinstance(motion, Rock)
    amplitude, pulse = motion.amplitude, 2 * np.pi * motion.frequency
    since = observed.time[part] - observed.time[part.start]

    def position(t: Array) -> Array:
        angle = amplitude * np.sin(pulse * t)
        return Rotation.from_rotvec(angle[:, None] * UP).apply(observed.attitude[index].T @ arm)

    path = (position(since + step) - 2 * position(since) + position(since - step)) / step**2
    back = Rotation.from_rotvec(-observed.angle[part][:, None] * UP).apply(path) @ observed.attitude[index].T
    columns = _columns(observed, "lever_arm")
    found = sum(value * _part(columns[f"r_{axis}"], observed)[part, 3:] for axis, value in zip("xyz", arm, strict=True))
    assert found == pytest.approx(back, abs=1e-5 * np.abs(back).max())


def test_latitude_is_the_derivative_of_the_earth_rate(observed: Observed) -> None:
    small = 1e-6
    moved = 15.041067 * DEG / 3600 * np.array([0, np.cos(SITE.latitude + small), np.sin(SITE.latitude + small)])
    back = Rotation.from_rotvec(-observed.angle[:, None] * UP)
    expected = np.einsum("nij,nj->ni", observed.attitude[observed.owner], back.apply((moved - EARTH) / small))
    assert _part(_columns(observed, "site_latitude")["error"], observed)[:, :3] == pytest.approx(expected, abs=1e-10)


def test_a_lag_of_a_sine_is_the_textbook_response(observed: Observed) -> None:
    """After its transient, amplitude 1/√(1 + (ωτ)²) and phase −atan ωτ; and a delay shifts the phase alone."""
    index = next(i for i, p in enumerate(observed.segments()) if observed.acceleration[p].any())
    part, motion = observed.segments()[index], observed.motions[index]
    assert isinstance(motion, Rock)
    pulse = 2 * np.pi * motion.frequency
    since = observed.time[part] - observed.time[part.start]
    axis = int(np.argmax(np.abs(observed.omega[part]).max(0)))

    def phasor(signal: Array) -> complex:
        late = since >= 2.0 - 1e-9
        return complex(np.mean(signal[late] * np.exp(-1j * pulse * since[late])))

    tau = 0.03
    ratio = phasor((observed.omega + lagging(observed, tau))[part, axis]) / phasor(observed.omega[part, axis])
    assert ratio == pytest.approx(1 / (1 + 1j * pulse * tau), rel=3e-3)
    delayed = observed.omega[part, axis] + TimeLatency().at(observed, 0.01).columns[0].parts[axis][part]
    ratio = phasor(delayed) / phasor(observed.omega[part, axis])
    assert ratio == pytest.approx(np.exp(-1j * pulse * 0.01), rel=3e-3)


def test_mean_squares_of_a_rocking_table(observed: Observed) -> None:
    """3 deg at 0.5 Hz: the mean square of A·p·cos pt is (A·p)²/2, at every sample; that of its derivative (A·p²)²/2."""
    p, amplitude = np.pi, 3 * DEG
    rocking = np.repeat([isinstance(motion, Rock) for motion in observed.motions], np.diff(observed.bounds))
    for name, size, unit in (("gyro", amplitude * p, 1 / DEG), ("accel", amplitude * p**2, 1.0)):
        (variant,) = plugins.load("planrunner.effects", f"{name}_vibration_rectification")().variants(observed)
        for column in variant.columns:
            (part,) = column.parts.values()
            assert part[rocking] == pytest.approx(np.full(rocking.sum(), size**2 / 2), rel=1e-9)
            assert not part[~rocking].any()
            assert column.factor == pytest.approx(unit if name == "gyro" else 9.80665e-6)


def test_a_mount_that_shifts_turns_what_the_sensor_feels(observed: Observed) -> None:
    """Against rotations by scipy: in the axes of a sensor that is turned by R, a vector v is R⁻¹·v."""
    moment = float(observed.time[len(observed.time) // 3 + 7])
    angles = np.array([2e-5, -1e-5, 3e-5])
    variant = plugins.load("planrunner.effects", "mount_shift")().at(observed, moment)
    found = sum(angle * _part(column, observed) for angle, column in zip(angles, variant.columns, strict=True))
    back = Rotation.from_rotvec(angles).inv()
    felt = np.hstack([back.apply(observed.omega) - observed.omega, back.apply(observed.force) - observed.force])
    expected = np.where((observed.time >= moment)[:, None], felt, 0.0)
    assert found == pytest.approx(expected, abs=2e-8)


def test_every_axis_is_late_by_its_own_delay(observed: Observed) -> None:
    delays = np.array([0.02, 0.0, -0.05])
    effect = plugins.load("planrunner.effects", "gyro_axis_delay")()
    (variant,) = effect.around(observed, delays)
    found = sum(delay * _part(column, observed) for delay, column in zip(delays, variant.columns, strict=True))
    part = next(
        rows for rows, motion in zip(observed.segments(), observed.motions, strict=True) if isinstance(motion, Rock)
    )
    since = observed.time[part] - observed.time[part][0]
    for axis, delay in enumerate(delays):
        rate = 3 * DEG * np.pi * (np.cos(np.pi * (since - delay)) - np.cos(np.pi * since))
        assert found[part, axis] == pytest.approx(rate * observed.table_axis[part][:, axis], abs=1e-9)


def test_the_lag_of_a_temperature_is_that_of_an_integration() -> None:
    """A ramp of 20 K in 200 s, an exponential of which 180 s are recorded, and rests, against Euler's rule in steps of 10 ms; the rests
    begin after the temperature has settled, and one soon after a step."""
    from dataclasses import replace

    from planrunner.error_model.effects.thermal_lag import lag

    tau, sets = 120.0, [(0.0, 100.0), (110.0, 200.0), (315.0, 180.0), (1500.0, 60.0), (1570.0, 60.0)]

    def warm(t: Array) -> Array:
        ramp = np.clip((t - 110.0) / 10.0, 0.0, 20.0)
        settling = np.where(t > 315.0, -30.0 * (1 - np.exp(-(t - 315.0) / 90.0)), 0.0)
        return 25.0 + ramp + settling + np.where(t > 1560.0, 5.0, 0.0)

    clock = np.arange(0.0, 1640.0, 0.01)
    body, value = np.empty(len(clock)), 25.0
    for place, chamber in enumerate(warm(clock)):
        body[place] = value
        value += 0.01 / tau * (chamber - value)
    time = np.concatenate([start + np.arange(0.0, length, 1.0) for start, length in sets])
    bounds = np.concatenate(([0], np.cumsum([int(length) for _, length in sets])))
    seen = record()
    slope = np.where(
        time < 110, 0.0, np.where(time < 310, 0.1, np.where(time < 500, -np.exp(-(time - 315) / 90) / 3, 0))
    )
    made = replace(
        seen,
        labels=tuple("abcde"),
        motions=seen.motions[:5],
        attitude=seen.attitude[:5],
        bounds=bounds.astype(np.int64),
        time=time,
        temperature=warm(time),
        temperature_rate=slope,
        last_change=np.ones(5),
    )
    expected = np.interp(time, clock, body) - warm(time)
    assert np.abs(expected).max() > 5.0
    assert lag(made, tau) == pytest.approx(
        expected, abs=0.06 * 5.0
    )  # within the gap of 10 s, 5 K come at its beginning
    assert lag(made, tau)[: bounds[4]] == pytest.approx(expected[: bounds[4]], abs=0.02)


def test_limits_of_one_side_and_a_gradual_one(observed: Observed) -> None:
    rates = np.degrees(observed.omega)
    above, below = plugins.load("planrunner.effects", "gyro_saturation_asymmetric")().alternatives
    for way, expected in (
        (above, np.minimum(rates, 30.0)),
        (below, np.maximum(rates, -30.0)),
        (plugins.load("planrunner.effects", "gyro_soft_saturation")(), 100 * np.tanh(rates / 100)),
    ):
        (column,) = way.at(observed, 100.0 if way.shape_name == "limit" else 30.0).columns
        found = np.degrees(_part(column, observed)[:, :3])
        assert found == pytest.approx(expected - rates, abs=1e-5) and np.abs(found).max() > 10
