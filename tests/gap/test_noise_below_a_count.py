"""The rounding error of long means against a simulation of rounded noise at many positions within a count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.rounding import PLACES, _reading, dithering, undithered
from planrunner.plan.schedule import Rest
from tests.gap.turntable import RATE, Array, record

STEP = 1e-3
SAMPLES = 400


def at_rest(sigma: float | Callable[[np.random.Generator, int], Array], places: Array, declared: float) -> Observed:
    """Rounded readings at rest about positions (S,), all in counts; every channel alike. sigma: of Gaussian noise, or what draws noise."""
    whole, draw = record(), np.random.default_rng(3)
    count = len(places)
    noise = (
        sigma(draw, count * SAMPLES * 6).reshape(-1, 6)
        if callable(sigma)
        else sigma * draw.standard_normal((count * SAMPLES, 6))
    )
    samples = np.repeat(places, SAMPLES)[:, None] + noise
    channels = tuple(
        replace(one, resolution=STEP, white=declared * STEP / np.sqrt(RATE), flicker=0.0) for one in whole.channels
    )
    return replace(
        whole,
        channels=channels,
        labels=("S",) * count,
        motions=(Rest(),) * count,
        attitude=np.repeat(whole.attitude[:1], count, axis=0),
        bounds=np.arange(count + 1) * SAMPLES,
        time=np.arange(count * SAMPLES) / RATE,
        values=np.round(samples) * STEP,
    )


@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.15])
def test_variance_of_the_error_of_a_mean(sigma: float) -> None:
    places = np.linspace(-0.5, 0.5, 201)
    draw = np.random.default_rng(5).standard_normal(20_000)
    errors = np.array([np.round(place + sigma * draw).mean() - place for place in places])
    assert float(np.mean(errors**2)) == pytest.approx(float(dithering(sigma)) / 12, rel=0.15)


@pytest.mark.parametrize("declared", [0.0, 0.1])
@pytest.mark.parametrize(
    "places", [np.full(20, 7.5), np.linspace(7.0, 8.0, 20)], ids=["between two counts", "anywhere"]
)
def test_small_noise_does_not_dither(places: Array, declared: float) -> None:
    observed = at_rest(0.1, places, declared)
    white = observed.values.std(0)
    found = undithered(observed, white, np.ones(6, dtype=bool))
    assert np.all(found > 0.3 * STEP**2 / 12)
    assert np.all(found < STEP**2 / 12)


def test_noise_that_reaches_a_third_count_dithers_whatever_is_declared() -> None:
    observed = at_rest(0.45, np.linspace(7.0, 8.0, 20), 0.1)
    found = undithered(observed, observed.values.std(0), np.ones(6, dtype=bool))
    assert np.all(found < 0.01 * STEP**2 / 12)


def mixed(draw: np.random.Generator, count: int) -> Array:
    """Noise of 0.25 counts in four samples of five, and of 1.1 counts in the others: 0.54 counts in all, like noise that dithers well."""
    return draw.standard_normal(count) * np.where(draw.uniform(size=count) < 0.8, 0.25, 1.1)


def test_noise_with_many_small_values_dithers_less_than_gaussian_noise_of_its_standard_deviation() -> None:
    draw = np.random.default_rng(7)
    noise = mixed(draw, 100_000)
    errors = np.array([np.round(place + noise).mean() - place for place in np.linspace(-0.5, 0.5, 101)])
    expected = float(np.mean((errors - errors.mean()) ** 2))
    assert expected > 50 * float(dithering(noise.std())) / 12
    observed = at_rest(mixed, draw.uniform(5.0, 15.0, 20), 0.54)
    found = undithered(observed, np.full(6, np.sqrt(0.54**2 + 1 / 12) * STEP), np.zeros(6, dtype=bool))
    assert np.all(found > 0.6 * expected * STEP**2)
    assert np.all(found < 2.5 * expected * STEP**2)


def test_gaussian_noise_is_no_mixture() -> None:
    """Its dithering is that of its standard deviation."""
    observed = at_rest(0.6, np.linspace(7.0, 8.0, 20), 0.6)
    white = np.full(6, np.sqrt(0.6**2 + 1 / 12) * STEP)
    found = undithered(observed, white, np.zeros(6, dtype=bool))
    assert found == pytest.approx(np.full(6, float(dithering(0.6)) / 12 * STEP**2), rel=1e-9)


@pytest.mark.parametrize("sigma", [1.0, 4.0])
def test_large_noise_gives_mean_readings_at_the_true_means(sigma: float) -> None:
    assert _reading(sigma) == pytest.approx(PLACES, abs=1e-3)
