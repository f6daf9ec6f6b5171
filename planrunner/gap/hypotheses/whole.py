"""Effects that are fully determined by their shape: a lag, a delay, a dead zone, a limit.

Their evidence is computed like that of others, with an amplitude in addition to the shape; for a weak effect the two are redundant. If such
an effect is named, its shape is found exactly, with amplitude 1. If it acts on the output of the sensor, the nominal parameters are fitted
together with it: fitted without the effect they would absorb part of it and give a wrong output (Gauss–Newton in those parameters, a search
in the shape).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.error_model.effects.interface import Shaped, is_whole
from planrunner.error_model.observed import Observed
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing

Array = NDArray[np.float64]
_STEPS = 20
_ROUNDS = 15
_DROP = 0.5  # nats below the best: one standard deviation
_TOLD = 1.0  # nats that an effect of any shape must explain beyond none
_SPAN, _FORMS = 4.0, 17  # standard deviations either way, and values among them


def shape_alone(candidate: Candidate) -> Shaped | None:
    """The effect of a candidate that has a shape and no amplitude; None for all others."""
    effect = candidate.effect
    if isinstance(effect, Shaped) and any(is_whole(item.variant.columns) for item in candidate.variants):
        return effect
    return None


def forms(weighing: Weighing, effect: Shaped) -> list[tuple[Weighed, float]]:
    """Forms about the most probable shape, in even steps of its logarithm, and their probabilities; none if the search does not
    converge, or converges to no effect because the data require the opposite."""
    seen, found = weighing.observed, np.nan
    for _ in range(_STEPS):
        shape, sigma = _most_probable(weighing, effect, seen)
        if abs(np.log(shape / found)) < 0.05 * sigma:
            break
        found = shape
        (best,) = weighing.weigh([effect.at(seen, shape)])
        seen = replace(weighing.observed, fitted=weighing.fitted([raw[:, 0] for raw in best.raw]))
    else:
        return []
    near = shape * np.exp(sigma * np.linspace(-_SPAN, _SPAN, _FORMS))
    weighed = weighing.weigh([effect.at(seen, float(value)) for value in near])
    evidence = np.array([_evidence(weighing, item) for item in weighed])
    if evidence.max() < weighing.evidence(np.zeros(len(weighing.base))) + _TOLD:
        return []
    share = np.exp(evidence - evidence.max())
    return list(zip(weighed, (share / share.sum()).tolist(), strict=True))


def _evidence(weighing: Weighing, form: Weighed) -> float:
    """Log evidence of an amplitude of 1, relative to none, up to a constant."""
    return weighing.evidence(form.score[:, 0] - 0.5 * form.gram[:, 0, 0])


def _most_probable(weighing: Weighing, effect: Shaped, seen: Observed) -> tuple[float, float]:
    """The most probable shape and the standard deviation of its logarithm: on the grid, beyond it where the best is at its edge, then
    between the best and its neighbours until those are within a standard deviation. A shape that the data barely constrain is reported
    up to the edge of the grid."""
    known: dict[float, float] = {}
    new = np.log(effect.grid(seen))
    widest = float(np.ptp(new)) / (2 * _SPAN)
    for _ in range(_ROUNDS):
        weighed = weighing.weigh([effect.at(seen, float(np.exp(value))) for value in new])
        known |= {float(value): _evidence(weighing, item) for value, item in zip(new, weighed, strict=True)}
        place = np.array(sorted(known))
        evidence = np.array([known[value] for value in place])
        top = int(np.argmax(evidence))
        if top in (0, len(place) - 1):
            beyond, step = (place[0], place[0] - place[1]) if top == 0 else (place[-1], place[-1] - place[-2])
            new = beyond + step * np.arange(1, 4)
            continue
        if np.ptp(evidence[top - 1 : top + 2]) < _DROP:
            break
        new = np.concatenate([np.linspace(place[i], place[i + 1], 5)[1:-1] for i in (top - 1, top)])
    top = int(np.clip(top, 1, len(place) - 2))
    bend, slope, _ = np.polyfit(place[top - 1 : top + 2] - place[top], evidence[top - 1 : top + 2] - evidence[top], 2)
    reach = float(place[top + 1] - place[top - 1])
    sigma = float(1 / np.sqrt(-2 * bend)) if bend < 0 else reach
    best = float(np.clip(-slope / (2 * bend), -reach, reach)) if bend < 0 else 0.0
    return float(np.exp(place[top] + best)), min(sigma, widest)
