"""The answerer that knows all but the draw: its Bayes factors by hand and by drawing directions, its probabilities by what came true."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.ceiling import LEVELS, WHOLE, Separable, log_bayes, reached
from tests.blind.generator import STRONGEST, WEAKEST

ENERGIES = WEAKEST * (STRONGEST / WEAKEST) ** ((np.arange(LEVELS) + 0.5) / LEVELS)


@pytest.mark.parametrize("radius", [0.3, 2.0, 9.0])
def test_one_and_three_parameters_by_hand(radius: float) -> None:
    """Two directions: cosh; a sphere: sinh(x)/x."""
    x = np.sqrt(ENERGIES) * radius
    grown = np.exp(x - ENERGIES / 2)
    one = np.mean(grown * (1 + np.exp(-2 * x)) / 2)
    three = np.mean(grown * (1 - np.exp(-2 * x)) / (2 * x))
    assert float(log_bayes(np.array(radius), 1)) == pytest.approx(np.log(one), abs=1e-9)
    assert float(log_bayes(np.array(radius), 3)) == pytest.approx(np.log(three), abs=1e-9)


def test_many_parameters_by_drawn_directions() -> None:
    draw = np.random.default_rng(2).standard_normal((200_000, 6))
    along = draw[:, 0] / np.linalg.norm(draw, axis=1) * 4.0
    weak = ENERGIES[ENERGIES < 400]
    drawn = [np.mean(np.exp(np.sqrt(energy) * along - energy / 2)) for energy in weak]
    assert float(log_bayes(np.array(4.0), 6)) == pytest.approx(np.log(np.sum(drawn) / LEVELS), abs=0.02)


def test_the_probabilities_come_true() -> None:
    """A truth has the probability that it is given: 95 % sets hold it so often or more."""
    rng = np.random.default_rng(5)
    plan = Separable([1, 3, 6, 2], [3, 2])
    cases = [plan.case(rng) for _ in range(400)]
    covered = np.mean([case[4] for case in cases])
    assert covered > 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(cases))
    p = plan.posterior(np.array([8.0, -1.0, -2.0, -1.0, -1.5, -1.0]))
    assert plan.hypotheses[int(np.argmax(p))] == (0,)
    assert p.sum() == pytest.approx(1.0)


def test_the_whole_catalogue_is_harder_than_a_part() -> None:
    whole, part = reached(WHOLE, 100, 3)["all"], reached(Separable([1] * 3, [1]), 100, 3)["all"]
    assert whole.brier > part.brier
    assert whole.size > part.size
