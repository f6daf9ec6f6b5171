"""Real recordings through the estimators, against what is known of them.

rate staircase: two gyros on an open-loop stepper jig, 60 to 720 °/s about sensor y; pitch tumble: 37 stops about sensor y;
MPU-9150: tumbled by hand.
How much the threshold of stillness matters is tabled in docs/real-recordings.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from recorded import from_samples, real, rows_of, segment, sensor, table

from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.interface import Estimate, EstimateRequest, EstimationError
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.orientation import rotation
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Spin
from planrunner.plan.selection import Detection

SITE = Site(math.radians(40.0))


def staircase(gyro: str, margin: float = 2.0, declared: str = "deg/s", **keys: Any) -> Estimate:
    data = table(real("rimu_jig", "rate_staircase.parquet"))
    outputs = tuple(f"{gyro}_gyro_{axis}" for axis in "xyz")
    recorded = []
    for row in rows_of(real("rimu_jig", "rate_staircase.segments.csv")):
        inside = (data["time_s"] >= float(row["start_s"]) + margin) & (data["time_s"] <= float(row["end_s"]) - margin)
        channels = {name: data[f"{name}_deg_per_s"][inside] for name in outputs}
        spin = Spin(math.radians(float(row["rate_about_sensor_y_deg_per_s"])))
        planned = segment(row["label"], np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float), spin)
        recorded.append(from_samples(planned, data["time_s"][inside], channels, dict.fromkeys(outputs, declared)))
    parameters = ScaleFactorParameters(outputs=outputs, **keys)
    return ScaleFactor().estimate(
        EstimateRequest("scale", tuple(recorded), parameters, SITE, sensor(*outputs, unit=declared))
    )


def test_staircase_scale_factors() -> None:
    """Equal weights, as in the known figures."""
    bno, lsm = staircase("bno", weights="equal"), staircase("lsm", weights="equal")
    assert bno["K_bno_gyro_y"].unit == "1"
    assert bno["K_bno_gyro_y"].value == pytest.approx(1.0028, abs=0.0005)
    assert lsm["K_lsm_gyro_y"].value == pytest.approx(0.846, abs=0.008)
    # Biases known from rest: (2.2, −5.7, −4.9) °/s. The line's offsets agree within their 95 % intervals (t of 5 degrees of freedom: 2.571)
    # on y and z; on x, a cross-axis output that the jig's resonance at 360 °/s shifts by 0.7 °/s, only within 3 standard uncertainties.
    # x is not held against its bias at rest, 2.2 °/s: it misses it by 2.85 u, as docs/real-recordings.md says.
    for axis, bias in (("y", -5.7), ("z", -4.9)):
        offset = lsm[f"F0_lsm_gyro_{axis}"]
        assert offset.unit == "deg/s"
        assert abs(offset.value - bias) <= 2.571 * offset.standard_uncertainty, offset
    assert lsm["F0_lsm_gyro_z"].value == pytest.approx(-4.9, abs=0.1)
    # The jig's resonances make the residual far larger than the noise: the page must say so.
    assert any("something changes from segment to segment" in warning for warning in lsm.warnings)


def test_gyro_declared_in_the_wrong_unit_is_named() -> None:
    """The staircase's degrees per second, declared as radians per second."""
    found = staircase("bno", declared="rad/s")
    assert found["K_bno_gyro_y"].value == pytest.approx(1.0028 * 180 / math.pi, rel=0.001)
    assert [text for text in found.warnings if "bno_gyro_y" in text and "agree with deg/s" in text]
    assert not [text for text in staircase("bno").warnings if "declares" in text]


def test_unsteady_rate_counts_less_by_its_noise() -> None:
    """At 720 °/s the jig slows down before the two seconds that are left out begin, and drags the equal-weight line; a longer margin or
    weights by noise show the same scale factor without it."""
    weighted = staircase("bno")["K_bno_gyro_y"]
    steady = staircase("bno", margin=3.5, weights="equal")["K_bno_gyro_y"]
    assert abs(weighted.value - steady.value) < 2.571 * (weighted.standard_uncertainty + steady.standard_uncertainty)


def tumble(
    imu: str, terms: tuple[str, ...] = ("bias", "accel_x", "accel_z"), signs: Mapping[str, int] = MappingProxyType({})
) -> Estimate:
    """x east, y north, z up, then turned by −angle about the sensor's y: x rises first. signs: of the channels."""
    data = table(real("rimu_jig", "pitch_tumble.parquet"))
    outputs = tuple(f"{imu}_accel_{axis}" for axis in "xyz")
    recorded = []
    for row in rows_of(real("rimu_jig", "pitch_tumble.segments.csv")):
        inside = (data["time_s"] >= float(row["start_s"]) + 0.5) & (data["time_s"] <= float(row["end_s"]) - 0.5)
        channels = {name: signs.get(name, 1) * data[f"{name}_g"][inside] for name in outputs}
        attitude = rotation(1, -math.radians(float(row["commanded_top_angle_deg"])))
        recorded.append(
            from_samples(segment(row["label"], attitude), data["time_s"][inside], channels, dict.fromkeys(outputs, "g"))
        )
    parameters = AccelerometerMultiPositionParameters(outputs=outputs, terms=terms)
    request = EstimateRequest("tumble", tuple(recorded), parameters, SITE, sensor(*outputs, unit="g"))
    return AccelerometerMultiPosition().estimate(request)


