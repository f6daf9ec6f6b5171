"""Budgets: the end-gauge example of JCGM 100:2008 (H.1), GTC on the same inputs, and inputs that act by several ways."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planrunner.uncertainty.budget import Measured, combine, effective_degrees_of_freedom, merged
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import Influence, InputQuantity


def influence(name: str, u: float, sensitivities: object, **keys: Any) -> Influence:
    array = np.atleast_2d(np.asarray(sensitivities, dtype=float))
    own = {key: keys.pop(key) for key in ("in_scatter", "parts") if key in keys}
    return Influence(InputQuantity(name, 0.0, "1", u, **keys), array, **own)


def end_gauge() -> tuple[Measured, list[Influence]]:
    """l = l_S + d − l_S·(δα·θ + α_S·δθ), in nm; the figures of table H.1."""
    length, expansion, theta = 50.000623e6, 11.5e-6, -0.1
    measured = Measured("length", 50.000838e6, "nm", 5.8, 24)
    return measured, [
        influence("standard", 25.0, 1.0, degrees_of_freedom=18),
        influence("comparator, random", 3.9, 1.0, degrees_of_freedom=5),
        influence("comparator, systematic", 6.7, 1.0, degrees_of_freedom=8),
        influence("expansion", 1.2e-6, 0.0, distribution="rectangular"),
        influence("temperature", 0.41, 0.0, distribution="u-shaped"),
        influence("difference of expansion", 0.58e-6, -length * theta, degrees_of_freedom=50),
        influence("difference of temperature", 0.029, -length * expansion, degrees_of_freedom=2),
    ]


def test_end_gauge_of_the_guide() -> None:
    """u = 32 nm, 16 degrees of freedom, U99 = 2.92·32 nm = 93 nm; contributions 25, 5.8, 3.9, 6.7, 2.9 and 16.6 nm."""
    measured, influences = end_gauge()
    budget = combine([measured], np.array([[5.8**2]]), influences).budgets[0]
    assert budget.standard_uncertainty == pytest.approx(32, abs=0.5)
    assert math.floor(budget.degrees_of_freedom) == 16
    assert coverage_factor(16, 0.99) == pytest.approx(2.92, abs=0.005)
    assert coverage_factor(16, 0.99) * 32 == pytest.approx(93, abs=0.5)
    shown = {line.quantity: round(line.contribution, 1) for line in budget.lines}
    assert shown.pop("difference of temperature") == pytest.approx(16.6, abs=0.1)
    assert shown == {
        "data": 5.8,
        "standard": 25.0,
        "comparator, random": 3.9,
        "comparator, systematic": 6.7,
        "difference of expansion": 2.9,
    }
    assert [line.kind for line in budget.lines] == ["A", "B", "B", "B", "B", "B"]


@pytest.mark.parametrize("seed", range(5))
def test_gtc_finds_the_same(seed: int) -> None:
    """Five coefficients, four inputs each of one to three parts, against the GUM Tree Calculator (MSL)."""
    from GTC import get_covariance, multiple_ureal, ureal

    rng = np.random.default_rng(seed)
    m = 5
    root = rng.normal(size=(m, m))
    covariance = root @ root.T
    widths = np.sqrt(np.diag(covariance))
    freedoms = rng.uniform(2, 30, m)
    measured = [Measured(f"c{k}", 0.0, "1", widths[k], freedoms[k]) for k in range(m)]
    stated = [(rng.uniform(0.1, 2), rng.uniform(1, 40), rng.normal(size=(m, 1 + n % 3))) for n in range(4)]
    found = combine(
        measured, covariance, [influence(f"q{n}", u, c, degrees_of_freedom=v) for n, (u, v, c) in enumerate(stated)]
    )

    correlation = covariance / np.outer(widths, widths)
    data = multiple_ureal([0.0] * m, list(widths), math.inf)
    for i in range(m):
        for j in range(i):
            data[i].set_correlation(correlation[i, j], data[j])
    sums = list(data)
    for u, _, c in stated:
        parts = [ureal(0.0, u) for _ in range(c.shape[1])]
        sums = [total + sum(float(c[k, r]) * parts[r] for r in range(c.shape[1])) for k, total in enumerate(sums)]
    theirs = np.array([[get_covariance(a, b) for b in sums] for a in sums])
    assert found.covariance == pytest.approx(theirs, rel=1e-10)
    assert found.standard_uncertainties == pytest.approx(np.sqrt(np.diag(theirs)), rel=1e-10)
    for k in range(m):  # degrees of freedom: GTC takes finite ones of uncorrelated inputs, one an input
        alone = ureal(0.0, widths[k], freedoms[k])
        total = alone + sum(float(np.linalg.norm(c[k])) * ureal(0.0, u, v) for u, v, c in stated)
        assert found.degrees_of_freedom[k] == pytest.approx(total.df, rel=1e-9)
        assert found.budgets[k].standard_uncertainty == pytest.approx(total.u, rel=1e-12)


def test_one_input_by_two_ways_is_added_before_it_is_squared() -> None:
    """c₁ = 3 and c₂ = −1 of one input leave 2·u; of two inputs √10·u."""
    measured, zero = [Measured("c", 1.0, "1", 0.0)], np.zeros((1, 1))
    one = [influence("gravity", 0.5, 3.0), influence("gravity", 0.5, -1.0)]
    assert combine(measured, zero, one).standard_uncertainties == pytest.approx(1.0)
    other = [influence("gravity", 0.5, 3.0), influence("latitude", 0.5, -1.0)]
    assert combine(measured, zero, other).standard_uncertainties == pytest.approx(0.5 * math.sqrt(10))


def test_parts_of_an_input_are_known_by_name() -> None:
    first = influence("position", 1.0, [1.0, 2.0], parts=("P1", "P2"))
    second = influence("position", 1.0, [5.0, 7.0], parts=("P2", "P3"))
    (together,) = merged([first, second])
    assert together.parts == ("P1", "P2", "P3")
    assert together.sensitivities == pytest.approx(np.array([[1.0, 7.0, 7.0]]))
    (apart,) = merged([influence("position", 1.0, [1.0, 2.0]), influence("position", 1.0, [5.0, 7.0])])
    assert apart.sensitivities == pytest.approx(np.array([[1.0, 2.0, 5.0, 7.0]]))


def test_what_the_scatter_shows_is_listed_and_not_added() -> None:
    found = combine(
        [Measured("c", 1.0, "1", 2.0, 4)], np.array([[4.0]]), [influence("position", 1.0, 3.0, in_scatter=True)]
    )
    assert found.covariance == pytest.approx(np.array([[4.0]]))
    assert found.degrees_of_freedom == pytest.approx([4.0])
    assert [(line.quantity, line.added, line.contribution) for line in found.budgets[0].lines] == [
        ("data", True, 2.0),
        ("position", False, 3.0),
    ]


def test_lines_are_shown_in_the_unit_that_was_stated() -> None:
    arcsec = math.pi / 648000
    quantity = InputQuantity("position", 10 * arcsec, "rad", 3 * arcsec, 9, "t", "RT-1", "2026-03-01", "arcsec", arcsec)
    line = (
        combine([Measured("c", 1.0, "V", 0.1)], np.zeros((1, 1)), [Influence(quantity, np.array([[5.0]]))])
        .budgets[0]
        .lines[1]
    )
    assert line.unit == "arcsec" and (line.value, line.standard_uncertainty) == pytest.approx((10, 3))
    assert (
        line.sensitivity * line.standard_uncertainty == pytest.approx(line.contribution) == pytest.approx(15 * arcsec)
    )
    assert (line.source, line.calibrated, line.degrees_of_freedom) == ("RT-1", "2026-03-01", 9)


def test_nothing_stated_leaves_the_estimate_as_it_is() -> None:
    found = combine([Measured("c", 1.0, "1", 0.1, 7.25)], np.array([[0.01]]))
    assert (found.standard_uncertainties[0], found.degrees_of_freedom[0]) == (0.1, 7.25)
    assert [line.quantity for line in found.budgets[0].lines] == ["data"]


def test_an_input_that_acts_nowhere_is_no_line() -> None:
    nowhere = [influence("rate", 1.0, np.zeros((1, 0))), influence("latitude", 1.0, 0.0)]
    found = combine([Measured("c", 1.0, "1", 0.1)], np.array([[0.01]]), nowhere)
    assert [line.quantity for line in found.budgets[0].lines] == ["data"]
    assert found.degrees_of_freedom[0] == math.inf


def test_degrees_of_freedom_at_the_edges() -> None:
    assert effective_degrees_of_freedom([1.0, 1.0], [4.0, math.inf]) == pytest.approx(16.0)
    assert effective_degrees_of_freedom([1.0, 0.0], [4.0, 0.0]) == pytest.approx(4.0)
    assert effective_degrees_of_freedom([1.0, 1.0], [0.0, 5.0]) == 0.0
    assert math.isinf(effective_degrees_of_freedom([], []))


@pytest.mark.parametrize("wrong", [[[1.0], [2.0], [3.0]], [[math.nan], [1.0]]])
def test_sensitivities_that_do_not_fit_are_refused(wrong: list[list[float]]) -> None:
    pair = [Measured("a", 1.0, "1", 0.1), Measured("b", 1.0, "1", 0.1)]
    with pytest.raises(ValueError, match="sensitivities to 'position' do not fit"):
        combine(pair, np.zeros((2, 2)), [influence("position", 1.0, wrong)])
