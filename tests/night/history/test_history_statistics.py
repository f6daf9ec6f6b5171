"""The statistics of a history against published examples, published run lengths, figures worked by hand, and coverage in simulations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.night.history.agreement import agreement
from planrunner.night.history.change_points import causes, change_points
from planrunner.night.history.control_charts import between_runs, control_charts, cusum, ewma, shewhart
from planrunner.night.history.drift import HORIZON, days_left, drift_line
from planrunner.night.history.gauge import UnbalancedError, gauge_study
from planrunner.night.history.rows import Circumstance, CircumstanceKind

Array = NDArray[np.int_]

# -- NIST/SEMATECH e-Handbook of Statistical Methods, chapter 6.3.2 ----------------------------------------------------

FLOWRATE = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]


def test_individuals_chart_of_the_nist_handbook() -> None:
    """6.3.2.2 (itl.nist.gov/div898/handbook/pmc/section3/pmc322.htm), flowrates:
    mean 50.81, mean moving range 1.8778, limits 55.8041 and 45.8159 (with d₂ = 1.128)."""
    x, none = np.array(FLOWRATE), np.zeros(10)
    sigma = between_runs(x, none)
    assert np.abs(np.diff(x)).mean() == pytest.approx(1.8778, abs=5e-5)
    chart = shewhart(x, float(x.mean()), np.full(10, sigma))
    assert x.mean() == pytest.approx(50.81)
    assert (chart.upper[0], chart.lower[0]) == (pytest.approx(55.8041, abs=2e-3), pytest.approx(45.8159, abs=2e-3))
    assert not chart.alarms.any()


def test_ewma_chart_of_the_nist_handbook() -> None:
    """6.3.2.4 (…/pmc324.htm): EWMA₀ = 50, s = 2.0539, λ = 0.3, limits 52.5884 and 47.4115, no alarm."""
    data = [52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5]
    data += [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]
    expected = [50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33]
    expected += [50.11, 49.36, 49.52, 50.05, 49.38, 49.92, 50.73, 51.23, 51.94, 51.99]
    chart = ewma(np.array(data), 50.0, np.full(20, 2.0539), 0.3, 3.0, steady=True)
    assert chart.statistic == pytest.approx(expected, abs=6e-3)
    assert (chart.upper[-1], chart.lower[-1]) == (pytest.approx(52.5884, abs=5e-4), pytest.approx(47.4115, abs=5e-4))
    assert not chart.alarms.any()


def test_cusum_chart_of_the_nist_handbook() -> None:
    """6.3.2.3 (…/pmc323.htm): mean 325, σ = 0.635, k = 0.3175, h = 4.1959; the sum is beyond h from group 14 on."""
    data = [324.925, 324.675, 324.725, 324.350, 325.350, 325.225, 324.125, 324.525, 325.225, 324.600]
    data += [324.625, 325.150, 328.325, 327.250, 327.825, 328.500, 326.675, 327.775, 326.875, 328.350]
    high = [0, 0, 0, 0, 0.03, 0, 0, 0, 0, 0, 0, 0, 3.01, 4.94, 7.45, 10.63, 11.99, 14.44, 16.00, 19.04]
    low = [0, 0.01, 0, 0.33, 0, 0, 0.56, 0.72, 0.17, 0.25, 0.31, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    sigma = 0.635
    up, down = cusum(np.array(data), 325.0, np.full(20, sigma), 0.3175 / sigma, 4.1959 / sigma)
    assert up.statistic * sigma == pytest.approx(high, abs=0.011)
    assert -down.statistic * sigma == pytest.approx(low, abs=0.011)
    assert np.flatnonzero(up.alarms)[0] == 13 and up.alarms[13:].all() and not down.alarms.any()


# -- run lengths -------------------------------------------------------------------------------------------------------


def run_lengths(chart: str, shift: float, most: int, samples: int, **settings: float) -> Array:
    rng = np.random.default_rng(20)
    z = rng.normal(shift, 1.0, (most, samples))
    one = np.ones(most)
    if chart == "ewma":
        alarms = ewma(z, 0.0, one, settings["weight"], settings["width"], steady=True).alarms
    else:
        up, down = cusum(z, 0.0, one, settings["allowance"], settings["decision"])
        alarms = up.alarms | down.alarms
    assert alarms.any(axis=0).all()
    return alarms.argmax(axis=0) + 1


@pytest.mark.parametrize(
    ("weight", "width", "shift", "published"),
    [(0.2, 2.962, 1.0, 10.5), (0.2, 2.962, 2.0, 3.7), (0.1, 2.814, 1.0, 10.3), (0.2, 2.962, 0.5, 41.8)],
)
def test_run_length_of_the_moving_average(weight: float, width: float, shift: float, published: float) -> None:
    """Lucas and Saccucci (1990), as in Montgomery, table 9.11."""
    found = run_lengths("ewma", shift, 800, 4000, weight=weight, width=width)
    assert abs(found.mean() - published) < 4 * found.std() / math.sqrt(len(found)) + 0.05


@pytest.mark.parametrize(
    ("decision", "shift", "published"), [(5.0, 1.0, 10.4), (5.0, 2.0, 4.01), (4.0, 1.0, 8.38), (4.0, 0.5, 26.6)]
)
def test_run_length_of_the_sums(decision: float, shift: float, published: float) -> None:
    """Montgomery, table 9.3, of the two-sided chart with k = 0.5."""
    found = run_lengths("cusum", shift, 800, 4000, allowance=0.5, decision=decision)
    assert abs(found.mean() - published) < 4 * found.std() / math.sqrt(len(found)) + 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("chart", "published"), [("ewma", 500.0), ("cusum", 465.0)])
def test_run_length_in_control(chart: str, published: float) -> None:
    """The charts as planrunner sets them: 500 and 465 values to a false alarm."""
    settings = {"weight": 0.2, "width": 2.962, "allowance": 0.5, "decision": 5.0}
    found = run_lengths(chart, 0.0, 9000, 3000, **settings)
    assert abs(found.mean() - published) < 4 * found.std() / math.sqrt(len(found)) + 0.5


# -- stated uncertainties ----------------------------------------------------------------------------------------------


def test_scatter_that_the_uncertainties_explain_needs_no_more() -> None:
    rng = np.random.default_rng(1)
    u = rng.uniform(0.5, 2.0, 4000)
    x = 3.0 + u * rng.normal(size=4000)
    assert between_runs(x, u) < 0.25
    assert between_runs(x + rng.normal(0, 2.0, 4000), u) == pytest.approx(2.0, rel=0.1)


def test_an_uncertain_value_has_wide_limits() -> None:
    values, u = [1.0] * 10 + [2.0, 2.0], [0.1] * 11 + [1.0]
    charts = control_charts(values, u)
    assert charts is not None and charts.shewhart.alarms.tolist() == [False] * 10 + [True, False]


def test_values_without_any_scatter_have_no_charts() -> None:
    assert control_charts([1.0, 1.0, 1.0], [0.0, 0.0, 0.0]) is None


# -- changes -----------------------------------------------------------------------------------------------------------


def test_a_change_worked_by_hand() -> None:
    """Two values of 0 and two of 10, σ = 1 and 2: the weighted means are 0 and 10, with variances 1/2 and 4/2."""
    (found,) = change_points(np.array([0.0, 0.0, 10.0, 10.0]), np.array([1.0, 1.0, 2.0, 2.0]))
    assert (found.index, found.step) == (2, 10.0)
    assert found.standard_uncertainty == pytest.approx(math.sqrt(2.5))
    assert found.p == pytest.approx(3 * math.erfc(10 / math.sqrt(2.5) / math.sqrt(2)))


def test_changes_are_found_where_they_are() -> None:
    rng = np.random.default_rng(2)
    level = np.repeat([0.0, 5.0, 2.0], [30, 20, 40])
    found = change_points(level + rng.normal(size=90), np.ones(90))
    assert [one.index for one in found] == [30, 50]
    assert [one.step for one in found] == [pytest.approx(5, abs=1), pytest.approx(-3, abs=1)]


def test_changes_that_are_none_are_rare() -> None:
    rng = np.random.default_rng(3)
    false = sum(bool(change_points(rng.normal(size=50), np.ones(50))) for _ in range(1000))
    assert false <= 10 + 3 * math.sqrt(10)  # at most 1 %, as the level says


def test_causes_are_what_changed_with_the_level() -> None:
    kinds = CircumstanceKind

    def of(firmware: str, operator: str, bench: str = "b") -> list[Circumstance]:
        return [
            Circumstance(kinds.FIRMWARE, "table", firmware),
            Circumstance(kinds.OPERATOR, "", operator),
            Circumstance(kinds.BENCH, "", bench),
        ]

    runs = [of("1", "ann"), of("1", "bob"), of("1", "ann"), of("2", "bob"), of("2", "ann"), of("2", "bob")]
    (point,) = change_points(np.array([0.0, 0, 0, 9, 9, 9]), np.ones(6))
    firmware, operator = causes(point, runs)
    assert (firmware.kind, firmware.before, firmware.after, firmware.shared) == (kinds.FIRMWARE, "1", "2", 1.0)
    assert (operator.kind, operator.shared) == (kinds.OPERATOR, 4 / 6)


# -- drift -------------------------------------------------------------------------------------------------------------


def test_a_drift_worked_by_hand() -> None:
    """Values 0, 1, 2 at days 0, 100, 200, u = 1: slope 0.01 per day with u = 1/√20000; the level 1 has u = 1/√3."""
    line = drift_line(np.array([0.0, 100, 200]), np.array([0.0, 1, 2]), np.ones(3), 0.0)
    assert line is not None
    found = [line.slope, line.slope_uncertainty, line.level, line.level_uncertainty]
    assert found == pytest.approx([0.01, 1 / math.sqrt(20000), 1.0, 1 / math.sqrt(3)])
    assert line.uncertainty(300) == pytest.approx(math.sqrt(1 / 3 + 200**2 / 20000 + 1))
    assert not line.significant
    # Without a tolerance: the drift exceeds U = 2 after 200 days.
    assert days_left(line) == pytest.approx(200, abs=0.02)
    # With one: 0.01·t + 2·√(1/3 + (100 + t)²/20000 + 1) = 6, solved for t by hand: t = 126.01.
    t = days_left(line, 6.0)
    assert 0.01 * t + 2 * math.sqrt(4 / 3 + (100 + t) ** 2 / 20000) == pytest.approx(6.0, abs=1e-3)
    assert days_left(line, 1.0) == 0.0
    assert days_left(replace(line, slope=0.0, slope_uncertainty=0.0), 6.0) == HORIZON


def test_the_line_is_that_of_statsmodels() -> None:
    """statsmodels 0.15.0, `WLS(y, [1, t], weights=1/u²).fit(cov_type="fixed scale")`; the level is that of the weighted mean."""
    days, u = np.array([0.0, 30, 65, 90, 140, 200]), np.array([0.05, 0.08, 0.05, 0.1, 0.06, 0.07])
    line = drift_line(days, np.array([1.02, 1.10, 0.97, 1.21, 1.18, 1.36]), u, 0.0)
    assert line is not None
    assert (line.slope, line.slope_uncertainty) == pytest.approx((0.00159813, 0.00037849), abs=1e-8)
    assert (line.level, line.level_uncertainty) == pytest.approx((1.10148458, 0.02549802), abs=1e-8)
    assert line.level - line.middle * line.slope == pytest.approx(0.9774326, abs=1e-7)  # the constant of statsmodels


def test_a_drift_needs_three_values_over_a_day() -> None:
    assert drift_line(np.array([0.0, 1]), np.array([0.0, 1]), np.ones(2), 0.0) is None
    assert drift_line(np.zeros(3), np.arange(3.0), np.ones(3), 0.0) is None
    assert drift_line(np.array([0.0, 0.4, 0.9]), np.arange(3.0), np.ones(3), 0.0) is None
    assert drift_line(np.array([0.0, 0.4, 1.0]), np.arange(3.0), np.ones(3), 0.0) is not None


# -- agreement ---------------------------------------------------------------------------------------------------------


def test_en_numbers_worked_by_hand() -> None:
    """A 10.0 (u 0.3) against the named reference 9.0 (u 0.4): 1/(2·0.5) = 1. Without it: against the weighted mean of the others."""
    values = {"A": [(10.0, 0.3)], "R": [(9.0, 0.4)], "B": [(9.5, 0.3), (9.7, 0.3)]}
    found = {one.name: one for one in agreement(values, "R")}
    assert found["A"].en == pytest.approx(1.0) and found["A"].agrees and "R" not in found
    assert found["B"].en == pytest.approx(0.6 / (2 * 0.5)) and found["B"].standard_uncertainty == pytest.approx(0.3)
    among = {one.name: one for one in agreement(values)}
    weights = 1 / 0.4**2, 1 / 0.3**2
    mean = (9.0 * weights[0] + 9.6 * weights[1]) / sum(weights)
    assert among["A"].reference == pytest.approx(mean)
    assert among["A"].en == pytest.approx((10 - mean) / (2 * math.sqrt(0.09 + 1 / sum(weights))))
    assert agreement({"A": [(1.0, 0.1)]}) == ()


# -- gauge R&R ---------------------------------------------------------------------------------------------------------

AIAG = """
0.29 -0.56 1.34 0.47 -0.80 0.02 0.59 -0.31 2.26 -1.36
0.41 -0.68 1.17 0.50 -0.92 -0.11 0.75 -0.20 1.99 -1.25
0.64 -0.58 1.27 0.64 -0.84 -0.21 0.66 -0.17 2.01 -1.31
0.08 -0.47 1.19 0.01 -0.56 -0.20 0.47 -0.63 1.80 -1.68
0.25 -1.22 0.94 1.03 -1.20 0.22 0.55 0.08 2.12 -1.62
0.07 -0.68 1.34 0.20 -1.28 0.06 0.83 -0.34 2.19 -1.50
0.04 -1.38 0.88 0.14 -1.46 -0.29 0.02 -0.46 1.77 -1.49
-0.11 -1.13 1.09 0.20 -1.07 -0.67 0.01 -0.56 1.45 -1.77
-0.15 -0.96 0.67 0.11 -1.45 -0.49 0.21 -0.49 1.87 -2.16
"""


def test_the_study_of_the_aiag_manual() -> None:
    """AIAG, Measurement Systems Analysis, 4th edition, chapter III: 3 appraisers, 3 trials, 10 parts; with the interaction pooled
    EV = 0.199933, AV = 0.226838, GRR = 0.302373, PV = 1.042327, TV = 1.085."""
    table = np.array([[float(text) for text in line.split()] for line in AIAG.split("\n") if line])
    labels = [(str(part), str(row // 3)) for row in range(9) for part in range(10)]
    factors = {"device": [part for part, _ in labels], "operator": [who for _, who in labels]}
    study = gauge_study(factors, table.ravel().tolist())
    assert [one.factors for one in study.anova] == [("device",), ("operator",), ("device", "operator"), ()]
    assert [one.sum_of_squares for one in study.anova] == pytest.approx([88.3619, 3.1673, 0.3590, 2.7589], abs=5e-4)
    assert [one.df for one in study.anova] == [9, 2, 18, 60]
    found = {
        one.name: one.standard_deviation for one in gauge_study(factors, table.ravel().tolist(), pooled=True).components
    }
    assert found["repeatability"] == pytest.approx(0.199933, abs=5e-6)
    assert found["operator"] == pytest.approx(0.226838, abs=5e-6)
    assert found["gauge R&R"] == pytest.approx(0.302373, abs=5e-6)
    assert found["device"] == pytest.approx(1.042327, abs=5e-6)
    assert found["total"] == pytest.approx(1.085, abs=5e-4)


def test_the_sums_of_squares_are_those_of_statsmodels() -> None:
    """statsmodels 0.15.0, `anova_lm(ols("y ~ C(device)*C(operator)"), typ=2)`, and with `*C(bench)` on 24 whole numbers."""
    table = np.array([[float(text) for text in line.split()] for line in AIAG.split("\n") if line])
    places = [(str(part), str(row // 3)) for row in range(9) for part in range(10)]
    two = gauge_study({"device": [p for p, _ in places], "operator": [o for _, o in places]}, table.ravel().tolist())
    expected = [88.361934444, 3.167262222, 0.358982222, 2.758933333]
    assert [one.sum_of_squares for one in two.anova] == pytest.approx(expected, abs=1e-9)
    values = [0, 11, 5, 16, 3, 14, 12, 6, 7, 12, 12, 0, 10, 15, 4, 9, 14, 13, 2, 1, 0, 16, 13, 12]
    design = list(np.ndindex(3, 2, 2, 2))
    labels = {name: [str(p[axis]) for p in design] for axis, name in enumerate(("device", "operator", "bench"))}
    three = {one.factors: one for one in gauge_study(labels, [float(x) for x in values]).anova}
    expected_sums = {
        ("device",): (1.0, 2),
        ("operator",): (18.375, 1),
        ("bench",): (22.041666667, 1),
        ("device", "operator"): (4.0, 2),
        ("device", "bench"): (66.333333333, 2),
        ("operator", "bench"): (15.041666667, 1),
        ("device", "operator", "bench"): (134.333333333, 2),
        (): (438.5, 12),
    }
    assert three.keys() == expected_sums.keys()
    for names, (sum_of_squares, df) in expected_sums.items():
        assert three[names].sum_of_squares == pytest.approx(sum_of_squares, abs=1e-8) and three[names].df == df


def test_parts_add_up_to_the_total_even_if_some_are_estimated_below_zero() -> None:
    """Whole numbers without any effect: about half of the components are estimated below zero."""
    values = np.random.default_rng(2).integers(0, 20, 24).astype(float).tolist()
    design = list(np.ndindex(3, 2, 2, 2))
    labels = {name: [str(p[axis]) for p in design] for axis, name in enumerate(("device", "operator", "bench"))}
    study = {one.name: one for one in gauge_study(labels, values).components}
    sums = ("reproducibility", "gauge R&R", "total")
    parts = {name: one.variance for name, one in study.items() if name not in sums}
    assert list(parts.values()).count(0.0) >= 2
    assert study["total"].variance == pytest.approx(sum(parts.values()))
    assert study["gauge R&R"].variance == pytest.approx(sum(parts.values()) - parts["device"])
    assert all(one.lower <= one.variance <= one.upper for one in study.values())


def three_factors(rng: np.random.Generator) -> tuple[dict[str, list[str]], list[float]]:
    """8 devices × 4 operators × 3 benches, twice: σ = 2 of devices, 0.7 of operators, 0.5 of benches, 0.3 of all interactions, 0.4 of
    values."""
    d, o, b = 8, 4, 3
    x = rng.normal(0, 2.0, (d, 1, 1, 1)) + rng.normal(0, 0.7, (1, o, 1, 1)) + rng.normal(0, 0.5, (1, 1, b, 1))
    x = x + rng.normal(0, 0.3, (d, o, 1, 1)) + rng.normal(0, 0.3, (d, 1, b, 1)) + rng.normal(0, 0.3, (1, o, b, 1))
    x = x + rng.normal(0, 0.3, (d, o, b, 1)) + rng.normal(0, 0.4, (d, o, b, 2))
    places = list(np.ndindex(d, o, b, 2))
    names = {
        "device": [str(p[0]) for p in places],
        "operator": [str(p[1]) for p in places],
        "bench": [str(p[2]) for p in places],
    }
    return names, [float(x[p]) for p in places]


TRUE = {
    "repeatability": 0.16,
    "device": 4.0,
    "device × operator": 0.09,
    "device × operator × bench": 0.09,
    "gauge R&R": 0.16 + 0.49 + 0.25 + 4 * 0.09,
    "total": 4 + 0.16 + 0.49 + 0.25 + 4 * 0.09,
}


@pytest.mark.slow
def test_components_are_unbiased_and_their_intervals_cover() -> None:
    """Drawn from the model, written separately. The method is approximate; Burdick, Borror and Montgomery report 94 to 97 %."""
    rng = np.random.default_rng(5)
    runs = 500
    held, sums = dict.fromkeys(TRUE, 0), dict.fromkeys(TRUE, 0.0)
    for _ in range(runs):
        for one in gauge_study(*three_factors(rng)).components:
            if one.name in TRUE:
                held[one.name] += one.lower <= TRUE[one.name] <= one.upper
                sums[one.name] += one.variance / runs
    assert all(0.92 <= count / runs <= 0.99 for count in held.values()), held
    assert all(sums[name] == pytest.approx(true, rel=0.12) for name, true in TRUE.items()), sums


def test_a_design_with_a_hole_is_refused_by_name() -> None:
    factors = {"device": ["a", "a", "b", "b"], "bench": ["1", "1", "1", "1"], "operator": ["x", "y", "x", "x"]}
    with pytest.raises(UnbalancedError, match="no value of device b, operator y"):
        gauge_study(factors, [1.0, 2.0, 3.0, 4.0])
    with pytest.raises(UnbalancedError, match="needs at least two values"):
        gauge_study({"device": ["a", "b"]}, [1.0, 2.0])
