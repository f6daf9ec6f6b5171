"""The uncertainties of parameters that are evaluated on a grid: the density of a random walk, and the shape of an effect."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from planrunner.base.arrays import Array
from planrunner.error_model.effects.gyro import GyroGSensitivity
from planrunner.error_model.effects.interface import OutsideCoefficients, effect_named
from planrunner.error_model.effects.warming import GyroWarmUp
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.parameters import _density, of_noise, shape
from planrunner.gap.evidence.weighing import WALKS, Setting
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import candidates_of
from planrunner.plan.units import STANDARD_GRAVITY
from tests.gap.turntable import DEG, record

_DENSITY = 2e-4  # deg/s/√s


def _walk(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    steps = np.sqrt(np.diff(observed.time, prepend=observed.time[0]))
    return np.cumsum(draw.normal(0, _DENSITY * DEG, omega.shape) * steps[:, None], axis=0), 0.0


def _walk_beside(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    """A random walk, and a strong g-sensitivity of the gyros."""
    sensitivity = np.array([[0.0, 9e-2, 0.0], [-6e-2, 0.0, 0.0], [0.0, 3e-2, 0.0]]) * DEG / STANDARD_GRAVITY
    return _walk(observed, omega, force, draw)[0] + force @ sensitivity.T, 0.0


def test_the_density_of_a_random_walk_deviates_by_its_uncertainty() -> None:
    """The true density lies between two evaluated levels. One level often has nearly all of the probability."""
    effect, away = effect_named("gyro_bias_random_walk"), []
    assert isinstance(effect, OutsideCoefficients)
    for seed in range(100, 130):
        weighing = Weighing(record(seed=seed, fault=_walk_beside, sampling=5.0))
        (beside,) = candidates_of(weighing, [GyroGSensitivity()])
        (density,) = of_noise(weighing, effect, beside.best)
        away.append((density.value - _DENSITY) / density.standard_uncertainty)
    assert np.mean(np.abs(away) <= 2) >= 0.9
    assert 0.6 < np.sqrt(np.mean(np.square(away))) < 1.4


@pytest.mark.parametrize("number", [10, 100, 1000, 10_000])
@pytest.mark.parametrize(("times", "edge"), [(0.0, True), (0.15, True), (0.5, True), (15.0, False), (150.0, True)])
def test_a_density_outside_the_evaluated_levels_has_an_uncertainty_that_covers_it(
    number: int, times: float, edge: bool
) -> None:
    """`number` increments, whose variance is 1 + w², have exactly the expected scatter. `times`: the true density w divided by the
    smallest evaluated density."""
    walks = np.sqrt(WALKS)
    settings = (Setting(0.0, 0.0, 1.0, False), *(Setting(0.0, walk, 0.01, False) for walk in walks.tolist()))
    true = times * walks[0]
    variance = 1 + np.array([setting.walk for setting in settings]) ** 2
    weighing = SimpleNamespace(
        settings={"gyro": settings},
        base=-number / 2 * (np.log(variance) + (1 + true**2) / variance),
        log_prior=(None, np.append(-np.inf, np.zeros(len(walks)))),
        shape=(len(settings), 1),
    )
    mean, spread = _density(weighing, None)  # type: ignore[arg-type]
    assert abs(mean - true) < 2 * spread
    assert (spread >= mean) == edge


@pytest.mark.parametrize(("tau", "edge"), [(1500.0, False), (12000.0, True)])
def test_a_time_constant_at_the_edge_of_the_grid_has_the_uncertainty_of_the_grid(tau: float, edge: bool) -> None:
    def warming(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return np.ones_like(omega) * (10 * DEG * np.exp(-observed.time / tau))[:, None], 0.0

    weighing = Weighing(record(seed=5, fault=warming, sampling=5.0))
    (candidate,) = candidates_of(weighing, [GyroWarmUp()])
    (found,) = shape(candidate)
    assert abs(found.value - tau) < 3 * found.standard_uncertainty
    assert (found.standard_uncertainty > 0.2 * found.value) == edge
