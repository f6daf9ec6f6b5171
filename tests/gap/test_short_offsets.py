"""Causes outside the catalogue that effects of the catalogue used to imitate: offsets of a few seconds, events of the noise, and effects
whose size depends on the motion in another way."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from math import factorial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import poisson

from planrunner.error_model.effects.gyro import GyroScaleAsymmetry
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import diagnose
from planrunner.gap.evidence.weighing import Left
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.open_set import ODD_SEGMENT, _with_events, competitors, look_alike
from planrunner.gap.hypotheses.outside import BURSTS, ENERGIES, _now_and_then, scopes_of
from planrunner.gap.hypotheses.patterns import WHOLE, Factor, Pattern, Sort
from planrunner.gap.hypotheses.short_offsets import (
    RATES,
    SHORT_OFFSETS,
    Events,
    ShortOffsets,
    _windows,
    averaged_over_rates,
)
from planrunner.plan.schedule import RecordedMotion, Rest, Spin
from tests.gap.turntable import ACCEL_WHITE, DEG, GYRO_WHITE, RATE, Fault, kept, record

Array = np.ndarray
SIGMA = GYRO_WHITE * np.sqrt(RATE)
THRICE = Pattern("3 per turn, alike", Sort.THRICE_PER_TURN, Factor.TABLE_ANGLE)


def offsets(segments: dict[int, float], size: float) -> Fault:
    """An offset of 3 s in the gyros in some segments, which begins at the given time in the segment, s."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        on = np.zeros(len(observed.time))
        for index, start in segments.items():
            since = observed.time - observed.time[observed.bounds[index]]
            on += (observed.owner == index) & (since >= start) & (since < start + 3)
        return size * SIGMA * np.outer(on, [1.0, -0.7, 0.3]), 0.0

    return fault


def test_a_few_offsets_of_some_seconds_are_one_pattern() -> None:
    """The flexible pattern needs an amplitude for each coefficient of all segments, the short offsets need one for each offset."""
    found = competitors(Weighing(record(seed=61, fault=offsets({2: 4.0, 9: 11.0, 17: 7.0, 25: 2.0}, 2.0)))).log_bayes
    assert found[SHORT_OFFSETS][0] > found[WHOLE[Sort.TRANSIENT]][0] + 20
    assert found[SHORT_OFFSETS][0] > 60


@pytest.mark.slow
def test_noise_holds_no_short_offsets() -> None:
    """Bayes factors of what is not there are below one on average."""
    found = np.array([competitors(Weighing(record(seed=100 + k))).log_bayes[SHORT_OFFSETS][0] for k in range(40)])
    assert found.max() < 3
    assert np.exp(found).mean() < 1


@pytest.mark.parametrize(
    ("segments", "size", "kind"),
    [({9: 11.0}, 1.0, "none"), ({9: 11.0}, 8.0, "unknown"), ({3: 3.0, 9: 11.0, 17: 7.0}, 1.0, "unknown")],
)
def test_a_single_small_event_is_noise(segments: dict[int, float], size: float, kind: str) -> None:
    """About eight standard deviations. Noise contains such an event now and then, but neither a much larger one nor several."""
    assert diagnose(record(seed=62, fault=offsets(segments, size))).verdict.kind == kind


@pytest.mark.parametrize("size", [3.5, 5.0])
def test_a_single_small_event_in_louder_noise_is_noise(size: float) -> None:
    """A wrong noise level is a separate cause. It does not change what a small event is."""
    offset = offsets({9: 11.0}, size)

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        louder = 3.0 * SIGMA * draw.standard_normal((len(observed.time), 3))
        return louder + offset(observed, omega, force, draw)[0], 0.0

    assert diagnose(record(seed=62, fault=fault)).verdict.effects == ("gyro_noise_excess",)


@pytest.mark.parametrize(("begin", "end", "size"), [(8, 20, 0.5), (0, 10, 0.7)])
def test_an_offset_of_most_of_a_segment_is_no_event_of_a_few_seconds(begin: float, end: float, size: float) -> None:
    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        since = observed.time - observed.time[observed.bounds[9]]
        on = (observed.owner == 9) & (since >= begin) & (since < end)
        return size * SIGMA * np.outer(on, [1.0, -0.7, 0.3]), 0.0

    assert diagnose(record(seed=62, fault=fault)).verdict.kind == "unknown"


