"""The form of a gap whose cause the catalogue does not contain: the channels that show it, the factor that it follows, and its
fraction of the whole gap.

The patterns of `hypotheses.open_set` compete with the effects of the catalogue. The most probable of them determines the factor
that the gap follows. The residuals of the simulation give the form of the gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.documents import JsonObject
from planrunner.gap.answer.posterior import Posterior
from planrunner.gap.answer.where import state_labels
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import Factor, Sort, sorts

SEEN = 3.0
"""Log Bayes factor from which a channel shows the pattern."""


@dataclass(frozen=True)
class FormPoint:
    """Offsets of the channels at one level of the factor, and their standard uncertainties due to noise, in the units of the
    channels."""

    level: str
    values: tuple[float, ...]
    uncertainties: tuple[float, ...]


@dataclass(frozen=True)
class UnknownForm:
    """The form of an unknown cause.

    `pattern`: name of the pattern in words. `factor`: the factor that the gap follows. `channels`, `units`: channels that show the
    gap, and their units. `share`: fraction of the gap's energy in all channels; None for noise and tones, which lie outside the
    coefficients. `points`: offsets at each level if the pattern consists of offsets; otherwise empty.
    """

    pattern: str
    factor: Factor
    channels: tuple[str, ...]
    units: tuple[str, ...]
    share: float | None
    points: tuple[FormPoint, ...]

    def to_json(self) -> JsonObject:
        """JSON data according to `unknown_form` of `schemas/diagnosis.schema.json`."""
        return {
            "pattern": self.pattern,
            "factor": self.factor.value,
            "channels": list(self.channels),
            "units": list(self.units),
            "share": self.share,
            "points": [
                {"level": one.level, "values": list(one.values), "standard_uncertainties": list(one.uncertainties)}
                for one in self.points
            ],
        }


def unknown_form(weighing: Weighing, found: Posterior) -> UnknownForm | None:
    """The form of the most probable pattern outside the catalogue; None if no channel shows a pattern."""
    usual = [pattern for pattern, value in found.kinds.items() if np.isfinite(value) and pattern in found.by_channel]
    if not usual:
        return None
    best = max(usual, key=lambda pattern: found.kinds[pattern])
    seen = [index for index, value in enumerate(found.by_channel[best]) if value > SEEN]
    if not seen:
        return None
    rows = sorts(weighing).get(best.sort)
    share: float | None = None
    points: tuple[FormPoint, ...] = ()
    if best.sort is Sort.MEANS:
        labels = _labels(weighing, best.factor)
        share, points = _of_levels(weighing, labels, seen), _points(weighing, labels, seen)
    elif rows is not None:
        share = _share(weighing, sum(_excess(weighing, index, rows) for index in seen))
    channels = [weighing.observed.channels[index] for index in seen]
    return UnknownForm(
        best.name, best.factor, tuple(c.name for c in channels), tuple(c.unit for c in channels), share, points
    )


def _labels(weighing: Weighing, factor: Factor) -> list[str]:
    """The level of the factor in each segment, as text. For a factor without common levels, each segment has its own level."""
    observed = weighing.observed
    if factor is Factor.TEMPERATURE:
        middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
        return [f"{value:.0f} degC" for value in observed.temperature[middles]]
    return state_labels(observed).get(factor) or list(observed.labels)


def _excess(weighing: Weighing, index: int, rows: NDArray[np.bool_]) -> float:
    """Energy of the selected coefficients (`rows`) of a channel, minus the energy that noise alone would have."""
    residual = weighing.weights[index][0].residual[rows]
    return float(residual @ residual) - len(residual)


def _share(weighing: Weighing, part: float) -> float:
    """Converts a part of the gap's energy to a fraction of the total energy, limited to 0 … 1."""
    every = np.ones(len(weighing.spectrum.segment), dtype=bool)
    whole = sum(_excess(weighing, index, every) for index in range(len(weighing.weights)))
    return float(np.clip(part / max(whole, 1e-300), 0.0, 1.0))


def _of_levels(weighing: Weighing, labels: Sequence[str], seen: Sequence[int]) -> float:
    """The fraction of the gap's energy that a constant offset at each level of the factor explains."""
    _, which = np.unique(np.array(labels), return_inverse=True)
    count = np.bincount(which)
    total = 0.0
    for index in seen:
        means = weighing.weights[index][0].residual[weighing.spectrum.means]
        total += float((np.bincount(which, means) ** 2 / count).sum()) - len(count)
    return _share(weighing, total)


def _points(weighing: Weighing, labels: Sequence[str], seen: Sequence[int]) -> tuple[FormPoint, ...]:
    """The mean offset at each level, weighted by the noise of the segments, in the order of the recording."""
    order = list(dict.fromkeys(labels))
    which = np.array([order.index(label) for label in labels])
    values, uncertainties = [], []
    for index in seen:
        weight, spectrum = weighing.weights[index][0], weighing.spectrum
        factor = weighing.observed.channels[index].factor
        root = np.sqrt(weighing.observed.counts)
        sigma = np.sqrt(np.diag(weight.covariance(spectrum.frequency == 0))) / root / factor
        weights = np.bincount(which, 1 / sigma**2)
        values.append(np.bincount(which, weight.residual[spectrum.means] / sigma) / weights)
        uncertainties.append(1 / np.sqrt(weights))
    return tuple(
        FormPoint(label, tuple(float(v[k]) for v in values), tuple(float(u[k]) for u in uncertainties))
        for k, label in enumerate(order)
    )
