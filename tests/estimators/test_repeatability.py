"""Scatter of repeats: by hand, against certified analyses of variance, the truth, and what cannot be done."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from recorded import from_means, noisy, segment, sensor

from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
)
from planrunner.estimators.method import designed
from planrunner.estimators.repeatability import (
    Repeatability,
    RepeatabilityParameters,
    analysis_of_variance,
    chance_of_order,
    deviation_interval,
)
from planrunner.physics.earth import Site
from planrunner.uncertainty.decision import expanded_uncertainty

SITE = Site(math.radians(40.0))
DAYS = {"a": ("a*",), "b": ("b*",), "c": ("c*",)}


def given(value: float, name: str = "K", unit: str = "ppm", u: float = 0.1) -> Estimate:
    return Estimate("cal", "other", (Coefficient(name, value, unit, u),), np.array([[u**2]]))


def repeats(uses: dict[str, Estimate], **keys: Any) -> Estimate:
    parameters = RepeatabilityParameters(**keys)
    return Repeatability().estimate(EstimateRequest("again", (), parameters, SITE, sensor("gyro"), uses))


def of_values(values: dict[str, float], **keys: Any) -> Estimate:
    return repeats({name: given(value) for name, value in values.items()}, **keys)


# -- by hand ---------------------------------------------------------------------------------------------------------


def test_three_repeats_by_hand() -> None:
    """998, 1000, 1005: mean 1001, s² = (9 + 1 + 16)/2 = 13; u of the mean √(13/3), of s by s/√4."""
    found = of_values({"r1": 998, "r2": 1000, "r3": 1005})
    assert found["mean_K"].value == pytest.approx(1001, rel=1e-9)
    assert found["mean_K"].standard_uncertainty == pytest.approx(math.sqrt(13 / 3), rel=1e-9)
    assert found["s_K"].value == pytest.approx(math.sqrt(13), rel=1e-9)
    assert found["s_K"].standard_uncertainty == pytest.approx(math.sqrt(13) / 2, rel=1e-9)
    assert found["repeatability_K"].value == pytest.approx(1e6 * math.sqrt(13) / 1001, rel=1e-9)
    assert {item.degrees_of_freedom for item in found.coefficients} == {2}


def test_interval_by_tables() -> None:
    """χ² tables, 10 degrees of freedom: 3.247 and 20.483."""
    low, high = deviation_interval(4.0, 10)
    assert (low, high) == pytest.approx((math.sqrt(40 / 20.483), math.sqrt(40 / 3.247)), rel=1e-4)


def test_two_days_by_hand() -> None:
    """Days (1, 3) and (6, 8): M_w = 2 with two degrees, M_b = 25 with one, n₀ = 2: between (25 − 2)/2 = 11.5, both together 13.5 with
    13.5²/(12.5²/1 + 1²/2) degrees. Mean 4.5 with u = 5/√2/√2."""
    found = of_values({"a1": 1, "a2": 3, "b1": 6, "b2": 8}, groups={"a": ("a*",), "b": ("b*",)})
    assert found["mean_K"].value == pytest.approx(4.5) and found["mean_K"].standard_uncertainty == pytest.approx(2.5)
    assert found["mean_K"].degrees_of_freedom == 1
    assert found["s_K"].value == pytest.approx(math.sqrt(2), rel=1e-9) and found["s_K"].degrees_of_freedom == 2
    assert found["s_between_K"].value == pytest.approx(math.sqrt(11.5), rel=1e-9)
    assert found["s_total_K"].value == pytest.approx(math.sqrt(13.5), rel=1e-9)
    assert found["s_total_K"].degrees_of_freedom == pytest.approx(13.5**2 / (12.5**2 + 0.5), rel=1e-9)


def test_unequal_groups_by_hand() -> None:
    """Groups of 1, 2 and 3: n₀ = (6 − 14/6)/2 = 11/6."""
    split = analysis_of_variance(np.array([4.0, 1, 3, 7, 8, 9]), np.array([0, 1, 1, 2, 2, 2]))
    within = (2 + 2) / 3
    grand = 32 / 6
    between = ((4 - grand) ** 2 + 2 * (2 - grand) ** 2 + 3 * (8 - grand) ** 2) / 2
    assert split.within == pytest.approx(within, rel=1e-9) and split.within_freedom == 3
    assert split.ratio == pytest.approx(between / within, rel=1e-9)
    assert split.between == pytest.approx((between - within) * 6 / 11, rel=1e-9)


def test_certified_analysis_of_variance() -> None:
    """JCGM 100:2008, H.5, table H.9: a Zener standard on ten days, five observations a day, as daily means and deviations."""
    means = np.array([172, 116, 13, 144, 106, 31, 60, 125, 163, 41])  # µV above 10.000 V
    deviations = np.array([60, 77, 111, 101, 67, 93, 80, 73, 88, 86])
    standardised = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / math.sqrt(2.5)  # mean 0, standard deviation 1
    values = (means[:, None] + deviations[:, None] * standardised).ravel()
    split = analysis_of_variance(values, np.repeat(np.arange(10), 5))
    # s_a² = 5·(57 µV)² = (128 µV)² with 9, s_b² = (85 µV)² with 40 degrees of freedom; F = 2.25.
    assert math.sqrt(split.within) == pytest.approx(85, abs=0.5) and split.within_freedom == 40
    assert split.mean_uncertainty * math.sqrt(10) == pytest.approx(57, abs=0.5) and split.mean_freedom == 9
    assert split.ratio == pytest.approx(2.25, abs=0.02)
    # s_B² = (s_a² − s_b²)/5 = (43 µV)².
    assert math.sqrt(split.between) == pytest.approx(43, abs=0.5)


def test_scipy_agrees() -> None:
    stats = pytest.importorskip("scipy.stats")
    draw = np.random.default_rng(1)
    groups = [draw.normal(k, 1, size) for k, size in enumerate((3, 5, 4))]
    expected = stats.f_oneway(*groups)
    split = analysis_of_variance(np.concatenate(groups), np.repeat(np.arange(3), (3, 5, 4)))
    assert (split.ratio, split.probability) == pytest.approx((expected.statistic, expected.pvalue), rel=1e-9)


# -- against the truth -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_truth_within_the_stated_uncertainty() -> None:
    """10 000 tests of five days with four repeats each: means by Student's t, s by χ², the variance between groups without bias."""
    from scipy.stats import t as student

    draw, runs = np.random.default_rng(3), 10_000
    group = np.repeat(np.arange(5), 4)
    values = 10 + 3 * np.repeat(draw.standard_normal((runs, 5)), 4, axis=1) + 2 * draw.standard_normal((runs, 20))
    splits = [analysis_of_variance(row, group) for row in values]
    wide = [student.ppf(0.975, one.mean_freedom) * one.mean_uncertainty for one in splits]
    inside = np.mean([abs(one.mean - 10) <= u for one, u in zip(splits, wide, strict=True)])
    scatter = 4 * math.sqrt(0.95 * 0.05 / runs)
    assert inside == pytest.approx(0.95, abs=scatter)
    bounds = [deviation_interval(one.within, one.within_freedom) for one in splits]
    assert np.mean([low**2 <= 4 <= high**2 for low, high in bounds]) == pytest.approx(0.95, abs=scatter)
    together = np.mean([low <= 13 <= high for low, high in (one.total_interval for one in splits)])
    assert together == pytest.approx(0.95, abs=scatter + 0.005)  # Graybill and Wang's is approximate
    assert np.mean([one.between for one in splits]) == pytest.approx(9.0, abs=0.3)
    assert np.mean([one.between_uncertainty**2 for one in splits]) == pytest.approx(
        np.var([one.between for one in splits]), rel=0.6
    )


