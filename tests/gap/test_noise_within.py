"""A spectrum of the noise counts at rest and in motion, or in one of them, as the samples show it."""

from __future__ import annotations

import numpy as np

from planrunner.error_model.observed import Observed
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.plan.schedule import Rest
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
