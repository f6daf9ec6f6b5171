"""The estimator error_model and effects of the table, the site and the mounting, against inputs from rotation matrices alone.

What the payload feels is computed from the matrix of its attitude on the way round, and its rate from the change of that matrix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import simulated_imu as imu
from recorded import from_means, from_samples, noisy, sensor
from test_error_model import OBLIQUE

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.error_model.estimator import ErrorModelEstimator
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, EstimationError
from planrunner.estimators.method import designed
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Segment

Array = np.ndarray
AXES = dict(zip((*imu.GYROS, *imu.ACCELS), "xyzxyz", strict=True))
GYRO, ACCEL = ("gyro_bias", "gyro_scale_factor"), ("accel_bias", "accel_scale_factor")
ARCSEC = math.radians(1) / 3600
STEPS = 72


def rotation(vector: Array) -> Array:
    """The matrix of a small rotation vector, rad, by the series of the exponential."""
    x, y, z = vector
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / 2 + skew @ skew @ skew / 6)


def about_up(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@dataclass(frozen=True)
class Place:
    """What is wrong with table, site and mounting. tilt: rotation of the base, wobble: of the payload while the table turns, both rad;
    latitude: rad; faster: relative; arm: m, from the axis to the accelerometers, in sensor axes."""

    tilt: Array | None = None
    wobble: Array | None = None
    latitude: float = imu.LATITUDE
    faster: float = 0.0
    arm: Array | None = None

    def felt(self, segment: Segment) -> tuple[Array, Array]:
        """Rate and specific force on the sensor's axes, means over a turn."""
        angles = np.arange(STEPS if segment.rate else 1) * (2 * math.pi / STEPS)
        rates, forces = self.along(segment, angles)
        return rates.mean(axis=0), forces.mean(axis=0)

    def along(self, segment: Segment, angles: Array) -> tuple[Array, Array]:
        """The same at each angle of the table, rad; (k, 3) each."""
        assert segment.attitude is not None
        earth = imu.EARTH * np.array([0, math.cos(self.latitude), math.sin(self.latitude)])
        up, rate = np.array([0, 0, imu.GRAVITY]), segment.rate * (1 + self.faster)
        base = np.eye(3) if self.tilt is None else rotation(self.tilt)
        payload = np.eye(3) if self.wobble is None or not segment.rate else rotation(self.wobble)

        def attitude(angle: float) -> Array:
            """Site axes as the payload sees them, (3, 3)."""
            return np.asarray((base @ about_up(angle) @ payload).T)

        rates, forces = [], []
        for angle in angles:
            seen, step = attitude(angle), 1e-4
            turning = (attitude(angle + step) - attitude(angle - step)) / (2 * step) * rate  # Ṁ = −[ω×]·M
            skew = -turning @ seen.T
            own = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
            force = seen @ up
            if self.arm is not None:
                arm = segment.attitude.T @ self.arm
                force = force + np.cross(own, np.cross(own, arm))
            rates.append(segment.attitude @ (seen @ earth + own))
            forces.append(segment.attitude @ force)
        return np.array(rates), np.array(forces)


def segments(rates: Sequence[float] = (20.0, -20.0, 90.0, -90.0)) -> list[Segment]:
    positions = [imu.rest(text) for text in imu.POSITIONS]
    oblique = [replace(positions[0], attitude=one, label=f"o{k}", orientation=f"o{k}") for k, one in enumerate(OBLIQUE)]
    return [*positions, *oblique, *(imu.spin(axis, rate) for axis in "xyz" for rate in rates)]


SIZES = np.repeat([1e-7, 1e-4], 3)
"""Standard uncertainty of the mean of a segment, rad/s and m/s²; half of the variance is common to gx and gy."""
SAMPLES = 6 * STEPS
"""Of a segment: at 36 deg/s, a dwell of 60 s is six turns."""