@pytest.mark.slow
def test_recorded_repeats_give_the_scatter_of_the_instrument_and_of_its_noise() -> None:
    """300 recordings of five days with four repeats each, whose samples are noisy: the scatter of the means is that of the repeats, 2, and
    of the noise, 1, together."""
    draw, runs, inside, within, between = np.random.default_rng(4), 300, [], [], []
    planned = [segment(f"{day}{k}") for day in "abcde" for k in range(4)]
    parameters = RepeatabilityParameters(channels=("gyro",), groups={day: (f"{day}*",) for day in "abcde"})
    for _ in range(runs):
        values = 10 + 3 * np.repeat(draw.standard_normal(5), 4) + 2 * draw.standard_normal(20)
        recorded = tuple(
            noisy(one, {"gyro": value}, "deg/h", 1.0, draw, 300.0 * k, samples=64)
            for k, (one, value) in enumerate(zip(planned, values.tolist(), strict=True))
        )
        found = Repeatability().estimate(EstimateRequest("again", recorded, parameters, SITE, sensor("gyro")))
        mean = found["mean_gyro"]
        inside.append(abs(mean.value - 10) <= expanded_uncertainty(mean.standard_uncertainty, mean.degrees_of_freedom))
        within.append(found["s_gyro"].value ** 2)
        between.append(found["s_total_gyro"].value ** 2 - within[-1])
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / runs))
    assert np.mean(within) == pytest.approx(5.0, rel=4 * math.sqrt(2 / 15 / runs))
    assert np.mean(between) == pytest.approx(
        9.0, rel=0.15
    )  # (9 + 5/4)·√(2/4/600) is 3 %; a negative variance counts as zero


