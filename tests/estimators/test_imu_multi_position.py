"""Calibration of an IMU: hand-worked, against the truth, against a refit with changed inputs, and what cannot be done."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import simulated_imu as imu
from recorded import from_means, sensor
from scipy.stats import binom

from planrunner.base.said import Said
from planrunner.design.identifiability import identify
from planrunner.estimators import method
from planrunner.estimators.imu.imu_multi_position import ImuMultiPosition, ImuMultiPositionParameters
from planrunner.estimators.interface import Design, DesignRequest, Estimate, EstimateRequest, EstimationError, Setup
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Rock, Segment
from planrunner.uncertainty.decision import expanded_uncertainty

BOTH: dict[str, Any] = {"gyros": imu.GYROS, "accelerometers": imu.ACCELS}
SIX = ("east north up", "east south down", "up east north", "down east south", "north up east", "south down east")


def calibrate(recorded: Any, setup: Setup | None = None, site: Site = imu.SITE, **keys: Any) -> Estimate:
    parameters = ImuMultiPositionParameters(**(keys or BOTH))
    request = EstimateRequest(
        "imu",
        recorded,
        parameters,
        site,
        sensor(*imu.GYROS, *imu.ACCELS),
        setup=setup or Setup(),
    )
    return ImuMultiPosition().estimate(request)


def designed(segments: list[Segment], **keys: object) -> Design:
    noisy = NoiseModel(white=1e-5)
    outputs = [OutputModel(name, "rad/s", noise=noisy) for name in imu.GYROS]
    outputs += [OutputModel(name, "m/s^2", noise=noisy) for name in imu.ACCELS]
    parameters = ImuMultiPositionParameters(**(keys or BOTH))
    return method.designed(
        ImuMultiPosition(),
        DesignRequest("imu", tuple(segments), parameters, imu.SITE, SensorModel("imu", tuple(outputs), 100.0)),
    )


# -- by hand ---------------------------------------------------------------------------------------------------------


def test_six_positions_by_hand() -> None:
    """x reads 10.1 up and −9.5 down: half their difference is 9.8, half their sum 0.3. With 0.02 and −0.02 where y is up and down and
    nothing for z the row is (9.8, 0.02, 0)/g."""
    rows = {"up": 10.1, "down": -9.5}
    recorded = []
    for words in SIX:
        x, y, z = words.split()
        value = rows.get(x, 0.3 + {"up": 0.02, "down": -0.02}.get(y, 0.0))
        others = [{"up": 9.8, "down": -9.8}.get(word, 0.0) for word in (y, z)]
        recorded.append(
            from_means(imu.rest(words), dict(zip(imu.ACCELS, (value, *others), strict=True)), "m/s^2", 1e-4)
        )
    found = calibrate(tuple(recorded), accelerometers=imu.ACCELS)
    length = math.sqrt(9.8**2 + 0.02**2)
    assert found["accel_bias_x"].value == pytest.approx(0.3 / 9.80665e-3, rel=1e-9)
    assert found["accel_scale_x"].value == pytest.approx(length / imu.GRAVITY, rel=1e-9)
    assert found["accel_misalignment_x_y"].value == pytest.approx(1000 * 0.02 / length, rel=1e-9)
    assert found["accel_misalignment_x_z"].value == pytest.approx(0, abs=1e-9)
    assert found["accel_scale_z"].value == pytest.approx(9.8 / imu.GRAVITY, rel=1e-9)
    # The means fit exactly, so the noise within the six positions gives the uncertainty.
    assert found["accel_bias_x"].degrees_of_freedom == 6 * 31
    assert found["accel_bias_x"].standard_uncertainty == pytest.approx(1e-4 / math.sqrt(6) / 9.80665e-3, rel=1e-9)
    # Inverse of the matrix: true = (S·M)⁻¹·(measured − b), of the first position's x.
    inverse = np.array(found.extra["accel"]["inverse"])
    assert inverse @ np.array([9.8, 0, 0]) * 9.80665 == pytest.approx([imu.GRAVITY, 0, 0], rel=1e-9, abs=1e-9)


def test_a_rate_by_hand() -> None:
    """Both senses of 10 deg/s about an upward axis: half the difference is the scale, whatever bias and Earth rate are."""
    segments = [imu.spin(axis, rate) for axis in "xyz" for rate in (10.0, -10.0)]
    recorded = []
    for n, segment in enumerate(segments):
        values = [0.0, 0.0, 0.0]
        earth = 15.041067 / 3600 * math.sin(imu.LATITUDE)
        values[n // 2] = 1.5 * (segment.rate / math.radians(1) + earth) + 0.25
        for other in range(3):
            if other != n // 2:
                values[other] = 0.25
        recorded.append(from_means(segment, dict(zip(imu.GYROS, values, strict=True)), "deg/s", 1e-6))
    found = calibrate(tuple(recorded), gyros=imu.GYROS, gyro_terms=("bias", "rate_x", "rate_y", "rate_z"))
    for axis in "xyz":
        assert found[f"gyro_scale_{axis}"].value == pytest.approx(1.5, rel=1e-9)
        assert found[f"gyro_bias_{axis}"].value == pytest.approx(0.25 * 3600, rel=1e-9)


# -- against the truth -----------------------------------------------------------------------------------------------


def test_noiseless_outputs_give_the_truth() -> None:
    truth = imu.drawn_truth(np.random.default_rng(1))
    found = calibrate(imu.recorded(imu.plan(), truth))
    expected = imu.named(truth)
    assert set(expected) == {item.name for item in found.coefficients}
    for name, value in expected.items():
        assert found[name].value == pytest.approx(value, rel=1e-9, abs=1e-7), name


@pytest.mark.slow
@pytest.mark.parametrize("basis", ["residual", "within_segment"])
def test_truth_within_the_stated_uncertainty(basis: str) -> None:
    """120 realisations: how often each coefficient's 95 % interval holds the truth is binomial. The bounds hold for all 33 jointly at 1 %
    (Šidák), whatever ties them together."""
    draw, runs = np.random.default_rng(7), 120
    segments, hits = imu.plan(), dict.fromkeys(imu.named(imu.drawn_truth(draw)), 0)
    for _ in range(runs):
        truth = imu.drawn_truth(draw)
        found = calibrate(imu.recorded(segments, truth, draw), **BOTH, uncertainty=basis)
        for name, value in imu.named(truth).items():
            item = found[name]
            width = expanded_uncertainty(item.standard_uncertainty, item.degrees_of_freedom)
            hits[name] += abs(item.value - value) <= width
    each = 1 - 0.99 ** (1 / len(hits))
    low, high = binom.ppf(each / 2, runs, 0.95), binom.ppf(1 - each / 2, runs, 0.95)
    assert low <= min(hits.values()) and max(hits.values()) <= high, hits


def test_lower_triangular_form_is_the_same_sensor_in_another_frame() -> None:
    """A sensor with known triangular matrices, mounted turned by (2, −3, 5) mrad: they and the turn come back."""
    draw = np.random.default_rng(3)
    truth = imu.drawn_truth(draw)
    triangle = np.tril(truth["A_a"])
    angles = np.array([2e-3, -3e-3, 5e-3])
    # Rotation by the series of the exponential: turned axes seen from the fixture's.
    cross = np.array([[0, -angles[2], angles[1]], [angles[2], 0, -angles[0]], [-angles[1], angles[0], 0]])
    turn = np.eye(3) - cross + cross @ cross / 2
    turned = truth | {"A_a": triangle @ turn, "A_g": truth["A_g"] @ turn, "G": truth["G"] @ turn}
    found = calibrate(imu.recorded(imu.plan(), turned), **BOTH, misalignment="lower_triangular")
    expected = imu.named(truth | {"A_a": triangle})
    names = {item.name for item in found.coefficients}
    assert not names & {"accel_misalignment_x_y", "accel_misalignment_x_z", "accel_misalignment_y_z"}
    assert len(names) == len(expected)  # three misalignments became three angles
    for name in names & set(expected):
        assert found[name].value == pytest.approx(expected[name], rel=1e-6, abs=1e-4), name
    arcmin = math.degrees(1) * 60
    for axis, angle in zip("xyz", angles, strict=True):
        assert found[f"rotation_{axis}"].value == pytest.approx(angle * arcmin, abs=0.05)


@pytest.mark.slow
def test_uncertainties_of_the_lower_triangular_form_by_simulation() -> None:
    draw = np.random.default_rng(5)
    truth = imu.drawn_truth(draw)
    values, stated = [], []
    for _ in range(150):
        found = calibrate(
            imu.recorded(imu.plan(), truth, draw), **BOTH, misalignment="lower_triangular", uncertainty="within_segment"
        )
        values.append([item.value for item in found.coefficients])
        stated.append([item.standard_uncertainty for item in found.coefficients])
    ratio = np.std(values, axis=0, ddof=1) / np.mean(stated, axis=0)
    assert ratio == pytest.approx(np.ones(len(ratio)), abs=0.28)
    assert ratio.mean() == pytest.approx(1, abs=0.05)


def test_own_units_of_pulses_and_volts() -> None:
    truth = imu.drawn_truth(np.random.default_rng(1))
    segments = imu.recorded(imu.plan(), truth)
    for one in segments:
        one.units.update(dict.fromkeys(imu.GYROS, "pulse/s") | dict.fromkeys(imu.ACCELS, "V"))
    found, expected = calibrate(segments), imu.named(truth)
    assert found["gyro_scale_y"].unit == "(pulse/s)/(deg/s)" and found["accel_bias_z"].unit == "V"
    assert found["gyro_scale_y"].value == pytest.approx(expected["gyro_scale_y"] * math.radians(1), rel=1e-9)
    assert found["accel_scale_x"].value == pytest.approx(expected["accel_scale_x"] * 9.80665, rel=1e-9)
    assert found["gyro_misalignment_x_z"].value == pytest.approx(expected["gyro_misalignment_x_z"], rel=1e-6)


# -- before the run --------------------------------------------------------------------------------------------------


def test_a_sound_plan_is_identified_and_predicted() -> None:
    design = designed(imu.plan())
    assert all(one.sound for one in identify(design))
    assert not design.remarks
    predicted = {item.name: item for item in design.predicted}
    assert set(predicted) == set(imu.named(imu.drawn_truth(np.random.default_rng(0))))


@pytest.mark.slow
def test_coefficients_scatter_as_predicted() -> None:
    design = designed(imu.plan())
    draw = np.random.default_rng(8)
    truth = {"A_g": np.eye(3), "A_a": np.eye(3), "b_g": np.zeros(3), "b_a": np.zeros(3), "G": np.zeros((3, 3))}
    values = [
        [item.value for item in calibrate(imu.recorded(imu.plan(), truth, draw, (1e-5, 1e-5)), **BOTH).coefficients]
        for _ in range(150)
    ]
    stated_u = np.array([item.standard_uncertainty for item in design.predicted])
    ratio = np.std(values, axis=0, ddof=1) / stated_u
    assert ratio.mean() == pytest.approx(1, abs=0.05)


def test_rates_alone_cannot_determine_g_sensitivity() -> None:
    """Spins about one upward axis after the other: bias and g-sensitivities share three attitudes."""
    design = designed([imu.spin(axis, rate) for axis in "xyz" for rate in (50.0, -50.0)], gyros=imu.GYROS)
    judged = identify(design)
    assert not judged[0].sound
    assert {"bias", "accel_x", "accel_y", "accel_z"} <= set(judged[0].unidentifiable)


def test_positions_alone_leave_scale_factors_to_the_earth() -> None:
    design = designed([imu.rest(words) for words in imu.POSITIONS], gyros=imu.GYROS)
    (remark,) = design.remarks
    assert remark.code == "physics-earth-rate-alone" and not remark.error and "x and y and z" in remark.message
    spun = designed(imu.plan(), gyros=imu.GYROS)
    predicted = [next(i for i in d.predicted if i.name == "gyro_scale_x").standard_uncertainty for d in (design, spun)]
    assert predicted[0] > 1000 * predicted[1]


def test_a_rate_about_one_axis_only_is_ill_conditioned() -> None:
    segments = [*map(imu.rest, imu.POSITIONS), imu.spin("z", 50.0), imu.spin("z", -50.0)]
    assert identify(designed(segments, gyros=imu.GYROS))[0].condition > 1000


# -- what cannot be done ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"uncertainty": "residual"}, "neither `gyros` nor `accelerometers`"),
        ({"gyros": ("gx", "gy")}, "three channels"),
        ({"gyros": ("gx", "gx", "gy")}, "three channels"),
        ({"gyros": ("gx", "gy", "gq")}, "has no channel 'gq'"),
        ({"gyros": imu.GYROS, "gyro_terms": ("bias", "accel_x")}, "at least one of the terms rate_x"),
        ({"gyros": imu.ACCELS}, "not a possible unit of a gyro"),
        ({"accelerometers": imu.GYROS}, "not a possible unit of an accelerometer"),
        (
            {"gyros": imu.GYROS, "gyro_terms": ("rate_x", "rate_y"), "misalignment": "lower_triangular"},
            "all three axes",
        ),
        (
            {
                "accelerometers": imu.ACCELS,
                "misalignment": "lower_triangular",
                "accelerometer_terms": ("bias", "accel_x", "accel_y", "accel_z", "accel_x_accel_z"),
            },
            "cannot separate all terms",
        ),
        ({"gyros": imu.GYROS, "gyro_terms": ("bias", "rate_x", "rate_y", "rate_z", "accel_x_accel_z")}, "is a product"),
    ],
)
def test_bad_plans(keys: dict[str, Any], words: str) -> None:
    recorded = imu.recorded(imu.plan(), imu.drawn_truth(np.random.default_rng(2)), np.random.default_rng(3))
    with pytest.raises(EstimationError, match=words):
        calibrate(recorded, **keys)


def test_bad_recordings() -> None:
    truth = imu.drawn_truth(np.random.default_rng(2))
    with pytest.raises(EstimationError, match="cannot determine 7 coefficients"):
        calibrate(imu.recorded(imu.plan()[:5], truth), gyros=imu.GYROS)
    with pytest.raises(EstimationError, match="every chosen segment moves"):
        calibrate(imu.recorded([imu.spin("x", 50.0)], truth), accelerometers=imu.ACCELS)
    lost = [*imu.plan(), replace(imu.rest("up north west"), attitude=None)]
    with pytest.raises(EstimationError, match="unknown"):
        designed(lost)
    rocking = [*imu.plan(), replace(imu.rest("up north west"), motion=Rock(0.1, 1.0, (0.0,), 10.0))]
    with pytest.raises(EstimationError, match="rock"):
        designed(rocking, gyros=imu.GYROS)
    dead = truth | {"A_a": np.diag([1.0, 0.0, 1.0]), "b_a": np.zeros(3)}
    with pytest.raises(EstimationError, match="output y of the accelerometers does not respond"):
        calibrate(imu.recorded(imu.plan(), dead), accelerometers=imu.ACCELS)
    flat = truth | {"A_a": np.array([[1.0, 0, 0], [1.0, 1e-6, 0], [0, 0, 1.0]])}
    with pytest.raises(EstimationError, match="right-handed triad"):
        calibrate(imu.recorded(imu.plan(), flat), accelerometers=imu.ACCELS, misalignment="lower_triangular")


def test_a_term_of_another_package_is_found_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its column is the cube of the force along x; the truth has 2·10⁻⁶ of it in every output."""
    from planrunner.base import plugins
    from planrunner.error_model.terms import Term

    cube = Term(
        "cubed_x", Said("Cube of the force along x."), 9.8**3, "m^3/s^6", lambda one: one.specific_force[:, 0] ** 3, 3
    )
    load = plugins.load
    monkeypatch.setattr(plugins, "load", lambda group, name: cube if name == "cubed_x" else load(group, name))
    truth = imu.drawn_truth(np.random.default_rng(1))
    tilted = [
        replace(imu.rest("east north up"), label=f"T{k}", attitude=attitude) for k, attitude in enumerate(_tilted())
    ]
    recorded = []
    for segment in [*map(imu.rest, imu.POSITIONS), *tilted]:
        _, accelerometers = imu.outputs(segment, truth)
        cubed = 2e-6 * imu.felt(segment)[1][0] ** 3
        means = dict(zip(imu.ACCELS, accelerometers + cubed, strict=True))
        recorded.append(from_means(segment, means, "m/s^2", 1e-9))
    terms = ("bias", "accel_x", "accel_y", "accel_z", "cubed_x")
    found = calibrate(tuple(recorded), accelerometers=imu.ACCELS, accelerometer_terms=terms)
    assert found["accel_cubed_x_y"].value == pytest.approx(2e-6 / 9.80665e-3, rel=1e-6)
    assert found["accel_cubed_x_y"].unit == "mg/(m^3/s^6)"


def _tilted() -> list[np.ndarray]:
    angles = [math.radians(a) for a in (25, 50, 130, 155)]
    return [np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]]) for a in angles]
