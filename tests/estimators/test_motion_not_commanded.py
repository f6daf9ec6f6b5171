"""Estimates from motion that nobody commanded: of arrays, of units turned by hand, of sensors on jigs without a drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from moved_by_hand import BY_POSES, BY_REFERENCE, SENSOR, Hand
from recorded import from_samples

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import combined
from planrunner.estimators.error_model.estimator import DILUTION, ErrorModelEstimator
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.error_model.within import uneven_ratios
from planrunner.estimators.interface import Estimate, EstimateRequest, EstimationError
from planrunner.instruments.models import SensorModel
from planrunner.observation.samples import observed
from planrunner.physics.earth import Site
from planrunner.plan.schedule import RecordedMotion

SITE = Site(math.radians(45.0), 9.81, earth_rate=0.0)
GYRO = ("gyro_bias", "gyro_scale_factor", "gyro_misalignment")
ACCEL = ("accel_bias", "accel_scale_factor", "accel_misalignment", "lever_arm")
MATRIX = np.eye(3) + 1e-2 * np.array([[0.4, -0.3, 0.2], [0.1, -0.7, 0.5], [-0.2, 0.6, 0.9]])
BOARD = Hand((0.02, -0.03, 0.01), MATRIX, (0.5, -0.3, 0.1), MATRIX.T, (0.05, -0.02, 0.1))


def estimate(
    hand: Hand, motion: RecordedMotion, outputs: Mapping[str, tuple[str, ...]], seed: int = 1, parts: int = 4
) -> Estimate:
    parameters = ErrorModelParameters(outputs=dict(outputs), uncertainty="residual")
    recording = tuple(hand.recording(seed, motion, parts))
    return ErrorModelEstimator().estimate(EstimateRequest("model", recording, parameters, SITE, SENSOR))


def away(found: Estimate, name: str, true: float) -> float:
    """Error in standard uncertainties."""
    one = found[name]
    return (one.value - true) / one.standard_uncertainty


def test_a_second_unit_on_the_board_is_calibrated_against_the_first() -> None:
    errors = []
    for seed in (1, 2):
        found = estimate(BOARD, BY_REFERENCE, {"two_gyro_z": GYRO, "two_accel_x": ACCEL}, seed)
        arcsec = math.degrees(3600)
        errors += [
            away(found, "gyro_scale_factor_z", 9e3),
            away(found, "gyro_misalignment_towards_x_z", -2e-3 * arcsec),
            away(found, "gyro_misalignment_towards_y_z", 6e-3 * arcsec),
            away(found, "gyro_bias_z", 0.1),
            away(found, "accel_scale_factor_x", 4e3),
            away(found, "lever_arm_r_x_two_accel_x", 20.0),
            away(found, "lever_arm_r_y_two_accel_x", -30.0),
            away(found, "lever_arm_r_z_two_accel_x", 10.0),
        ]
        assert found["lever_arm_r_y_two_accel_x"].standard_uncertainty < 1.0
    assert np.abs(errors).max() < 4.0 and 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.8


def test_a_gyro_is_calibrated_against_poses_that_are_late() -> None:
    hand = replace(BOARD, late=7e-3, fast=60.0)
    outputs = {"two_gyro_y": (*GYRO, "reference_latency")}
    found = estimate(hand, BY_POSES, outputs)
    assert abs(away(found, "reference_latency_delay", 7e-3)) < 4
    assert abs(away(found, "gyro_scale_factor_y", -7e3)) < 4
    assert abs(away(found, "gyro_misalignment_towards_z_y", 5e-3 * math.degrees(3600))) < 4
    assert found["gyro_scale_factor_y"].standard_uncertainty < 300


def test_an_encoder_shows_the_motion_of_a_jig_without_a_drive() -> None:
    hand = replace(BOARD, delay=5e-3, axis=2, fast=90.0)
    found = estimate(
        hand,
        RecordedMotion(angle="angle", averaging=0.05),
        {"two_gyro_z": ("gyro_bias", "gyro_scale_factor", "time_latency")},
    )
    assert abs(away(found, "time_latency_delay", 5e-3)) < 4
    assert abs(away(found, "gyro_scale_factor_z", 9e3)) < 4
    assert found["gyro_scale_factor_z"].standard_uncertainty < 200


def test_the_gyros_of_a_unit_show_how_its_accelerometers_turn() -> None:
    """Slowly, from a known orientation; the lever arm is that from the point about which the hand turns."""
    hand = replace(BOARD, shaken=0.0, fast=40.0)
    motion = RecordedMotion(rates=tuple(f"one_gyro_{a}" for a in "xyz"))
    found = estimate(hand, motion, {"two_accel_y": ACCEL})
    assert abs(away(found, "accel_scale_factor_y", -7e3)) < 4
    assert abs(away(found, "accel_misalignment_towards_x_y", -3e-3 * math.degrees(3600))) < 4
    assert abs(found["lever_arm_r_y_two_accel_y"].value + 30) < 5


def test_rates_and_poses_give_the_same_motion() -> None:
    """The attitude that is followed from rates alone, and the rates that differences of attitudes give."""
    hand, names = (
        replace(BOARD, noise=0.0, shaken=0.0, fast=40.0),
        [f"two_{k}_{a}" for k in ("gyro", "accel") for a in "xyz"],
    )
    by_rates, by_poses = (
        RecordedMotion(rates=BY_REFERENCE.rates),
        RecordedMotion(attitude=BY_POSES.attitude, averaging=0.01),
    )
    followed, differences = (
        observed(hand.recording(3, way, 1), SITE, SENSOR, only=names) for way in (by_rates, by_poses)
    )
    inner = slice(1, -1)
    assert np.abs(followed.force[inner] - differences.force).max() < 1e-3
    assert np.abs(followed.omega[inner] - differences.omega).max() < math.radians(0.05)
    assert np.abs(followed.swing[inner] - differences.swing)[inner].max() < 0.02


def test_an_output_cannot_be_its_own_reference() -> None:
    with pytest.raises(EstimationError, match="'one_gyro_x' shows the motion of segment 'part_0'") as refused:
        estimate(BOARD, BY_REFERENCE, {"one_gyro_x": GYRO})
    assert "by other channels" in refused.value.hint


def test_accelerometers_alone_show_no_rate() -> None:
    with pytest.raises(EstimationError, match="no segment shows the rate of 'two_gyro_x'"):
        estimate(BOARD, RecordedMotion(forces=BY_REFERENCE.forces), {"two_gyro_x": GYRO})


def test_a_clipped_reference_does_not_count() -> None:
    """Where the reference reads its full scale the motion is not known; neighbours of such samples have no difference either."""
    limit = 120.0
    outputs = tuple(replace(o, full_scale=limit) if o.name.startswith("one_gyro") else o for o in SENSOR.outputs)
    motion = RecordedMotion(rates=BY_REFERENCE.rates)
    recording = []
    for part in BOARD.recording(1, motion, 4):
        blocks = list(part.blocks(tuple(part.units)))
        channels = {n: np.concatenate([np.asarray(b.channels[n]) for b in blocks]) for n in part.units}
        for axis in "xyz":
            channels[f"one_gyro_{axis}"] = np.clip(channels[f"one_gyro_{axis}"], -limit, limit)
        recording.append(from_samples(part.segment, np.concatenate([b.time for b in blocks]), channels, part.units))
    assert any(float(np.abs(r.statistics.maximum).max()) >= limit for r in recording)
    parameters = ErrorModelParameters(outputs={"two_gyro_z": GYRO}, uncertainty="residual")

    def found(sensor: SensorModel) -> Estimate:
        return ErrorModelEstimator().estimate(EstimateRequest("model", tuple(recording), parameters, SITE, sensor))

    assert abs(away(found(replace(SENSOR, outputs=outputs)), "gyro_scale_factor_z", 9e3)) < 4
    assert found(SENSOR)["gyro_scale_factor_z"].value > 2e4  # 120 deg/s stand for more


def _with_uneven_reference(seed: int, parts: int = 8) -> tuple[RecordedSegment, ...]:
    """The board with reference gyros whose scale factors differ by 0.5 % from segment to segment."""
    draw = np.random.default_rng(seed)
    found = []
    for part in BOARD.recording(seed, BY_REFERENCE, parts):
        blocks = list(part.blocks(tuple(part.units)))
        channels = {n: np.concatenate([np.asarray(b.channels[n]) for b in blocks]) for n in part.units}
        for axis in "xyz":
            channels[f"one_gyro_{axis}"] *= 1 + 0.005 * draw.standard_normal()
        found.append(from_samples(part.segment, np.concatenate([b.time for b in blocks]), channels, part.units))
    return tuple(found)


def test_errors_of_the_reference_that_differ_between_segments_are_warned_of() -> None:
    parameters = ErrorModelParameters(outputs={"two_gyro_z": GYRO}, uncertainty="residual")
    for seed in (1, 2, 3):
        recording = _with_uneven_reference(seed)
        found = ErrorModelEstimator().estimate(EstimateRequest("model", recording, parameters, SITE, SENSOR))
        assert [text for text in found.warnings if "single segments give" in text]


def test_the_scatter_of_segments_gives_the_variance_of_a_contrast() -> None:
    """Contributions with 30 times the variance of white noise, because the residuals within a segment agree with each other."""
    draw = np.random.default_rng(5)
    n, each = 9, 200
    first = np.arange(n) * each
    found = []
    for _ in range(300):
        functional = draw.standard_normal(n * each) * np.repeat(draw.uniform(0.5, 1.5, n), each)
        functional /= np.linalg.norm(functional)
        own = np.sqrt(np.add.reduceat(functional**2, first))
        common = np.sqrt(29.0) * draw.standard_normal(n) / own
        left = draw.standard_normal(n * each) + functional * np.repeat(common, each)
        left -= functional * (functional @ left)
        found.append(uneven_ratios(functional[None], left, first, 1.0)[0])
    assert np.mean(found) == pytest.approx(30.0, rel=0.1)
    white = [uneven_ratios(functional[None], draw.standard_normal(n * each), first, 1.0)[0] for _ in range(100)]
    assert np.mean(np.array(white) > 1) < 0.05


def test_an_even_reference_gives_no_such_warning() -> None:
    found = estimate(BOARD, BY_REFERENCE, {"two_gyro_z": GYRO, "two_accel_x": ACCEL}, parts=8)
    assert not [text for text in found.warnings if "single segments give" in text]


def test_the_limit_of_the_error_of_a_noisy_reference_concerns_gyros_alone() -> None:
    """An accelerometer responds to a specific force and to the rotation, whose noise differs."""
    found = combined(estimate(BOARD, BY_REFERENCE, {"two_gyro_z": GYRO, "two_accel_x": ACCEL}))
    named = {one.coefficient: {line.quantity for line in one.lines} for one in found.budgets}
    assert DILUTION in named["gyro_scale_factor_z"]
    assert not [name for name, lines in named.items() if DILUTION in lines and not name.startswith("gyro")]
