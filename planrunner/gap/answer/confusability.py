"""Confusability: which effects a plan can distinguish, before and after it is recorded.

ρ(A|B) is the fraction of the energy of effect A's projected, whitened signature that effect B reproduces with its own amplitudes.
If effect A is fitted with the energy λ, λ(1 − ρ) is the non-centrality of the test between A and B.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.gap.answer.sets import EffectSet
from planrunner.gap.hypotheses.candidates import Candidate, Weighed

DISCRIMINABLE = 10.0  # non-centrality below which two effects are not distinguished
ALIKE = 0.9  # share at and above which they form one class at any energy
_RIDGE = 1e-9


def fitted(weighed: Weighed) -> list[Array]:
    """The whitened, projected signature of an effect at its fitted amplitudes, (M,) for each channel."""
    return [block @ weighed.amplitudes[0] for block in weighed.by_channel]


def energy(signature: Sequence[Array]) -> float:
    return float(sum(part @ part for part in signature))


def reproduced(signature: Sequence[Array], rivals: Sequence[Weighed]) -> float:
    """The fraction of a signature's energy that the best of the `rivals` reproduces."""
    total = energy(signature)
    if total <= 0:
        return 0.0
    shares = []
    for rival in rivals:
        score = np.sum([block.T @ part for block, part in zip(rival.by_channel, signature, strict=True)], axis=0)
        gram = rival.gram[0] + _RIDGE * rival.trace / len(rival.gram[0]) * np.eye(len(rival.gram[0]))
        shares.append(float(score @ np.linalg.solve(gram, score)) / total)
    return min(1.0, max(shares, default=0.0))


def beside(together: EffectSet, name: str) -> float:
    """The fraction of an effect's fitted energy that lies in channels on which the other effects of the set do not act. An
    imperfect form of the other effects cannot leave residuals with this energy."""
    weighed, own = together.weighed, together.columns(name)
    amplitudes, _ = weighed.amplitudes
    others = np.ones(len(amplitudes), dtype=bool)
    others[own] = False
    energies = [float(((block[:, own] @ amplitudes[own]) ** 2).sum()) for block in weighed.by_channel]
    elsewhere = [part for part, raw in zip(energies, weighed.raw, strict=True) if not raw[:, others].any()]
    return sum(elsewhere) / sum(energies) if sum(energies) > 0 else 0.0


def shared(best: Sequence[Weighed]) -> Array:
    """The confusability ρ(A|B) before data are recorded, one row for each A. It is averaged over amplitudes from A's prior: ρ =
    tr(G_ab·G_bb⁻¹·G_ba)/tr(G_aa)."""
    bounds = np.concatenate(([0], np.cumsum([len(item.gram[0]) for item in best]))).astype(int)
    parts = [slice(low, high) for low, high in pairwise(bounds)]
    blocks = [np.hstack(channel) for channel in zip(*(item.by_channel for item in best), strict=True)]
    gram = np.sum([block.T @ block for block in blocks], axis=0)
    shares = np.empty((len(best), len(best)))
    for column, (b, part) in enumerate(zip(best, parts, strict=True)):
        own = b.gram[0] + _RIDGE * b.trace / len(b.gram[0]) * np.eye(len(b.gram[0]))
        taken = (np.linalg.solve(own, gram[part]) * gram[part]).sum(0)
        shares[:, column] = [taken[rows].sum() / a.trace for a, rows in zip(best, parts, strict=True)]
    return np.clip(shares, 0.0, 1.0)


def matrix(candidates: Sequence[Candidate]) -> tuple[list[str], Array]:
    """Names of all candidates that have a signature, and their ρ(A|B), each at its most probable shape; the matrix has one row for
    each A."""
    present = [candidate for candidate in candidates if np.isfinite(candidate.log_bayes).any()]
    return [c.id for c in present], shared([candidate.best for candidate in present])
