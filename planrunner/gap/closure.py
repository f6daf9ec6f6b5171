"""Closure: how far the gap shrinks on segments that had no part in choosing or fitting the effect.

Segments are held out in groups and the choice of the effect is repeated within each. With r the held-out residual of the nominal
simulation,
whitened with the uncertainty of its fitted parameters, and d the known difference between the predictions with and without the effect, the
gap g (r = g + noise) splits along d: its part along d is measured with unit noise, and the size of the rest follows from a non-central χ²
(its confidence distribution: Schweder and Hjort, Confidence, Likelihood, Probability, 2016). Before: |g|; after: |g − d|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.gap.candidates import Weighed, Weighing
from planrunner.gap.evidence import best_amplitudes, log_bayes_factors
from planrunner.gap.nominal_rank import DEPENDENT

Array = NDArray[np.float64]
FOLDS = 4
FEWEST = 6  # segments, so that three in four of them still say something
DRAWS = 2000
SEED = 21
WIDEST = 0.5  # of an interval that still says something
_WORTH = 4.0  # log BF in a fold from which on an effect is taken up there


@dataclass(frozen=True, slots=True)
class Closure:
    """before, after: size of the held-out gap in standard deviations of the noise, root mean square over coefficients. shrinks_by:
    share of it,
    1 where it closes. interval_90: of that share. resolvable: False where the data cannot say; the numbers are then NaN."""

    before: float
    after: float
    shrinks_by: float
    interval_90: tuple[float, float]
    resolvable: bool


NOT_RESOLVABLE = Closure(np.nan, np.nan, np.nan, (np.nan, np.nan), False)


def closure(weighing: Weighing, choices: Sequence[Weighed]) -> Closure:
    """The closure by the effects and pairs among which each fold chooses anew. Segments are dealt to folds in turn."""
    segments = len(weighing.observed)
    if segments < FEWEST or not choices:
        return NOT_RESOLVABLE
    residual, difference = [], []
    for fold in range(FOLDS):
        held = (np.arange(segments) % FOLDS == fold)[weighing.spectrum.segment]
        r, d = _fold(weighing, choices, held)
        residual.append(r)
        difference.append(d)
    return measured(np.concatenate(residual), np.concatenate(difference))


def measured(residual: Array, difference: Array) -> Closure:
    """The closure from whitened held-out residuals (m,) and the known difference of the predictions (m,)."""
    from scipy.special import chndtr

    size = float(np.linalg.norm(difference))
    m = len(residual)
    if size < 1e-9 or m < 3:
        return NOT_RESOLVABLE
    along = float(residual @ difference) / size
    rest = float(residual @ residual) - along**2
    draw = np.random.default_rng(SEED)
    parallel = along + draw.standard_normal(DRAWS)
    top = max(rest - m, 0.0) + 8 * np.sqrt(2 * m + 4 * max(rest - m, 0.0)) + 10
    grid = np.concatenate(([0.0], np.geomspace(1e-3, top, 400)))
    chance = 1 - chndtr(rest, m - 1, grid)
    across = np.interp(draw.uniform(size=DRAWS), np.maximum.accumulate(chance), grid)
    before = np.sqrt(parallel**2 + across)
    after = np.sqrt((parallel - size) ** 2 + across)
    shrink = 1 - after / np.maximum(before, 1e-9)
    low, middle, high = (float(value) for value in np.quantile(shrink, [0.05, 0.5, 0.95]))
    if high - low > WIDEST:
        return NOT_RESOLVABLE
    scale = np.sqrt(m)
    return Closure(float(np.median(before)) / scale, float(np.median(after)) / scale, middle, (low, high), True)


def _fold(weighing: Weighing, choices: Sequence[Weighed], held: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Whitened residual and difference of the predictions on held-out rows, all channels, with the effect that the other rows choose."""
    used = [_Rows(weighing, channel, ~held) for channel in range(len(weighing.weights))]
    best, amplitudes = None, np.zeros(0)
    highest = _WORTH
    for number, choice in enumerate(choices):
        columns = [rows.project(choice.raw[c][~held]) for c, rows in enumerate(used)]
        gram = np.sum([block.T @ block for block in columns], axis=0)
        score = np.sum([block.T @ rows.residual for block, rows in zip(columns, used, strict=True)], axis=0)
        trace = float(np.trace(gram))
        if trace <= 0:
            continue
        value = float(log_bayes_factors(gram[None], score[None], trace)[0])
        if value > highest:
            highest, best, (amplitudes, _) = value, number, best_amplitudes(gram, score, trace)
    residual, difference = [], []
    for c, rows in enumerate(used):
        signature = np.zeros(len(held)) if best is None else choices[best].raw[c] @ amplitudes
        r, d = rows.predict(signature, held)
        residual.append(r)
        difference.append(d)
    return np.concatenate(residual), np.concatenate(difference)


class _Rows:
    """One channel's chosen coefficients, whitened and freed of the nominal parameters."""

    def __init__(self, weighing: Weighing, channel: int, chosen: NDArray[np.bool_]):
        self.weight = weighing.weights[channel][0]
        self.values = weighing.spectrum.values[:, channel]
        self.nominal = weighing.nominal[channel]
        self.chosen = chosen
        self.whiten = self.weight.whitening(chosen)
        size = np.linalg.norm(self.nominal, axis=0)
        left, values, right = np.linalg.svd(self.whiten(self.nominal[chosen] / size), full_matrices=False)
        told = values > DEPENDENT * values.max(initial=0.0)
        self.basis = left[:, told]
        self.parameters = right[told].T / values[told] / size[:, None]
        self.untold = right[~told].T / size[:, None]
        self.residual = self.project(self.values[chosen])

    def project(self, columns: Array) -> Array:
        whitened = self.whiten(columns)
        return whitened - self.basis @ (self.basis.T @ whitened)

    def predict(self, signature: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Held-out residual without the effect, and what the effect changes in the prediction, both whitened.

        The nominal parameters are fitted to the chosen rows without and with the effect; their covariance adds to the held-out noise: with
        U its whitened root, (I + UUᵀ)^−½ acts in the span of U alone. What of them the chosen rows do not tell is projected out.
        """
        both = np.column_stack([self.values, signature])
        fitted = self.parameters @ (self.basis.T @ self.whiten(both[self.chosen]))
        whiten, nominal = self.weight.whitening(held), self.nominal[held]
        left = whiten(both[held] - nominal @ fitted)
        spread = whiten(nominal @ self.parameters)
        if self.untold.shape[1]:
            open_, _ = np.linalg.qr(whiten(nominal @ self.untold))
            left, spread = (part - open_ @ (open_.T @ part) for part in (left, spread))
        along, size, _ = np.linalg.svd(spread, full_matrices=False)
        left -= along @ ((1 - 1 / np.sqrt(1 + size**2))[:, None] * (along.T @ left))
        return left[:, 0], left[:, 1]
