"""Attribution to device, bench and occasion, against textbook figures and a second formula."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from planrunner.gap.fleet.attribution import Estimates, Source, attribute, components, log_evidence

LOOMS = np.array([[98, 97, 99, 96], [91, 90, 93, 92], [96, 95, 97, 95], [95, 96, 99, 98]], dtype=float)
"""Strength of fabric from four looms, lb/in² (Montgomery, Design and Analysis of Experiments, 6th edition, example 13-1)."""


def _fleet(benches, devices, values, spread, occasions=None) -> Estimates:
    values = np.asarray(values, dtype=float)
    groups = {
        Source.BENCH: list(benches),
        Source.DEVICE: list(devices),
        Source.OCCASION: list(occasions or map(str, range(len(values)))),
    }
    return Estimates(values, np.full(len(values), float(spread)), groups)


def _looms(spread: float) -> Estimates:
    return _fleet("w" * 16, np.repeat(list("abcd"), 4), LOOMS.ravel(), spread)


def test_the_likeliest_variances_of_a_textbook_are_found() -> None:
    """A bench part of unlimited size is an unknown mean, which makes the evidence the restricted likelihood; for balanced data its
    maximum is the analysis of variance: 6.96 between the looms and 1.90 within, as printed in the book."""
    given = _looms(0.1)
    device, bench, occasion = components(given.groups)
    assert bench.sources == (Source.BENCH, Source.COMMON)

    def cost(log_spreads: np.ndarray) -> float:
        return -float(log_evidence(given, (device, occasion, bench), np.array([[*np.exp(log_spreads), 1e5]]))[0])

    best = np.exp(minimize(cost, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}).x)
    assert best[0] ** 2 == pytest.approx(6.96, abs=0.005)
    assert best[1] ** 2 + 0.1**2 == pytest.approx(1.90, abs=0.005)


def test_the_evidence_is_that_of_the_whole_covariance_matrix() -> None:
    draw = np.random.default_rng(3)
    benches, devices = list("uuuvvvvuw"), list("aabbacdda")
    occasions = list("112345567")
    given = Estimates(
        draw.normal(0, 3, 9),
        draw.uniform(0.2, 2, 9),
        {Source.BENCH: benches, Source.DEVICE: devices, Source.OCCASION: occasions},
    )
    spreads = np.array([1.3, 0.4, 2.2])
    covariance = np.diag(given.standard_uncertainties**2)
    for labels, sigma in zip((devices, benches, occasions), spreads, strict=True):
        covariance += sigma**2 * (np.array(labels)[:, None] == np.array(labels))
    expected = multivariate_normal(np.zeros(9), covariance).logpdf(given.values)
    chosen = components(given.groups)[:3]
    assert log_evidence(given, chosen, spreads[None])[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_parts_are_best_linear_unbiased_predictions() -> None:
    """With σ known well from many groups, the part of a device with four runs is its shrunk mean (Searle et al., 1992, section 7.4)."""
    draw = np.random.default_rng(5)
    devices, benches = np.repeat(np.arange(12), 4), np.tile(np.arange(4), 12)
    parts = draw.normal(0, 2, 12)
    values = (parts - parts.mean())[devices] + draw.normal(0, 1, 48)
    whole = attribute(_fleet(map(str, benches), map(str, devices), values, 0.2))
    found = whole.of(Source.DEVICE)
    between, within = found.spread**2, whole.of(Source.OCCASION).spread ** 2 + 0.2**2
    predicted = between / (between + within / 4) * np.bincount(devices, values) / 4
    assert [part.part.value for part in found.parts] == pytest.approx(list(predicted), abs=0.15)
    u = 1.96 * np.sqrt(between * within / (4 * between + within))
    assert [part.part.expanded for part in found.parts] == pytest.approx([u] * 12, rel=0.2)


@pytest.mark.parametrize("source", [Source.DEVICE, Source.BENCH, Source.OCCASION])
def test_one_source_is_named_and_the_others_are_not(source: Source) -> None:
    draw = np.random.default_rng(11)
    benches, devices = np.tile(np.arange(4), 6), np.repeat(np.arange(6), 4)
    of = {Source.BENCH: benches, Source.DEVICE: devices, Source.OCCASION: np.arange(24)}[source]
    parts = draw.normal(0, 4, 24)
    found = attribute(_fleet(map(str, benches), map(str, devices), parts[of] + draw.normal(0, 0.3, 24), 0.3))
    assert [one.component.sources for one in found.named] == [(source,)]
    assert found.of(source).probability > 0.999
    assert found.of(source).share + found.of(Source.COMMON).share > 0.95
    named = found.of(source).parts
    errors = np.array([part.part.value - parts[int(part.label)] for part in named])
    assert np.ptp(errors) < 2.0  # a mean of the parts that is not zero may be what all runs have in common
    assert all(abs(error) < 1.5 * part.part.expanded for error, part in zip(errors, named, strict=True))


def test_noise_alone_is_attributed_to_nothing() -> None:
    draw = np.random.default_rng(4)
    found = attribute(_fleet("uuuuvvvv" * 3, "aabbccdd" * 3, draw.normal(0, 0.3, 24), 0.3))
    assert found.none > 0.5
    assert not found.named


def test_sources_that_group_alike_are_one_component() -> None:
    """One device on one bench: what all runs have in common may be either."""
    found = attribute(_fleet("uuuu", "aaaa", [5.0, 5.1, 4.9, 5.05], 0.1))
    assert [one.component.sources for one in found.named] == [(Source.DEVICE, Source.BENCH, Source.COMMON)]
    (part,) = found.named[0].parts
    assert part.part.value == pytest.approx(5.01, abs=0.05)
    assert part.part.expanded == pytest.approx(1.96 * 0.05, rel=0.5)


def test_a_run_with_a_large_uncertainty_contributes_little() -> None:
    given = _fleet("uuuu", "abcd", [4.0, 4.1, 3.9, 0.0], 0.1)
    given.standard_uncertainties[3] = 1e6
    found = attribute(given)
    assert found.of(Source.BENCH).probability > 0.9
    assert found.of(Source.BENCH).parts[0].part.value == pytest.approx(4.0, abs=0.15)


def test_benches_that_are_alike_are_what_the_runs_have_in_common() -> None:
    values = np.random.default_rng(8).normal(500.0, 0.3, 24)
    found = attribute(_fleet("uuuuvvvvwwww" * 2, "aabbccdd" * 3, values, 0.3))
    assert [one.component.sources for one in found.named] == [(Source.COMMON,)]
    (part,) = found.named[0].parts
    assert abs(part.part.value - 500) < part.part.expanded < 0.3


def test_a_level_and_a_difference_are_known_better_than_a_part() -> None:
    """Two benches, one as simulated and one 60 away: whether the benches have a mean in common stays open, their levels do not."""
    values = np.array([0.1, -0.2, 0.3, 60.1, 59.8, 60.2])
    found = attribute(_fleet("uuuvvv", "abcabc", values, 0.3)).of(Source.BENCH)
    first, second = found.parts
    assert found.probability > 0.99 and second.part.expanded > 10
    assert first.level is not None and second.level is not None and second.difference is not None
    assert second.level.value == pytest.approx(60.03, abs=0.1)
    assert second.difference.value == pytest.approx(59.97, abs=0.2)
    assert 1.96 * 0.3 / 3**0.5 < second.level.expanded < second.difference.expanded < 1.5


def test_probabilities_and_shares_add_up() -> None:
    found = attribute(_looms(0.3))
    assert sum(found.probability.values()) == pytest.approx(1)
    assert sum(one.share for one in found.contributions) == pytest.approx(1)