def outputs_of(rate: Array, force: Array) -> Array:
    """Scale factors 1.001, biases 1e-5 rad/s and 0.01 m/s²; (k, 6) for (k, 3) each."""
    return np.concatenate([1.001 * rate + 1e-5, 1.001 * force + 0.01], axis=-1)


def play(planned: Sequence[Segment], place: Place) -> list[RecordedSegment]:
    """Exact means with the stated sizes of noise."""
    found = []
    for number, one in enumerate(planned):
        values = outputs_of(*place.felt(one))
        made = from_means(one, dict(zip(AXES, values, strict=True)), "rad/s", SIZES, 4000, start=100.0 * number)
        covariance = made.statistics.covariance.copy()
        covariance[0, 1] = covariance[1, 0] = covariance[0, 0] / math.sqrt(2)
        made = replace(made, statistics=replace(made.statistics, covariance=covariance))
        made.units.update(dict.fromkeys(imu.ACCELS, "m/s^2"))
        found.append(made)
    return found


def without_noise(planned: Sequence[Segment], place: Place) -> list[Array]:
    """Samples of each segment, (6, SAMPLES), each in the middle of its interval."""
    found = []
    for one in planned:
        assert one.dwell is not None
        turns = one.rate * one.dwell * (np.arange(SAMPLES if one.rate else 1) + 0.5) / SAMPLES
        values = outputs_of(*place.along(one, turns))
        found.append(np.broadcast_to(values, (SAMPLES, 6)).T)
    return found


def with_noise(
    planned: Sequence[Segment], exact: Sequence[Array], draw: np.random.Generator
) -> tuple[RecordedSegment, ...]:
    found = []
    for number, (one, values) in enumerate(zip(planned, exact, strict=True)):
        assert one.dwell is not None
        noise = draw.standard_normal(values.shape)
        noise[1] = (noise[0] + noise[1]) / math.sqrt(2)
        made = values + (SIZES * math.sqrt(SAMPLES))[:, None] * noise
        time = 100.0 * number + one.dwell / SAMPLES * np.arange(SAMPLES)
        units = dict.fromkeys(imu.GYROS, "rad/s") | dict.fromkeys(imu.ACCELS, "m/s^2")
        found.append(from_samples(one, time, dict(zip(AXES, made, strict=True)), units))
    return tuple(found)


def estimate(
    recorded: Sequence[RecordedSegment],
    outputs: Mapping[str, tuple[str, ...]],
    site: Site = imu.SITE,
    uncertainty: str = "within_segment",
) -> Estimate:
    axes = {name: AXES[name] for name in outputs}
    parameters = ErrorModelParameters(outputs=dict(outputs), axes=axes, uncertainty=uncertainty)
    return ErrorModelEstimator().estimate(EstimateRequest("m", tuple(recorded), parameters, site, sensor(*AXES)))


MINUTE = 60 * ARCSEC
CASES: list[tuple[Place, tuple[str, ...], tuple[str, ...], dict[str, float]]] = [
    (
        Place(tilt=np.array([MINUTE, -0.5 * MINUTE, 0])), (*GYRO, "table_tilt"), (*ACCEL, "table_tilt"),
        {"table_tilt_about_east": 60.0, "table_tilt_about_north": -30.0},
    ),
    (Place(tilt=np.array([0, 0, 10 * MINUTE])), (*GYRO, "table_azimuth"), (), {"table_azimuth_about_up": 600.0}),
    (Place(latitude=imu.LATITUDE + 1e-3), (*GYRO, "site_latitude"), (), {"site_latitude_error": math.degrees(1e-3)}),
    (Place(faster=1e-4), ("gyro_bias", "gyro_misalignment", "table_rate_error"), (), {"table_rate_error_epsilon": 1100.0}),
    (
        Place(wobble=np.array([MINUTE, -0.5 * MINUTE, 0])), (*GYRO, "table_wobble"), (*ACCEL, "lever_arm.r_own", "table_wobble"),
        {"table_wobble_cos": 60.0, "table_wobble_sin": -30.0},
    ),
    (
        Place(arm=np.array([0.02, -0.01, 0.03])), (), (*ACCEL, "lever_arm.r_own"),
        {
            "lever_arm_r_x_ax": 20.02, "lever_arm_r_y_ay": -10.01, "lever_arm_r_z_az": 30.03,
        },
    ),
]  # fmt: skip


