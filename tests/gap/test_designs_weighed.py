"""Designs weighed from few rows, beside whole coefficients that are whitened and projected one column after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.gap.evidence.weighing import ChannelWeights, Left, eigen
from planrunner.gap.hypotheses.candidates import Weighing
from tests.gap.turntable import record

Array = NDArray[np.float64]


@pytest.fixture(scope="module", params=[0.0, 2e-6], ids=["white", "flicker"])
def weighing(request: pytest.FixtureRequest) -> Weighing:
    observed = record(seed=12)
    return Weighing(replace(observed, channels=tuple(replace(c, flicker=request.param) for c in observed.channels)))


def _plain(weight: ChannelWeights, design: Array, held: Array | None = None) -> tuple[Array, Array]:
    """Gram matrix and score of columns, from all their projected coefficients; `held`: columns whose span is taken out as well."""
    columns, residual = weight.project(design), weight.residual
    if held is not None:
        directions, size, _ = np.linalg.svd(weight.project(held), full_matrices=False)
        directions = directions[:, size > 1e-6 * size.max()]
        columns, residual = (part - directions @ (directions.T @ part) for part in (columns, residual))
    return columns.T @ columns, columns.T @ residual


def _resolvent(values: Array, along: Array, scale: float) -> tuple[float, float]:
    """log det(I + sG) and cᵀ(I + sG)⁻¹c from eigenvalues and squared scores."""
    return float(np.log1p(scale * values).sum()), float((along / (1 + scale * values)).sum())


def _expected(gram: Array, score: Array, scale: float) -> tuple[float, float]:
    inner = np.eye(len(gram)) + scale * gram
    return float(np.linalg.slogdet(inner)[1]), float(score @ np.linalg.solve(inner, score))


SORTS = {
    "means": lambda spectrum: spectrum.frequency == 0,
    "slow": lambda spectrum: (spectrum.frequency > 0) & (spectrum.harmonic == 0),
    "turns": lambda spectrum: spectrum.harmonic == 1,
}


@pytest.mark.parametrize("taken", [None, *SORTS])
@pytest.mark.parametrize("sort", SORTS)
def test_evidence_is_that_of_whole_columns(weighing: Weighing, sort: str, taken: str | None) -> None:
    if taken == sort:
        return
    spectrum = weighing.spectrum
    rows, draw = SORTS[sort](spectrum), np.random.default_rng(3)
    few = np.where(rows[:, None], draw.standard_normal((len(rows), 7)), 0.0)
    held = None if taken is None else np.eye(len(rows))[:, SORTS[taken](spectrum)]
    for channel in (0, 5):
        weight = weighing.weights[channel][0]
        left = Left.whole(weight) if taken is None else Left.whole(weight).without(SORTS[taken](spectrum))
        designs = [(few, few)] if sort == "means" else [(few, few), (rows, np.eye(len(rows))[:, rows])]
        for design, columns in designs:
            gram, score = _plain(weight, columns, held)
            for scale in np.array([0.1, 10.0, 1e4]) / np.trace(gram):
                found = _resolvent(*eigen(left, design), float(scale))
                assert found == pytest.approx(_expected(gram, score, float(scale)), rel=1e-8)


def test_a_nominal_column_leaves_nothing(weighing: Weighing) -> None:
    """A constant is the bias: no direction of it is left, whatever rounding leaves of its length."""
    spectrum, weight = weighing.spectrum, weighing.weights[0][0]
    constant = np.where(spectrum.frequency == 0, np.sqrt(weighing.observed.counts)[spectrum.segment], 0.0)
    values, along = eigen(Left.whole(weight), constant[:, None])
    assert not len(values) and not len(along)