# -- channels --------------------------------------------------------------------------------------------------------


def test_means_of_segments_by_group() -> None:
    values = {"day1/r1": 1.0, "day1/r2": 3.0, "day2/r1": 6.0, "day2/r2": 8.0}
    recorded = tuple(from_means(segment(label), {"gyro": value}, "deg/h", 0.5) for label, value in values.items())
    parameters = RepeatabilityParameters(channels=("gyro",), groups={"one": ("day1",), "two": ("day2/*",)})
    request = EstimateRequest("again", recorded, parameters, SITE, sensor("gyro"))
    found = Repeatability().estimate(request)
    assert found["s_between_gyro"].value == pytest.approx(math.sqrt(11.5), rel=1e-9)
    assert found["mean_gyro"].unit == "deg/h"
    assert any("groups" in note and "F = 12.5" in note for note in found.notes)


def test_groups_that_do_not_differ_say_so() -> None:
    found = of_values({"a1": 1, "a2": 3, "b1": 1.2, "b2": 3.1}, groups={"a": ("a*",), "b": ("b*",)})
    assert found["s_between_K"].value == 0 and found["s_between_K"].standard_uncertainty > 0
    assert any("the differences between the groups do not" in note for note in found.notes)


# -- what cannot be done ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "keys", "words"),
    [
        (("r1",), {}, "one estimate is not enough for repeatability"),
        ((), {}, "nothing to compare"),
        (("r1", "r2"), {"channels": ("gyro",)}, "both `channels` and `uses`"),
        (("r1", "r2"), {"coefficients": ("Q",)}, "no coefficient common to all estimates matches 'Q'"),
        (("a1", "a2", "d1"), {"groups": DAYS}, "'d1' belongs to no group"),
        (("a1", "a2", "b1"), {"groups": DAYS}, "the group 'c' is empty"),
        (("a1", "a2", "b1"), {"groups": {"a": ("a*",), "b": ("*",)}}, "'a1' belongs to a and b"),
        (("a1", "b1", "c1"), {"groups": DAYS}, "with at least two members"),
        (("a1", "a2"), {"groups": {"a": ("a*",)}}, "give at least two groups"),
    ],
)
def test_bad_plans(names: tuple[str, ...], keys: dict[str, object], words: str) -> None:
    with pytest.raises(EstimationError, match=words):
        of_values(dict.fromkeys(names, 1.0), **keys)


def test_unlike_estimates() -> None:
    with pytest.raises(EstimationError, match="no coefficient in common"):
        repeats({"a": given(1.0), "b": given(1.0, name="B")})
    with pytest.raises(EstimationError, match="different units"):
        repeats({"a": given(1.0), "b": given(1.0, unit="deg/h")})
    with pytest.raises(EstimationError, match="not a finite number"):
        repeats({"a": given(1.0), "b": given(math.nan)})


def test_bad_recordings() -> None:
    one = from_means(segment("r1"), {"gyro": 1.0}, "deg/h", 0.1)
    other = from_means(segment("r2"), {"gyro": 1.0}, "deg/s", 0.1)
    for recorded, channel, words in (
        ((one,), "gyro", "one segment is not enough for repeatability"),
        ((one, one), "gyrq", "has no channel 'gyrq'"),
        ((one, other), "gyro", "different units"),
        ((one, from_means(segment("r3"), {"gyro": math.nan}, "deg/h", count=0)), "gyro", "no usable samples"),
    ):
        request = EstimateRequest("again", recorded, RepeatabilityParameters(channels=(channel,)), SITE, sensor("gyro"))
        with pytest.raises(EstimationError, match=words):
            Repeatability().estimate(request)


