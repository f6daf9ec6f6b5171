"""How what is fitted over rates follows an error that all of the table's rates share.

Every coefficient answers to the means by a linear functional. A rate that is really (1 + δ) times the commanded one moves its mean by
K·ω·δ, which the functional carries into the coefficient. A plan states what all rates share, such as the error of the table's clock or
encoder: it changes the slope and leaves no scatter. How well each rate is held on its own does (`table_effects`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.uncertainty.influences import Influence, InputQuantity

Array = NDArray[np.float64]


def rate_part(rate: float) -> str:
    """Name of the error of one commanded rate [rad/s], so that it is known for the same wherever it acts."""
    return f"{np.degrees(rate):.9g} deg/s"


def all_rates(quantity: InputQuantity, functionals: Array, slopes: Array, rates: Array) -> Influence:
    """functionals: (q, m, n), ∂coefficient/∂(mean of output k over segment n); slopes: (m,), output unit per rad/s; rates: (n,), rad/s."""
    return Influence(quantity, -np.einsum("qmn,m,n->q", functionals, slopes, rates)[:, None])