def test_events_have_a_common_unknown_rate() -> None:
    """Three events in 500 s, by the Poisson probabilities of each number of events; a cause in their channels leaves one event."""
    gains, rate = np.array([20.0, 30.0, 25.0]), RATES[:, None]
    events = Events(gains, (frozenset({0}), frozenset({1, 2}), frozenset({1})), 500.0)
    sums = {0: 1.0, 1: np.exp(gains).sum(), 2: sum(np.exp(gains.sum() - gains)), 3: np.exp(gains.sum())}
    counts = np.array(list(sums))
    each = poisson.pmf(counts, rate * 500) * [factorial(n) / 500**n * sums[n] for n in sums]
    np.testing.assert_allclose(events.log_bayes(), np.log(each.sum(1)))
    np.testing.assert_allclose(events.log_bayes([0, 2]), np.log1p(RATES * np.exp(25)) - RATES * 500)
    assert averaged_over_rates(events.log_bayes()) == pytest.approx(np.log(each.sum(1).mean()))
    assert averaged_over_rates(np.full((2, 4), -1.0)).tolist() == [0.0, 0.0]


def test_a_pattern_of_all_channels_leaves_no_event_in_the_coefficients() -> None:
    """Events outside the coefficients, in 3600 s. That the coefficients contain none has its own probability at each rate."""
    patterns, events = SimpleNamespace(scopes=[[0], [1]]), Events(np.array([30.0]), (frozenset({0}),), 3600.0)
    outside = np.array([150.0, 190.0, 200.0, 200.0])
    value = _with_events(patterns, {ODD_SEGMENT: np.array([5.0])}, -np.inf, events, outside, 0.0)  # type: ignore[arg-type]
    assert value == pytest.approx(5 + np.log(np.exp(outside - 3600 * RATES).sum() / 4) - np.log(2))


def test_an_event_outside_the_coefficients_has_a_limited_size() -> None:
    """One of 200 windows of 2 s shows an event in one of two channels."""
    quiet = np.zeros((200, len(ENERGIES)))
    for size in (20.0, 300.0):
        loud = quiet.copy()
        loud[17] = size
        chance = 1 - np.exp(-2 * RATES)
        expected = np.log(1 - chance + chance * (np.exp(min(size, 50.0)) + 1) / 2)
        np.testing.assert_allclose(_now_and_then([[loud], [quiet]], 2.0), expected)


def _events(sizes: Sequence[tuple[int, int, float]]) -> Fault:
    """Offsets of 2 s in the gyros. sizes: of each offset, its segment, its axis, and its size in standard deviations of a sample."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        out = np.zeros_like(omega)
        for segment, axis, size in sizes:
            since = observed.time - observed.time[observed.bounds[segment]] - 6
            out[:, axis] += size * SIGMA * ((observed.owner == segment) & (since >= 0) & (since < 2))
        return out, 0.0

    return fault


@pytest.mark.parametrize("beside", [0.0, 1.5e-4])
def test_several_events_of_independent_channels_are_noise(beside: float) -> None:
    """Four events of about six standard deviations, alone and beside an asymmetry. No cause of theirs is certain."""
    events = _events([(3, 0, 1.3), (9, 1, -1.2), (17, 2, 1.4), (25, 1, 1.2)])

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return beside * np.abs(omega) + events(observed, omega, force, draw)[0], 0.0

    found = diagnose(record(seed=62, fault=fault))
    assert found.verdict.effects == (("gyro_scale_asymmetry",) if beside else ())
    assert sum(p for name, p in found.posterior.probability.items() if "unknown" in name.split("+")) < 0.5


@pytest.mark.parametrize(("segments", "something_else"), [([9], False), ([3, 9, 17], True)])
@pytest.mark.parametrize("size", [2.0, pytest.param(2.4, marks=pytest.mark.slow)])
def test_an_event_of_the_noise_is_no_cause_beside_an_effect(
    segments: list[int], something_else: bool, size: float
) -> None:
    """Ringing for 3 s, which appears outside the coefficients. A single event belongs to the noise, several do not."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        out = np.zeros(len(observed.time))
        for index in segments:
            since = observed.time - observed.time[observed.bounds[index]] - 8
            out += np.where((since >= 0) & (since < 3), np.cos(2 * np.pi * 4.3 * since), 0.0)
        return 1.5e-4 * np.abs(omega) + size * SIGMA * np.outer(out, [1.0, 0.0, -0.7]), 0.0

    said = diagnose(record(seed=62, fault=fault)).verdict
    assert said.effects == ("gyro_scale_asymmetry",)
    assert said.something_else == something_else


