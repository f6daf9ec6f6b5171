"""One-pass statistics against numpy on the whole arrays."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planrunner.archive import statistics as one_pass
from planrunner.archive.recording import BATCHES
from planrunner.archive.statistics import CHUNK, statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Motion, Rest, Spin

NAMES = ("x", "y", "z")


def blocks_of(time: np.ndarray, values: np.ndarray, cuts: list[int]) -> list[Block]:
    edges = [0, *sorted(cuts), len(time)]
    return [
        Block(time[low:high], {name: values[row, low:high] for row, name in enumerate(NAMES[: len(values)])})
        for low, high in pairwise(edges)
    ]


def by_numpy(values: np.ndarray, rows: int) -> np.ndarray:
    """The standard error from batch means, written plainly: one batch after the other."""
    edges = [round(rows * i / min(BATCHES, rows)) for i in range(min(BATCHES, rows) + 1)]
    means, counts = [], []
    for low, high in pairwise(edges):
        batch = values[:, low:high]
        batch = batch[:, np.isfinite(batch).all(axis=0)]
        if batch.shape[1]:
            means.append(batch.mean(axis=1))
            counts.append(batch.shape[1])
    weights = np.array(counts) / sum(counts)
    centre = weights @ np.array(means)
    return np.sqrt(weights @ (np.array(means) - centre) ** 2 / (len(means) - 1))


@pytest.mark.parametrize("rows", [2, 31, 32, 33, 1000, CHUNK, CHUNK + 1, 3 * CHUNK + 17])
@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_against_numpy(rows: int, missing: float) -> None:
    noise = np.random.default_rng(rows)
    values = noise.standard_normal((3, rows)) * np.array([[1.0], [1e-3], [50.0]]) + np.array([[1e4], [0.0], [-3.0]])
    time = np.cumsum(noise.uniform(0.5, 1.5, rows))
    holes = noise.random(rows) < missing
    holes[:2] = False
    values[1, holes] = np.nan
    got = statistics_of(blocks_of(time, values, [rows // 3, rows // 2]), NAMES, rows)
    good, when = values[:, ~holes], time[~holes]
    assert (got.count, got.rejected) == (good.shape[1], int(holes.sum()))
    np.testing.assert_allclose(got.mean, good.mean(axis=1), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(got.covariance, np.cov(good), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.standard_error, by_numpy(values, rows), rtol=1e-8)
    np.testing.assert_array_equal(got.minimum, good.min(axis=1))
    np.testing.assert_array_equal(got.maximum, good.max(axis=1))
    assert (got.start, got.end, got.largest_gap) == (when[0], when[-1], np.diff(when).max())


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_the_cuts_do_not_matter(data: st.DataObject) -> None:
    """Blocks, row groups and files may be cut anywhere: the last digit stays."""
    rows = data.draw(st.integers(1, 300))
    values = np.random.default_rng(rows).standard_normal((2, rows))
    for row in data.draw(st.lists(st.integers(0, rows - 1), max_size=5)):
        values[0, row] = data.draw(st.sampled_from([math.nan, math.inf, -math.inf]))
    time = np.arange(rows) * 0.1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(one_pass, "CHUNK", 37)
        one = statistics_of(blocks_of(time, values, []), NAMES[:2], rows)
        cuts = data.draw(st.lists(st.integers(0, rows), max_size=8))
        many = statistics_of(blocks_of(time, values, cuts), NAMES[:2], rows)
    assert one.count == many.count
    for name in ("mean", "covariance", "standard_error", "minimum", "maximum"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))
    good = values[:, np.isfinite(values).all(axis=0)]
    assert one.count == good.shape[1]
    if one.count:
        np.testing.assert_allclose(one.mean, good.mean(axis=1), rtol=1e-12, atol=1e-13)


def test_correlated_noise_has_a_larger_standard_error() -> None:
    """A first-order process with correlation 0.9: the mean's variance is (1 + 0.9)/(1 − 0.9) = 19 times that of white
    noise."""
    ratios = []
    for seed in range(40):
        white = np.random.default_rng(seed).standard_normal(20_000)
        values = np.empty_like(white)
        level = white[0] / math.sqrt(1 - 0.81)
        for i, push in enumerate(white):
            level = 0.9 * level + push
            values[i] = level
        got = statistics_of(blocks_of(np.arange(20_000.0), values[None], []), NAMES[:1], 20_000)
        ratios.append(got.standard_error[0] ** 2 * got.count / got.covariance[0, 0])
    assert np.mean(ratios) == pytest.approx(19, rel=0.15)


def test_few_and_no_samples() -> None:
    one = statistics_of(blocks_of(np.array([3.0]), np.array([[5.0]]), []), NAMES[:1], 1)
    assert (one.count, one.mean[0], one.start, one.end, one.largest_gap) == (1, 5.0, 3.0, 3.0, 0.0)
    assert math.isnan(one.standard_error[0])
    assert math.isnan(one.covariance[0, 0])
    none = statistics_of([], NAMES, 0)
    assert none.count == 0
    assert np.isnan(none.mean).all()
    lost = statistics_of(blocks_of(np.arange(3.0), np.full((1, 3), np.nan), []), NAMES[:1], 3)
    assert (lost.count, lost.rejected) == (0, 3)
    assert math.isnan(lost.mean[0])


def test_large_offset_keeps_its_digits() -> None:
    """Scatter of 1e-3 on 1e9, of which a naive sum of squares would lose every digit. The steps of 2⁻²³ are exact there."""
    noise = np.random.default_rng(1).standard_normal((2, 200_000))
    noise[1] += noise[0] + np.linspace(0, 30, 200_000)
    steps = np.round(noise * 1e-3 * 2**23) / 2**23
    got = statistics_of(blocks_of(np.arange(200_000.0), 1e9 + steps, [70_000]), NAMES[:2], 200_000)
    np.testing.assert_allclose(got.covariance, np.cov(steps), rtol=1e-11)
    np.testing.assert_allclose(got.standard_error, by_numpy(steps, 200_000), rtol=1e-11)
    np.testing.assert_allclose(got.mean - 1e9, steps.mean(axis=1), atol=2**-23)


def test_glitches_where_chunks_begin_cost_no_digits() -> None:
    """Products are summed about a chunk's first sample: the worst that this can be. Sums in long double tell what is right."""
    values = np.random.default_rng(2).standard_normal((2, 2 * CHUNK + 5))
    values[:, [0, CHUNK]] = [[1e6, -3e7], [2e9, 1e5]]
    got = statistics_of(blocks_of(np.arange(values.shape[1]) * 1.0, values, []), NAMES[:2], values.shape[1])
    exact = values.astype(np.longdouble)
    mean = exact.mean(axis=1)
    deviations = exact - mean[:, None]
    covariance = np.array([[(one * other).sum() for other in deviations] for one in deviations]) / (values.shape[1] - 1)
    assert (abs(got.mean - mean) < 1e-13 * np.sqrt(np.diag(covariance))).all()
    np.testing.assert_allclose(got.covariance, covariance.astype(float), rtol=1e-11)


