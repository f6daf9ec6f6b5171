"""Closure: intervals of known gaps, and what held-out segments can and cannot say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, t

from planrunner.error_model.observed import Observed
from planrunner.gap.answer.closure import (
    FOLDS,
    Amplitudes,
    Closure,
    KnownCause,
    NoiseLevels,
    NotMeasured,
    closure,
    dealt_by_motion,
    measured,
)
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions, diagnose
from planrunner.plan.schedule import Rock
from tests.gap.turntable import kept, record

Array = np.ndarray
SHOWN_BY_ROCKING = ("gyro_bandwidth", "time_latency", "table_tilt", "gyro_g_sensitivity")


def holds(found: Closure, gap: Array, difference: Array) -> bool:
    """Whether the interval contains the true share by which the gap shrinks."""
    true = 1 - np.linalg.norm(gap - difference) / np.linalg.norm(gap)
    return bool(found.interval_90[0] <= true <= found.interval_90[1])


def test_intervals_of_any_gap_cover_the_truth() -> None:
    """90 % intervals from residuals of a known gap cover the true shrinkage in at least 87 % of draws (binomial, 1 % level)."""
    draw = np.random.default_rng(7)
    m, covered, said = 400, 0, 0
    for _ in range(200):
        gap = draw.normal(size=m)
        gap *= 30 / np.linalg.norm(gap)
        miss = draw.normal(size=m)
        difference = gap + miss * draw.uniform(2, 25) / np.linalg.norm(miss)
        found = measured(gap + draw.normal(size=m), difference)
        if found.resolvable:
            said += 1
            covered += holds(found, gap, difference)
    assert said > 100
    assert covered >= binom.ppf(0.01, said, 0.9)


def test_intervals_of_an_explained_gap_cover_the_truth_and_no_more() -> None:
    """A gap that is a signature of five amplitudes, predicted from three times as many data as are held out: nine in ten intervals hold the
    truth (binomial, 1 % level either way), and they are narrower than those of any gap."""
    draw = np.random.default_rng(9)
    m, covered, tries, narrower = 600, 0, 200, 0
    for _ in range(tries):
        signature = draw.normal(size=(m, 5)) / np.sqrt(m)
        true = draw.normal(size=5) * 8
        residual = signature @ true + draw.normal(size=m)
        gram = signature.T @ signature
        predicted = true + np.linalg.cholesky(np.linalg.inv(3 * gram)) @ draw.normal(size=5)
        covariance = np.linalg.inv(4 * gram)
        mean = covariance @ (signature.T @ residual + 3 * gram @ predicted)
        difference = signature @ predicted
        amplitudes = Amplitudes(mean, np.linalg.cholesky(covariance)[None], np.array([np.inf]))
        cause = KnownCause(1.0, gram, signature.T @ difference, amplitudes)
        found, any_gap = measured(residual, difference, [cause], 0.0), measured(residual, difference)
        shrinks = 1 - np.linalg.norm(signature @ (true - predicted)) / np.linalg.norm(signature @ true)
        covered += bool(found.interval_90[0] <= shrinks <= found.interval_90[1])
        narrower += not any_gap.resolvable or np.ptp(found.interval_90) < np.ptp(any_gap.interval_90)
    assert binom.ppf(0.01, tries, 0.9) <= covered <= binom.ppf(0.99, tries, 0.9)
    assert narrower > 0.9 * tries


def test_intervals_of_a_fit_to_the_residuals_themselves_cover_the_truth() -> None:
    """A signature of three amplitudes is fitted to the very residuals that measure the gap. A part of the gap is no signature. With
    the number of fitted parameters told, 90 % intervals cover the true shrinkage in at least as many draws as chance allows at 1 %."""
    draw = np.random.default_rng(11)
    m, p, covered, said = 60, 3, 0, 0
    for _ in range(200):
        signature, _ = np.linalg.qr(draw.normal(size=(m, p)))
        gap = signature @ draw.normal(size=p) * 15 + draw.normal(size=m) * 0.8
        residual = gap + draw.normal(size=m)
        difference = signature @ (signature.T @ residual)
        found = measured(residual, difference, fitted=p - 1)
        if found.resolvable:
            said += 1
            covered += holds(found, gap, difference)
    assert said > 100
    assert covered >= binom.ppf(0.01, said, 0.9)


def test_closure_of_too_little_is_not_resolvable() -> None:
    draw = np.random.default_rng(8)
    assert not measured(draw.normal(size=400), draw.normal(size=400) * 0.05).resolvable


def test_every_fold_holds_some_of_every_motion() -> None:
    """However they are ordered: here every fourth segment turns, and every second of those the other way round."""
    kinds = ["Spin" if n % 4 == 0 else "Rest" for n in range(64)]
    dealt = dealt_by_motion(kinds)
    for fold in range(FOLDS):
        assert np.count_nonzero(dealt == fold) == 16
        assert np.count_nonzero(dealt[::4] == fold) == 4
        assert np.count_nonzero(dealt[::8] == fold) == 2


def test_few_residuals_give_wide_errors() -> None:
    """Amplitudes with Student's t distribution: nine in ten draws lie within the quantile of scipy's t."""
    one = np.ones((1, 1, 1))
    for degrees in (3.0, 10.0):
        drawn = Amplitudes(np.zeros(1), one, np.array([degrees])).drawn(20000, np.random.default_rng(3))
        inside = int(np.count_nonzero(np.abs(drawn) < t.ppf(0.95, degrees)))
        assert binom.ppf(0.001, 20000, 0.9) <= inside <= binom.ppf(0.999, 20000, 0.9)


@pytest.mark.parametrize("coefficients", [24, 60])
def test_few_residuals_of_the_noise_widen_the_interval_of_any_gap(coefficients: int) -> None:
    """The level of the noise comes from six residuals. 90 % intervals hold the truth in at least as many draws as chance allows at 1 %."""
    draw, degrees = np.random.default_rng(5), 6.0
    level = NoiseLevels(np.zeros(coefficients, dtype=np.int64), np.array([degrees]), np.array([False]))
    covered = said = 0
    for _ in range(120):
        gap = 3 * draw.normal(size=coefficients)
        difference = 0.7 * gap + draw.normal(size=coefficients)
        scale = np.sqrt(draw.chisquare(degrees) / degrees)
        residual = (gap + draw.normal(size=coefficients)) / scale
        found = measured(residual, difference / scale, levels=level)
        if found.resolvable:
            said += 1
            covered += holds(found, gap, difference)
    assert said > 80
    assert covered >= binom.ppf(0.01, said, 0.9)


def test_noise_that_may_be_smaller_than_measured_widens_the_interval_of_any_gap() -> None:
    """The noise has any share of the variance of the model, with equal probability. 90 % intervals hold the truth in at least as many draws
    as chance allows at 1 %. If the variance of the model is taken for that of the noise, they hold it in fewer than half of them."""
    draw, m, tries = np.random.default_rng(6), 300, 120
    every, covered = np.zeros(m, dtype=np.int64), {True: 0, False: 0}
    for _ in range(tries):
        gap = 2 * draw.normal(size=m)
        difference = 0.8 * gap + 0.5 * draw.normal(size=m)
        residual = gap + np.sqrt(draw.uniform()) * draw.normal(size=m)
        for limit in covered:
            level = NoiseLevels(every, np.array([300.0]), np.array([limit]))
            found = measured(residual, difference, levels=level)
            assert found.resolvable
            covered[limit] += holds(found, gap, difference)
    assert covered[True] >= binom.ppf(0.01, tries, 0.9)
    assert covered[False] < tries / 2


def _unbalance(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    return force @ np.array([[0, 4e-3, 0], [-2e-3, 0, 0], [0, 1e-3, 0]]).T * np.pi / 180 / 9.8, 0.0


def test_flicker_that_is_declared_but_absent_does_not_change_the_closure() -> None:
    """The recording contains white noise alone. The declared flicker of the second diagnosis is five times its noise of the means."""
    recorded = record(seed=44, fault=_unbalance)
    options, shut = DiagnosisOptions(effects=("gyro_g_sensitivity", "table_tilt")), []
    for flicker in (0.0, 2e-5):
        channels = tuple(replace(one, flicker=flicker) for one in recorded.channels)
        found = diagnose(replace(recorded, channels=channels), options)
        assert found.verdict.effects == ("gyro_g_sensitivity",)
        shut.append(found.closure)
    plain, flickering = shut
    assert flickering.shrinks_by == pytest.approx(plain.shrinks_by, abs=0.025)
    assert np.ptp(flickering.interval_90) == pytest.approx(np.ptp(plain.interval_90), rel=0.3)


def _walk(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    steps = np.sqrt(np.diff(observed.time, prepend=observed.time[0]))
    return np.cumsum(draw.normal(0, 2e-4 * np.pi / 180, omega.shape) * steps[:, None], axis=0), 0.0


def test_what_is_random_has_no_closure() -> None:
    found = diagnose(record(seed=14, fault=_walk), DiagnosisOptions(effects=("gyro_bias_random_walk", "table_tilt")))
    assert found.verdict.effects == ("gyro_bias_random_walk",)
    assert found.closure.reason is NotMeasured.RANDOM
    assert found.closure.unpredicted == ("gyro_bias_random_walk",)


def _late(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    """A lag of 1 ms: rates are behind by 1 ms times their change; the table turns about up."""
    about = np.einsum("sij,j->si", observed.attitude, [0.0, 0.0, 1.0])[observed.owner]
    return -1e-3 * observed.acceleration[:, None] * about, 0.0


def _rocking(number: int) -> Diagnosis:
    """Of a recording with a lag that rocks so many times."""
    whole = record(seed=41, fault=_late)
    rocks = [index for index, motion in enumerate(whole.motions) if isinstance(motion, Rock)]
    others = [index for index in range(len(whole)) if index not in rocks]
    return diagnose(kept(whole, sorted([*others, *rocks[:number]])), DiagnosisOptions(effects=SHOWN_BY_ROCKING))


@pytest.mark.parametrize(("rocks", "resolvable"), [(1, False), (3, True)])
def test_what_one_segment_alone_shows_cannot_be_seen_to_close(rocks: int, resolvable: bool) -> None:
    found = _rocking(rocks)
    assert found.verdict.kind in ("effect", "indistinguishable")
    assert set(found.verdict.effects) <= {"gyro_bandwidth", "time_latency"}
    assert found.closure.resolvable is resolvable
    if resolvable:
        assert found.closure.shrinks_by > 0.8
    else:
        assert found.to_json()["closure"]["interval_90"] is None
        assert found.closure.reason is NotMeasured.NOT_REPEATED
        assert found.closure.repetition is not None
        assert found.closure.repetition.shrinks_by > 0.8


def test_the_repetition_is_that_of_the_named_effect() -> None:
    """Another hypothesis explains hardly anything, but its single form is more probable than each of the two forms of the named effect:
    the gap shrinks as it does if the named effect is the only hypothesis."""
    found = _rocking(1)
    assert found.grounds is not None and found.grounds.noise is not None
    weighing, noise = found.grounds.weighing, found.grounds.noise
    named = max(found.grounds.choices, key=lambda choice: choice.probability)
    forms = [replace(named, probability=0.3)] * 2
    turned = [raw * np.resize([1.0, -1.0], len(raw))[:, None] for raw in named.raw]
    other = replace(named, effect="other", raw=tuple(turned), probability=0.4)
    alone = closure(weighing, noise, forms, 0.4, named.effect).repetition
    beside = closure(weighing, noise, [*forms, other], 0.0, named.effect).repetition
    assert alone is not None and beside is not None
    assert alone.shrinks_by > 0.8
    assert beside.shrinks_by == pytest.approx(alone.shrinks_by, abs=0.1)