@pytest.mark.parametrize(("segments", "something_else"), [({9: 11.0}, False), ({3: 3.0, 9: 11.0, 17: 7.0}, True)])
def test_an_offset_of_the_noise_is_no_cause_beside_an_effect(segments: dict[int, float], something_else: bool) -> None:
    """The same offsets as without an effect."""
    events = offsets(segments, 1.0)

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 1.5e-4 * np.abs(omega) + events(observed, omega, force, draw)[0], 0.0

    said = diagnose(record(seed=62, fault=fault)).verdict
    assert said.effects == ("gyro_scale_asymmetry",)
    assert said.something_else == something_else


def test_bursts_are_found_while_the_table_turns_fast() -> None:
    """Harmonics of a fast turn are in the coefficients of a segment, so that no window there shows an offset. It shows the scatter."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        out = np.zeros(len(observed.time))
        for index in np.flatnonzero([isinstance(m, Spin) for m in observed.motions])[::4]:
            since = observed.time - observed.time[observed.bounds[index]] - 8
            out += np.where((since >= 0) & (since < 4), np.cos(2 * np.pi * 4.3 * since), 0.0)
        return 2.0 * SIGMA * np.outer(out, [1.0, 0.0, -0.7]), 0.0

    assert competitors(Weighing(record(seed=63, fault=fault))).log_bayes[BURSTS][0] > 30


@pytest.mark.parametrize(
    ("sizes", "kind"),
    [((1.0, 1.0, 1.0), "effect"), pytest.param((1.0, -1.6, 0.5), "unknown", marks=pytest.mark.slow)],
)
def test_an_effect_whose_size_is_another_in_each_motion_is_imitated(sizes: tuple[float, ...], kind: str) -> None:
    """An asymmetry at 18, 40 and 90 °/s."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        rate = np.abs(observed.rate) / DEG
        size = np.select([rate < 25, rate < 60], sizes[:2], sizes[2])
        return 1.5e-4 * np.abs(omega) * size[:, None], 0.0

    found = diagnose(record(seed=64, fault=fault))
    assert found.verdict.kind == kind


@pytest.mark.parametrize(("sizes", "least", "most"), [((1.0, 1.0, 1.0), -100, 0), ((1.0, -1.6, 0.5), 100, 1e5)])
def test_a_recorded_motion_is_another_in_each_segment(sizes: tuple[float, ...], least: float, most: float) -> None:
    """The same asymmetry, in 18 turns that a reference shows instead of commanded ones. Separate sizes cost evidence."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        rate = np.abs(observed.rate) / DEG
        size = np.select([rate < 25, rate < 60], sizes[:2], sizes[2])
        return 1.5e-4 * np.abs(omega) * size[:, None], 0.0

    whole = record(seed=64, fault=fault)
    whole = kept(whole, [index for index, m in enumerate(whole.motions) if isinstance(m, Rest | Spin)])
    motions = tuple(RecordedMotion(angle="encoder") if isinstance(m, Spin) else m for m in whole.motions)
    weighing = Weighing(replace(whole, motions=motions))
    (effect,) = weighing.weigh(GyroScaleAsymmetry().variants(weighing.observed))
    assert least < look_alike(weighing, [raw @ effect.amplitudes[0] for raw in effect.raw]) < most


@pytest.mark.parametrize("size", [1.8, pytest.param(2.5, marks=pytest.mark.slow)])
def test_an_effect_is_named_beside_an_offset_that_also_shows_outside_the_coefficients(size: float) -> None:
    """The offset explains 2 % of the gap. Its part outside the coefficients speaks for all hypotheses equally."""
    offset = offsets({9: 11.0}, size)

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 1.5e-4 * np.abs(omega) + offset(observed, omega, force, draw)[0], 0.0

    said = diagnose(record(seed=62, fault=fault)).verdict
    assert said.effects == ("gyro_scale_asymmetry",)
    assert said.something_else


def test_a_ripple_of_the_table_is_the_same_in_every_motion() -> None:
    """The rate of the table has three ripples per turn, of 100 ppm."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 1e-4 * np.cos(3 * observed.angle + 0.4)[:, None] * omega, 0.0

    found = competitors(Weighing(record(seed=65, fault=fault))).log_bayes
    assert found[THRICE][0] > found[WHOLE[Sort.THRICE_PER_TURN]][0] + 20


