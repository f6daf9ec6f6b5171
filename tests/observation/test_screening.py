"""Screening: what is found in known data, and that noise, counts and motion alone give no find."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.archive.recording import Find, FindKind
from planrunner.archive.statistics import statistics_of
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.observation.screening import Screening, threshold, watch_of
from planrunner.plan.schedule import Rest, Segment

Array = NDArray[np.float64]
ROWS, STEP = 6000, 0.02


def screened(
    values: Array, *, steady: bool = True, still: bool = False, time: Array | None = None, rows: int = 997
) -> tuple[Find, ...]:
    """values: (k, n)."""
    times: Array = np.asarray(100 + np.arange(values.shape[1]) * STEP if time is None else time, dtype=float)
    names = [f"c{k}" for k in range(len(values))]
    screening = Screening(dict.fromkeys(names, 0.0), {}, values.shape[1], steady=steady, still=still)
    for low in range(0, values.shape[1], rows):
        part = slice(low, low + rows)
        screening.add(Block(times[part], {name: values[k, part] for k, name in enumerate(names)}))
    return screening.finds()


def screened_while_read(values: Array, time: Array, edges: Sequence[int]) -> tuple[Find, ...]:
    """The same in blocks between these edges, in the pass that makes the statistics; its ranges decide what is looked at."""
    names = [f"c{k}" for k in range(len(values))]
    screening = Screening(dict.fromkeys(names, 0.0), {}, values.shape[1], steady=True)
    parts = [slice(low, high) for low, high in itertools.pairwise(edges)]
    blocks = [Block(time[part], {name: values[k, part] for k, name in enumerate(names)}) for part in parts]
    statistics_of(blocks, names, values.shape[1], screening)
    return screening.finds()


def noise(seed: int = 0, rows: int = ROWS, channels: int = 2) -> Array:
    return np.random.default_rng(seed).standard_normal((channels, rows))


def bad(finds: tuple[Find, ...]) -> list[tuple[FindKind, int, int]]:
    return [(one.kind, one.first, one.rows) for one in finds if one.bad]


def test_the_threshold_is_that_of_the_normal_distribution_for_many_samples_and_larger_for_few() -> None:
    """2·(1 − Φ(7.13)) = 10⁻¹²."""
    assert threshold(10**6) == pytest.approx(7.13, abs=0.01)
    assert threshold(20) > 100


def test_encoders_and_thermometers_are_left_alone() -> None:
    """A platform's ring stands between two rockings for many seconds, and its encoder at one count."""
    units = {"gyro_x": "deg/s", "gimbal_inner": "deg", "temperature": "degC"}
    sensor = SensorModel("under-test", tuple(OutputModel(*pair) for pair in units.items()), 10.0)
    screening = watch_of(sensor)(Segment(0, "S", np.eye(3), "", Rest(), 10.0), units, 100)
    assert isinstance(screening, Screening) and screening.channels == ("gyro_x",)


@pytest.mark.parametrize("size", [10.0, -1000.0])
def test_one_sample_is_found_and_its_size_is_stated(size: float) -> None:
    values = noise()
    values[1, 3000] += size
    (one,) = screened(values)
    assert (one.kind, one.channel, one.first, one.rows, one.bad) == (FindKind.SPIKE, "c1", 3000, 1, True)
    assert one.time == pytest.approx(160.0) and one.size == pytest.approx(size, abs=4) and 0.7 < one.noise < 1.3


@pytest.mark.parametrize("place", [3, 15, 5980, 5990, 5997])
def test_a_spike_near_an_end_of_a_slow_change_is_found_alone(place: int) -> None:
    """Two standard deviations from sample to sample, as gravity in the level axis of an element that is fixed in space."""
    values = noise() + 2.0 * np.arange(ROWS)
    values[1, place] += 1000
    assert bad(screened(values)) == [(FindKind.SPIKE, place, 1)]
    assert len(screened(values)) == 1


@pytest.mark.parametrize(
    ("rows", "place", "steady"),
    [(30, 12, True), (30, 23, True), (1800, 1798, True), (1800, 1798, False), (1800, 1, False)],
)
def test_a_spike_in_a_short_segment_or_next_to_its_end_is_found(rows: int, place: int, steady: bool) -> None:
    values = noise(rows=rows)
    values[1, place] += 1000
    assert bad(screened(values, steady=steady)) == [(FindKind.SPIKE, place, 1)]


