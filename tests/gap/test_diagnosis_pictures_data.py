"""Numbers for drawings: spectra before and after an effect, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from tests.gap.turntable import DEG, GYRO_WHITE, record


def _ripple(
    observed: Observed, omega: np.ndarray, force: np.ndarray, draw: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A rate that swings by 0.05 % twice a turn."""
    return 0.0005 * np.cos(2 * observed.angle)[:, None] * observed.rate[:, None] * observed.table_axis, np.zeros_like(
        force
    )


def test_spectra_show_an_effect_before_and_none_after() -> None:
    """White noise of 0.0014 °/s·√s has the one-sided density √2 times that; the ripple lies at 0.1 to 0.5 Hz."""
    options = DiagnosisOptions(effects=("table_rate_ripple", "table_wobble", "gyro_scale_asymmetry"))
    found = diagnose(record(seed=31, fault=_ripple), options)
    assert found.verdict.effects == ("table_rate_ripple",)
    density = GYRO_WHITE * np.sqrt(2) / DEG
    for name in ("gyro_x", "gyro_y", "gyro_z"):
        one = found.pictures["spectrum"][name]
        assert one["noise"][0] == pytest.approx(density, rel=0.03)
        assert one["after"] == pytest.approx([density] * len(one["after"]), rel=0.3)
        lowest = np.array(one["frequency_hz"]) < 0.5
        assert max(np.array(one["before"])[lowest] / np.array(one["after"])[lowest]) > 1.5
        assert one["before"][-1] == pytest.approx(one["after"][-1])
