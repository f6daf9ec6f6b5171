"""Sensitivities to what a bench states, against brute force: the world is changed, the recording made again and fitted as if it were not.

The generator shares nothing with planrunner: the rotor's balance is solved for the torquers' currents, in deg/h, g and radians.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recorded import from_means, segment, sensor
from scipy.spatial.transform import Rotation
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, TRUTH, attitude

from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.analysis import combined
from planrunner.estimators.flexure_gyro.compensation_residual import (
    CompensationResidual,
    CompensationResidualParameters,
)
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, Setup
from planrunner.estimators.method import designed
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel, TableModel
from planrunner.physics.kinematics import TableAxis, joint_angles
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.influences import Influence, InputQuantity, Inputs

AXES = (
    TableAxis("outer", (0.0, 0.0, 1.0), 7.0, 3.5),
    TableAxis("middle", (1.0, 0.0, 0.0), 3.5, 1.7),
    TableAxis("inner", (0.0, 1.0, 0.0), 7.0, 3.5),
)
WIDTHS = {
    "latitude": 5e-6,
    "gravity": 2e-5,
    "azimuth": 5e-5,
    "table position": 1.5e-5,
    "table orthogonality": 1e-5,
    "resolution torquer_x": 1 / math.sqrt(12),
}
SETUP = Setup(
    TableModel(AXES), inputs=Inputs({name: InputQuantity(name, 0.0, "rad", width) for name, width in WIDTHS.items()})
)
STEP = 1e-4
NOTHING = Setup()


def turn(about: np.ndarray, angle: float) -> np.ndarray:
    return np.asarray(Rotation.from_rotvec(np.asarray(about, dtype=float) * angle).as_matrix())


def currents(
    axes: np.ndarray, latitude: float = SITE.latitude, gravity: float = SITE.gravity, truth: dict[str, float] = TRUTH
) -> np.ndarray:
    """Torquer currents (2,), pulse/s: those whose precession balances what the rotor feels."""
    rate = axes @ np.array([0.0, math.cos(latitude), math.sin(latitude)]) * 15.041067
    force = np.append(1.0, axes[:, 2] * gravity / 9.80665)
    felt = [
        rate[1] + force @ [truth[f"D_X_{k}"] for k in "FXYZ"],
        rate[0] + force @ [truth[f"D_Y_{k}"] for k in "FXYZ"],
    ]
    e, s = math.radians(truth["epsilon"] / 60), math.radians((truth["epsilon"] + truth["xi"]) / 60)
    torquers = np.array([[math.cos(e), -math.sin(s)], [math.sin(e), math.cos(s)]]) * [truth["SF_Y"], truth["SF_X"]]
    return np.linalg.solve(torquers, felt)


def fitted(
    world: dict[str, np.ndarray],
    setup: Setup = NOTHING,
    basis: str = "within_segment",
    noise: NoiseModel | None = None,
    error: float = 0.01,
    latitude: float = SITE.latitude,
    gravity: float = SITE.gravity,
) -> Estimate:
    """A recording made with the attitudes of `world`, fitted at the planned ones."""
    recorded = tuple(
        from_means(
            replace(segment(label, attitude(words)), orientation=words),
            dict(zip(CHANNELS, currents(world[label], latitude, gravity), strict=True)),
            "pulse/s",
            error,
        )
        for label, words in OPTIMAL.items()
    )
    parameters = FlexureGyroStaticParameters(uncertainty=basis)
    return FlexureGyroStatic().estimate(
        EstimateRequest("drift", recorded, parameters, SITE, under_test(noise or NoiseModel()), setup=setup)
    )


def under_test(noise: NoiseModel) -> SensorModel:
    return SensorModel("under-test", tuple(OutputModel(name, "pulse/s", noise=noise) for name in CHANNELS), 10.0)


PLANNED = {label: attitude(words) for label, words in OPTIMAL.items()}


def values(estimate: Estimate) -> np.ndarray:
    return np.array([item.value for item in estimate.coefficients])


def influence(estimate: Estimate, name: str) -> Influence:
    return next(item for item in estimate.influences if item.quantity.name == name)


def same_but_for_sign(found: np.ndarray, expected: np.ndarray) -> bool:
    size = np.abs(expected).max(axis=0) + 1e-12
    return min(np.abs((found - sign * expected) / size).max() for sign in (1, -1)) < 2e-3


def brute(
    world: dict[str, np.ndarray], step: float = STEP, latitude: float = SITE.latitude, gravity: float = SITE.gravity
) -> np.ndarray:
    """Change of all coefficients per unit of the change."""
    nominal = values(fitted(PLANNED, SETUP))
    scale = np.maximum(np.abs(nominal), 1.0)
    return (values(fitted(world, SETUP, latitude=latitude, gravity=gravity)) - nominal) / step / scale


def relative(column: np.ndarray) -> np.ndarray:
    return column / np.maximum(np.abs(values(fitted(PLANNED))), 1.0)


def test_latitude_gravity_and_azimuth() -> None:
    found = fitted(PLANNED, SETUP)
    north = {label: axes @ turn(np.array([0, 0, 1.0]), STEP) for label, axes in PLANNED.items()}
    expected = {
        "latitude": brute(PLANNED, latitude=SITE.latitude + STEP),
        "gravity": brute(PLANNED, gravity=SITE.gravity + STEP),
        "azimuth": brute(north),
    }
    for name, change in expected.items():
        column = influence(found, name).sensitivities
        assert column.shape[1] == 1
        assert same_but_for_sign(relative(column[:, 0]), change), name


def test_every_position_on_its_own() -> None:
    """One position turned about each site axis: the sums of squares over the three agree, whichever axes are taken."""
    item = influence(fitted(PLANNED, SETUP), "table position")
    assert item.sensitivities.shape[1] == 3 * len(OPTIMAL)
    assert not item.in_scatter
    for label, words in OPTIMAL.items():
        changes = np.column_stack([brute(PLANNED | {label: PLANNED[label] @ turn(axis, STEP)}) for axis in np.eye(3)])
        mine = [k for k, part in enumerate(item.parts) if part.startswith(words)]
        ours = np.column_stack([relative(item.sensitivities[:, k]) for k in mine])
        assert np.sum(ours**2, axis=1) == pytest.approx(np.sum(changes**2, axis=1), rel=5e-3, abs=1e-6)


@pytest.mark.parametrize("pair", [0, 1])
def test_axes_that_are_not_at_right_angles(pair: int) -> None:
    """The inner axis of a pair leans out of its right angle; attitudes of the leaning table at the same joint angles."""
    near, leaning = np.zeros(3), {}
    directions = [np.array(axis.direction) for axis in AXES]
    directions[pair + 1] = turn(np.cross(directions[pair], directions[pair + 1]), STEP) @ directions[pair + 1]
    for label, axes in PLANNED.items():
        near = joint_angles(AXES, axes, near)
        platform = np.eye(3)
        for direction, angle in zip(directions, near, strict=True):
            platform = platform @ turn(direction, angle)
        leaning[label] = platform.T
    item = influence(fitted(PLANNED, SETUP), "table orthogonality")
    assert item.parts == ("outer and middle", "middle and inner")
    assert same_but_for_sign(relative(item.sensitivities[:, pair]), brute(leaning))


def test_resolution_is_listed_by_the_share_that_noise_leaves_of_it() -> None:
    """Noise of 0.01·√1200 = 0.35 pulse/s a sample is below half a count and dithers nothing: each mean may be off by a count's rounding.
    A counter that hands what is left of a count to the next of its 1200 samples leaves 1/√1200 of that."""
    alone = Setup(inputs=Inputs({name: one for name, one in SETUP.inputs.quantities.items() if name[:5] == "resol"}))
    item = influence(fitted(PLANNED, alone, noise=NoiseModel(resolution=1.0)), "resolution torquer_x")
    assert item.in_scatter
    counted = influence(fitted(PLANNED, alone, noise=NoiseModel(resolution=1.0, counted=True)), "resolution torquer_x")
    assert counted.sensitivities == pytest.approx(item.sensitivities / math.sqrt(1200), rel=1e-9)
    one = fitted(PLANNED, alone, noise=NoiseModel(resolution=1.0))
    moved = np.zeros((len(one.coefficients), len(OPTIMAL)))
    for n, label in enumerate(OPTIMAL):
        recorded = [
            from_means(
                replace(segment(other, attitude(words)), orientation=words),
                dict(zip(CHANNELS, np.add(currents(PLANNED[other]), [STEP * (other == label), 0.0]), strict=True)),
                "pulse/s",
                0.01,
            )
            for other, words in OPTIMAL.items()
        ]
        parameters = FlexureGyroStaticParameters(uncertainty="within_segment")
        counting = under_test(NoiseModel(resolution=1.0))
        request = EstimateRequest("d", tuple(recorded), parameters, SITE, counting, setup=alone)
        moved[:, n] = (values(FlexureGyroStatic().estimate(request)) - values(one)) / STEP
    assert item.sensitivities == pytest.approx(moved, rel=1e-3, abs=1e-6)


def test_what_scatters_is_in_the_covariance_of_the_residual_basis_also_where_an_orientation_comes_twice() -> None:
    shown = {one.quantity.name for one in fitted(PLANNED, SETUP, "residual").influences if one.in_scatter}
    assert shown == {"table position", "azimuth", "table orthogonality", "resolution torquer_x"}
    believed = fitted(PLANNED, SETUP, "within_segment").influences
    assert {one.quantity.name for one in believed if one.in_scatter} == {"resolution torquer_x"}
    # Without the right angles: the joints take each orientation in another way when they come to it again.
    setup = replace(
        SETUP, inputs=Inputs({k: v for k, v in SETUP.inputs.quantities.items() if k[-13:] != "orthogonality"})
    )
    recorded = tuple(
        from_means(
            replace(segment(f"{label}{turn_}", attitude(words)), orientation=words),
            dict(zip(CHANNELS, currents(PLANNED[label]), strict=True)),
            "pulse/s",
            0.01,
        )
        for turn_ in (1, 2)
        for label, words in OPTIMAL.items()
    )
    twice = FlexureGyroStatic().estimate(
        EstimateRequest("d", recorded, FlexureGyroStaticParameters(), SITE, sensor(*CHANNELS), setup=setup)
    )
    item = influence(twice, "table position")
    assert item.in_scatter  # the error that both times share is in the weights as such
    assert item.sensitivities.shape[1] == 3 * len(OPTIMAL)
    once = influence(fitted(PLANNED, setup, error=0.01 / math.sqrt(2)), "table position")
    assert item.covariance == pytest.approx(once.covariance, rel=1e-6)


@pytest.mark.slow
def test_monte_carlo_of_all_of_them_has_the_combined_covariance() -> None:
    """400 worlds with every input drawn at once, refitted; standard deviations within 4 standard errors (14 %)."""
    rng = np.random.default_rng(4)
    drawn_here = {k: v for k, v in SETUP.inputs.quantities.items() if k[:5] != "resol" and k != "table orthogonality"}
    setup = replace(SETUP, inputs=Inputs(drawn_here))
    budget = combined(fitted(PLANNED, setup))
    assert budget.covariance is not None and budget.data_covariance is not None
    predicted = np.sqrt(np.diag(budget.covariance - budget.data_covariance))
    drawn = []
    for _ in range(400):
        lat, grav, azimuth = (WIDTHS[name] * rng.normal() for name in ("latitude", "gravity", "azimuth"))
        world = {
            label: axes @ turn(np.array([0, 0, 1.0]), azimuth) @ turn(rng.normal(size=3), WIDTHS["table position"])
            for label, axes in PLANNED.items()
        }
        drawn.append(values(fitted(world, setup, latitude=SITE.latitude + lat, gravity=SITE.gravity + grav)))
    assert np.std(drawn, axis=0, ddof=1) == pytest.approx(predicted, rel=0.15)


def test_check_foresees_what_the_estimate_will_state() -> None:
    """Predicted uncertainties are those of a recording whose segments show the declared noise, on the basis that believes it."""
    noise = NoiseModel(white=0.9)
    outputs = tuple(OutputModel(name, "pulse/s", noise=noise) for name in CHANNELS)
    nominal = {name: value * scale for (name, value), scale in zip(TRUTH.items(), SCALES, strict=True)}
    model = SensorModel("flexure-gyro", outputs, 100.0, nominal)
    segments = tuple(replace(segment(label, attitude(words)), orientation=words) for label, words in OPTIMAL.items())
    parameters = FlexureGyroStaticParameters()
    stated = designed(FlexureGyroStatic(), DesignRequest("d", segments, parameters, SITE, model, setup=SETUP))
    found = combined(fitted(PLANNED, SETUP, error=0.9 / math.sqrt(120)))
    assert [item.name for item in stated.predicted] == [item.name for item in found.coefficients]
    for item in stated.predicted:
        assert item.standard_uncertainty == pytest.approx(found[item.name].standard_uncertainty, rel=1e-3), item.name


DEG_H = math.pi / 180 / 3600
SCALES = [DEG_H, DEG_H, math.pi / 10800, math.pi / 10800, *[DEG_H, *[DEG_H / 9.80665] * 3] * 2]


@pytest.mark.parametrize("reference", ["orientation", "gravity_magnitude"])
def test_accelerometers_held_against_gravity(reference: str) -> None:
    """a = b + S·f with |f| = g: with g stated 1e-3 too small, scale factors are 1e-3 too large and biases stay."""
    channels = ("accel_x", "accel_y", "accel_z")
    rng = np.random.default_rng(2)
    attitudes = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(14)]
    matrix, bias = np.array([[1.01, 0.002, -0.001], [0.003, 0.98, 0.004], [0.0, -0.002, 1.002]]), [0.02, -0.05, 0.03]

    def fit(gravity: float) -> Estimate:
        recorded = tuple(
            from_means(
                replace(segment(f"P{n}", axes), orientation=f"pose {n}"),
                dict(zip(channels, matrix @ axes @ [0, 0, gravity] + bias, strict=True)),
                "m/s^2",
                1e-4,
            )
            for n, axes in enumerate(attitudes)
        )
        parameters = AccelerometerMultiPositionParameters(reference=reference, uncertainty="within_segment")
        inputs = Inputs({"gravity": InputQuantity("gravity", 9.8, "m/s^2", 1e-3)})
        request = EstimateRequest(
            "a", recorded, parameters, SITE, sensor(*channels, unit="m/s^2"), setup=Setup(inputs=inputs)
        )
        return AccelerometerMultiPosition().estimate(request)

    nominal = fit(SITE.gravity)
    change = (values(fit(SITE.gravity * (1 + 1e-6))) - values(nominal)) / (SITE.gravity * 1e-6)
    assert influence(nominal, "gravity").sensitivities[:, 0] == pytest.approx(-change, rel=1e-4, abs=1e-6)
    scales = [k for k, item in enumerate(nominal.coefficients) if item.name.startswith("scale")]
    for k in scales:
        u = combined(nominal).coefficients[k].standard_uncertainty
        assert u >= 1e-3 / SITE.gravity * nominal.coefficients[k].value


TRADITIONAL = {"T1": "north west up", "T2": "west south up", "T3": "south east up", "T4": "east north up"} | {
    "T5": "west up north",
    "T6": "up east north",
    "T7": "east down north",
    "T8": "down west north",
}
VERIFY = {"V1": "up west south", "V2": "west north down", "V3": "east up south"}


def residual_sums(
    noise: np.ndarray,
    turned: dict[str, np.ndarray],
    setup: Setup = NOTHING,
    latitude: float = SITE.latitude,
    gravity: float = SITE.gravity,
) -> tuple[np.ndarray, Estimate]:
    """Both sets calibrated and compared on the verification positions, in a world where words point as `turned` says."""

    def recorded(positions: dict[str, str], shift: np.ndarray) -> tuple:
        return tuple(
            from_means(
                replace(segment(label, attitude(words)), orientation=words),
                dict(
                    zip(
                        CHANNELS,
                        currents(attitude(words) @ turned.get(words, np.eye(3)), latitude, gravity) + row,
                        strict=True,
                    )
                ),
                "pulse/s",
                0.1,
            )
            for (label, words), row in zip(positions.items(), shift, strict=True)
        )

    uses = {}
    for name, positions in (("optimal", OPTIMAL), ("traditional", TRADITIONAL)):
        asked = EstimateRequest(
            name,
            recorded(positions, np.zeros((8, 2))),
            FlexureGyroStaticParameters(),
            SITE,
            sensor(*CHANNELS),
            setup=setup,
        )
        uses[name] = combined(FlexureGyroStatic().estimate(asked))
    parameters = CompensationResidualParameters(trials=1000)
    request = EstimateRequest("r", recorded(VERIFY, noise), parameters, SITE, sensor(*CHANNELS), uses, setup=setup)
    made = CompensationResidual().estimate(request)
    return values(made), made


def test_residual_sums_follow_an_input_that_acts_on_calibration_and_verification() -> None:
    """Latitude, gravity and azimuth wrong in all three recordings; a table error at 'west south up', which both sets share."""
    noise = np.array([[0.3, -0.2], [0.1, 0.4], [-0.3, 0.2]])
    nominal, made = residual_sums(noise, {}, SETUP)
    step = 1e-4
    inputs = {one.quantity.name: one for one in merged(made.influences)}
    assert not any(one.in_scatter for one in inputs.values())
    for name, keys in (("latitude", {"latitude": SITE.latitude + step}), ("gravity", {"gravity": SITE.gravity + step})):
        change = (residual_sums(noise, {}, SETUP, **keys)[0] - nominal) / step
        # The calibration takes up what the verification would miss: gravity cancels, and latitude but for the scale of the residuals.
        assert inputs[name].sensitivities[:, 0] == pytest.approx(-change, rel=1e-3, abs=1e-7)
    everywhere = {*OPTIMAL.values(), *TRADITIONAL.values(), *VERIFY.values()}
    step = 1e-5
    ends = [
        dict.fromkeys(everywhere, turn(np.array([0, 0, 1.0]), one)) for one in (-step, step)
    ]  # less and more azimuth
    low, high = (residual_sums(noise, north, SETUP)[0] for north in ends)
    assert inputs["azimuth"].sensitivities.shape[1] == 1
    assert inputs["azimuth"].sensitivities[:, 0] == pytest.approx((low - high) / (2 * step), rel=1e-2)
    position = inputs["table position"]
    assert len(position.parts) == 3 * len(everywhere)
    shared = [k for k, part in enumerate(position.parts) if part.startswith("west south up")]
    changes = [
        (residual_sums(noise, {"west south up": turn(axis, step)}, SETUP)[0] - nominal) / step for axis in np.eye(3)
    ]
    assert np.sum(position.sensitivities[:, shared] ** 2, axis=1) == pytest.approx(
        np.sum(np.square(changes), axis=0), rel=1e-2
    )
