"""Coefficients of one segment are correlated if the noise is strong at high frequencies, because both ends of the segment act on all of
them."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.covariance import Blocks, Correlation
from planrunner.gap.evidence.noise_within import _leakage
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.open_set import PERIODIC, competitors
from planrunner.gap.hypotheses.outside import PLAIN
from planrunner.gap.hypotheses.patterns import WHOLE, Sort
from tests.gap.test_noise_as_it_is import noisy
from tests.gap.turntable import Array


def differenced(observed: Observed, draw: np.random.Generator) -> Array:
    """The error of each sample cancels that of the sample before, apart from a small part that is white."""
    samples, channels = observed.values.shape
    white = draw.standard_normal((samples + 1, channels))
    return np.asarray(np.diff(white, axis=0) + 0.002 * draw.standard_normal((samples, channels)))


def test_ends_of_a_segment_are_no_transient() -> None:
    """Order 1 and order 3 of a segment are the same sum of its ends, so that they count as one observation and not as two."""
    weighing = Weighing(noisy(differenced))
    first = weighing.spectrum.means
    raw = np.array([weighing._left()[first + order].ravel() for order in (1, 3)])
    residuals = np.array([each[0].residual for each in weighing.weights])
    whitened = np.array([residuals[:, first + order].ravel() for order in (1, 3)])
    assert np.corrcoef(raw)[0, 1] > 0.8
    assert 0.5 < (whitened[0] ** 2).mean() < 1.5
    assert (whitened[1] ** 2).mean() < 0.4
    found = competitors(weighing).log_bayes
    assert max(found[WHOLE[Sort.TRANSIENT]][0], found[PERIODIC][0]) < PLAIN


def test_blocks_are_whitened_and_restored() -> None:
    """Two segments, of three and two coefficients, against the inverse of the whole covariance matrix."""
    draw = np.random.default_rng(3)
    blocks = Blocks.diagonal([3, 2], np.array([1.0, 2.0]))
    own = [(root := draw.standard_normal((size, size))) @ root.T + np.eye(size) for size in (3, 2)]
    whole = np.zeros((5, 5))
    for index, (place, block) in enumerate(zip((slice(0, 3), slice(3, 5)), own, strict=True)):
        blocks.of_segment(index)[:] = block
        whole[place, place] = block
    more = np.arange(5.0)
    whole += np.diag(more)
    correlation = Correlation(blocks.plus(more))
    root = np.sqrt(np.diag(whole))
    values = draw.standard_normal((5, 2))
    apart = correlation.apart(values / root[:, None])
    assert blocks.correlated and not Blocks.diagonal([3, 2], np.ones(2)).correlated
    assert apart.T @ apart == pytest.approx(values.T @ np.linalg.inv(whole) @ values, rel=0.02)
    assert correlation.joined(apart) == pytest.approx(values / root[:, None])
    assert correlation.log_det == pytest.approx(np.linalg.slogdet(whole / np.outer(root, root))[1], abs=0.02)
    rows = np.array([True, False, True, False, True])
    some = correlation.among(rows).apart(np.where(rows[:, None], values / root[:, None], 0.0))[rows]
    part = np.ix_(rows, rows)
    assert some.T @ some == pytest.approx(values[rows].T @ np.linalg.inv(whole[part]) @ values[rows], rel=0.02)


def test_leakage_of_the_cosine_transform() -> None:
    """Against the Fourier transform of a vector of each band, at bands that are not neighbours."""
    samples, fine = 256, 1 << 15
    edges = np.pi * np.concatenate([2.0 ** np.arange(-5, -2), np.linspace(0.25, 1.0, 7)])
    low, high = edges[:-1], edges[1:]
    centre = (low + high) / 2
    found = _leakage(np.array([low, high, centre]), samples)
    turn = 2 * np.pi * np.arange(fine // 2 + 1) / fine
    for band, angle in enumerate(centre):
        order = round(angle * samples / np.pi)
        vector = np.cos(np.pi * order * (np.arange(samples) + 0.5) / samples) * np.sqrt(2 / samples)
        power = np.abs(np.fft.rfft(vector, fine)) ** 2
        for other in range(len(centre)):
            if abs(other - band) > 2:
                own = power[(turn >= low[other]) & (turn < high[other])].mean() * (high[other] - low[other]) / np.pi
                assert found[band, other] == pytest.approx(own, rel=0.3)
