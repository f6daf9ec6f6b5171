"""How coefficients of a linear model follow what is stated of the site: latitude and gravity.

With A the matrix at the stated site, β the coefficients and G = (AᵀWA)⁻¹·AᵀW, an input stated wrong by δ moves the coefficients by
−G·(∂A/∂input)·β·δ, because the data were made with the right one. Both change what terms are worth: segments do not scatter for them, as
they do for what the table has wrong (`table_errors`), so that they are added to whatever the data show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.terms import ErrorModel
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import Poses, Stimulus
from planrunner.plan.schedule import Segment, Spin
from planrunner.uncertainty.influences import Influence, Inputs

Array = NDArray[np.float64]

_STEP = 1e-5  # rad, or relative: of central differences, whose error is of the order of its square


def mean_poses(segments: Sequence[Segment]) -> Poses:
    """How the segments stand, spins over whole turns: at which angle recording begins in a spin is not known."""
    return Poses.of(segments, [None if isinstance(one.motion, Spin) else one.dwell for one in segments])


def mean_stimulus(segments: Sequence[Segment], site: Site) -> Stimulus:
    """What was felt on average, spins over whole turns."""
    return mean_poses(segments).felt(site)


def stated_influences(
    model: ErrorModel,
    segments: Sequence[Segment],
    site: Site,
    inputs: Inputs,
    coefficients: Array,
    gains: Array,
) -> tuple[Influence, ...]:
    """Influences on all coefficients, output after output, in SI columns and the outputs' units.

    coefficients: (m, p) of m outputs; gains: (m, p, n), coefficients from observations.
    """

    def answer(low: Site, high: Site) -> Array:
        """Of all coefficients, (m·p, 1), to a step either way."""
        change = model.columns(poses.felt(high)) - model.columns(poses.felt(low))
        sensitivities: Array = -np.einsum("mpn,nq,mq->mp", gains, change / (2 * _STEP), coefficients).reshape(-1, 1)
        return sensitivities

    poses = mean_poses(segments)
    found = []
    if latitude := inputs.get("latitude"):
        low, high = (replace(site, latitude=site.latitude + step) for step in (-_STEP, _STEP))
        found.append(Influence(latitude, answer(low, high)))
    if gravity := inputs.get("gravity"):
        low, high = (replace(site, gravity=site.gravity * (1 + step)) for step in (-_STEP, _STEP))
        found.append(Influence(gravity, answer(low, high) / site.gravity))
    return tuple(found)
