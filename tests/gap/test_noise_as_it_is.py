"""Noise that departs from its declaration is measured and reported, and prevents no right name. The noise is drawn here, by formulas of
its own, and added to noise-free recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions, diagnose
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.open_set import competitors
from planrunner.gap.hypotheses.outside import BURSTS, PLAIN, TONE, _of_short_windows, _summed, _Sums, outside
from planrunner.gap.hypotheses.patterns import WHOLE, Sort
from planrunner.plan.schedule import Spin
from tests.gap.turntable import ACCEL_WHITE, DEG, GYRO_WHITE, RATE, Array, Fault, G, record

SAMPLE = np.array([GYRO_WHITE] * 3 + [ACCEL_WHITE] * 3) * np.sqrt(RATE)
Noise = Callable[[Observed, np.random.Generator], Array]


def noisy(noise: Noise, fault: Fault | None = None, seed: int = 1) -> Observed:
    """A recording with other noise, in units of the declared white noise of a sample; without counts."""
    whole = record(seed, fault, clean=True)
    values = whole.values + noise(whole, np.random.default_rng([seed, 7])) * SAMPLE
    return replace(whole, values=values, channels=tuple(replace(one, resolution=0.0) for one in whole.channels))


def g_sensitivity(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    return force / G @ draw.normal(0, 0.002 * DEG, (3, 3)).T, 0.0


def white(factor: float) -> Noise:
    return lambda observed, draw: factor * draw.standard_normal(observed.values.shape)


def differenced(observed: Observed, draw: np.random.Generator) -> Array:
    """The noise of an angle, read as a rate: anti-correlated from sample to sample."""
    angle = draw.standard_normal((len(observed.time) + 1, 6))
    return np.asarray(angle[1:] - 0.9 * angle[:-1])


def uneven(observed: Observed, draw: np.random.Generator) -> Array:
    factor = np.exp(draw.normal(0, 0.2, len(observed)))[observed.owner]
    return np.asarray(factor[:, None] * draw.standard_normal(observed.values.shape))


def vibrating(observed: Observed, draw: np.random.Generator) -> Array:
    turning = np.array([isinstance(motion, Spin) for motion in observed.motions])[observed.owner]
    return np.asarray(np.where(turning, 1.7, 1.0)[:, None] * draw.standard_normal(observed.values.shape))


def humming(observed: Observed, draw: np.random.Generator) -> Array:
    line = 0.4 * np.sin(2 * np.pi * 7.3 * observed.time)[:, None]
    return np.asarray(draw.standard_normal(observed.values.shape) + line)


DEPARTURES: dict[str, Noise] = {
    "0.02 of the declared level": white(0.02),
    "1.03 times the declared level": white(1.03),
    "anti-correlated": differenced,
    "other in every segment": uneven,
    "larger while turning": vibrating,
    "with a line": humming,
}


QUICK = ("other in every segment",)


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in DEPARTURES],
)
def named(request: pytest.FixtureRequest) -> tuple[str, Diagnosis]:
    return request.param, diagnose(noisy(DEPARTURES[request.param], g_sensitivity))


def test_an_effect_is_named_whatever_the_noise(named: tuple[str, Diagnosis]) -> None:
    """A line is also named, as interference, in addition to the effect."""
    noise, found = named
    lines = ("accel_line_interference", "gyro_line_interference") if noise == "with a line" else ()
    assert set(found.verdict.effects) == {"gyro_g_sensitivity", *lines}


def test_amplitudes_agree_within_their_uncertainties(named: tuple[str, Diagnosis]) -> None:
    """The amplitudes are drawn as `g_sensitivity` draws them; K_x_y is the response of output y to the force along x."""
    _, found = named
    true = np.random.default_rng(1).normal(0, 0.002, (3, 3))
    estimates = {one.name: one for one in found.parameters}
    for (output, x), (force, y) in product(enumerate("xyz"), repeat=2):
        one = estimates[f"K_{y}_{x}"]
        assert abs(one.value - true[output, force]) < 4 * one.standard_uncertainty + 0.005 * abs(true).max()


@pytest.mark.slow
def test_no_effect_is_named_in_noise_alone() -> None:
    for name, noise in DEPARTURES.items():
        if name != "with a line":
            assert diagnose(noisy(noise)).verdict.kind == "none", name


def test_the_noise_is_reported() -> None:
    made = (noisy(noise) for noise in (white(0.02), vibrating, humming))
    small, uneven_, line = (diagnose(one, DiagnosisOptions(effects=("gyro_g_sensitivity",))).noise for one in made)
    for one, sigma in zip(small, SAMPLE, strict=True):
        assert one.white / one.declared == pytest.approx(0.02, rel=0.05)
        assert one.white * (DEG if one.channel.startswith("gyro") else 1.0) == pytest.approx(0.02 * sigma, rel=0.05)
        assert (one.slow, one.quietest, one.loudest, one.line) == (1.0, 1.0, 1.0, None)
    for one in uneven_:
        assert one.loudest == pytest.approx(1.7, rel=0.15)
        assert one.quietest == pytest.approx(1.0, rel=0.15)
    for one, sigma in zip(line, SAMPLE, strict=True):
        assert one.line is not None
        assert one.line.frequency == pytest.approx(7.3, abs=1e-3)
        assert one.line.amplitude * (DEG if one.channel.startswith("gyro") else 1.0) == pytest.approx(
            0.4 * sigma, rel=0.1
        )


def test_anti_correlated_noise_averages_faster_than_white_noise() -> None:
    """The spectrum of w(t) − 0.9·w(t − 1): its density at low frequencies is (1 − 0.9)² of that of w, at the highest (1 + 0.9)²."""
    weighing = Weighing(noisy(differenced))
    within = weighing.noise.spectrum
    expected: NDArray[np.float64] = 1 + 0.9**2 - 1.8 * np.cos(2 * np.pi * weighing.noise.frequency / RATE)
    measured = within[0] * weighing.white**2 / SAMPLE**2
    assert measured[-4:] == pytest.approx(np.repeat(expected[-4:, None], 6, axis=1), rel=0.15)
    for weights in weighing.weights:
        # Below the lowest band the density counts as constant, although this one falls further.
        assert 0.6 < float(np.mean(weights[0].residual ** 2)) < 1.3


def rising(observed: Observed, draw: np.random.Generator) -> Array:
    """White, and processes of 0.2 s and 4 s time constant that are 5 and 20 times as strong at the lowest frequencies."""
    found = draw.standard_normal(observed.values.shape)
    for lasting, power in ((0.2, 5.0), (4.0, 20.0)):
        slow, keep = draw.standard_normal(observed.values.shape), np.exp(-1 / (lasting * RATE))
        for index in range(1, len(slow)):
            slow[index] = keep * slow[index - 1] + (1 - keep) * slow[index]
        found += np.sqrt(power) * slow
    return np.asarray(found)


def test_noise_that_rises_below_the_measured_bands_is_no_transient_of_the_segments() -> None:
    """The orders of a segment of 20 s lie at 0.025 to 0.1 Hz, where few coefficients are left outside the basis."""
    weighing = Weighing(noisy(rising, seed=2))
    low = (weighing.spectrum.frequency > 0) & (weighing.spectrum.harmonic == 0)
    ratios = [float(np.mean(each[0].residual[low] ** 2)) for each in weighing.weights]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.4)
    assert competitors(weighing).log_bayes[WHOLE[Sort.TRANSIENT]][0] < PLAIN


@pytest.mark.parametrize("counts", [3.0, 8.0])
def test_coarse_counts_without_a_declaration_name_no_effect(counts: float) -> None:
    plain = noisy(white(1.0), g_sensitivity if counts == 3.0 else None)
    step = counts * SAMPLE
    coarse = replace(plain, values=np.round(plain.values / step) * step)
    assert Weighing(coarse).steps == pytest.approx(step, rel=1e-3)
    found = diagnose(coarse)
    assert found.posterior.probability["unknown"] < 0.1
    if counts == 3.0:
        assert found.verdict.effects == ("gyro_g_sensitivity",)


def test_readings_at_rest_that_alternate_between_two_counts_name_no_effect() -> None:
    plain = noisy(white(1.0))
    step = 8.0 * SAMPLE
    still = plain.values[: plain.bounds[1]].mean(0)
    between = plain.values + np.floor(still / step) * step + step / 2 - still
    values = np.round(between / step) * step
    assert values[: plain.bounds[1]].std(0) / step == pytest.approx(0.5, abs=0.1)  # as if by noise of half a count
    found = diagnose(replace(plain, values=values))
    assert found.posterior.probability["none"] > 0.5


def faint_tone(observed: Observed, draw: np.random.Generator) -> Array:
    """A sine of 0.15 standard deviations, 50 times above the noise of a periodogram: it makes the noise 0.6 % larger."""
    line = 0.15 * np.sin(2 * np.pi * 3.3 * observed.time)[:, None] * np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    return np.asarray(draw.standard_normal(observed.values.shape) + line)


def two_tones(observed: Observed, draw: np.random.Generator) -> Array:
    lines = sum(0.6 * np.sin(2 * np.pi * hertz * observed.time) for hertz in (2.3, 3.7))
    return np.asarray(draw.standard_normal(observed.values.shape) + np.reshape(lines, (-1, 1)) * np.eye(6)[1])


def narrow_band(observed: Observed, draw: np.random.Generator) -> Array:
    """A resonance at 2.9 Hz that noise excites: its phase is lost within a minute or so."""
    hertz = 2.9 + 0.003 * np.cumsum(draw.standard_normal(len(observed.time))) / np.sqrt(RATE)
    phase = 2 * np.pi * np.cumsum(hertz) / RATE
    return np.asarray(draw.standard_normal(observed.values.shape) + 0.6 * np.sin(phase)[:, None] * np.eye(6)[1])


@pytest.mark.parametrize("noise", [faint_tone, two_tones, narrow_band])
def test_lines_of_the_noise_are_no_cause_and_are_reported(noise: Noise) -> None:
    found = diagnose(noisy(noise))
    assert found.verdict.kind == "none"
    assert found.posterior.kinds[TONE] <= 0
    assert next(one for one in found.noise if one.channel == "gyro_y").line is not None


def of_an_angle(observed: Observed, draw: np.random.Generator) -> Array:
    """The noise of an angle that is read as a rate, with little noise of the rate itself. The noise of a mean is a hundredth of what white
    noise of the same size would cause."""
    angle = draw.standard_normal((len(observed.time) + 1, 6))
    return np.asarray(np.diff(angle, axis=0) + 0.01 * draw.standard_normal(observed.values.shape))


def walking(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    """A random walk of every gyro, which reaches 1/400 or 1/200 of the noise of a sample in 60 s."""
    steps = np.sqrt(np.diff(observed.time, prepend=observed.time[0]) / 60)
    walk = np.cumsum(steps[:, None] * draw.standard_normal((len(steps), 3)), axis=0)
    return walk * np.array([0.0025, 0.005, 0.0025]) * SAMPLE[0], 0.0


OF_TIME = (
    "gyro_bias_random_walk",
    "gyro_bias_gauss_markov",
    "gyro_bias_step",
    "gyro_bias_drift",
    "gyro_warm_up",
    "accel_bias_random_walk",
    "accel_bias_drift",
)
"""The effects that follow the time."""
AMONG_ALL = pytest.param(None, marks=pytest.mark.slow, id="all")
"""All effects are hypotheses, which takes long."""


@pytest.mark.parametrize("effects", [pytest.param(OF_TIME, id="alike"), AMONG_ALL])
def test_a_random_walk_is_found_far_below_the_noise_of_a_sample(effects: tuple[str, ...] | None) -> None:
    """A smooth or periodic course in time, outside the catalogue, describes such a walk nearly as well as the walk itself does."""
    options = DiagnosisOptions(effects=effects)
    right = [
        diagnose(noisy(of_an_angle, walking, seed), options).posterior.probability["gyro_bias_random_walk"]
        for seed in range(1, 5)
    ]
    assert np.mean(right) > 0.5
    assert min(right) > 0.05


def mixed(observed: Observed, draw: np.random.Generator) -> Array:
    """Noise with a kurtosis of 9.75: four fifths of the values are small."""
    shape = observed.values.shape
    return np.asarray(draw.standard_normal(shape) * np.where(draw.random(shape) < 0.8, 0.5, 2.0))


def test_noise_with_many_small_values_holds_no_bursts() -> None:
    """The energy of such noise varies more from window to window, which is no sign of bursts."""
    spread, evidence = {}, []
    for noise in (white(1.0), mixed):
        weighing = Weighing(noisy(noise, None, 6))
        within = {id(basis): _summed(basis.vectors) for basis in weighing.spectrum.bases}
        spread[noise] = _of_short_windows(weighing, _Sums.of(weighing), within)
        evidence.append(float(outside(weighing).log_bayes[BURSTS].max()))
    normal, heavy = spread.values()
    assert 0.7 < normal.min() <= normal.max() < 1.3
    assert heavy.min() > 1.8  # (kurtosis − 1)/2 = 4.4 for the variance; less for the median deviation
    assert max(evidence) < 3


@pytest.mark.parametrize("response", [(1.0, 0.7, 0.4), pytest.param((1.0, 1.0), marks=pytest.mark.slow), (1.0, -0.97)])
def test_filtered_noise_holds_no_bursts(response: tuple[float, ...]) -> None:
    """Successive samples of smoothed noise are alike, so the energies of its windows scatter more than those of white noise. Those of
    differenced noise cancel, except at the ends of a segment."""

    def filtered(observed: Observed, draw: np.random.Generator) -> Array:
        samples = draw.standard_normal(observed.values.shape)
        return np.asarray(lfilter(np.array(response) / np.linalg.norm(response), [1.0], samples, axis=0))

    evidence = [float(outside(Weighing(noisy(filtered, None, seed))).log_bayes[BURSTS].max()) for seed in range(20, 28)]
    assert max(evidence) < PLAIN
