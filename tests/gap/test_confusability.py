"""Shares that one signature has in another, by hand."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from planrunner.error_model.effects.interface import Column
from planrunner.gap.answer.verdict import energy, fitted, reproduced, shared
from planrunner.gap.evidence.weighing import ChannelWeights
from planrunner.gap.hypotheses.candidates import Reduced, Weighed


class Unit:
    """Weights of independent noise with a variance of one, without nominal parameters."""

    segment = np.zeros(3, dtype=np.int64)

    def project(self, columns: np.ndarray) -> np.ndarray:
        return columns


def _weighed(columns: np.ndarray, data: np.ndarray) -> Weighed:
    gram = columns.T @ columns
    reduced = Reduced(tuple(Column("a", "1", 1.0, 1.0, {0: own}, axis=None) for own in columns.T))
    weights = cast(list[ChannelWeights], [Unit()])
    return Weighed(reduced, gram[None], (columns.T @ data)[None], float(np.trace(gram)), 1.0, weights)


def test_shares_by_hand() -> None:
    """a along x; b along (1, 1): cos² 45° = ½. c spans x and y and holds both."""
    data = np.array([100.0, 0.0, 0.0])
    a = _weighed(np.array([[10.0], [0.0], [0.0]]), data)
    b = _weighed(np.array([[3.0], [3.0], [0.0]]), data)
    c = _weighed(np.array([[1.0, 0.0], [0.0, 7.0], [0.0, 0.0]]), data)
    signature = fitted(a)
    assert energy(signature) == pytest.approx(1e4, rel=1e-3)
    assert reproduced(signature, [b]) == pytest.approx(0.5)
    assert reproduced(signature, [b, c]) == pytest.approx(1.0)
    assert shared([a, b, c]) == pytest.approx(np.array([[1, 0.5, 1], [0.5, 1, 1], [1 / 50, 0.5, 1]]))
