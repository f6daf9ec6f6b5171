"""Outputs that are counted without loss are not rounded as a whole."""

from __future__ import annotations

import pytest

from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.observations import dithered


@pytest.mark.parametrize(
    ("noise", "variance", "expected"),
    [
        (NoiseModel(resolution=2.0), 0.99, False),
        (NoiseModel(resolution=2.0), 1.01, True),
        (NoiseModel(resolution=2.0, counted=True), 0.0, True),
    ],
)
def test_what_carries_a_mean_past_the_counts(noise, variance, expected):
    sensor = SensorModel("gyro", (OutputModel("x", "pulse/s", noise=noise),), 100.0)
    assert bool(dithered(sensor, "x", variance)) is expected


def test_a_counted_mean_is_rounded_at_its_two_ends():
    # Steps of 3 pulse/s at 10 Hz are counts of 0.3 pulse; two ends of ±0.15 pulse over 5 s: √2·0.3/√12/5.
    declared = NoiseModel(resolution=3.0, counted=True).standard_error(5.0, 10.0)
    assert declared == pytest.approx(2**0.5 * 0.3 / 12**0.5 / 5)
