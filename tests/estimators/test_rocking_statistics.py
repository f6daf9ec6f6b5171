"""Step 6, its uncertainty and random pairings, against figures worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rocking_recordings import planned

from planrunner.estimators.rocking.report import comparison, sentence
from planrunner.estimators.rocking.runs import by_state, find_runs, quadruples
from planrunner.estimators.rocking.statistics import Pairings, StateDrifts, combine, pair
from planrunner.estimators.rocking.windows import RecordPiece, low_pass, passed


def four_runs(state: str, count: int = 1):
    segments = [
        planned(state, name, 4 * number + place, 600.0)
        for number in range(count)
        for place, name in enumerate(("static-1", "dynamic-1", "dynamic-2", "static-2"))
    ]
    return tuple(quadruples(find_runs(segments, "xzy")))


def drifts(level, quadruples_, *values):
    return StateDrifts("s", level, quadruples_, np.array(values, dtype=float))


def columns(*figures):
    """Four runs of one quadruple: two axes by the accelerometers, the same doubled by the gimbals."""
    return [[a, b, 2 * a, 2 * b] for a, b in figures]


def test_a_quadruple_by_hand():
    """(1.3 + 1.5)/2 − (1.0 + 1.2)/2 = 0.3; a drift that grows by 0.1 a run leaves 0."""
    state = drifts((0, 2), four_runs("vertical"), columns((1.0, 0.0), (1.3, 0.1), (1.5, 0.2), (1.2, 0.3)))
    np.testing.assert_allclose(state.rocking[0], [0.3, 0.0, 0.6, 0.0], atol=1e-15)


def test_uncertainty_of_one_quadruple_by_hand():
    """x: the dynamic runs differ by 0.2, the static ones by 0.2: variances 0.02 each, halved, summed: 0.02."""
    state = drifts((0, 2), four_runs("vertical"), columns((1.0, 0.0), (1.3, 0.1), (1.5, 0.2), (1.2, 0.3)))
    covariance, freedom = state.scatter()
    assert covariance[0, 0] == pytest.approx(0.02)
    assert covariance[1, 1] == pytest.approx((0.1**2 + 0.3**2) / 4)
    assert freedom == 1.0


def test_uncertainty_of_repeats_by_hand():
    """Rocking drifts 0.1, 0.2, 0.3: standard deviation 0.1, of the mean 0.1/√3, two degrees of freedom."""
    values = [columns((0, 0), (v, -v), (v, -v), (0, 0)) for v in (0.1, 0.2, 0.3)]
    state = drifts((0, 2), four_runs("vertical", 3), *values)
    covariance, freedom = state.scatter()
    assert math.sqrt(covariance[0, 0]) == pytest.approx(0.1 / math.sqrt(3))
    assert covariance[0, 1] == pytest.approx(-0.01 / 3)
    assert freedom == 2.0


def test_an_axis_that_is_level_twice_has_the_mean_of_both_states():
    vertical = drifts(
        (0, 2), four_runs("vertical", 2), *[columns((0, 0), (1.0, v), (1.0, v), (0, 0)) for v in (0.2, 0.4)]
    )
    horizontal = drifts(
        (1, 2), four_runs("horizontal", 2), *[columns((0, 0), (3.0, v), (3.0, v), (0, 0)) for v in (0.5, 0.5)]
    )
    found = combine([vertical, horizontal])
    assert found.axes == (0, 1, 2, 0, 1, 2)
    assert found.by_gimbals == (False, False, False, True, True, True)
    np.testing.assert_allclose(found.values, [1.0, 3.0, 0.4, 2.0, 6.0, 0.8])
    # z: half of 0.3 ± 0.1 and half of 0.5 ± 0: the whole scatter has one degree of freedom
    assert math.sqrt(found.covariance[2, 2]) == pytest.approx(0.05)
    assert found.degrees_of_freedom == (1.0,) * 6
    assert np.all(np.linalg.eigvalsh(found.covariance) > -1e-15)


def test_all_pairs_where_they_are_few_and_a_seeded_draw_where_they_are_many():
    values = [columns((0, 0), (v, v), (v + 1, v), (10, 0)) for v in (1, 2)]
    state = drifts((0, 2), four_runs("vertical", 2), *values)
    x, z = pair([state], 200, 1)
    # four static runs 0, 10, 0, 10 and four dynamic ones 1, 2, 2, 3
    assert sorted(x.accelerometers) == sorted(d - s for s in (0, 10, 0, 10) for d in (1, 2, 2, 3))
    assert len(z.accelerometers) == 16
    np.testing.assert_allclose(x.gimbals, 2 * x.accelerometers)
    few, again, other = (pair([state], 5, seed)[0] for seed in (1, 1, 2))
    assert len(few.accelerometers) == 5
    np.testing.assert_array_equal(few.accelerometers, again.accelerometers)
    assert not np.array_equal(few.accelerometers, other.accelerometers)


def test_the_headline_by_hand():
    better = Pairings(0, np.array([0.1, -0.1, 0.2, -0.2]), np.array([1.0, -0.05, 2.0, -2.0]))
    worse = Pairings(2, np.array([1.0, -1.0, 1.0, -1.0]), np.array([0.1, 0.2, 0.1, 2.0]))
    assert better.smaller == 0.75
    assert better.deviations[0] == pytest.approx(np.sqrt(0.1 / 3))
    text = sentence([better, worse])
    assert "smaller standard deviation on x, not on z" in text
    assert "In 50 % of the pairings" in text
    assert "not more than 70 % on z" in text
    assert "on every axis (x). In 75 %" in sentence([better])
    row = comparison([better]).rows[0]
    assert row[:2] == ("x", 4) and row[-1] == 0.75


def test_states_are_distinguished_by_their_orientation():
    groups = by_state([*four_runs("vertical", 2), *four_runs("horizontal")])
    assert [len(group) for group in groups] == [2, 1]
    assert [group[0].runs[0].state.level for group in groups] == [(0, 2), (1, 2)]


def test_the_filter_has_no_delay_and_no_edges_for_slow_tilts():
    """A parabola passes unchanged to its very ends; a slow sine is not shifted; rocking is taken out as its gain says."""
    time = np.arange(6000) / 50
    slow = 1e-3 + 2e-4 * time + 3e-7 * time**2
    np.testing.assert_allclose(low_pass(RecordPiece(time, slow[:, None]), 0.05)[:, 0], slow, rtol=1e-9)
    sine = np.sin(2 * np.pi * 0.01 * time)
    inside = slice(2000, 4000)
    np.testing.assert_allclose(low_pass(RecordPiece(time, sine[:, None]), 0.05)[inside, 0], sine[inside], atol=2e-3)
    rocking = np.sin(2 * np.pi * 0.2 * time)
    left = low_pass(RecordPiece(time, rocking[:, None]), 0.1)[inside, 0]
    assert np.abs(left).max() == pytest.approx(1 / 257, rel=0.05)
    assert passed(0.2, 0.1) == pytest.approx(1 / 257)


def test_noise_at_the_end_of_a_record_is_averaged_too():
    """The last window counts as much as the first: its noise is that of some seconds, not that of its last sample."""
    draw = np.random.default_rng(1)
    time = np.arange(3000) / 50
    ends = [low_pass(RecordPiece(time, draw.standard_normal((3000, 1))), 0.05)[-100:].mean() for _ in range(300)]
    # 0.05 Hz averages over about 10 s, half of them at an end: 1/√250 of a sample's noise, not 1
    assert np.std(ends) < 3 / math.sqrt(250)
