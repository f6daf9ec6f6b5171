"""The rounding error of long means against a simulation of rounded noise at many positions within a count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.rounding import dithering, undithered
from planrunner.plan.schedule import Rest
from tests.gap.turntable import RATE, Array, record

STEP = 1e-3
SAMPLES = 400


def at_rest(sigma: float, places: Array, declared: float) -> Observed:
    """Rounded readings at rest about positions (S,), all in counts; every channel alike."""
    whole, draw = record(), np.random.default_rng(3)
    count = len(places)
    samples = np.repeat(places, SAMPLES)[:, None] + sigma * draw.standard_normal((count * SAMPLES, 6))
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