@pytest.mark.parametrize("place", [0, 1, 5998, 5999, 16319, 16320, 16384, 16448])
def test_spikes_at_ends_and_at_the_borders_of_pieces_are_found_once(place: int) -> None:
    values = noise(3, rows=20_000 if place >= ROWS else ROWS, channels=1)
    values[0, place] += 100
    assert bad(screened(values)) == [(FindKind.SPIKE, place, 1)]


def test_a_burst_is_one_find() -> None:
    values = noise()
    values[0, 3000:3020] += 40 * np.where(np.arange(20) % 2, 1, -1)
    assert bad(screened(values)) == [(FindKind.BURST, 3000, 20)]


@pytest.mark.parametrize("begins", [True, False])
@pytest.mark.parametrize(
    ("shape", "left_out"),
    [
        ([-91.0, -79, -33, 95, 11, -36, 48, 5, 57], True),  # scatters
        ([80.0, -60, 40, -20], True),  # rings at half the sample rate
        (np.linspace(90, 10, 9), False),  # a table that slows down
        ([50.0] * 4, False),  # a rate that is reached four samples late
        (60 * np.sin(np.arange(1, 8) * np.pi / 4), False),  # an oscillation with eight samples per period
    ],
)
def test_a_burst_at_an_end_is_left_out_unless_it_may_be_motion(
    begins: bool, shape: Sequence[float], left_out: bool
) -> None:
    """At rest, motion is as wrong as any other cause."""
    values, rows = noise(channels=1), len(shape)
    place = slice(0, rows) if begins else slice(ROWS - rows, ROWS)
    values[0, place] += shape if begins else shape[::-1]
    (turning,), (resting,) = screened(values), screened(values, still=True)
    assert turning.kind is FindKind.BURST and abs(turning.rows - rows) <= 1
    assert (turning.bad, resting.bad) == (left_out, True)


def test_a_stuck_second_of_all_channels_is_found_in_each() -> None:
    values = noise()
    values[:, 3000:3050] = values[:, 2999:3000]
    found = screened(values)
    assert bad(found) == [(FindKind.STUCK, 2999, 51)] * 2
    assert {one.channel for one in found} == {"c0", "c1"} and found[0].seconds == pytest.approx(1.02)


def test_a_stretch_longer_than_a_piece_is_one_find() -> None:
    values = noise(2, rows=60_000, channels=1)
    values[0, 10_000:55_000] = 0.25
    assert bad(screened(values)) == [(FindKind.STUCK, 10_000, 45_000)]


def test_a_stretch_at_full_scale_is_clipped_and_cut_tops_are_reported_but_kept() -> None:
    values = noise(channels=1)
    values[0] = np.minimum(values[0], 1.0)
    (one,) = screened(values)
    assert (one.kind, one.size, one.bad) == (FindKind.CLIPPED, 1.0, False)
    values[0, 3000:3100] = 1.0
    assert (FindKind.CLIPPED, 3000, 100) in [
        (kind, max(first, 3000), 100) for kind, first, rows in bad(screened(values))
    ]


def test_a_step_is_reported_and_kept() -> None:
    values = noise()
    values[0, 3000:] += 1.0
    (one,) = screened(values)
    assert one.kind is FindKind.STEP and not one.bad
    assert one.size == pytest.approx(1, abs=0.3) and one.time == pytest.approx(160, abs=1)


@pytest.mark.parametrize("case", range(12))
def test_finds_are_the_same_while_the_statistics_are_made(case: int) -> None:
    """Samples are lost and repeated at the borders of blocks, in some cases also anywhere else; in some cases numbers are missing."""
    random = np.random.default_rng(case)
    values, rows = noise(case, rows=40_000), 40_000
    edges = [0, *np.unique(random.integers(1, rows, 1 + case)).tolist(), rows]
    inner = [] if case % 2 else random.integers(100, rows - 1, 6).tolist()
    places = [*inner, *edges[1:-1]]
    steps = np.full(rows, STEP)
    for place in places:
        steps[place] = random.choice([0.0, 3 * STEP])
        if not steps[place]:
            values[:, place] = values[:, place - 1]
    if case % 3 == 0:
        values[0, random.integers(0, rows, 4)] = np.nan
    values[1, random.integers(0, rows, 3)] += 50
    time = 100 + np.cumsum(steps)
    found = screened_while_read(values, time, edges)
    assert found == screened(values, time=time, rows=rows)
    assert {FindKind.LOST, FindKind.REPEATED} & {one.kind for one in found}