@pytest.mark.parametrize(
    ("place", "gyro", "accel", "truth"), CASES, ids=lambda one: "-".join(one) if isinstance(one, dict) else ""
)
def test_effects_of_table_site_and_mounting_are_found(
    place: Place, gyro: tuple[str, ...], accel: tuple[str, ...], truth: dict[str, float]
) -> None:
    """Small angles and the scale factors of 1.001: to a part in a thousand."""
    lists = {name: gyro for name in imu.GYROS if gyro} | {name: accel for name in imu.ACCELS if accel}
    # Turns about the vertical show an accelerometer only the arm along its own axis.
    outputs = {name: tuple(one.replace("r_own", f"r_{name[1]}") for one in own) for name, own in lists.items()}
    found = estimate(play(segments(), place), outputs)
    for name, value in truth.items():
        assert found[name].value == pytest.approx(value, rel=3e-3), name


@pytest.mark.slow
def test_a_tilt_in_common_is_found_within_its_uncertainty() -> None:
    """From 60 recordings: errors over u have a standard deviation of one, and u is smaller than that of one output."""
    draw, planned, errors, biases = np.random.default_rng(4), segments((36.0, -36.0)), [], []
    clean = without_noise(planned, Place(tilt=np.array([20 * ARCSEC, -10 * ARCSEC, 0])))
    outputs: dict[str, tuple[str, ...]] = {
        "gx": (*GYRO, "table_tilt"),
        "ax": (*ACCEL, "table_tilt"),
        "ay": (*ACCEL, "table_tilt"),
    }
    parameters = ErrorModelParameters(
        outputs=dict(outputs), axes={name: AXES[name] for name in outputs}, uncertainty="within_segment"
    )
    for _ in range(60):
        recorded = with_noise(planned, clean, draw)
        made = ErrorModelEstimator().quantities(EstimateRequest("m", recorded, parameters, imu.SITE, sensor(*AXES)))
        found = {one.name: one for one in made.coefficients}
        for name, truth in (("table_tilt_about_east", 20.02), ("table_tilt_about_north", -10.01)):
            errors.append((found[name].value - truth) / found[name].standard_uncertainty)
        bias = found["accel_bias_x"]
        biases.append((bias.value - 1e3 * 0.01 / 9.80665) / bias.standard_uncertainty)
    for name in ("gx", "ax"):
        alone = estimate(recorded, {name: outputs[name]})["table_tilt_about_east"].standard_uncertainty
        assert found["table_tilt_about_east"].standard_uncertainty < 0.8 * alone
    assert np.std(errors) == pytest.approx(1.0, abs=0.25) and abs(np.mean(errors)) < 0.35
    assert np.std(biases) == pytest.approx(1.0, abs=0.35)


def test_noise_in_common_correlates_the_coefficients_of_different_outputs() -> None:
    """gx and gy share half of their noise variance: so do their biases, whose matrices are alike."""
    found = estimate(
        play([imu.rest(text) for text in imu.POSITIONS], Place()),
        dict.fromkeys(imu.GYROS, ("gyro_bias",)),
    )
    correlation = found.covariance / np.sqrt(np.outer(np.diag(found.covariance), np.diag(found.covariance)))
    assert correlation == pytest.approx(np.array([[1, math.sqrt(0.5), 0], [math.sqrt(0.5), 1, 0], [0, 0, 1]]), abs=1e-9)


