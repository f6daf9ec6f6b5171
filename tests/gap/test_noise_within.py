"""A spectrum of the noise counts at rest and in motion, or in one of them, as the samples show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.noise_within import moderated
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.plan.schedule import Rest, Spin
from tests.gap.test_noise_as_it_is import noisy
from tests.gap.turntable import Array


def squares_of_harmonics(weighing: Weighing, about: float, within: float) -> Array:
    """Squares of the harmonics up to `within` Hz from `about`, relative to the variances that the noise gives them."""
    variance = np.column_stack(
        [own.variances for own in weighing.noise.of_coefficients(weighing.observed, weighing.spectrum)]
    )
    at = (weighing.spectrum.harmonic > 0) & (np.abs(weighing.spectrum.frequency - about) < within)
    return np.asarray((weighing.spectrum.values[at] / weighing.white) ** 2 / variance[at]).ravel()


def test_a_spectrum_counts_where_it_describes_the_noise() -> None:
    def noise(observed: Observed, draw: np.random.Generator) -> Array:
        """White, but for some slow noise in gyro x, and in gyro y at rest."""
        still = np.array([isinstance(motion, Rest) for motion in observed.motions])[observed.owner]
        white = draw.standard_normal(observed.values.shape)
        slow = np.convolve(draw.standard_normal(len(white)), np.full(40, 40**-0.5), "same")
        white[:, 0] += 0.5 * slow
        white[:, 1] += 0.5 * slow * still
        return np.asarray(white)

    at_rest, in_motion = Weighing(noisy(noise)).noise.coloured
    assert at_rest.tolist() == [True, True, False, False, False, False]
    assert in_motion.tolist() == [True, False, False, False, False, False]


def test_a_line_of_the_noise_at_a_harmonic_of_the_motion_counts() -> None:
    """The noise has a line at the frequency of the rocking motion, except while the table turns. In rocking segments, the harmonics take
    it, so that only the segments at rest show it."""

    def noise(observed: Observed, draw: np.random.Generator) -> Array:
        without = np.array([isinstance(motion, Spin) for motion in observed.motions])
        size = np.where(without[:, None], 0.0, draw.standard_normal((2, len(observed), 6)))[:, observed.owner]
        phase = 2 * np.pi * 0.5 * observed.time[:, None]
        return np.asarray(
            draw.standard_normal(observed.values.shape) + 0.3 * (size[0] * np.cos(phase) + size[1] * np.sin(phase))
        )

    weighing = Weighing(noisy(noise))
    at = (weighing.spectrum.harmonic == 1) & (weighing.spectrum.frequency == 0.5)
    expected = 1 + 0.3**2 * weighing.observed.counts[0] / 2
    blocks = weighing.noise.of_coefficients(weighing.observed, weighing.spectrum)
    found = np.column_stack([own.variances for own in blocks])[at]
    assert at.sum() == 6
    assert found.mean() > 0.3 * expected


def test_a_resonance_that_is_narrower_than_a_band_counts() -> None:
    """Besides white noise, a structure resonates at 0.25 Hz, the frequency of a harmonic of one of the rates. The band about it is
    several times as wide as the resonance."""

    def noise(observed: Observed, draw: np.random.Generator) -> Array:
        turn, decay = 2 * np.pi * 0.25 / observed.sample_rate, np.exp(-2 * np.pi * 0.01 / observed.sample_rate)
        white = draw.standard_normal((2, *observed.values.shape))
        swinging = lfilter([1.0], [1.0, -2 * decay * np.cos(turn), decay**2], white[1], axis=0)
        return np.asarray(white[0] + 0.2 * swinging / swinging.std(axis=0))

    ratios = []
    for seed in range(4):
        weighing = Weighing(noisy(noise, seed=seed + 1))
        ratios.append(squares_of_harmonics(weighing, 0.25, 0.005))
    found = np.concatenate(ratios)
    assert found.size >= 96
    assert 0.6 < found.mean() < 1.4


def test_slow_vibration_that_differs_between_segments_counts_where_it_acts() -> None:
    """Differenced noise, as of rounded increments, hides a vibration about 2 Hz whose strength differs from segment to segment. The
    level of the samples shows nothing of it."""

    def noise(observed: Observed, draw: np.random.Generator) -> Array:
        fast = np.diff(draw.standard_normal((len(observed.values) + 1, 6)), axis=0) / np.sqrt(2)
        steps = np.exp(
            -2 * np.pi * 0.3 / observed.sample_rate + 2j * np.pi * 2.0 * np.arange(400) / observed.sample_rate
        )
        shape = (np.abs(steps[0]) ** np.arange(400) * np.cos(np.angle(steps[1]) * np.arange(400)))[:, None]
        slow = np.column_stack(
            [np.convolve(column, shape[:, 0], "same") for column in draw.standard_normal(fast.shape).T]
        )
        strength = np.exp(draw.normal(0.0, 1.0, (len(observed), 1)))[observed.owner]
        return np.asarray(fast + 0.05 * strength * slow / slow.std())

    ratios = []
    for seed in range(3):
        weighing = Weighing(noisy(noise, seed=seed + 1))
        ratios.append(squares_of_harmonics(weighing, 2.0, 1.0))
    assert all(ratio.size for ratio in ratios)
    found = np.concatenate(ratios)
    assert 0.7 < found.mean() < 1.35


def test_a_variance_is_moderated_by_those_of_the_other_segments() -> None:
    """A further normal value of each segment has the stated variance, whether the segments scatter or not."""
    draw = np.random.default_rng(11)
    for freedom in (6.0, 1e9):
        variance = freedom / draw.chisquare(freedom, (400, 30))
        energy = variance * draw.chisquare(8.0, variance.shape)
        stated = np.array([moderated(row, np.full(30, 8.0)) for row in energy])
        further = draw.standard_normal(variance.shape) ** 2 * variance
        high = energy > np.quantile(energy, 0.9)
        assert np.mean(further / stated) == pytest.approx(1.0, abs=0.08)
        assert np.mean(further[high]) / np.mean(stated[high]) == pytest.approx(1.0, abs=0.25)


def test_the_mean_of_a_short_segment_contains_the_noise_of_several_bands() -> None:
    """Long segments have measured a hundredth of the noise in a band far below 1/T of the short segments; the other bands are white. The
    means of 20000 simulated segments show the true variance."""
    weighing = Weighing(noisy(lambda observed, draw: draw.standard_normal(observed.values.shape)))
    measured = weighing.noise
    frequency = np.concatenate([[measured.lowest / 100], measured.frequency[1:]])
    spectrum = np.ones_like(measured.spectrum)
    spectrum[:, 0] = 0.01
    coloured = np.ones_like(measured.coloured)
    noise = replace(measured, frequency=frequency, spectrum=spectrum, density=spectrum, coloured=coloured)
    samples, draw = int(weighing.observed.counts[0]), np.random.default_rng(4)
    long = np.fft.rfft(draw.standard_normal(20000 * samples))
    place = np.log(np.maximum(np.fft.rfftfreq(20000 * samples, 1 / weighing.observed.sample_rate), frequency[0]))
    long *= np.exp(np.interp(place, np.log(frequency), np.log(spectrum[0, :, 0])) / 2)
    means = np.fft.irfft(long).reshape(-1, samples).mean(axis=1)
    true = samples * means.var()
    for blocks in noise.of_coefficients(weighing.observed, weighing.spectrum):
        found = blocks.variances[weighing.spectrum.means]
        assert np.all((found > true / 2) & (found < 1.1 * true)), "frequencies above 1/T are left out"
