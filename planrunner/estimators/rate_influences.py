"""How what is fitted over rates follows the table's rate.

Every coefficient answers to the means by a linear functional. A rate that is really (1 + δ) times the commanded one moves its mean by
K·ω·δ, which the functional carries into the coefficient. A bench states how well each rate is held: errors that differ from rate to
rate. A plan states what all rates share, such as the error of the table's clock or encoder.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.uncertainty.influences import Influence, InputQuantity

Array = NDArray[np.float64]


def rate_part(rate: float) -> str:
    """Name of the error of one commanded rate [rad/s], so that it is known for the same wherever it acts."""
    return f"{np.degrees(rate):.9g} deg/s"


def each_rate(quantity: InputQuantity, functionals: Array, slopes: Array, rates: Array) -> Influence:
    """A relative error of each commanded rate, the same whenever that rate comes again.

    functionals: (q, m, n), ∂coefficient/∂(mean of output k over segment n); slopes: (m,), output unit per rad/s; rates: (n,), rad/s. It is
    added on either basis: such errors grow with the rate, and what the scatter about a line says of the largest rates, which
    decide on the slope, is the average over all of them.
    """
    carried = -np.einsum("qmn,m,n->qn", functionals, slopes, rates)
    different = np.unique(rates[rates != 0])
    columns = [carried[:, rates == rate].sum(axis=1) for rate in different]
    parts = tuple(map(rate_part, different))
    return Influence(quantity, np.array(columns).reshape(len(different), len(functionals)).T, parts=parts)


def all_rates(quantity: InputQuantity, functionals: Array, slopes: Array, rates: Array) -> Influence:
    """A relative error that all rates share; arguments as for `each_rate`."""
    return Influence(quantity, -np.einsum("qmn,m,n->q", functionals, slopes, rates)[:, None])