def test_outputs_that_contradict_each_other_about_a_tilt_are_named() -> None:
    """One accelerometer on a level table, the others on a tilted one."""
    level, tilted = (play(segments(()), Place(tilt=one)) for one in (None, np.array([MINUTE, 0, 0])))
    mixed = [
        replace(
            one, statistics=replace(one.statistics, mean=np.append(other.statistics.mean[:5], one.statistics.mean[5]))
        )
        for one, other in zip(level, tilted, strict=True)
    ]
    outputs: dict[str, tuple[str, ...]] = dict.fromkeys(imu.ACCELS, (*ACCEL, "table_tilt"))
    found = estimate(mixed, outputs)
    (said,) = found.warnings
    assert "table_tilt_about_east" in said and "the outputs give different values" in said
    held = next(table for table in found.tables if table.title == "Coefficients that outputs have in common")
    east = [row[2] for row in held.rows if row[0] == "table_tilt_about_east"]
    assert east == pytest.approx([60.06, 60.06, 0.0], abs=0.1)
    assert not estimate(tilted, outputs).warnings


@pytest.mark.parametrize(
    ("kind", "effect", "size"),
    [("g", "magnetic_sensitivity", math.radians(0.01)), ("a", "accel_magnetic_sensitivity", 9.80665e-3)],
)
def test_a_response_to_the_field_is_found(kind: str, effect: str, size: float) -> None:
    """The field points north and down at 60 deg; the outputs respond to it along x with one unit of the effect times three."""
    field = np.array([0.0, math.cos(math.radians(60)), -math.sin(math.radians(60))])
    site = replace(imu.SITE, magnetic_field=tuple((48.0 * field).tolist()))
    recorded = []
    for one in play(segments(()), Place()):
        assert one.segment.attitude is not None
        more = np.zeros(6)
        more[3 * (kind == "a") : 3 * (kind == "a") + 3] = 3 * size * (one.segment.attitude @ field)[0]
        recorded.append(replace(one, statistics=replace(one.statistics, mean=one.statistics.mean + more)))
    base: Any = GYRO if kind == "g" else ACCEL
    found = estimate(recorded, {f"{kind}x": (*base, effect), f"{kind}z": (*base, effect)}, site)
    expected = 0.03 if kind == "g" else 3.0
    for axis in "xz":
        assert found[f"{effect}_K_x_{axis}"].value == pytest.approx(expected, rel=1e-6)
        assert found[f"{effect}_K_y_{axis}"].value == pytest.approx(0.0, abs=1e-6 * expected)


def test_thermal_hysteresis_is_found() -> None:
    """0, 20, 40 degC and back, twice; the sign is that of the last change."""
    celsius, recorded = [0, 20, 40, 20, 0, 20, 40, 20, 0], []
    for number, warm in enumerate(celsius):
        sign = 0 if number == 0 else math.copysign(1, warm - celsius[number - 1])
        one = imu.rest("east north up", temperature=warm + 273.15)
        level = imu.EARTH * math.sin(imu.LATITUDE)
        value = level + math.radians(0.1) + math.radians(1e-3) * (warm - 25) + math.radians(0.02) * sign
        recorded.append(from_means(one, dict.fromkeys(AXES, value), "rad/s", 1e-9, start=100.0 * number))
    found = estimate(recorded, {"gz": ("gyro_bias", "gyro_bias_temperature.c1", "gyro_thermal_hysteresis")})
    assert found["gyro_thermal_hysteresis_z"].value == pytest.approx(0.02, rel=1e-9)
    assert found["gyro_bias_z"].value == pytest.approx(0.1, rel=1e-9)


# -- a shape: the time constant of a warm-up ---------------------------------------------------------------------------

TAU, SIZE, DWELL = 900.0, 0.05, 120.0


def one_row(start: float, means: Mapping[str, float], channels: Sequence[str]) -> Iterator[Block]:
    """What a published table has in place of samples."""
    yield Block(np.array([start]), {name: np.array([means[name]]) for name in channels})


