"""Decision rules: examples worked by hand with tabulated quantiles."""

from __future__ import annotations

import math

import pytest

from planrunner.uncertainty.decision import conformance_probability, coverage_factor, decide, expanded_uncertainty


@pytest.mark.parametrize(
    ("dof", "k"),
    [(1, 12.71), (2, 4.30), (4, 2.78), (10, 2.23), (50, 2.01), (math.inf, 1.960)],
)
def test_coverage_factor_is_that_of_the_table(dof: float, k: float) -> None:
    """JCGM 100:2008, table G.2 (95 %)."""
    assert coverage_factor(dof) == pytest.approx(k, abs=0.006)


def test_coverage_factor_of_a_fraction_holds_95_percent_of_the_density() -> None:
    """Student's density for 2.5 degrees of freedom, summed by the midpoint rule."""
    dof, k, n = 2.5, coverage_factor(2.5), 100_000
    scale = math.gamma((dof + 1) / 2) / (math.sqrt(dof * math.pi) * math.gamma(dof / 2))
    inside = sum((1 + ((i + 0.5) * k / n) ** 2 / dof) ** (-(dof + 1) / 2) for i in range(n))
    assert 2 * inside * scale * k / n == pytest.approx(0.95, abs=1e-8)


def test_no_degrees_of_freedom_means_no_bound() -> None:
    assert math.isinf(coverage_factor(0))
    assert expanded_uncertainty(0.0, 0) == 0.0
    assert math.isinf(expanded_uncertainty(1.0, 0))


def test_inside_by_more_than_u_passes_both_rules() -> None:
    """0.30 ± 0.05 against ±0.5: U = 1.96 × 0.05 = 0.098, and 0.30 + 0.098 < 0.5; z = 4.0 to the limit."""
    for rule in ("simple", "guarded"):
        decision = decide(0.30, 0.05, math.inf, -0.5, 0.5, rule)
        assert decision.verdict == "pass"
        assert decision.expanded_uncertainty == pytest.approx(0.097998, abs=1e-6)
        assert decision.probability == pytest.approx(0.999968, abs=1e-6)
    assert decide(0.30, 0.05, math.inf, -0.5, 0.5, "simple").guard_band == 0.0


def test_inside_the_guard_band_fails_only_when_guarded() -> None:
    """0.45 ± 0.05: 0.45 + 0.098 > 0.5; one standard uncertainty inside means 84.13 %."""
    assert decide(0.45, 0.05, math.inf, -0.5, 0.5, "simple").verdict == "pass"
    decision = decide(0.45, 0.05, math.inf, -0.5, 0.5, "guarded")
    assert decision.verdict == "fail"
    assert "guard band" in decision.reason
    assert decision.probability == pytest.approx(0.841345, abs=1e-6)


def test_outside_fails_and_says_so() -> None:
    decision = decide(-0.55, 0.05, math.inf, -0.5, 0.5, "simple")
    assert decision.verdict == "fail"
    assert "outside" in decision.reason
    assert decision.probability == pytest.approx(0.158655, abs=1e-6)


def test_few_degrees_of_freedom_widen_the_guard_band() -> None:
    """With 2 degrees of freedom U = 4.303 u: 0.30 ± 0.05 is then 0.515 at most, over the limit. t = 4 has 97.14 % below it."""
    decision = decide(0.30, 0.05, 2, upper=0.5)
    assert decision.verdict == "fail"
    assert decision.guard_band == pytest.approx(0.21513, abs=1e-4)
    assert decision.probability == pytest.approx(0.97140, abs=1e-5)


def test_one_sided_limit() -> None:
    assert decide(1.0, 0.1, math.inf, lower=0.8).verdict == "pass"
    assert decide(1.0, 0.1, math.inf, lower=0.85).verdict == "fail"


def test_exactly_on_the_limit_without_uncertainty() -> None:
    assert decide(0.5, 0.0, math.inf, upper=0.5).verdict == "pass"
    assert conformance_probability(0.5, 0.0, math.inf, upper=0.5) == 1.0
    assert conformance_probability(0.6, 0.0, math.inf, upper=0.5) == 0.0


@pytest.mark.parametrize(("value", "u"), [(math.nan, 0.1), (0.0, math.nan), (0.0, math.inf), (math.inf, 0.1)])
def test_what_is_not_known_never_passes(value: float, u: float) -> None:
    assert decide(value, u, math.inf, -1, 1, "simple").verdict == "fail"


def test_limits_must_make_sense() -> None:
    with pytest.raises(ValueError, match="bound"):
        decide(0, 1, 1)
    with pytest.raises(ValueError, match="bound"):
        decide(0, 1, 1, 2, 1)


def test_zener_diode() -> None:
    """JCGM 106:2012, 7.4: limit −5.40 V from above, measured −5.47 V with u = 0.05 V: p = Φ(1.4) = 92 %."""
    decision = decide(-5.47, 0.05, math.inf, upper=-5.40, rule="simple")
    assert decision.probability == pytest.approx(0.919, abs=0.0005)
    assert decision.verdict == "pass"
    assert decision.false == pytest.approx(0.081, abs=0.0005)


def test_guard_band_is_the_factor_times_u_of_the_coverage() -> None:
    """U99 = 2.576·0.05 = 0.129; half of it leaves 0.5 − 0.064 = 0.436."""
    for value, verdict in ((0.43, "pass"), (0.44, "fail")):
        decision = decide(value, 0.05, math.inf, -0.5, 0.5, rule="guarded", factor=0.5, confidence=0.99)
        assert decision.verdict == verdict
        assert decision.guard_band == pytest.approx(0.5 * 2.5758 * 0.05, abs=1e-5)
        assert decision.coverage_factor == pytest.approx(2.5758, abs=1e-4)
    assert "0.5 times its expanded uncertainty" in decision.reason
    assert decision.false == decision.probability  # of a false rejection


def test_a_rule_without_a_band_needs_no_degrees_of_freedom() -> None:
    assert decide(0.1, 0.05, 0.0, -0.5, 0.5, "guarded", factor=0.0).verdict == "pass"
    assert decide(0.1, 0.05, 0.0, -0.5, 0.5, "guarded").verdict == "fail"