def test_a_plan_without_repeats_is_refused_before_the_run() -> None:
    request = DesignRequest(
        "again", (segment("r1"),), RepeatabilityParameters(channels=("gyro",)), SITE, sensor("gyro")
    )
    with pytest.raises(EstimationError, match="one segment is not enough for repeatability"):
        designed(Repeatability(), request)


def test_angles_on_either_side_of_zero_are_near_each_other() -> None:
    """359.9 and 0.1 deg: mean 0, standard deviation 0.2/√2."""
    each = [
        Estimate("n", "e", (Coefficient("heading", value, "deg", 0.05, period=360.0),), np.eye(1))
        for value in (359.9, 0.1)
    ]
    parameters = RepeatabilityParameters()
    request = EstimateRequest("r", (), parameters, SITE, sensor("gyro"), {"a": each[0], "b": each[1]})
    found = {item.name: item for item in Repeatability().estimate(request).coefficients}
    assert found["mean_heading"].value == pytest.approx(0.0, abs=1e-9)
    assert found["mean_heading"].period == 360.0
    assert found["s_heading"].value == pytest.approx(0.2 / np.sqrt(2))
    assert "repeatability_heading" not in found


# -- what the repeats themselves contradict ----------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "groups"), [(8, 1), (20, 1), (60, 3)])
def test_values_in_random_order_are_doubted_as_often_as_stated(count: int, groups: int) -> None:
    draw, tries = np.random.default_rng(count), 2000
    group = np.arange(count) * groups // count
    doubted = np.mean([chance_of_order(draw.standard_normal(count) + 5 * group, group) < 0.01 for _ in range(tries)])
    assert abs(doubted - 0.01) < 4 * math.sqrt(0.01 * 0.99 / tries)


