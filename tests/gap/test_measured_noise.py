"""The noise that the closure measures: the share of flicker in it, and effects that the other segments do not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.error_model.effects.gyro import GyroGSensitivity
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.closure import FoldChoice, choices_of, measured_noise, predictions
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import candidates_of
from tests.gap.turntable import record

Array = np.ndarray
DECLARED = 2e-5  # rad/s, ten times the noise of a mean


def _flickering(level: float, seed: int) -> Observed:
    """A recording with g-sensitivity and with flicker of a bias instability `level`; declared is `DECLARED`. The flicker is a sum of
    first-order Markov processes one octave apart, simulated sample by sample."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        changed = force @ np.array([[0, 4e-3, 0], [-2e-3, 0, 0], [0, 1e-3, 0]]).T * np.pi / 180 / 9.8
        steps = np.diff(observed.time)
        for tau in 2.0 ** np.arange(0, 13):
            one = np.empty((len(observed.time), 3))
            one[0] = draw.normal(size=3)
            kept = np.exp(-steps / tau)
            new = np.sqrt(1 - kept**2)[:, None] * draw.normal(size=(len(steps), 3))
            for k, (keep, more) in enumerate(zip(kept, new, strict=True)):
                one[k + 1] = keep * one[k] + more
            changed = changed + level * np.sqrt(0.5) * one  # variance ln 2/(2·ln 2) for octaves
        return changed, 0.0

    recorded = record(seed=seed, fault=fault, sampling=5.0)
    return replace(recorded, channels=tuple(replace(one, flicker=DECLARED) for one in recorded.channels))


def _weighed(recorded: Observed) -> tuple[Weighing, FoldChoice]:
    """The recording, and g-sensitivity as the only choice."""
    weighing = Weighing(recorded)
    (candidate,) = candidates_of(weighing, [GyroGSensitivity()])
    (choice,) = choices_of(weighing, candidate.id, [(candidate.best, candidate)], 1.0)
    return weighing, choice


@pytest.mark.parametrize(("true", "least", "most"), [(0.0, 0.0, 0.15), (1.0, 0.5, 2.0)])
def test_the_share_of_flicker_is_measured(true: float, least: float, most: float) -> None:
    """The covariance between the means of segments, relative to that of the declared flicker, is the squared level of the flicker."""
    weighing, choice = _weighed(_flickering(true * DECLARED, 3))
    noise = measured_noise(weighing, choice, np.zeros(len(weighing.base)), False, True)
    means = np.zeros(len(weighing.spectrum.segment), dtype=bool)
    means[weighing.spectrum.means] = True
    declared = weighing.weights[0][0].covariance(means)
    scale = noise.scale[0][means]
    measured = noise.weights[0].covariance(means) * np.outer(scale, scale)
    beside = ~np.eye(int(means.sum()), dtype=bool)
    level = np.sqrt(measured[beside].sum() / declared[beside].sum())
    assert least <= level <= most


def test_weights_of_any_flicker_follow_from_two_levels() -> None:
    """The weights of the declared level, from those of half and of twice that level, equal those that are computed directly."""
    recorded = record(seed=2, sampling=5.0)
    flickering = replace(recorded, channels=tuple(replace(one, flicker=DECLARED) for one in recorded.channels))
    weighing = Weighing(flickering)
    levels = [one.flicker for one in weighing.settings["gyro"] if one.walk == 0]
    declared, half, twice = (weighing.weights[0][levels.index(level)] for level in (1.0, 0.5, 2.0))
    share = (1 - 0.25) / (4 - 0.25)
    made = half.towards(twice, share, weighing.nominal[0], weighing.spectrum.values[:, 0])
    assert made.log_likelihood == pytest.approx(declared.log_likelihood, abs=1e-6)
    np.testing.assert_allclose(made.residual, declared.residual, atol=1e-8)
    every = np.ones(len(weighing.spectrum.segment), dtype=bool)
    np.testing.assert_allclose(made.covariance(every), declared.covariance(every), rtol=1e-9, atol=1e-30)


def test_a_fold_never_selects_an_effect_that_the_other_segments_do_not_show() -> None:
    """One effect of a pair is a bias in all segments except one. Without that segment, its amplitude is a quotient of rounding errors."""
    weighing, best = _weighed(_flickering(0.0, 4))
    lone = weighing.nominal[0][:, [0]] * (weighing.spectrum.segment != 5)[:, None]
    nothing = np.zeros_like(lone)
    raw = tuple(np.hstack([own, lone if c == 0 else nothing]) for c, own in enumerate(best.raw))
    pair = FoldChoice("pair", raw, (best.raw[0].shape[1], 1), 1.0)
    noise = measured_noise(weighing, pair, np.zeros(len(weighing.base)), False, True)
    change = np.column_stack([block.sum(axis=1) for block in best.raw])
    alone = predictions(weighing, noise, [best], change)[1]
    together = predictions(weighing, noise, [pair], change)[1]
    assert 0 < np.linalg.norm(together) < 1.2 * np.linalg.norm(alone)


def test_a_choice_needs_no_memory_for_channels_on_which_it_does_not_act() -> None:
    """g-sensitivity acts on the gyros. Its columns of the accelerometers are one zero that is repeated (strides of 0)."""
    weighing, choice = _weighed(_flickering(0.0, 4))
    for own, raw in zip(weighing.observed.channels, choice.raw, strict=True):
        assert raw.shape == choice.raw[0].shape
        assert raw.any() == (own.kind == "gyro")
        assert (raw.strides == (0, 0)) == (own.kind == "accel")