def test_tumble_scale_bias_and_residuals() -> None:
    lsm, bno = tumble("lsm"), tumble("bno")
    for axis in "xz":
        assert bno[f"scale_{axis}"].value == pytest.approx(0.954, abs=0.002)

    # A second formula: each axis is a bias and one harmonic of the commanded angle, with equal weights.
    stops = rows_of(real("rimu_jig", "pitch_tumble.segments.csv"))
    data = table(real("rimu_jig", "pitch_tumble.parquet"))
    angle = np.radians([float(row["commanded_top_angle_deg"]) for row in stops])
    harmonic = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
    for k, axis in enumerate("xyz"):
        means = np.array(
            [
                data[f"lsm_accel_{axis}_g"][
                    (data["time_s"] >= float(row["start_s"]) + 0.5) & (data["time_s"] <= float(row["end_s"]) - 0.5)
                ].mean()
                for row in stops
            ]
        )
        (bias, cosine, sine), squares, *_ = np.linalg.lstsq(harmonic, means, rcond=None)
        for name, expected in ((f"bias_{axis}", 1e3 * bias), *second_names(axis, cosine, sine)):
            assert abs(lsm[name].value - expected) < lsm[name].standard_uncertainty, name
        assert lsm.extra["root_mean_square"][k] == pytest.approx(math.sqrt(squares[0] / (len(angle) - 3)), rel=0.02)


def test_reversed_axis_has_a_negative_scale_factor_and_a_warning() -> None:
    plain, turned = tumble("bno"), tumble("bno", signs={"bno_accel_x": -1})
    assert turned["scale_x"].value == -plain["scale_x"].value < -0.9
    assert turned["scale_x"].standard_uncertainty == pytest.approx(plain["scale_x"].standard_uncertainty)
    assert turned["misalignment_x_z"].value == pytest.approx(plain["misalignment_x_z"].value)
    assert turned["scale_z"].value == plain["scale_z"].value
    said = set(turned.warnings) - set(plain.warnings)
    assert [text for text in said if "bno_accel_x responds along x with the opposite sign" in text]


def second_names(axis: str, cosine: float, sine: float) -> tuple[tuple[str, float], ...]:
    """The estimator's names for the harmonic: its amplitude is the scale along the axis' own input direction, what lies along the
    other axis is misalignment, mrad."""
    parts = {"z": cosine, "x": sine}
    return tuple(
        (f"scale_{axis}", math.hypot(cosine, sine)) if other == axis else (f"misalignment_{axis}_{other}", 1e3 * value)
        for other, value in parts.items()
    )


def test_tumble_about_y_cannot_show_y_unless_it_is_left_out() -> None:
    with pytest.raises(EstimationError, match="accel_y is zero in every position"):
        tumble("lsm", ("bias", "accel_x", "accel_y", "accel_z"))


def still_poses(threshold: str = "0.12 m/s^2") -> Detection:
    """Three times the 4 mg rms noise of an MPU-9150 (400 µg/√Hz over about 100 Hz), half-second windows, spans of two seconds."""
    return Detection(
        detect="still",
        window=parse_quantity("0.5 s"),
        threshold=parse_quantity(threshold),
        at_least=parse_quantity("2 s"),
    )


def tumbled_by_hand(name: str, detection: Detection) -> Estimate:
    data = table(real("mikoff_mpu9150", f"{name}.parquet"))
    outputs = ("accel_x", "accel_y", "accel_z")
    channels = {output: data[f"{output}_m_per_s2"] for output in outputs}
    recorded = from_samples(segment("tumble"), data["time_s"], channels, dict.fromkeys(outputs, "m/s^2"))
    parameters = AccelerometerMultiPositionParameters(reference="gravity_magnitude")
    request = EstimateRequest(
        "triad", (recorded,), parameters, SITE, sensor(*outputs, unit="m/s^2"), detection=detection
    )
    return AccelerometerMultiPosition().estimate(request)


@pytest.mark.parametrize("name", ["imu0", "imu2"])
def test_hand_tumbled_triads(name: str) -> None:
    found = tumbled_by_hand(name, still_poses())
    assert found.extra["poses"] == 22  # the recording's own count
    assert found.extra["root_mean_square"] <= 2.5e-3
    assert found["scale_x"].degrees_of_freedom == 22 - 9
    # The result does not hang on the threshold: half as much again moves no parameter by more than two standard uncertainties.
    other = tumbled_by_hand(name, still_poses("0.18 m/s^2"))
    for item in found.coefficients:
        assert abs(other[item.name].value - item.value) < 2 * item.standard_uncertainty, item.name
