"""How coefficients of a linear model follow what is stated of site and table: latitude, gravity, azimuth and rates.

With A the matrix at the stated site, β the coefficients and G = (AᵀWA)⁻¹·AᵀW, an input stated wrong by δ moves the coefficients by
−G·(∂A/∂input)·β·δ, because the data were made with the right one. Only the azimuth moves the table itself, and them by +.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.rate_influences import rate_part
from planrunner.estimators.turned_segments import UP, turned
from planrunner.physics.earth import Site
from planrunner.physics.stimulus import Stimulus, segment_means
from planrunner.physics.terms import ErrorModel
from planrunner.plan.schedule import Segment, Spin
from planrunner.uncertainty.influences import Influence, Inputs

Array = NDArray[np.float64]

_STEP = 1e-5  # rad, or relative: of central differences, whose error is of the order of its square


def mean_stimulus(segments: Sequence[Segment], site: Site) -> Stimulus:
    """What was felt on average, spins over whole turns: at which angle recording begins in a spin is not known."""
    return segment_means(segments, site, [None if isinstance(one.motion, Spin) else one.dwell for one in segments])


def stated_influences(
    model: ErrorModel,
    segments: Sequence[Segment],
    site: Site,
    inputs: Inputs,
    coefficients: Array,
    gains: Array,
) -> tuple[Influence, ...]:
    """Influences on all coefficients, output after output, in SI columns and the outputs' units.

    coefficients: (m, p) of m outputs; gains: (m, p, n), coefficients from observations. The table's position acts on each observation in
    its own way and stands in `observation_effects`.
    """

    def columns(changed: Sequence[Segment], where: Site) -> Array:
        return model.columns(mean_stimulus(changed, where))

    def slope(low: Array, high: Array) -> Array:
        """Change of the observations, (m, n), per unit of the input."""
        return np.asarray(((high - low) / (2 * _STEP) @ coefficients.T).T)

    def moved(change: Array) -> Array:
        return np.einsum("mpn,mn->mp", gains, change).reshape(-1, 1)

    found = []
    if latitude := inputs.get("latitude"):
        sites = [replace(site, latitude=site.latitude + step) for step in (-_STEP, _STEP)]
        change = slope(*(columns(segments, one) for one in sites))
        found.append(Influence(latitude, -moved(change)))
    if gravity := inputs.get("gravity"):
        sites = [replace(site, gravity=site.gravity * (1 + step)) for step in (-_STEP, _STEP)]
        change = slope(*(columns(segments, one) for one in sites)) / site.gravity
        found.append(Influence(gravity, -moved(change)))
    if azimuth := inputs.get("azimuth"):
        change = slope(*(columns(turned(segments, UP, step), site) for step in (-_STEP, _STEP)))
        found.append(Influence(azimuth, moved(change)))
    if (rate := inputs.get("table rate")) and any(isinstance(one.motion, Spin) for one in segments):
        change = slope(*(columns(_hastened(segments, 1 + step), site) for step in (-_STEP, _STEP)))
        each = -np.einsum("mpn,mn->mpn", gains, change).reshape(-1, len(segments))
        rates = tuple(rate_part(one.rate) for one in segments if isinstance(one.motion, Spin))
        spun = np.array([isinstance(one.motion, Spin) for one in segments])
        found.append(_by_part(Influence(rate, each[:, spun], parts=rates)))
    return tuple(found)


def _by_part(influence: Influence) -> Influence:
    """One column for each name: segments at the same orientation, or the same rate, share the table's error there."""
    names = tuple(dict.fromkeys(influence.parts))
    of = np.array([names.index(name) for name in influence.parts])
    sums = np.stack([influence.sensitivities[:, of == k].sum(axis=1) for k in range(len(names))], axis=1)
    return replace(influence, sensitivities=sums, parts=names)


def _hastened(segments: Sequence[Segment], factor: float) -> list[Segment]:
    return [
        replace(one, motion=replace(one.motion, rate=one.motion.rate * factor)) if isinstance(one.motion, Spin) else one
        for one in segments
    ]
