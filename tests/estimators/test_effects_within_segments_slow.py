"""Coverage of effects within segments, in recordings by independent formulas (`effects_within`)."""

from __future__ import annotations

import numpy as np
import pytest
from effects_within import WORLDS, campaign
from scipy.stats import binom

OWN = {
    "lag": ("gyro_bandwidth_tau_x",),
    "delay": ("time_latency_delay",),
    "ripple": ("table_rate_ripple_cos", "table_rate_ripple_sin"),
    "lever arm": tuple(f"lever_arm_r_{axis}_accel_x" for axis in "xyz"),
}
SEEDS = 40


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_intervals_contain_the_truth_and_the_scatter_is_predicted(name: str) -> None:
    found = campaign(WORLDS[name], range(1, 1 + SEEDS))
    assert np.mean([one.covered for one in found.values()]) >= 0.93  # of all coefficients of the fit
    own = [found[one] for one in OWN[name]]
    least = float(binom.ppf(0.001, SEEDS * len(own), 0.95)) / (SEEDS * len(own))
    assert np.mean([one.covered for one in own]) >= least
    scatter = np.sqrt(np.mean([(one.scatter / one.predicted) ** 2 for one in own]))
    assert 0.75 < scatter < 1.25
    assert all(0.75 < one.stated / one.predicted < 1.25 for one in own)
