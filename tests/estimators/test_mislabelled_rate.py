"""A rate with the wrong label among many is named by `scale_factor`."""

from __future__ import annotations

import numpy as np
from recorded import noisy, segment, sensor

from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Spin


def test_one_of_48_rates_with_a_wrong_label_is_named() -> None:
    rates = np.linspace(-200, 200, 48)
    draw = np.random.default_rng(1)
    planned = rates.copy()
    planned[30] += 9.0  # deg/s
    recorded = tuple(
        noisy(segment(f"R{k}", np.eye(3), Spin(float(np.radians(rate)))), {"gyro_z": 1.01 * true}, "deg/s", 0.01, draw)
        for k, (rate, true) in enumerate(zip(planned, rates, strict=True))
    )
    site = Site(latitude=0.7, gravity=9.80665)
    request = EstimateRequest("line", recorded, ScaleFactorParameters(), site, sensor("gyro_z", unit="deg/s"))
    warnings = ScaleFactor().estimate(request).warnings
    assert [text for text in warnings if "'R30' does not fit the other segments" in text]
    assert not [text for text in warnings if "does not fit the other segments" in text and "'R30'" not in text]
