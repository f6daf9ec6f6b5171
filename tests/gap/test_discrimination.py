"""Expected evidence between rivals, against the divergence of the predictions worked out sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.gap.answer.next import Rival, expected_evidence, expected_loss, expected_probability


def _made(seed: int) -> tuple[list[Rival], np.ndarray, np.ndarray]:
    """Three rivals over two shared and five own columns after forty samples; twelve samples that are to come."""
    draw = np.random.default_rng(seed)
    recorded, further = draw.normal(size=(40, 7)), draw.normal(size=(12, 7))
    values = recorded[:, :3] @ [1.0, -2.0, 0.8] + draw.normal(size=40)
    information, score = recorded.T @ recorded, recorded.T @ values
    columns = ([0, 1, 2], [0, 1, 3, 4], [0, 1, 5, 6])
    rivals = [
        Rival.learnt(f"r{i}", p, np.array(c), np.array([0.0, 0.0] + [2.0] * (len(c) - 2)), information, score)
        for i, (c, p) in enumerate(zip(columns, (0.5, 0.3, 0.2), strict=True))
    ]
    return rivals, further, recorded


def test_the_evidence_is_the_divergence_of_the_predictions() -> None:
    rivals, further, _ = _made(3)
    found = expected_evidence(rivals, further.T @ further)
    for i, a in enumerate(rivals):
        for j, b in enumerate(rivals):
            if i == j:
                continue
            # Two normal distributions of the twelve samples: mean and covariance of each, and their divergence as a textbook has it.
            mean = [further[:, r.columns] @ r.mean for r in (a, b)]
            spread = [
                np.eye(12) + further[:, r.columns] @ np.linalg.inv(r.precision) @ further[:, r.columns].T
                for r in (a, b)
            ]
            inverse = np.linalg.inv(spread[1])
            apart = mean[1] - mean[0]
            log = np.linalg.slogdet(spread[1])[1] - np.linalg.slogdet(spread[0])[1]
            divergence = 0.5 * (np.trace(inverse @ spread[0]) + apart @ inverse @ apart - 12 + log)
            assert found[i, j] == pytest.approx(divergence, rel=1e-6)


def test_what_was_learnt_is_the_ridge_solution() -> None:
    rivals, _, recorded = _made(4)
    own = recorded[:, [0, 1, 3, 4]]
    draw = np.random.default_rng(4)
    draw.normal(size=(40, 7)), draw.normal(size=(12, 7))
    values = recorded[:, :3] @ [1.0, -2.0, 0.8] + draw.normal(size=40)
    expected = np.linalg.solve(own.T @ own + np.diag([0, 0, 2, 2]), own.T @ values)
    assert rivals[1].mean == pytest.approx(expected, rel=1e-5)


def test_nothing_measured_changes_nothing() -> None:
    rivals, further, _ = _made(5)
    nothing = np.zeros((7, 7))
    assert expected_evidence(rivals, nothing) == pytest.approx(np.zeros((3, 3)), abs=1e-9)
    assert expected_probability(rivals, nothing) == pytest.approx(0.5**2 + 0.3**2 + 0.2**2)
    much = 100 * further.T @ further
    assert expected_loss(rivals, much) < 0.1 * expected_loss(rivals, nothing)
    assert expected_probability(rivals, much) > 0.9


def test_between_two_known_signals_the_expected_probability_is_that_of_draws() -> None:
    size, share = 1.7, 0.3
    one = Rival("one", share, np.array([0]), np.array([size]), np.array([[1e12]]))
    none = Rival("none", 1 - share, np.array([], dtype=int), np.zeros(0), np.zeros((0, 0)))
    draw = np.random.default_rng(6)
    samples = draw.normal(size=200_000)
    log = size * samples + size**2 / 2  # log likelihood ratio where the signal is there
    right = 1 / (1 + (1 - share) / share * np.exp(-log))
    log_none = -(size * samples - size**2 / 2)
    right_none = 1 / (1 + share / (1 - share) * np.exp(-log_none))
    expected = share * right.mean() + (1 - share) * right_none.mean()
    assert expected_probability([one, none], np.eye(1)) == pytest.approx(expected, abs=2e-3)