def test_lost_and_repeated_samples_are_read_from_the_time() -> None:
    values, time = noise(), np.asarray(100 + np.arange(ROWS) * STEP, dtype=float)
    kept = np.delete(np.arange(ROWS), [1000, 1001, 1002])
    (one,) = screened(values[:, kept], time=time[kept])
    assert (one.kind, one.first, one.size, one.bad) == (FindKind.LOST, 1000, 3.0, False)
    twice = np.insert(np.arange(ROWS), 2001, 2000)
    late = time[twice].copy()
    late[2001] += 0.001
    assert bad(screened(values[:, twice], time=late)) == [(FindKind.REPEATED, 2001, 1)]


COURSES: dict[str, Callable[[Array], Array]] = {
    "white": lambda x: x,
    "coarse counts": lambda x: 5 * np.round((x + 1.3) / 5),
    "fine counts": lambda x: 0.5 * np.round(x / 0.5),
    "rounding carried over": lambda x: 4 * np.diff(np.round(np.cumsum(x, axis=1) / 4), axis=1, prepend=0),
    "anti-correlated": lambda x: np.diff(x, axis=1, prepend=0),
    "filtered": lambda x: np.apply_along_axis(lambda row: np.convolve(row, np.ones(8) / 8, "same"), 1, x),
    "random walk": lambda x: np.cumsum(x, axis=1),
    "line": lambda x: x + 3 * np.sin(2 * np.pi * 20 * STEP * np.arange(x.shape[1])),
    "turning": lambda x: 1e-3 * x + 100 * np.sin(2 * np.pi * 0.05 * STEP * np.arange(x.shape[1])),
    "no noise": lambda x: 0 * x + 100 * np.sin(2 * np.pi * 0.05 * STEP * np.arange(x.shape[1])),
    "no noise, counts": lambda x: np.round(0 * x + 100 * np.sin(2 * np.pi * 0.005 * STEP * np.arange(x.shape[1])), 1),
    "slow, coarse counts": lambda x: np.round(0.1 * x + 3 * np.sin(2 * np.pi * 0.005 * STEP * np.arange(x.shape[1]))),
    "constant": lambda x: 0 * x + 1.0,
    "held twice": lambda x: np.repeat(x[:, ::2], 2, axis=1),
}


@pytest.mark.parametrize("steady", [True, False])
@pytest.mark.parametrize("name", COURSES)
def test_noise_counts_and_motion_alone_give_no_bad_sample(name: str, steady: bool) -> None:
    for seed in range(3):
        assert bad(screened(COURSES[name](noise(seed)), steady=steady)) == []


@pytest.mark.parametrize("rows", [0, 1, 2, 5, 17, 60])
def test_short_segments_are_taken_as_they_are(rows: int) -> None:
    assert screened(noise(rows=rows)) == ()


def test_the_finds_do_not_depend_on_the_blocks_and_missing_numbers_are_passed_over() -> None:
    values = noise(5, rows=40_000)
    values[0, [5, 17_000, 30_000]] += 50
    values[1, 20_000:20_100] = 0.5
    values[0, 8000] = np.nan
    one = screened(values, rows=40_000)
    assert bad(one) == [
        (FindKind.SPIKE, 5, 1),
        (FindKind.SPIKE, 17_000, 1),
        (FindKind.STUCK, 20_000, 100),
        (FindKind.SPIKE, 30_000, 1),
    ]
    assert bad(screened(values, rows=313)) == bad(one)


def test_rest_at_one_coarse_count_between_many_motions_counts() -> None:
    """0.02 of noise never leaves a count of 0.1; smooth motion of some hundred counts does."""
    rng = np.random.default_rng(3)
    moving = np.repeat(np.arange(120) % 2, 500)
    wide = np.hanning(60)
    motion = 300 * np.convolve(rng.standard_normal(60_000) * moving, wide / wide.sum(), "same")
    values = np.round((motion + 0.02 * rng.standard_normal(60_000)) / 0.1) * 0.1
    assert bad(screened(values[None], steady=False)) == []


def test_samples_that_are_often_far_off_belong_to_the_noise() -> None:
    """Student's t with 2 degrees of freedom: many samples beyond any Gaussian bound."""
    values = np.random.default_rng(1).standard_t(2, (1, 40_000))
    found = screened(values)
    assert bad(found) == [] and any(one.kind is FindKind.SPIKE and one.count > 40 for one in found)


@pytest.mark.slow
def test_white_noise_of_ten_million_samples_gives_no_find() -> None:
    assert screened(noise(7, rows=10**7, channels=1), rows=65_536) == ()
