"""What nobody can surpass: an answerer that knows all but the draw, where every effect is seen apart from every other.

Each effect has a subspace of its own in which the recording shows θ + noise, the direction of θ isotropic and its energy λ log-uniform.
Real signatures overlap, so every plan is harder than this. The posterior is exact: the mean of exp(√λ·u·z − λ/2) over directions u in p
dimensions is Γ(p/2)·(2/x)^(p/2−1)·I_(p/2−1)(x)·exp(−λ/2) with x = √λ·|z| (Mardia and Jupp, Directional Statistics, 2000, section 9.3). The
composition is the campaign's, and of what is off the catalogue every kind is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import gammaln, ive, logsumexp

from tests.blind.effects import CATALOGUE, FOREIGN, Kind
from tests.blind.generator import COMPOSITION, STRONGEST, WEAKEST
from tests.blind.motion import Array

LEVELS = 120  # of λ
COVERED = 0.95
HIDDEN = ("table_rate_error", "gyro_bias_random_walk")  # absorbed; and no vector of parameters
WEAK = 36.0


@dataclass(frozen=True)
class Reached:
    """Over cases: the mean Brier score with its standard error, that of the likeliest hypothesis alone, (p − right)², and the mean size and
    the coverage of the 95 % set."""

    cases: int
    brier: float
    standard_error: float
    brier_of_the_likeliest: float
    size: float
    covered: float


@dataclass(frozen=True)
class Separable:
    """A plan under which effects of these numbers of parameters, of the catalogue and off it, have nothing in common."""

    catalogue: Sequence[int]
    foreign: Sequence[int]

    def sort(self, kind: str, rng: np.random.Generator) -> list[int]:
        """Effects of a case: their places among all."""
        own = len(self.catalogue)
        if kind == "unknown":
            return [own + int(rng.integers(len(self.foreign)))]
        return sorted(int(i) for i in rng.choice(own, {"none": 0, "single": 1, "pair": 2}[kind], replace=False))

    @cached_property
    def hypotheses(self) -> list[tuple[int, ...]]:
        """The places of their effects; all that is off the catalogue is one, and comes last."""
        own = range(len(self.catalogue))
        return [(), *((a,) for a in own), *combinations(own, 2), (len(own),)]

    def posterior(self, log_bayes: Array) -> Array:
        """Probabilities of the hypotheses."""
        own = len(self.catalogue)
        single, foreign = log_bayes[:own], log_bayes[own:]
        first, second = np.triu_indices(own, 1)
        logs = np.concatenate(
            [
                [np.log(COMPOSITION["none"])],
                np.log(COMPOSITION["single"] / own) + single,
                np.log(COMPOSITION["pair"] / len(first)) + single[first] + single[second],
                [np.log(COMPOSITION["unknown"] / len(foreign)) + logsumexp(foreign)],
            ]
        )
        return np.asarray(np.exp(logs - logsumexp(logs)))

    def case(self, rng: np.random.Generator) -> tuple[float, float, float, int, bool]:
        """Weakest λ (0 without an effect), Brier score, that of the likeliest, size of the 95 % set, whether it holds the truth."""
        kind = str(rng.choice(list(COMPOSITION), p=list(COMPOSITION.values())))
        true, sizes = self.sort(kind, rng), np.array([*self.catalogue, *self.foreign])
        energy = np.zeros(len(sizes))
        energy[true] = np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST), len(true)))
        radius = np.sqrt(rng.noncentral_chisquare(sizes, np.maximum(energy, 1e-12)))
        each = np.empty(len(sizes))
        for size in set(sizes):
            each[sizes == size] = log_bayes(radius[sizes == size], int(size))
        p = self.posterior(each)
        truth = (len(self.catalogue),) if kind == "unknown" else tuple(true)
        right = np.array([name == truth for name in self.hypotheses])
        ranked = np.argsort(-p)
        listed = int(np.searchsorted(np.cumsum(p[ranked]), COVERED)) + 1
        likeliest = float((p[ranked[0]] - right[ranked[0]]) ** 2)
        weakest = float(energy[true].min()) if true else 0.0
        return weakest, float(np.sum((p - right) ** 2)), likeliest, listed, bool(right[ranked[:listed]].any())


def log_bayes(radius: Array, parameters: int) -> Array:
    """Log Bayes factors against none of θ + noise that lies at |z| = `radius`."""
    grid = np.exp(np.log(WEAKEST) + np.log(STRONGEST / WEAKEST) * (np.arange(LEVELS) + 0.5) / LEVELS)
    x = np.sqrt(grid) * np.asarray(radius, float)[..., None]
    order = parameters / 2 - 1
    each = gammaln(parameters / 2) + order * np.log(2 / x) + np.log(ive(order, x) + 1e-300) + x - grid / 2
    return np.asarray(logsumexp(each, axis=-1) - np.log(LEVELS))


def dimensions(kinds: Sequence[Kind]) -> list[int]:
    return [len(kind.scale) for kind in kinds if kind.name not in HIDDEN]


WHOLE = Separable(dimensions(list(CATALOGUE.values())), dimensions(list(FOREIGN.values())))
"""As if one plan could show the whole catalogue."""


def reached(plan: Separable, cases: int, seed: int) -> dict[str, Reached]:
    """Of so many drawn cases: all, those without an effect, those whose weakest λ is below 36, and the rest."""
    rng = np.random.default_rng(seed)
    table = np.array([plan.case(rng) for _ in range(cases)], float)
    weakest = table[:, 0]
    groups = {
        "all": weakest >= 0,
        "none": weakest == 0,
        "weakest below 36": (weakest > 0) & (weakest < WEAK),
        "the rest": weakest >= WEAK,
    }
    return {name: _mean(table[rows]) for name, rows in groups.items()}


def _mean(rows: Array) -> Reached:
    error = float(rows[:, 1].std() / np.sqrt(len(rows)))
    return Reached(len(rows), float(rows[:, 1].mean()), error, *(float(v) for v in rows[:, 2:].mean(axis=0)))


def told(cases: int, seed: int) -> str:
    """What is reached under such a plan, and where only ten effects of one parameter, or two of three, could be there at all."""
    plans = {
        f"{len(WHOLE.catalogue)} effects of the catalogue": WHOLE,
        "10 effects of one parameter": Separable([1] * 10, [1] * 5),
        "2 effects of three parameters": Separable([3] * 2, [3]),
    }
    lines = [f"{cases} cases of the campaign's composition, every effect seen apart: Brier score, size of the 95 % set"]
    for name, plan in plans.items():
        for group, found in reached(plan, cases, seed).items():
            score = (
                f"{found.brier:.3f} ± {found.standard_error:.3f} (likeliest alone {found.brier_of_the_likeliest:.3f})"
            )
            lines.append(
                f"{name:32s} {group:15s} {found.cases:5d}  {score}  {found.size:.2f} covering {found.covered:.3f}"
            )
    return "\n".join(lines) + "\n"
