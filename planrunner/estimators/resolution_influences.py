"""Computes the influence of the resolution of outputs on coefficients.

Budgets list this influence, but do not add it to the uncertainty, because other contributions already include it. Noise that is
large enough to spread the samples over several counts is said to dither the counts. If the noise does not dither the counts, the
standard errors of the means include the rounding (see `observations`). If the noise dithers the counts, the scatter of the samples
includes the rounding errors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.estimators.interface import EstimateRequest
from planrunner.instruments.models import SensorModel
from planrunner.observation.observations import dithered
from planrunner.uncertainty.influences import Aspect, Influence


def resolution_influences(
    request: EstimateRequest[object], outputs: Sequence[str], functionals: Array
) -> tuple[Influence, ...]:
    """Returns one influence for each of the m outputs whose resolution is stated. `functionals`: array of shape (q, m, n),
    ∂coefficient/∂(mean of output k over segment n); derivatives with respect to observations that are not means are ignored.

    If the noise is too small to dither the counts, a mean has the rounding error of a single sample. Otherwise the rounding errors
    of its samples average out: the error decreases with the square root of the number of samples.
    """
    found = []
    for k, name in enumerate(outputs):
        quantity = request.setup.inputs.of_output(Aspect.RESOLUTION, name)
        if quantity is None:
            continue
        left = _left(request.segments, name, request.sensor)
        found.append(
            Influence(
                quantity, functionals[:, k, : len(left)] * left, True, tuple(one.label for one in request.segments)
            )
        )
    return tuple(found)


def _left(segments: Sequence[RecordedSegment], name: str, sensor: SensorModel) -> Array:
    """Returns the fraction of a single sample's rounding error that remains in the mean of each segment, shape (n,)."""
    held = [one.statistics for one in segments]
    places = [one.of(name) for one in held]
    counts = np.array([one.count for one in held])
    variances = np.array([one.covariance[place, place] for one, place in zip(held, places, strict=True)])
    scattered = (counts > 1) & dithered(sensor, name, variances)
    return np.where(scattered, 1 / np.sqrt(np.maximum(counts, 1)), 1.0)
