"""Drift that a test with few degrees of freedom neither shows nor excludes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

from planrunner.estimators.interface import Estimate
from planrunner.uncertainty.decision import expanded_uncertainty
from tests.worlds.campaigns import CAMPAIGNS, Campaign
from tests.worlds.coverage import estimated, known, recorded, tally
from tests.worlds.faults import WORLDS, Recorded
from tests.worlds.felt import felt

EIGHT = CAMPAIGNS["flexure_gyro_static"]


def with_drift(key: str, made: Recorded, basis: str = "within_segment", base: Campaign = EIGHT) -> Estimate:
    keys = f"segments: P*, uncertainty: {basis}{key}"
    asked = replace(base, plan=base.plan.replace("segments: P*", keys))
    one = estimated(asked, known(asked, WORLDS["warming up"]), made)
    assert isinstance(one, Estimate), one
    return one


def test_its_change_of_the_coefficients_is_an_error_that_is_not_corrected() -> None:
    """Each fitted coefficient has the value without a drift. Its uncertainty is that with a linear drift, combined with the difference
    between the two fits (JCGM 100:2008, F.2.4.5)."""
    _, made = recorded(EIGHT, WORLDS["warming up"], np.random.default_rng([13, 1]))
    doubted, without, linear = (with_drift(key, made) for key in ("", ", drift: none", ", drift: linear"))
    fitted = [item.name for item in doubted.coefficients if item.name[0] in "UV"]
    assert len(fitted) == 12
    for name in fitted:
        assert doubted[name].value == without[name].value
        change = linear[name].value - without[name].value
        together = np.hypot(linear[name].standard_uncertainty, change)
        assert doubted[name].standard_uncertainty == pytest.approx(together, rel=1e-6)
    lines = {line.quantity for line in doubted.budgets[0].lines}
    assert lines - {line.quantity for line in without.budgets[0].lines} == {
        "drift linear torquer_x",
        "drift linear torquer_y",
    }
    assert any("neither show nor exclude a drift" in text for text in doubted.warnings)


@pytest.mark.parametrize("basis", ["within_segment", "residual"])
def test_no_expanded_uncertainty_is_smaller_for_the_doubt(basis: str) -> None:
    """The scatter of the residuals shows the drift, too, so the doubt adds no degrees of freedom."""
    doubts = 0
    for run in range(6):
        _, made = recorded(EIGHT, WORLDS["warming up"], np.random.default_rng([17, run]))
        doubted, without = (with_drift(key, made, basis) for key in ("", ", drift: none"))
        if any("drift linear torquer_x" in line.quantity for line in doubted.budgets[0].lines):
            doubts += 1
            for one, other in zip(doubted.budgets, without.budgets, strict=True):
                wide, narrow = (own.coverage_factor * own.standard_uncertainty for own in (one, other))
                assert wide >= narrow * (1 - 1e-9), one.coefficient
    assert doubts


def test_many_degrees_of_freedom_leave_no_doubt() -> None:
    """Ten rates and two coefficients: what the evidence does not show is not in the uncertainties."""
    asked, world = CAMPAIGNS["scale_factor"], WORLDS["white noise"]
    sound = known(asked, world)
    for run in range(8):
        _, made = recorded(asked, world, np.random.default_rng([14, run]))
        one = estimated(asked, sound, made)
        assert isinstance(one, Estimate)
        assert not any("neither show nor exclude a drift" in text for text in one.warnings)


def test_a_temperature_that_looks_like_coefficients_is_an_error_that_is_not_corrected() -> None:
    """As a drift in doubt: the values stay, and the uncertainty is that with a drift with temperature, combined with the difference
    between the two fits."""
    world = WORLDS["temperature drift, recorded"]
    _, made = recorded(EIGHT, world, np.random.default_rng([18, 0]))
    found, without, fitted = (with_drift(key, made) for key in ("", ", drift: none", ", drift: temperature"))
    for item in found.coefficients:
        if item.name[0] in "UV":
            assert item.value == without[item.name].value
            change = fitted[item.name].value - without[item.name].value
            together = np.hypot(fitted[item.name].standard_uncertainty, change)
            assert item.standard_uncertainty == pytest.approx(together, rel=1e-6)
    [text] = [text for text in found.warnings if "hard to distinguish from" in text]
    assert "but the uncertainties include the change that the drift would cause" in text


def test_a_temperature_that_leaves_no_residuals_is_in_the_uncertainty() -> None:
    """Seven positions: a drift with temperature fits the means exactly. With one spare observation, the residuals without the drift
    measure the drift alone, so that the standard uncertainty of its amplitude is the amplitude itself."""
    seven = replace(EIGHT, plan=EIGHT.plan.replace("segments: P*", "segments: [P1, P2, P3, P4, P5, P6, P7]"))
    world = WORLDS["temperature drift, recorded"]
    _, made = recorded(EIGHT, world, np.random.default_rng([13, 1]))

    def with_keys(keys: str) -> Estimate:
        asked = replace(seven, plan=seven.plan.replace("P7]", f"P7], {keys}"))
        one = estimated(asked, known(asked, world), made)
        assert isinstance(one, Estimate), one
        return one

    found, without = with_keys("uncertainty: residual"), with_keys("uncertainty: residual, drift: none")
    fitted = with_keys("uncertainty: within_segment, drift: temperature")
    assert sum(item.name[0] in "UV" for item in found.coefficients) == 12
    for item in found.coefficients:
        assert np.isfinite(item.standard_uncertainty), item.name
        if item.name[0] in "UV":
            change = fitted[item.name].value - without[item.name].value
            together = np.hypot(without[item.name].standard_uncertainty, np.sqrt(2) * change)
            assert item.standard_uncertainty == pytest.approx(together, rel=1e-6)
    [text] = [text for text in found.warnings if "hard to distinguish from" in text]
    assert "but the uncertainties include the change that the drift would cause" in text


def in_another_order() -> Campaign:
    """The eight positions by the direction of z: a linear drift looks so much like coefficients that fitting it makes an uncertainty 3.4
    times as large."""
    steps = sorted(EIGHT.steps, key=lambda step: step.axes.split()[2])
    lines = EIGHT.plan.splitlines(keepends=True)
    rows = {step.label: line for step in steps for line in lines if f"label: {step.label}," in line}
    head, _, tail = EIGHT.plan.partition("".join(rows[step.label] for step in EIGHT.steps))
    return replace(EIGHT, plan=head + "".join(rows[step.label] for step in steps) + tail, steps=tuple(steps))


def test_a_temperature_that_rises_evenly_is_the_same_drift_as_the_time() -> None:
    """The linear drift is in doubt, and the temperature is proportional to the time. Each uncertainty is that with a linear drift, combined
    once with the difference between the two fits."""
    doubts, by_z = 0, in_another_order()
    for run in range(8):
        _, made = recorded(by_z, WORLDS["linear drift"], np.random.default_rng([19, run]))
        course = (made.time - made.time.mean()) / np.ptp(made.time)
        weaker = made.values - 7 * made.mean * np.sign(made.values[-1] - made.values[0]) * course[:, None]
        made = replace(made, values=weaker, celsius=20 + 8 * course)
        found, without, linear = (with_drift(key, made, base=by_z) for key in ("", ", drift: none", ", drift: linear"))
        in_doubt = [text for text in found.warnings if "neither show nor exclude a drift (linear" in text]
        if not in_doubt:
            continue
        doubts += 1
        assert in_doubt[0] in with_drift("", replace(made, celsius=None), base=by_z).warnings  # the same probability
        [text] = [text for text in found.warnings if "hard to distinguish from" in text]
        assert "but the uncertainties include the change that the drift would cause" in text
        for item in found.coefficients:
            if item.name[0] in "UV":
                change = linear[item.name].value - without[item.name].value
                together = np.hypot(linear[item.name].standard_uncertainty, change)
                assert item.standard_uncertainty == pytest.approx(together, rel=1e-6)
    assert doubts


def test_even_a_test_for_the_exact_form_misses_small_drifts() -> None:
    """What decisions 71 and 86 state about the eight positions. The residuals of the means have two dimensions for each output; λ is the
    energy of a warm-up in them, in units of their variance. A test that knows the form of the warm-up, but not its sizes in the two
    outputs, compares a non-central χ² with two degrees of freedom."""
    seen = felt(EIGHT.steps, EIGHT.sampling)
    share = (seen.time - seen.time[0]) / np.ptp(seen.time)
    rows = [seen.step == number for number in range(8)]
    means = [[*seen.rate[own, :2].mean(axis=0), *seen.force[own].mean(axis=0), 1.0] for own in rows]
    course = np.array([(1 - np.exp(-3 * share[own])).mean() for own in rows])
    left = course - np.array(means) @ np.linalg.lstsq(np.array(means), course, rcond=None)[0]

    def found(size: float, false_alarms: float) -> float:
        return float(ncx2.sf(chi2.isf(false_alarms, 2), 2, 2 * size**2 * left @ left))

    assert 2 * 10**2 * left @ left == pytest.approx(20, abs=0.05)
    assert [round(100 * found(10, rate), 1) for rate in (0.01, 0.05)] == [94.2, 98.5]
    assert round(100 * found(5, 0.224)) == 78


@pytest.mark.slow
def test_intervals_of_a_unit_that_warms_up_hold_the_truth() -> None:
    """150 runs: each coefficient within four binomial standard deviations of 95 %, and a warning that names the drift in all but two."""
    found = tally(EIGHT, WORLDS["warming up"], 150, 15)
    assert not found.failed
    assert found.named >= 148
    for name, held in found.held.items():
        assert held / 150 >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / 150), name


@pytest.mark.slow
def test_a_temperature_that_changes_is_named() -> None:
    """100 runs in which the effect of the temperature looks like coefficients: each has a warning that names the temperature and the key
    to write. Each coefficient is covered within four binomial standard deviations of 95 %."""
    world = WORLDS["temperature drift, recorded"]
    sound, inside = known(EIGHT, world), dict[str, int]()
    for run in range(100):
        truth, made = recorded(EIGHT, world, np.random.default_rng([16, run]))
        one = estimated(EIGHT, sound, made)
        assert isinstance(one, Estimate)
        assert any(world.cause in text and "Write `drift: " in text for text in one.warnings)
        for name, value in truth.items():
            wide = expanded_uncertainty(one[name].standard_uncertainty, one[name].degrees_of_freedom)
            inside[name] = inside.get(name, 0) + (abs(one[name].value - value) <= wide)
    for name, held in inside.items():
        assert held / 100 >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / 100), name
