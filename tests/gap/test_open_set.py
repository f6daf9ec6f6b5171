"""Something else, of several sorts at once: what one sort does to the nominal parameters is not counted again in the others."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from planrunner.error_model.effects.gyro import GyroScaleAsymmetry
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.gap.evidence.weighing import Left
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.open_set import (
    PERIODIC,
    Kinds,
    Repeating,
    _one_segment,
    _within,
    competitors,
    something_else,
)
from planrunner.gap.hypotheses.outside import BURSTS
from planrunner.gap.hypotheses.patterns import CHANGING, WHOLE, Sort
from planrunner.plan.schedule import Spin
from tests.gap.turntable import DEG, GYRO_WHITE, RATE, record

Array = np.ndarray


@pytest.fixture(scope="module")
def rocked() -> tuple[Weighing, Kinds]:
    """The scale factor of z is another one while the table rocks: the fitted one is neither, and every turn about z stands off."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        rocking = (observed.acceleration != 0)[:, None]
        return np.where(rocking, omega * np.array([0.0, 0.0, 0.03]), 0.0), 0.0

    weighing = Weighing(record(seed=41, fault=fault))
    return weighing, competitors(weighing)


def test_no_evidence_is_more_than_half_the_energy(rocked: tuple[Weighing, Kinds]) -> None:
    """Of a Gaussian with known variance nothing gains more than it does by fitting every coefficient."""
    weighing, kinds = rocked
    most = sum(float(each[0].residual @ each[0].residual) for each in weighing.weights) / 2
    apart = sum(float(value[0]) for name, value in kinds.log_bayes.items() if name in SORTS)
    assert apart > most
    assert kinds.several[0] < most


def test_the_strongest_sort_is_counted_whole(rocked: tuple[Weighing, Kinds]) -> None:
    _, kinds = rocked
    assert kinds.several[0] > kinds.log_bayes[WHOLE[Sort.ROCKING]][0] - 10


def test_a_bias_that_swings_within_the_segments_is_not_counted_twice() -> None:
    """A period of 30 s, segments of 20 s: a sine explains means and transients, and is one pattern."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 1e-4 * np.sin(2 * np.pi * observed.time / 30)[:, None] * np.ones(3), 0.0

    weighing = Weighing(record(seed=42, fault=fault))
    kinds = competitors(weighing)
    most = sum(float(each[0].residual @ each[0].residual) for each in weighing.weights) / 2
    assert kinds.log_bayes[PERIODIC][0] + kinds.log_bayes[WHOLE[Sort.TRANSIENT]][0] > most
    assert kinds.several[0] < most


def test_what_shows_only_while_the_temperature_changes_is_one_pattern() -> None:
    """A bias of one gyro that fades within each of three segments, in which the chamber moves."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        since = observed.time - observed.time[observed.bounds[:-1]][observed.owner]
        sign = np.array([[1.0, -1.0, 0.7][k - 3] if 3 <= k < 6 else 0.0 for k in range(len(observed))])
        return np.outer(sign[observed.owner] * np.exp(-since / 15), [2e-4, 0.0, 0.0]), 0.0

    plain = record(seed=43, fault=fault)
    moving = (plain.owner >= 3) & (plain.owner < 6)
    since = plain.time - plain.time[plain.bounds[:-1]][plain.owner]
    found = competitors(Weighing(replace(plain, temperature=plain.temperature + np.where(moving, since, 0.0))))
    others = {name: value[0] for name, value in found.log_bayes.items() if name != CHANGING}
    assert found.log_bayes[CHANGING][0] > max(others.values()) + 20
    assert found.log_bayes[CHANGING][0] > found.several[0] + 20
    assert CHANGING not in competitors(Weighing(plain)).log_bayes


@pytest.mark.slow
def test_noise_holds_no_bursts() -> None:
    """Bayes factors of what is not there are below one on average: over many recordings none is large."""
    found = np.array([competitors(Weighing(record(seed=100 + k))).log_bayes[BURSTS][0] for k in range(60)])
    assert found.max() < 3
    assert np.exp(found).mean() < 1


@pytest.mark.parametrize("carrier", [0.0, 3.7])
def test_bursts_are_found(carrier: float) -> None:
    """Seven windows of three seconds in which two gyros stand off, or pick up a carrier."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        out = np.zeros(len(observed.time))
        for index in range(1, 20, 3):
            since = observed.time - observed.time[observed.bounds[index]] - draw.uniform(2, 12)
            out += np.where((since >= 0) & (since < 3), np.cos(2 * np.pi * carrier * since), 0.0)
        return 2.5 * GYRO_WHITE * np.sqrt(RATE) * np.outer(out, [1.0, 0.0, -0.7]), 0.0

    found = competitors(Weighing(record(seed=44, fault=fault))).log_bayes
    assert found[BURSTS][0] > 30


def test_a_saw_tooth_is_no_walk() -> None:
    """Eleven teeth over the run; a walk follows them as well as anything, but not for nothing."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        run = observed.time[-1] - observed.time[0]
        return 3e-3 * DEG * np.outer((observed.time - observed.time[0]) / run * 11.3 % 1, [1.0, -0.5, 0.8]), 0.0

    found = diagnose(record(seed=45, fault=fault))
    assert found.verdict.kind == "unknown"
    assert found.posterior.kinds[PERIODIC] > found.posterior.log_evidence["gyro_bias_random_walk"] + 10


