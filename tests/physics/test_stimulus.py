"""What the sensor felt: closed-form means against sampling in small steps, and what must be refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planrunner.error_model.terms import ACCEL_X, ACCEL_X_ACCEL_Z, BIAS, RATE_Z, ErrorModel, design_matrix
from planrunner.physics.earth import EARTH_RATE, Site
from planrunner.physics.stimulus import StimulusError, segment_means
from planrunner.plan.schedule import Motion, Rest, Rock, Segment, Spin

SITE = Site(math.radians(40), 9.80)
TILTED = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def segment(motion: Motion, dwell: float | None = 10.0, attitude: np.ndarray | None = TILTED) -> Segment:
    return Segment(0, "S", attitude, "as tested", motion, dwell, temperature=300.0, start=5.0)


def test_rest_in_words() -> None:
    """x up, y north, z west at 40°: Earth rate Ω·sin φ on x, Ω·cos φ on y, nothing on z; +g on x."""
    attitude = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float)
    felt = segment_means([segment(Rest(), attitude=attitude)], SITE)
    assert felt.omega[0] == pytest.approx(
        [EARTH_RATE * math.sin(SITE.latitude), EARTH_RATE * math.cos(SITE.latitude), 0]
    )
    assert felt.specific_force[0] == pytest.approx([9.80, 0, 0])
    assert felt.time[0] == 10.0
    assert felt.temperature[0] == 300.0
    assert not felt.moving[0]


@pytest.mark.parametrize("about", [(0, 0, 1), (0, 1, 0), (0.6, 0, 0.8)])
@pytest.mark.parametrize(("rate", "dwell"), [(0.3, 10.0), (-0.01, 50.0), (2.0, math.pi), (1e-9, 1.0)])
def test_spin_mean_equals_sampling(about: tuple[float, float, float], rate: float, dwell: float) -> None:
    felt = segment_means([segment(Spin(rate, about), dwell)], SITE)
    axis = np.array(about)
    n = 2_000
    angles = (np.arange(n) + 0.5) / n * rate * dwell
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    omega, force = np.zeros(3), np.zeros(3)
    for angle in angles:
        turned = (
            np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
        )  # Rodrigues, of the sensor's axes
        axes = (turned @ TILTED.T).T
        omega += axes @ SITE.earth_rate_enu
        force += axes @ SITE.specific_force_enu
    assert felt.omega[0] == pytest.approx(omega / n + TILTED @ axis * rate, abs=2e-6 * EARTH_RATE)
    assert felt.specific_force[0] == pytest.approx(force / n, abs=2e-6 * 9.8)
    assert felt.moving[0] == (rate != 0)


def test_whole_turns_leave_the_vertical_part() -> None:
    spin = Spin(2 * math.pi / 10)
    whole = segment_means([segment(spin, 10.0)], SITE)
    unknown = segment_means([segment(spin, None)], SITE)
    vertical = TILTED @ np.array([0, 0, spin.rate + EARTH_RATE * math.sin(SITE.latitude)])
    assert whole.omega[0] == pytest.approx(vertical, abs=1e-15)
    assert unknown.omega[0] == pytest.approx(vertical, abs=1e-15)
    recorded = segment_means([segment(spin, 10.0)], SITE, [5.0])
    assert np.abs(recorded.omega[0] - vertical).max() > 1e-6


def test_refusals_name_the_segment() -> None:
    with pytest.raises(StimulusError, match="orientation of segment 'S' is unknown"):
        segment_means([segment(Rest(), attitude=None)], SITE)
    with pytest.raises(StimulusError, match="'S' moves \\(rock\\)"):
        segment_means([segment(Rock(0.1, 0.2, (0.0,), 5.0))], SITE)


def test_products_refuse_turning_segments() -> None:
    felt = segment_means([segment(Spin(0.1))], SITE)
    with pytest.raises(StimulusError, match="accel_x_accel_z"):
        design_matrix([ACCEL_X_ACCEL_Z], felt)
    still = replace(felt, moving=np.array([False]))
    assert design_matrix([BIAS, ACCEL_X_ACCEL_Z], still)[0] == pytest.approx(
        [1.0, felt.specific_force[0, 0] * felt.specific_force[0, 2]]
    )


def test_model_predicts_by_name() -> None:
    felt = segment_means([segment(Rest())], SITE)
    model = ErrorModel((BIAS, RATE_Z, ACCEL_X))
    assert model.predict({"bias": 2.0, "accel_x": 0.5}, felt) == pytest.approx([2 + 0.5 * felt.specific_force[0, 0]])
    with pytest.raises(KeyError, match="acel_x"):
        model.predict({"acel_x": 0.5}, felt)


def test_the_registered_terms_are_these() -> None:
    from planrunner.base import plugins

    for name in plugins.names(plugins.TERMS):
        assert plugins.load(plugins.TERMS, name).name == name