def test_lost_blocks_leave_their_batches_empty() -> None:
    """A third of the rows lost in one piece, across blocks and batches, and the very first rows as well."""
    values = np.random.default_rng(3).standard_normal((2, 3200)) + 7
    values[0, 500:1500] = np.nan
    values[1, :7] = np.inf
    got = statistics_of(blocks_of(np.arange(3200.0), values, [7, 600, 700, 1450, 2000]), NAMES[:2], 3200)
    assert (got.count, got.rejected, got.batches, got.start, got.largest_gap) == (2193, 1007, BATCHES - 10, 7.0, 1001.0)
    np.testing.assert_allclose(got.standard_error, by_numpy(values, 3200), rtol=1e-12)


@pytest.mark.parametrize("motion", [Rest(), Spin(0.3, (0.0, 0.0, 1.0))], ids=["at rest", "turning"])
@pytest.mark.parametrize(
    ("time", "words"),
    [
        (np.zeros(400), "it is 0 s at the first of 400 samples and 0 s at the last"),
        (np.arange(400.0)[::-1], "it is 399 s at the first of 400 samples and 0 s at the last"),
        (np.full(400, np.nan), "the time of sample 1 is nan"),
        (np.where(np.arange(400) == 250, np.nan, np.arange(400.0)), "the time of sample 251 is nan"),
        (np.where(np.arange(400) == 399, np.inf, np.arange(400.0)), "the time of sample 400 is inf"),
    ],
    ids=["constant", "backwards", "missing", "one missing", "infinite"],
)
def test_times_that_are_no_times_are_named(motion: Motion, time: np.ndarray, words: str) -> None:
    values = np.random.default_rng(1).standard_normal(400)
    blocks = [Block(time[low : low + 97], {"x": values[low : low + 97]}) for low in range(0, 400, 97)]
    with pytest.raises(ValueError, match=words):
        statistics_of(blocks, ("x",), 400, motion=motion)


@pytest.mark.parametrize("wrong", [8, 5, 13])
def test_rejected_rows_count_in_the_number_of_a_sample_without_a_time(wrong: int) -> None:
    """Five rows without a value come before the row without a time, at any place in a block."""
    time, values = np.arange(20.0), np.ones(20)
    time[wrong], values[:5] = np.nan, np.nan
    blocks = [Block(time[low : low + 8], {"x": values[low : low + 8]}) for low in range(0, 20, 8)]
    with pytest.raises(ValueError, match=f"the time of sample {wrong + 1} is nan"):
        statistics_of(blocks, ("x",), 20)


@pytest.mark.parametrize("time", [(1.0, 2.0, 0.5), (5.0, 6.0, 1.0, 2.0)])
def test_a_single_step_back_in_time_raises_no_error(time: tuple[float, ...]) -> None:
    assert statistics_of([Block(np.array(time), {"x": np.ones(len(time))})], ("x",), len(time)).count == len(time)
