"""What remains beside a named effect is measured: noise, or something else of a size."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions, diagnose
from planrunner.reporting.diagnosis_page import verdict
from tests.gap.turntable import DEG, Array, G, record


def g_sensitivity(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    return force / G @ draw.normal(0, 0.05 * DEG, (3, 3)).T, 0.0


def with_offsets(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    """Beside the effect, offsets of z that follow nothing: a twentieth of it."""
    effect, _ = g_sensitivity(observed, omega, force, draw)
    offsets = np.random.default_rng(5).normal(0, 0.0025 * DEG, len(observed))[observed.owner]
    return effect + np.outer(offsets, [0.0, 0.0, 1.0]), 0.0


FEW = ("gyro_g_sensitivity", "gyro_g2_sensitivity", "gyro_bias_temperature", "table_tilt")


@pytest.fixture(
    scope="module",
    params=[pytest.param(FEW, id="few"), pytest.param(None, marks=pytest.mark.slow, id="all")],
)
def options(request: pytest.FixtureRequest) -> DiagnosisOptions:
    """A few effects, or all of them, which takes long."""
    return DiagnosisOptions(effects=request.param)


@pytest.fixture(scope="module")
def clean(options: DiagnosisOptions) -> Diagnosis:
    return diagnose(record(seed=8, fault=g_sensitivity), options)


@pytest.fixture(scope="module")
def beside(options: DiagnosisOptions) -> Diagnosis:
    return diagnose(record(seed=8, fault=with_offsets), options)


def test_an_effect_that_leaves_noise_explains_the_gap(clean: Diagnosis) -> None:
    assert clean.rest is not None and clean.rest.passes
    assert clean.rest.share == 0.0
    assert "explains the gap" in verdict(clean.to_json())


def test_a_rest_is_visible_where_it_lies(clean: Diagnosis, beside: Diagnosis) -> None:
    """The offsets are 2.5 m°/s; the noise of a mean of 400 samples is 0.31 m°/s."""
    assert clean.verdict.effects == beside.verdict.effects == ("gyro_g_sensitivity",)
    assert beside.rest is not None and not beside.rest.passes
    times = beside.rest.times_noise
    assert max(times, key=lambda name: times[name]) == "gyro_z"
    assert times["gyro_z"] > 2.0
    assert all(value < 1.3 for name, value in times.items() if name != "gyro_z")
    assert "The rest is not noise" in verdict(beside.to_json())
    assert "explains the gap" not in verdict(beside.to_json())
