"""Monte Carlo draws of a flexure gyro's coefficients: fit and stated inputs → [U; V] → physical coefficients, vectorised."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model import flexure_gyro
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.uncertainty.influences import Influence
from planrunner.uncertainty.monte_carlo import Draws, influence_draws, t_draws

Array = NDArray[np.float64]


def physical_draws(fit: OutputsFit, basis: str, factors: Array, stated: Sequence[Influence]) -> Draws:
    """Draws of the physical coefficients, then of U0 …, V0 …, each divided by its factor (q,).

    stated: influences on SI [U; V]. The fit's part is Student's t with the degrees of freedom of the variances that it rests on: one
    for both outputs where they are pooled, else each output's own.
    """
    m, p = fit.coefficients.shape
    freedom = np.repeat(fit.degrees_of_freedom(np.eye(m * p)[::p], basis), p)
    pooled = basis == "residual" and fit.pooled
    scatter = t_draws(
        fit.covariance(basis), freedom, [0 if pooled else output for output in range(m) for _ in range(p)]
    )
    inputs = influence_draws(stated, m * p)
    centre = fit.coefficients.reshape(-1, 1)

    def draw(rng: np.random.Generator, n: int) -> Array:
        outputs = centre + scatter(rng, n) + inputs(rng, n)
        physical = flexure_gyro.physical_coefficients(outputs.reshape(m, p, n))
        return np.concatenate([physical, outputs]) / factors[:, None]

    return draw
