"""What a user would reach for instead: regression on the same signatures, with no prior, no open set and no word for "cannot tell".

Each takes the catalogue's columns (of each effect the shape that fits best), the declared noise, and the nominal parameters projected
out, and names the effects that it keeps: forward selection by BIC on raw samples (white noise assumed); the same with slow noise
whitened; LassoCV (scikit-learn); sequentially thresholded least squares as in SINDy (Brunton, Proctor and Kutz, PNAS 113 (2016) 3932).
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import Any

import numpy as np

from tests.blind.effects import FOREIGN
from tests.blind.folder import Shown
from tests.blind.generator import SEEN
from tests.blind.library import Block, Weighed, library
from tests.blind.motion import Array

MOST = 4  # effects that forward selection may take up
COUNTS = 0.10  # share of what is explained from which on a kept effect is named
ROWS = 6000  # samples that LassoCV sees
THRESHOLD = 0.1  # of the largest coefficient in units of its own energy: smaller ones are dropped


class Regression:
    """One case as a linear regression: residual, and per effect the columns of the shape that fits best."""

    def __init__(self, shown: Shown, flicker: bool):
        self.library = library(shown.plan, shown.sensor.name)
        self.weighed: Weighed = self.library.weighed((1.0, 1.0)[: len(shown.sensor.triads)], flicker)
        self.residual = self.weighed.residual(shown.outputs)
        self.products = self.weighed.products(self.residual)
        self.gram = self.weighed.gram
        self.blocks = self._best()

    def explained(self, rows: Array) -> float:
        """Energy that the columns of these rows explain together."""
        gram, h = self.gram[np.ix_(rows, rows)], self.products[rows]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        return float(
            (h / scale) @ np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-7, hermitian=True) @ (h / scale)
        )

    def _best(self) -> dict[str, Block]:
        found: dict[str, tuple[float, Block]] = {}
        for block in self.library.blocks:
            off = block.effect in FOREIGN or block.effect == "gyro_bias_random_walk"
            if off or self.weighed.kept(block) < SEEN:
                continue
            value = self.explained(rows_of(block))
            if block.effect not in found or value > found[block.effect][0]:
                found[block.effect] = value, block
        return {name: block for name, (_, block) in found.items()}

    def shares(self, rows: Array, coefficients: Array) -> dict[str, float]:
        """Of the kept coefficients, the energy of each effect's part, relative to the largest."""
        energy = {}
        for name, block in self.blocks.items():
            mine = np.isin(rows, rows_of(block))
            part = coefficients[mine]
            own = rows[mine]
            energy[name] = float(part @ self.gram[np.ix_(own, own)] @ part)
        top = max(energy.values(), default=0.0)
        return {name: value / top for name, value in energy.items() if value > 0} if top > 0 else {}

    @property
    def rows(self) -> Array:
        return np.concatenate([rows_of(block) for block in self.blocks.values()])


def rows_of(block: Block) -> Array:
    return np.arange(block.rows.start, block.rows.stop)


def named(effects: list[str]) -> dict[str, Any]:
    """An answer without probabilities."""
    kind = {0: "none", 1: "effect"}.get(len(effects), "pair")
    return {"verdict": {"kind": kind, "effects": sorted(effects), "class": []}}


def _forward(case: Regression, penalty: float, raw: bool) -> list[str]:
    """Adds the effect that lowers the criterion most until none does."""
    chosen: list[str] = []
    total, n = float(np.sum(case.residual**2)), case.residual.size

    def criterion(names: list[str]) -> float:
        rows = np.concatenate([rows_of(case.blocks[name]) for name in names]) if names else np.zeros(0, int)
        left = total - (case.explained(rows) if names else 0.0)
        return (n * np.log(left / n) if raw else left) + penalty * len(rows)

    while len(chosen) < MOST:
        rest = [name for name in case.blocks if name not in chosen]
        values = {name: criterion([*chosen, name]) for name in rest}
        best = min(values, key=values.__getitem__, default=None)
        if best is None or values[best] >= criterion(chosen):
            break
        chosen.append(best)
    return chosen


def stepwise_bic(shown: Shown) -> dict[str, Any]:
    """Forward selection by BIC, every sample taken as independent."""
    case = Regression(shown, flicker=False)
    return named(_forward(case, float(np.log(case.residual.size)), raw=True))


def whitened_bic(shown: Shown) -> dict[str, Any]:
    """Forward selection by BIC on data whitened by the declared noise, a segment and channel counted as one observation."""
    case = Regression(shown, flicker=True)
    return named(_forward(case, float(np.log(len(shown.segments) * case.residual.shape[1])), raw=False))


@lru_cache(maxsize=2)
def _cleared(plan: str, sensor: str, step: int) -> Array:
    """All columns of a library with the nominal parameters taken out, every so many samples: shape (p, rows)."""
    known = library(plan, sensor)
    weighed = known.weighed((1.0, 1.0)[: len(known.around.sensor.triads)], flicker=False)
    return np.array([weighed.residual(column.T.astype(float))[::step].ravel() for column in known.columns])


def lasso(shown: Shown) -> dict[str, Any]:
    """LassoCV over all columns; an effect counts when its part is at least a tenth of the largest."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import LassoCV

    case = Regression(shown, flicker=False)
    rows, step = (
        case.rows,
        max(1, case.residual.size // ROWS),
    )  # whole samples are left out, so that every channel counts
    cleared = _cleared(shown.plan, shown.sensor.name, step)[rows].T
    scale = np.maximum(np.sqrt((cleared**2).mean(axis=0)), 1e-30)
    model = LassoCV(cv=5, fit_intercept=False, alphas=40, max_iter=3000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # at the smallest penalties, which are not chosen then
        model.fit(cleared / scale, case.residual[::step].ravel())
    shares = case.shares(rows, model.coef_ / scale)
    return named([name for name, share in shares.items() if share >= COUNTS])


def stlsq(shown: Shown) -> dict[str, Any]:
    """Least squares, small coefficients dropped, again, until none is small."""
    case = Regression(shown, flicker=False)
    rows = case.rows
    scale = np.sqrt(np.maximum(np.diag(case.gram)[rows], 1e-300))
    gram, h = case.gram[np.ix_(rows, rows)] / np.outer(scale, scale), case.products[rows] / scale
    active = np.ones(len(rows), bool)
    coefficients = np.zeros(len(rows))
    for _ in range(20):
        coefficients[:] = 0
        on = np.flatnonzero(active)
        coefficients[on] = np.linalg.lstsq(gram[np.ix_(on, on)] + 1e-6 * np.eye(len(on)), h[on], rcond=None)[0]
        small = active & (np.abs(coefficients) < THRESHOLD * np.abs(coefficients).max())
        if not small.any():
            break
        active &= ~small
    shares = case.shares(rows, coefficients / scale)
    return named([name for name, share in shares.items() if share >= COUNTS])
