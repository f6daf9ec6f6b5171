"""Outliers in coloured noise, compared with generalised least squares on the samples themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.outliers import MOST, pulses_in
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.observation.bins import SPIKE
from tests.gap.test_noise_as_it_is import SAMPLE, noisy
from tests.gap.turntable import Array

COUNT, FLOOR = 600, 0.1
NONE = np.zeros(0, dtype=np.int64)
FIRST = np.eye(COUNT)[:, :5]
"""Cosine transforms of the five lowest orders."""
VARIANCE = 2 - 2 * np.cos(np.pi * np.arange(COUNT) / COUNT) + FLOOR**2


def differences(draw: np.random.Generator) -> Array:
    """Differences of white noise, as rounding leaves them in increments of an angle, and a little white noise. Without the five lowest
    orders."""
    from scipy.fft import dct, idct

    noise = np.diff(draw.standard_normal(COUNT + 1)) + FLOOR * draw.standard_normal(COUNT)
    orders = dct(noise, norm="ortho")
    orders[:5] = 0.0
    return np.asarray(idct(orders, norm="ortho"))


def with_pulses(noise: Array, rows: list[int], size: float) -> Array:
    from scipy.fft import dct, idct

    orders = dct(size * np.eye(COUNT)[rows].sum(axis=0), norm="ortho")
    orders[:5] = 0.0
    return noise + np.asarray(idct(orders, norm="ortho"))


def test_an_outlier_within_the_scatter_of_the_samples_is_found() -> None:
    samples = with_pulses(differences(np.random.default_rng(3)), [200], 6.0)
    assert abs(samples[200]) < SPIKE * differences(np.random.default_rng(3)).std()
    found = pulses_in(samples, FIRST, VARIANCE, NONE)
    (row,) = found.rows.tolist()
    assert abs(row - 200) <= 2
    covariance = toeplitz(np.r_[2 + FLOOR**2, -1.0, np.zeros(COUNT - 2)])
    design = np.column_stack(
        [np.cos(np.pi * np.outer(np.arange(COUNT) + 0.5, np.arange(5)) / COUNT), np.eye(COUNT)[row]]
    )
    weighted = np.linalg.solve(covariance, design)
    expected = np.linalg.solve(design.T @ weighted, weighted.T @ samples)[-1]
    assert found.sizes[0] == pytest.approx(expected, abs=0.2)


def test_noise_and_steps_have_no_outliers_except_at_the_ends() -> None:
    """At the ends, an error of the noise is not cancelled by that of another sample."""
    draw = np.random.default_rng(4)
    for _ in range(40):
        samples = differences(draw)
        for each in (samples, with_pulses(samples, list(range(250, COUNT)), 1.0)):
            rows = pulses_in(each, FIRST, VARIANCE, NONE).rows
            assert np.minimum(rows, COUNT - 1 - rows).max(initial=0) < 5


def test_many_outliers_belong_to_the_noise() -> None:
    rows = list(range(100, 500, 60))
    samples = with_pulses(differences(np.random.default_rng(5)), rows, 6.0)
    assert len(rows) > MOST
    assert not len(pulses_in(samples, FIRST, VARIANCE, NONE).rows)
    known = np.array([70])
    assert pulses_in(samples, FIRST, VARIANCE, known).rows.tolist() == [70]


def test_outliers_leave_the_slow_coefficients_as_they_are() -> None:
    def noise(observed: Observed, draw: np.random.Generator) -> Array:
        shape = observed.values.shape
        white = draw.standard_normal((shape[0] + 1, shape[1]))
        return np.asarray(np.diff(white, axis=0) / 1.4 + 0.1 * draw.standard_normal(shape))

    whole = noisy(noise)
    pulses = np.zeros_like(whole.values)
    for part in whole.segments()[::3]:
        pulses[part.start + (part.stop - part.start) // 3, 0] = 5 * SAMPLE[0]
    clean, dirty = Weighing(whole), Weighing(replace(whole, values=whole.values + pulses))
    slow = (clean.spectrum.harmonic == 0) & (clean.spectrum.frequency > 0)
    left = dirty.spectrum.values[slow, 0] - clean.spectrum.values[slow, 0]
    caused = clean.spectrum.project(whole, pulses[:, :1])[slow, 0]
    assert np.mean(left**2) < 0.1 * np.mean(caused**2)
