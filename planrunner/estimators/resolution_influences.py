"""How coefficients follow the resolution of the outputs that they come from.

Listed in budgets and never added: rounding that noise does not dither is in the standard errors of the means (see `observations`), and
rounding that it does dither is in the scatter of the samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.uncertainty.influences import Influence, Inputs

Array = NDArray[np.float64]


def resolution_influences(
    inputs: Inputs, outputs: Sequence[str], recorded: Sequence[RecordedSegment], functionals: Array
) -> tuple[Influence, ...]:
    """One for each of the m outputs with a stated resolution. functionals: (q, m, n), ∂coefficient/∂(mean of output k over segment n).

    A mean is rounded as a whole count where the noise is too small to dither it, else by the average over its samples.
    """
    found = []
    for k, name in enumerate(outputs):
        quantity = inputs.get(f"resolution {name}")
        if quantity is None:
            continue
        count = quantity.standard_uncertainty * np.sqrt(12)
        left = [_left(one, name, count) for one in recorded]
        found.append(Influence(quantity, functionals[:, k] * left, True, tuple(one.label for one in recorded)))
    return tuple(found)


def _left(recorded: RecordedSegment, name: str, count: float) -> float:
    """The share of a count's rounding that is left in the mean."""
    statistics = recorded.statistics
    place = statistics.of(name)
    dithered = statistics.count > 1 and statistics.covariance[place, place] > (count / 2) ** 2
    return 1 / float(np.sqrt(statistics.count)) if dithered else 1.0
