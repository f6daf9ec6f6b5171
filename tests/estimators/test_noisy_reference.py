"""Noise and counts of an encoder make fitted responses too small: the uncertainties include this error, and a warning names it.

The recordings come from formulas that share nothing with planrunner: sums of Gaussian pulses of the rate, and their integral.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from recorded import from_samples
from scipy.special import erf

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.analysis import combined
from planrunner.estimators.error_model.estimator import DILUTION, ErrorModelEstimator
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.interface import Estimate, EstimateRequest
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.schedule import RecordedMotion, Segment

SITE = Site(math.radians(47.4), 9.807, earth_rate=0.0)
SENSOR = SensorModel("gyro", tuple(OutputModel(f"gyro_{axis}", "deg/s") for axis in "xz"), 100.0)
UNITS = {"gyro_x": "deg/s", "gyro_z": "deg/s", "encoder": "deg"}
SCALE, ACROSS = 3500e-6, 4e-3


def turned_by_hand(seed: int, count: float, motion: RecordedMotion, fastest: float = 70.0) -> list[RecordedSegment]:
    """Six minutes on a turntable: the z gyro has a scale-factor error of 3500 ppm, the x gyro a misalignment of 4 mrad. count: of
    the encoder, deg; fastest: deg/s."""
    draw, found = np.random.default_rng(seed), []
    time = np.arange(6000) / 100
    for number in range(6):
        rate, angle = np.zeros(6000), np.full(6000, draw.uniform(0, 360))
        for _ in range(8):
            middle, width, size = draw.uniform(3, 57), draw.uniform(1.0, 3.5), draw.uniform(-fastest, fastest)
            away = (time - middle) / width
            rate += size * np.exp(-(away**2) / 2)
            angle += (
                size * width * math.sqrt(math.pi / 2) * (erf(away / math.sqrt(2)) + erf(middle / width / math.sqrt(2)))
            )
        noise = 0.02 * draw.standard_normal((2, 6000))
        shown = np.round(angle % 360 / count) * count
        channels: dict[str, np.ndarray] = {
            "gyro_x": ACROSS * rate + noise[0],
            "gyro_z": (1 + SCALE) * rate + noise[1],
            "encoder": shown,
        }
        planned = Segment(0, f"M{number}", np.eye(3), "upright", motion, None)
        found.append(from_samples(planned, 65.0 * number + time, channels, UNITS))
    return found


def made(seed: int, count: float, averaging: float = 0.0, fastest: float = 70.0) -> Estimate:
    motion = RecordedMotion(about=(0.0, 0.0, 1.0), angle="encoder", averaging=averaging)
    outputs: dict[str, tuple[str, ...]] = {
        "gyro_z": ("gyro_bias", "gyro_scale_factor"),
        "gyro_x": ("gyro_bias", "gyro_misalignment.towards_z"),
    }
    recording = tuple(turned_by_hand(seed, count, motion, fastest))
    parameters = ErrorModelParameters(outputs=outputs, uncertainty="residual")
    return combined(ErrorModelEstimator().estimate(EstimateRequest("model", recording, parameters, SITE, SENSOR)))


def errors(found: Estimate) -> np.ndarray:
    """Of the scale factor and of the misalignment, in standard uncertainties."""
    true = {
        "gyro_scale_factor_z": 1e6 * SCALE,
        "gyro_misalignment_towards_z_x": math.degrees(ACROSS) * 3600,
    }
    return np.array([(found[name].value - value) / found[name].standard_uncertainty for name, value in true.items()])


def warned(found: Estimate) -> list[str]:
    return [text for text in found.warnings if "channels that show the motion" in text and "too small" in text]


@pytest.mark.parametrize("count", [360 / 4096, 1.0])
def test_counts_of_an_encoder_are_in_the_uncertainty_and_named(count: float) -> None:
    for seed in (1, 2, 3):
        found = made(seed, count)
        assert np.abs(errors(found)).max() < 3
        assert [text for text in warned(found) if text.startswith("gyro_z")]
        [budget] = [one for one in found.budgets if one.coefficient == "gyro_scale_factor_z"]
        [line] = [one for one in budget.lines if one.quantity == DILUTION]
        assert abs(line.contribution) == pytest.approx(found["gyro_scale_factor_z"].standard_uncertainty, rel=0.2)


def test_a_longer_average_reduces_the_error() -> None:
    short, long = (made(4, 360 / 4096, averaging)["gyro_scale_factor_z"] for averaging in (0.1, 1.0))
    assert abs(long.value - 1e6 * SCALE) < abs(short.value - 1e6 * SCALE) / 3
    assert long.standard_uncertainty < short.standard_uncertainty


@pytest.mark.parametrize("fastest", [70.0, 10.0])
def test_a_fine_encoder_and_a_noisy_gyro_give_no_such_warning(fastest: float) -> None:
    for seed in range(10, 16):
        found = made(seed, 1e-5, fastest=fastest)
        assert not warned(found)
        assert np.abs(errors(found)).max() < 4
