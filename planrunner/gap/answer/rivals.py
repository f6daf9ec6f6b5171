"""Describes rival explanations after a diagnosis, and computes how well further measurements are expected to distinguish them.

Every explanation is a linear model that predicts further recordings. The model consists of the nominal parameters and of effects
with normally distributed amplitudes. The posterior from the recording is the prior for the next measurements. Therefore, if
explanation A is true, the expected log evidence of A against explanation B is the Kullback-Leibler divergence between their
predictions. This divergence is the criterion of Box and Hill (Technometrics 9, 1967): T-optimality (Atkinson and Fedorov,
Biometrika 62, 1975), averaged over the uncertainty of the amplitudes. Only the information matrix of the new measurements is
needed, so the computing time does not depend on the number of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column, Effect, Shaped
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.posterior import Posterior
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing, nominal_columns, simulated

_FLAT = 1e-9  # precision of an unknown parameter, relative to its information from the recording
_AT_ONCE = 4_000_000  # numbers in the matrices that are evaluated at a time; limits memory
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(21)


@dataclass(frozen=True)
class Rival:
    """Describes a rival explanation after a recording. `columns`: array of shape (p,), indices of the rival's columns among all
    columns. `mean` (p,) and `precision` (p, p) describe the posterior of the amplitudes of these columns."""

    name: str
    probability: float
    columns: NDArray[np.int64] = field(repr=False)
    mean: Array = field(repr=False)
    precision: Array = field(repr=False)

    @classmethod
    def learnt(
        cls, name: str, probability: float, columns: NDArray[np.int64], prior: Array, information: Array, score: Array
    ) -> Rival:
        """Returns the rival with the posterior of its amplitudes after a recording. `prior`: array of shape (p,), precision
        (inverse variance) of the amplitudes about zero before the recording. The precision is 0 for a nominal parameter.
        `information` (P, P) and `score` (P,): information matrix and score vector of the recording for all columns of all rivals,
        in units of the noise."""
        own = information[np.ix_(columns, columns)]
        precision = own + np.diag(prior + _FLAT * np.maximum(np.diag(own), 1.0))
        mean = np.asarray(np.linalg.solve(precision, score[columns]))
        return cls(name, probability, columns, mean, precision)


def expected_evidence(rivals: Sequence[Rival], information: Array) -> Array:
    """Returns the log evidence for rival i against rival j that measurements are expected to give if i is true, shape (…, R, R).
    `information`: information of the measurements, shape (…, P, P)."""
    size = information.shape[-1]
    covariance = [np.linalg.inv(rival.precision) for rival in rivals]
    found = np.zeros((*information.shape[:-2], len(rivals), len(rivals)))
    gained, left, spent = [], [], []
    for rival in rivals:
        own = rival.columns
        across = information[..., own, :]
        after = rival.precision + across[..., own]
        solved = np.linalg.solve(after, across)
        gained.append(np.linalg.slogdet(after)[1] - np.linalg.slogdet(rival.precision)[1])
        left.append(information - np.swapaxes(across, -1, -2) @ solved)
        spent.append(np.trace(solved[..., own], axis1=-2, axis2=-1))
    for i, a in enumerate(rivals):
        for j, b in enumerate(rivals):
            if i == j:
                continue
            apart = np.zeros(size)
            apart[a.columns] += a.mean
            apart[b.columns] -= b.mean
            rows, columns = np.ix_(a.columns, a.columns)
            unsure = np.sum(left[j][..., rows, columns] * covariance[i], axis=(-2, -1))
            found[..., i, j] = 0.5 * (left[j] @ apart @ apart + unsure - spent[j] + gained[j] - gained[i])
    return np.maximum(found, 0.0)


def expected_loss(rivals: Sequence[Rival], information: Array) -> Array:
    """Returns the expected loss after measurements, shape (…). The loss is −log of the probability of the true rival. The best
    measurements have the smallest expected loss. The information of the measurements has the shape (…, P, P)."""
    many = information.reshape(-1, *information.shape[-2:])
    at_once = max(1, _AT_ONCE // (len(rivals) * many[0].size)) if len(many) else 1
    parts = [
        _averaged(rivals, expected_evidence(rivals, many[first : first + at_once]), np.log1p)
        for first in range(0, len(many), at_once)
    ]
    return np.concatenate([*parts, np.zeros(0)]).reshape(information.shape[:-2])


def expected_probability(rivals: Sequence[Rival], information: Array) -> float:
    """Returns the expected posterior probability of the true rival after measurements. The information of these measurements has
    the shape (P, P).

    The log evidence is assumed to be normal with the expectation D of `expected_evidence` and the variance 2D, as for two known signals.
    """
    return float(_averaged(rivals, expected_evidence(rivals, information), lambda odds: 1 / (1 + odds)))


def _averaged(rivals: Sequence[Rival], evidence: Array, measure: Callable[[Array], Array]) -> Array:
    """Averages a function of the posterior odds against the true rival. The average covers the rivals and the random log evidence.
    `evidence`: array of shape (…, R, R), expected log evidence of each rival against each other rival. The result has the shape
    (…). `measure`: function that is averaged; its argument is the odds against the true rival."""
    share = np.array([rival.probability for rival in rivals])
    share = share / share.sum()
    total = np.zeros(evidence.shape[:-2])
    for i in range(len(rivals)):
        others = np.arange(len(rivals)) != i
        d = evidence[..., i, others][..., None]
        log = np.clip(d + np.sqrt(2 * d) * _NODES, -700.0, 700.0)
        odds = (share[others, None] / share[i] * np.exp(-log)).sum(-2)
        total += share[i] * (measure(odds) @ _WEIGHTS) / _WEIGHTS.sum()
    return total


MOST = 5  # maximum number of explanations
SILENT = ("none", "unknown")
"""Explanations that make no predictions."""
LEAST = 0.01  # smallest probability of an explanation


@dataclass(frozen=True)
class ExplanationPart:
    """Describes one effect of an explanation, in the form that fits the recording best. `prior`: prior variance of the amplitudes
    of the effect, in magnitudes²."""

    effect: Effect
    weighed: Weighed
    prior: float

    @property
    def key(self) -> tuple[str, float | None]:
        return self.effect.id, self.weighed.variant.shape

    def on(self, observed: Observed) -> Sequence[Column]:
        """Returns the columns of the effect for another recording. The result is empty if the effect cannot act in that
        recording."""
        shape = self.weighed.variant.shape
        if isinstance(self.effect, Shaped):
            return self.effect.at(observed, float(shape or 0.0)).columns
        return next((v.columns for v in self.effect.variants(observed) if v.shape == shape), ())


@dataclass(frozen=True)
class Explanation:
    name: str
    probability: float
    parts: tuple[ExplanationPart, ...]


def explanations(found: Posterior, candidates: Sequence[Candidate]) -> list[Explanation]:
    """Returns the most probable explanations that predict different recordings, at most `MOST`.

    Effects that act only on the noise predict nothing. Explanations that differ only in such effects therefore count as one
    explanation. "Unknown" and "none" also predict nothing, so they count as one explanation too; it has the name of the more
    probable of the two.
    """
    by_id = {c.id: c for c in candidates if np.isfinite(c.log_bayes).any()}
    silent = max(SILENT, key=lambda name: found.probability[name])
    total: dict[str, float] = {}
    for name, probability in found.probability.items():
        key = "+".join(part for part in name.split("+") if part in by_id) or silent
        total[key] = total.get(key, 0.0) + probability
    chosen = sorted((item for item in _simplest(total).items() if item[1] >= LEAST), key=lambda item: -item[1])[:MOST]
    return [Explanation(name, probability, _parts(name, found, by_id)) for name, probability in chosen]


def _simplest(total: Mapping[str, float]) -> dict[str, float]:
    """Adds the probability of a set of effects to the probability of one of its subsets, if the subset is more probable. The reason
    is that the other effects of the set may be absent."""
    found: dict[str, float] = {}
    for name, value in sorted(total.items(), key=lambda item: item[0].count("+")):
        parts = set(name.split("+"))
        likelier = [one for one in found if set(one.split("+")) < parts and total[one] > value]
        target = max(likelier, key=lambda one: total[one], default=name)
        found[target] = found.get(target, 0.0) + value
    return found


def _parts(name: str, found: Posterior, by_id: Mapping[str, Candidate]) -> tuple[ExplanationPart, ...]:
    if name in SILENT:
        return ()
    together = found.sets.get(name)
    if together is None:
        forms = {one: by_id[one].best for one in name.split("+")}
        return tuple(ExplanationPart(by_id[one].effect, form, _size(form, slice(None))) for one, form in forms.items())
    return tuple(
        ExplanationPart(member.candidate.effect, member.form, _size(together.weighed, together.columns(member.id)))
        for member in sorted(together.members, key=lambda member: member.id)
    )


def _size(weighed: Weighed, columns: slice) -> float:
    """Returns the mean square of the posterior amplitudes."""
    mean, covariance = weighed.amplitudes
    return float(np.mean(mean[columns] ** 2 + np.diag(covariance)[columns]))


@dataclass(frozen=True)
class Layout:
    """Describes the order of all columns of several explanations: first the columns of the nominal parameters, then those of the
    effects. Each effect is identified by its name and shape."""

    nominal: tuple[str, ...]
    parts: tuple[ExplanationPart, ...]
    names: tuple[tuple[str, ...], ...]
    coefficients: tuple[float, ...]

    @classmethod
    def of(cls, listed: Sequence[Explanation], weighing: Weighing, nominal: Sequence[str], whole: Observed) -> Layout:
        """Makes the layout of the listed explanations. `whole`: the recording followed by all segments that may be measured next;
        it determines which columns exist."""
        distinct = tuple({part.key: part for item in listed for part in item.parts}.values())
        names = tuple(tuple(column.name for column in part.on(whole)) for part in distinct)
        return cls(tuple(nominal), distinct, names, _fitted(weighing))

    @property
    def widths(self) -> list[int]:
        return [len(self.coefficients), *(len(names) for names in self.names)]

    def columns(self, observed: Observed) -> list[Sequence[Column]]:
        """Returns the groups of columns for a recording: nominal parameters first, then one group for each effect."""
        nominal = nominal_columns(observed, self.nominal)
        output = simulated(observed, self.nominal)
        for column, value in zip(nominal, self.coefficients, strict=True):
            for channel, part in column.parts.items():
                output[:, channel] += part * (column.magnitude * value)
        observed.__dict__["nominal_output"] = (
            output  # a dead zone or a limit acts on the output of the sensor, not of an ideal sensor
        )
        return [nominal, *(part.on(observed) for part in self.parts)]

    def learnt(self, listed: Sequence[Explanation], weighing: Weighing) -> tuple[list[Rival], Array]:
        """Returns the posterior of the explanations, and the information from the recording, shape (P, P)."""
        information, score = self._recorded(weighing)
        starts = np.concatenate(([0], np.cumsum(self.widths)))
        rivals = []
        for item in listed:
            columns, prior = [np.arange(self.widths[0])], [np.zeros(self.widths[0])]
            for part in item.parts:
                at = [other.key for other in self.parts].index(part.key) + 1
                columns.append(np.arange(starts[at], starts[at + 1]))
                prior.append(np.full(self.widths[at], 1 / part.prior))
            rivals.append(
                Rival.learnt(
                    item.name, item.probability, np.concatenate(columns), np.concatenate(prior), information, score
                )
            )
        return rivals, information

    def _recorded(self, weighing: Weighing) -> tuple[Array, Array]:
        """Returns the information matrix (P, P) and the score vector (P,) of the recording for all columns."""
        size = sum(self.widths)
        starts = np.concatenate(([0], np.cumsum(self.widths)))
        information, score = np.zeros((size, size)), np.zeros(size)
        for channel, weights in enumerate(weighing.weights):
            table = np.zeros((len(weighing.spectrum.segment), size))
            own = [c for c, column in enumerate(weighing.nominal_columns) if channel in column.parts]
            table[:, own] = weighing.whole[channel]
            for part, names, start in zip(self.parts, self.names, starts[1:], strict=False):
                known = [column.name for column in part.weighed.variant.columns]
                table[:, [start + names.index(name) for name in known]] = part.weighed.raw[channel]
            whitened = weights[0].whiten(table)
            information += whitened.T @ whitened
            score += whitened.T @ weights[0].whiten(weighing.spectrum.values[:, [channel]])[:, 0]
        return information, score


def _fitted(weighing: Weighing) -> tuple[float, ...]:
    """Returns the nominal parameters, in magnitudes, from an unweighted fit to the recording without effects."""
    values = np.zeros(len(weighing.nominal_columns))
    for channel, nominal in enumerate(weighing.whole):
        own = [c for c, column in enumerate(weighing.nominal_columns) if channel in column.parts]
        size = np.linalg.norm(nominal, axis=0) + 1e-300
        values[own] = np.linalg.lstsq(nominal / size, weighing.spectrum.values[:, channel], rcond=None)[0] / size
    return tuple(float(value) for value in values)
