"""A spectrum of the noise counts at rest and in motion, or in one of them, as the samples show it."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.observed import Observed
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.plan.schedule import Rest, Spin
from tests.gap.test_noise_as_it_is import noisy
from tests.gap.turntable import Array


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
