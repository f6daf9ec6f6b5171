"""Labels of two segments that were exchanged are named; effects and noise name none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import pair_log_bayes_factor
from planrunner.gap.evidence.recording_checks import check_observed, exchanged_labels
from tests.gap.turntable import DEG, Array, G, record


def exchanged(observed: Observed, first: int, second: int) -> Observed:
    """What the plan says of two segments at rest, exchanged; the samples stay."""
    attitude = observed.attitude.copy()
    attitude[[first, second]] = attitude[[second, first]]
    return replace(observed, attitude=attitude)


@pytest.mark.parametrize("pair", [(0, 2), (1, 5), (3, 9)])
def test_exchanged_labels_are_named(pair: tuple[int, int]) -> None:
    log = Findings()
    check_observed(exchanged(record(), *pair), "recording", log)
    (found,) = [one for one in log if one.code == "gap-labels-exchanged"]
    assert f"'S{pair[0]}' and 'S{pair[1]}'" in found.message


def test_effects_and_noise_are_no_exchange() -> None:
    def g_sensitive(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 0.5 * DEG * force / G, 0.0

    def asymmetric(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 0.01 * np.abs(omega), 0.0

    for fault in (None, g_sensitive, asymmetric):
        assert exchanged_labels(record(seed=3, fault=fault)) is None


def test_pairs_of_very_strong_and_equal_effects_are_weighed() -> None:
    """Two columns that are equal up to rounding, at 10⁸ standard deviations."""
    column = np.random.default_rng(1).normal(size=(200, 1))
    both = np.hstack([column, column * (1 + 1e-15)]) * 1e8
    gram = both.T @ both
    score = both.T @ (both @ [1.0, 1.0])
    assert np.isfinite(pair_log_bayes_factor(gram, score, 1, (gram[0, 0], gram[1, 1]), np.geomspace(0.5, 1e18, 15)))