def warming(draw: np.random.Generator | None, noise: float = 1e-6, size: float = SIZE) -> list[RecordedSegment]:
    """36 positions in 90 minutes, beginning 60 s after power-on: means of the exponential by its integral, or with `draw` samples of it.
    noise: of each mean, rad/s."""
    found = []
    for number, one in enumerate(segments(())):
        rate, _ = Place().felt(one)
        begin = 60 + 150.0 * number
        level, planned = 1.001 * rate[0] + 1e-5, replace(one, dwell=DWELL, start=begin)
        if draw is None:
            mean = TAU / DWELL * (math.exp(-begin / TAU) - math.exp(-(begin + DWELL) / TAU))
            values = {"gx": level + math.radians(size) * mean}
            table = from_means(planned, values, "rad/s", noise, 4000, start=begin)
            found.append(replace(table, blocks=partial(one_row, begin, values)))
        else:
            course = np.exp(-(begin + DWELL * (np.arange(320) + 0.5) / 320) / TAU)
            found.append(noisy(planned, {"gx": level + math.radians(size) * course}, "rad/s", noise, draw, begin))
    return found


WARM: dict[str, tuple[str, ...]] = {"gx": (*GYRO, "gyro_warm_up")}


def test_the_time_constant_of_a_warm_up_is_found() -> None:
    clean = estimate(warming(None), WARM)
    assert clean["gyro_warm_up_tau_x"].value == pytest.approx(TAU, rel=1e-5) and clean["gyro_warm_up_tau_x"].unit == "s"
    assert clean["gyro_warm_up_a_x"].value == pytest.approx(SIZE, rel=1e-5)
    assert clean["gyro_bias_x"].value == pytest.approx(math.degrees(1e-5), rel=1e-4)
    added = clean.extra["effects"]
    assert isinstance(added, dict) and set(added["gyro_warm_up"]) == {"a_x", "tau"}


@pytest.mark.slow
def test_uncertainties_include_that_of_the_time_constant() -> None:
    truth = {"gyro_warm_up_tau_x": TAU, "gyro_warm_up_a_x": SIZE, "gyro_bias_x": math.degrees(1e-5)}
    draw, errors = np.random.default_rng(3), []
    for _ in range(40):
        found = estimate(warming(draw), WARM, uncertainty="residual")
        errors.append([(found[name].value - true) / found[name].standard_uncertainty for name, true in truth.items()])
    scatter, mean = np.std(errors, axis=0), np.mean(errors, axis=0)
    assert (scatter < 1.4).all() and (np.abs(mean) < 0.6).all()  # 40 errors: 1 ± 0.11 and 0 ± 0.16
    assert (scatter > 0.67).all()


def test_the_course_of_a_warm_up_within_a_segment_is_not_noise() -> None:
    """Means of 1e-6 rad/s: while the unit warms up, a segment scatters up to five times as widely as its noise."""
    found = estimate(warming(np.random.default_rng(5)), WARM)
    assert found.settings["weights"] == {"gx": "one noise level for all segments"}
    assert found["gyro_bias_x"].standard_uncertainty == pytest.approx(math.degrees(2.8e-7), rel=0.3)


def test_a_warm_up_that_is_not_there_or_too_long_is_refused() -> None:
    with pytest.raises(EstimationError, match=r"shows no gyro_warm_up|is not between"):
        estimate(warming(np.random.default_rng(1), size=0.0), WARM)


def test_a_warm_up_is_foreseen_without_uncertainty() -> None:
    planned = tuple(one.segment for one in warming(None))
    parameters = ErrorModelParameters(outputs=dict(WARM), axes={"gx": "x"})
    outputs = (OutputModel("gx", "rad/s", noise=NoiseModel(white=1e-5)),)
    request = DesignRequest("m", planned, parameters, imu.SITE, SensorModel("imu", outputs, 100.0))
    made = designed(ErrorModelEstimator(), request)
    assert not made.predicted and not [one for one in made.remarks if one.error]
    names = [one.name for one in estimate(warming(None), WARM).coefficients]
    assert sorted(one.name for one in made.unpredicted) == sorted(names)