@pytest.mark.parametrize(
    "effects",
    [
        pytest.param(("gyro_bias_random_walk", "gyro_bias_step", "gyro_g_sensitivity"), id="few"),
        pytest.param(None, marks=pytest.mark.slow, id="all"),
    ],
)
def test_what_a_periodic_bias_shows_within_the_windows_counts_too(effects: tuple[str, ...] | None) -> None:
    """The jumps of large teeth also look like bursts. As bursts of another cause, they would count in favour of the effects alone."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 0.02 * DEG * np.outer((observed.time / 48 + 0.2) % 1 - 0.5, [1.0, 0.6, 0.1]), 0.0

    found = diagnose(record(seed=4, fault=fault), DiagnosisOptions(effects=effects)).posterior
    both = found.kinds[PERIODIC] + found.kinds[BURSTS]
    assert found.kinds[BURSTS] > 100
    assert found.log_evidence["unknown"] > both - 10


@pytest.mark.parametrize(("fast", "least", "most"), [(1.0, -np.inf, 0.5), (0.6, 10.0, np.inf)])
def test_an_effect_has_the_same_size_in_every_motion(fast: float, least: float, most: float) -> None:
    """An asymmetry that is smaller at the largest rate. Patterns that do not know the effect find less."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        size = np.where(np.abs(observed.rate) > 60 * DEG, fast, 1.0)
        return 1e-3 * np.abs(omega) * size[:, None], 0.0

    weighing = Weighing(record(seed=46, fault=fault))
    (found,) = weighing.weigh(GyroScaleAsymmetry().variants(weighing.observed))
    beside = weighing.beside(found)
    amplitudes, _ = found.amplitudes
    knowing, _ = something_else(beside, [raw @ amplitudes for raw in found.raw])
    unknowing, _ = something_else(beside)
    assert least < knowing - unknowing < most


SORTS = [WHOLE[sort] for sort in (Sort.ROCKING, Sort.MEANS, Sort.TRANSIENT)]


@pytest.mark.parametrize(("per_force", "effects"), [(4e-5, 0), (4e-4, 1)])
def test_only_what_is_not_small_beside_something_unknown_is_named(per_force: float, effects: int) -> None:
    """Three waves per turn with a random phase in every segment are in no catalogue (850 nats). A bias that follows the specific force
    is named beside them if it is of their order, but not where it shows ten nats."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        turning = np.array([isinstance(motion, Spin) for motion in observed.motions])[observed.owner]
        phase = 0.3 * draw.standard_normal(len(observed))[observed.owner]
        wave = np.cos(3 * observed.angle + phase) * (1 + 0.3 * np.sin(7 * observed.angle)) * turning
        size = 0.5 * GYRO_WHITE * np.sqrt(RATE) * np.array([1.0, 0.6, 0.8])
        return wave[:, None] * size + per_force * DEG * force, 0.0

    found = diagnose(record(seed=3, fault=fault))
    best = next(iter(found.posterior.probability))
    assert "unknown" in best.split("+")
    assert len(best.split("+")) == 1 + effects


def test_waves_in_segments_of_different_durations_take_little_memory() -> None:
    """For each of 100 durations, five coefficients of 500 waves, 16 bytes each: 4 MB. At the 24 points of every segment, it would be
    19 MB."""
    durations, pulses = np.linspace(10.0, 20.0, 100), np.linspace(0.01, 1.0, 500)
    tracemalloc.start()
    found = _within(durations, pulses, 5)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3 * found.nbytes
    times = (np.arange(4000) + 0.5) / 4000
    mean = np.exp(1j * np.outer(pulses, durations[7] * times)).mean(axis=1)
    np.testing.assert_allclose(found[7, 0], mean, atol=2e-2)


def test_waves_are_whitened_in_parts() -> None:
    """Waves of eight times as many periods as usual. The covariance of a random walk correlates their coefficients."""
    weighing = Weighing(record(seed=1))
    repeating, left = Repeating(weighing), Left.whole(weighing.weights[0][-1])
    frequencies = np.tile(repeating.frequencies, 8)
    waves = repeating.waves(frequencies, 4)
    tracemalloc.start()
    (in_parts,) = repeating._eigen([left], frequencies, 4, (2, 8))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2 * waves.nbytes
    for found, expected in zip(in_parts, repeating._of_part(left, waves, (2, 8)), strict=True):
        np.testing.assert_allclose(found[0], expected[0], rtol=1e-6, atol=1e-9 * expected[0].max())
        np.testing.assert_allclose(found[1].sum(1), expected[1].sum(1), rtol=1e-6)


def test_a_part_of_the_waves_contains_at_least_one_period(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a run of thousands of segments, a single wave is larger than a part may be."""
    weighing = Weighing(record(seed=1))
    repeating, left = Repeating(weighing), Left.whole(weighing.weights[0][0])
    waves = repeating.waves(repeating.frequencies[:3], 4)
    monkeypatch.setattr("planrunner.gap.hypotheses.open_set._AT_ONCE", 1)
    (in_parts,) = repeating._eigen([left], repeating.frequencies[:3], 4, (2, 8))
    for found, expected in zip(in_parts, repeating._of_part(left, waves, (2, 8)), strict=True):
        np.testing.assert_allclose(found[1].sum(1), expected[1].sum(1), rtol=1e-9)


def test_a_segment_that_the_fit_absorbs_holds_no_deviation() -> None:
    """If every segment has its own bias, only rounding errors remain in the means."""
    weighing = Weighing(record())
    channels = [Left.whole(weighing.weights_at(weighing.likeliest[0], index)) for index in range(6)]
    means = weighing.spectrum.means
    own = np.zeros((len(weighing.spectrum.segment), len(means)))
    own[means, np.arange(len(means))] = 1.0
    absorbed = [Left.whole(left.weight.beside(own)) for left in channels]
    assert abs(_one_segment(means, absorbed)) < 1e-6