def test_a_ripple_of_the_catalogue_is_no_pattern_outside_it() -> None:
    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 1e-3 * np.cos(observed.angle + 0.4)[:, None] * omega, 0.0

    found = diagnose(record(seed=67, fault=fault))
    assert found.verdict.effects == ("table_rate_ripple",)
    assert not found.verdict.something_else


def test_a_class_contains_something_else_if_the_plan_cannot_exclude_it() -> None:
    """All turns come after all rests: what appears while the table turns may also have begun at that time."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[float, Array]:
        return 0.0, ACCEL_WHITE * np.outer(observed.rate != 0, [2.0, -1.0, 1.5])

    whole = record(seed=66, fault=fault)
    first = [index for index, m in enumerate(whole.motions) if isinstance(m, Rest) and index < 12]
    turns = [index for index, m in enumerate(whole.motions) if isinstance(m, Spin)]
    said = diagnose(kept(whole, first + turns)).verdict
    assert said.kind == "indistinguishable"
    assert {"accel_bias_step", "unknown"} <= set(said.members)


def _slow(observed: Observed) -> Observed:
    """The same recording of gyros with declared flicker and coloured noise: the means of all segments are whitened together."""
    channels = tuple(replace(one, flicker=one.white / 2) for one in observed.channels)
    noise = np.random.default_rng(3).standard_normal(observed.values.shape) * [one.white for one in channels]
    noise = lfilter([1.0], [1.0, -0.8], noise, axis=0) * np.sqrt(RATE)
    return replace(observed, channels=channels, values=observed.values + noise)


@pytest.mark.parametrize("setting", [0, -1])
@pytest.mark.parametrize("slow", [False, True])
def test_windows_are_weighed_as_their_whitened_coefficients(slow: bool, setting: int) -> None:
    """Energies and scores, before and after an offset has been fitted, against whitened windows of samples."""
    recorded = record(seed=61, fault=offsets({2: 4.0, 9: 11.0}, 2.0))
    weighing = Weighing(_slow(recorded) if slow else recorded)
    observed, left = weighing.observed, Left.whole(weighing.weights[0][setting])
    size, step, samples = 20, 10, int(np.diff(observed.bounds)[0])
    starts = np.concatenate([begin + np.arange(0, samples - size + 1, step) for begin in observed.bounds[:-1]])
    windows = np.zeros((len(observed.time), len(starts)))
    for column, start in zip(windows.T, starts, strict=True):
        column[start : start + size] = 1.0
    whitened = left.weight.project(weighing.spectrum.project(observed, windows))
    (one, *_), residual = ShortOffsets(weighing)._of(left), left.residual
    for fitted in (41, 150, 0):
        np.testing.assert_allclose(one.size, (whitened**2).sum(0), rtol=1e-9, atol=1e-12 * one.size.max())
        np.testing.assert_allclose(one.score, whitened.T @ residual, rtol=1e-7, atol=1e-7)
        unit = whitened[:, fitted] / np.linalg.norm(whitened[:, fitted])
        residual, whitened = residual - unit * (unit @ residual), whitened - np.outer(unit, unit @ whitened)
        one = one.without(fitted)


@pytest.mark.parametrize(("samples_per_second", "positions"), [(1.0, 1), (2.0, 2), (3.0, 3), (4.0, 2), (5.0, 2.5)])
def test_the_number_of_windows_is_that_of_windows_beside_each_other(
    samples_per_second: float, positions: float
) -> None:
    """Windows of one second contain 1 to 5 samples. In a segment of 20 s, 20 of them lie beside each other; at the ends of the segment,
    some positions are missing."""
    weighing = Weighing(record(seed=1, sampling=samples_per_second))
    windows = _windows(weighing, 1.0)
    assert windows is not None
    np.testing.assert_allclose(windows.share, 1 / positions)
    assert windows.count / len(weighing.observed) == pytest.approx(20, abs=1)


def test_windows_take_no_memory_that_grows_with_the_square_of_the_segments() -> None:
    """The whitened windows of a channel would be 8 bytes × 328 coefficients × 4592 windows, 12 MB; six channels are evaluated."""
    weighing = Weighing(record(seed=1, sampling=60.0))
    channels = [Left.whole(own[0]) for own in weighing.weights]
    tracemalloc.start()
    ShortOffsets(weighing).weighed(scopes_of(weighing), channels)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10e6