def test_blocks_that_differ_and_a_drift_are_named() -> None:
    noise = np.random.default_rng(3).standard_normal(60)
    blocks, ramp = 1000 + noise + 2 * (np.arange(60) // 20), 1000 + noise + np.arange(60) / 15
    for values in (blocks, ramp):
        found = of_values({f"r{k:02d}": float(value) for k, value in enumerate(values)})
        assert [text for text in found.warnings if "`groups`" in text]
    named = {"first": ("r0*", "r1*"), "second": ("r2*", "r3*"), "third": ("r4*", "r5*")}
    found = of_values({f"r{k:02d}": float(value) for k, value in enumerate(blocks)}, groups=named)
    assert not [text for text in found.warnings if "`groups`" in text]


@pytest.mark.parametrize("labels", ["start{0:02d}", "{1}/r{0}", "s{1}{0:02d}"])
def test_three_blocks_of_twenty_start_ups_that_differ_are_named(labels: str) -> None:
    """Blocks whose means differ by a third of the scatter each way, F = 6.9, p 0.002: too little for the order of the single values."""
    noise = np.random.default_rng(0).standard_normal((3, 20))
    noise = (noise - noise.mean(axis=1, keepdims=True)) / noise.std(axis=1, ddof=1, keepdims=True)
    values = (noise + np.array([[-0.59], [0.0], [0.59]])).ravel()
    split = analysis_of_variance(values, np.repeat(np.arange(3), 20))
    assert 0.001 < split.probability < 0.003
    found = of_values({labels.format(k, "abc"[k // 20]): 1000 + float(value) for k, value in enumerate(values)})
    (said,) = [text for text in found.warnings if "`groups`" in text]
    assert f"{split.ratio:.3g}" in said and "differ between these groups" in said


def test_pauses_divide_repeats() -> None:
    """Five segments, a night, and four more."""
    shift = [0, 0, 0, 0, 0, 8, 8, 8, 8]
    noise = np.random.default_rng(2).standard_normal(9)
    recorded = tuple(
        from_means(
            segment(f"turn-on {chr(97 + k)}"),
            {"gyro": 50 + shift[k] + noise[k]},
            "deg/h",
            2.0,
            start=300.0 * k + 5e4 * (k > 4),
        )
        for k in range(9)
    )
    request = EstimateRequest("again", recorded, RepeatabilityParameters(channels=("gyro",)), SITE, sensor("gyro"))
    assert any(
        "turn-on a … turn-on e, turn-on f … turn-on i" in text for text in Repeatability().estimate(request).warnings
    )


def test_one_group_is_divided_as_rarely_as_stated() -> None:
    draw, tries = np.random.default_rng(5), 200
    labels = [f"{'ab'[k % 2]}{k}" for k in range(24)]
    found = (
        of_values(dict(zip(labels, draw.standard_normal(24).tolist(), strict=True))).warnings for _ in range(tries)
    )
    doubted = sum(any("differ between these groups" in text for text in warnings) for warnings in found)
    assert doubted <= 0.01 * tries + 4 * math.sqrt(0.01 * tries)


def test_groups_that_scatter_differently_are_named() -> None:
    draw = np.random.default_rng(1)
    values = {
        f"{day}{k}": float(size * draw.standard_normal()) for day, size in (("a", 1.0), ("b", 10.0)) for k in range(8)
    }
    found = of_values(values, groups={"a": ("a*",), "b": ("b*",)})
    assert any("scatter within the groups differs" in text for text in found.warnings)
    alike = of_values(
        {name: value / (10 if name[0] == "b" else 1) for name, value in values.items()},
        groups={"a": ("a*",), "b": ("b*",)},
    )
    assert not any("scatter within the groups differs" in text for text in alike.warnings)


def test_repeats_that_scatter_more_than_their_uncertainties_are_named() -> None:
    """Nine repeats of u = 0.1 that scatter by 2: the uncertainty of each is twenty times too small for the next."""
    values = {f"r{k}": 5 + 2 * float(value) for k, value in enumerate(np.random.default_rng(8).standard_normal(9))}
    assert [text for text in of_values(values).warnings if "scatter" in text]
    quiet = {name: 5 + (value - 5) / 20 for name, value in values.items()}
    assert not of_values(quiet).warnings


def test_coefficients_with_different_names_are_compared() -> None:
    """1.0, 1.2 and 1.1 with u = 0.01: the mean square is 0.01, so the repeats scatter ten times as much as stated."""
    values = {"x": 1.0, "y": 1.2, "z": 1.1}
    made = {f"of_{axis}": given(value, f"r_accel_{axis}", "m", 0.01) for axis, value in values.items()}
    quantities = {"r": tuple(f"of_{axis}.r_accel_{axis}" for axis in "xyz")}
    found = repeats(made, quantities=quantities)
    assert found["mean_r"].value == pytest.approx(1.1)
    assert found["s_r"].value == pytest.approx(0.1)
    assert any("10 times as much" in text for text in found.warnings)
    for wrong in ("of_w.r_accel_w", "of_x.r_accel_w"):
        with pytest.raises(EstimationError, match=r"of_w|r_accel_w"):
            repeats(made, quantities={"r": ("of_x.r_accel_x", wrong)})
    with pytest.raises(EstimationError, match="leave `coefficients`"):
        repeats(made, quantities=quantities, coefficients=("r",))


def test_a_quantity_contains_each_coefficient_once() -> None:
    made = {f"of_{axis}": given(value, f"r_{axis}", "m", 0.01) for axis, value in (("x", 1.0), ("y", 1.2))}
    quantities: dict[str, tuple[str, ...]] = {"r": ("of_x.r_x", "of_y.r_y", "of_x.r_x")}
    with pytest.raises(EstimationError, match=r"the quantity 'r' contains 'of_x.r_x' twice"):
        repeats(made, quantities=quantities)
    parameters, uses = RepeatabilityParameters(quantities=quantities), dict.fromkeys(made, Design(()))
    request = DesignRequest("again", (), parameters, SITE, sensor("gyro"), uses)
    with pytest.raises(EstimationError, match="twice"):
        Repeatability().design(request)


@pytest.mark.parametrize("correlation", [0.0, 0.9, -0.9])
def test_correlated_coefficients_of_one_estimate_are_named(correlation: float) -> None:
    """Two coefficients of `one` and one of `other`: the difference of the first two has the variance 2u²(1 − r) instead of 2u²."""
    u = 0.1
    items = tuple(Coefficient(f"r_{axis}", 1.0 + 0.1 * k, "m", u) for k, axis in enumerate("xy"))
    one = Estimate("cal", "other", items, u**2 * np.array([[1.0, correlation], [correlation, 1.0]]))
    made = {"one": one, "other": given(0.95, "r_z", "m", u)}
    found = repeats(made, quantities={"r": ("one.r_x", "other.r_z", "one.r_y")})
    words = [text for text in found.warnings if "coefficients of the same estimate" in text]
    assert bool(words) == bool(correlation) and all(f"{correlation:.2g})" in text for text in words)
