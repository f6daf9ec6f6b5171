"""Residuals that are more than noise: their dispersion, and the uncertainties that it widens. Each is computed a second time, by hand, from
dense covariance matrices, or from the scatter of many draws."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2

from planrunner.error_model.effects.gyro import GyroScaleAsymmetry
from planrunner.error_model.effects.interface import Column, Shaped
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.parameters import ParameterEstimate, amplitudes, exact_shape, wider
from planrunner.gap.answer.remainder import dispersion, dispersions
from planrunner.gap.evidence.weighing import ChannelWeights
from planrunner.gap.hypotheses.candidates import Reduced, Weighed, Weighing
from tests.gap.test_weighing import dense_covariance
from tests.gap.turntable import DEG, record

Array = np.ndarray
WALK = 5  # index of a setting with a random walk of the gyros
RATIOS = np.array([9.0, 1.0, 4.0, 1.0, 2.0, 1.0])


# The dispersion of one channel ----------------------------------------------------------------------------------------


def rest(of_means: list[float], others: list[float]) -> tuple[Array, Array]:
    """Whitened residuals whose squares are given, and where those of order 0 are: after the others."""
    squares = np.array([*others, *of_means])
    signs = np.where(np.arange(len(squares)) % 2, -1.0, 1.0)
    return signs * np.sqrt(squares), len(others) + np.arange(len(of_means))


@pytest.mark.parametrize(
    ("of_means", "others", "lost", "expected"),
    [
        ([4.0, 4.0], [4.0] * 8, 2, 40 / 8),  # by chance 3e-6; the means alone, 8 with one degree, 0.005
        ([36.0] * 5, [1.0] * 95, 1, 180 / 4),  # all together 275 with 99 degrees: smaller than 45
        ([1.2] * 5, [1.2] * 95, 1, 1.0),  # 120 with 99 degrees: by chance 0.07
        ([16.0] + [0.0] * 4, [1.0] * 95, 1, 1.0),  # the means: 16 with 4 degrees, by chance 0.003
        ([0.0] * 5, [3.0] * 95, 1, 285 / 99),  # only the coefficients within the segments
        ([0.5] * 5, [0.5] * 95, 1, 1.0),  # residuals below the noise make nothing smaller
    ],
)
def test_the_dispersion_is_the_largest_ratio_that_chance_does_not_explain(
    of_means: list[float], others: list[float], lost: int, expected: float
) -> None:
    values, means = rest(of_means, others)
    assert dispersion(values, len(values) - lost, means, 12) == pytest.approx(expected)


def test_more_tests_ask_for_more_evidence() -> None:
    """Five means with the sum of squares that chance exceeds once in 2000 cases: one test at 1/1000 fails, twelve do not."""
    sum_ = float(chi2.isf(1 / 2000, 4))
    values, means = rest([sum_ / 5] * 5, [0.9] * 95)
    assert dispersion(values, 99, means, 1) == pytest.approx(sum_ / 4)
    assert dispersion(values, 99, means, 12) == 1.0


# The dispersions of a fit at one setting of the noise -----------------------------------------------------------------


def bent(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    """An asymmetry of all gyros, and in gyro x a square that no effect of the fit explains."""
    square = omega**2 / (90 * DEG) * np.array([1.0, 0.0, 0.0])
    return 3e-4 * np.abs(omega) + 3e-3 * square, 0.0


@pytest.fixture(scope="module")
def weighing() -> Weighing:
    return Weighing(record(seed=4, fault=bent))


@pytest.fixture(scope="module")
def asymmetry(weighing: Weighing) -> Weighed:
    (found,) = weighing.weigh(GyroScaleAsymmetry().variants(weighing.observed))
    return found


class DenseFit:
    """Generalised least squares of all channels together: the nominal parameters of each channel and the amplitudes of the effect.

    design: (K·M, q + p); covariances: K arrays (M, M)."""

    def __init__(self, weighing: Weighing, effect: Weighed, setting: int):
        size = [
            own[setting] if channel.kind == "gyro" else own[0]
            for own, channel in zip(weighing.weights, weighing.observed.channels, strict=True)
        ]
        self.covariances = [dense_covariance(weighing, k, weight.walk) for k, weight in enumerate(size)]
        scaled = [columns / np.linalg.norm(columns, axis=0) for columns in weighing.nominal]
        self.lost = [columns.shape[1] for columns in scaled]
        self.design = np.hstack([block_diag(*scaled), np.vstack(effect.raw)])
        inverse = block_diag(*map(np.linalg.inv, self.covariances))
        normal = self.design.T @ inverse @ self.design
        units = np.sqrt(np.diag(normal))
        self.gains = np.linalg.solve(normal / np.outer(units, units), (self.design.T @ inverse) / units[:, None])
        self.gains /= units[:, None]
        y = weighing.spectrum.values.T.ravel()
        self.rests = np.split(y - self.design @ (self.gains @ y), len(self.covariances))


def expected_dispersions(weighing: Weighing, effect: Weighed, setting: int) -> list[float]:
    fit, means = DenseFit(weighing, effect, setting), weighing.spectrum.means
    found = []
    for left, covariance, lost in zip(fit.rests, fit.covariances, fit.lost, strict=True):
        whole = float(left @ np.linalg.solve(covariance, left))
        others = np.delete(np.arange(len(left)), means)
        of_others = left[others] @ np.linalg.solve(covariance[np.ix_(others, others)], left[others])
        sums = ((whole, len(left) - lost), (whole - float(of_others), len(means) - lost))
        found.append(max([1.0, *(s / n for s, n in sums if 12 * chi2.sf(s, n) < 0.001)]))
    return found


@pytest.mark.parametrize("setting", [0, WALK])
def test_dispersions_are_those_of_a_dense_fit_at_the_setting(
    weighing: Weighing, asymmetry: Weighed, setting: int
) -> None:
    expected = expected_dispersions(weighing, asymmetry, setting)
    assert dispersions(weighing, asymmetry, setting) == pytest.approx(expected, rel=1e-3)
    assert expected[1:] == [1.0] * 5


def test_a_random_walk_explains_a_part_of_the_misfit(weighing: Weighing, asymmetry: Weighed) -> None:
    plain, walking = (dispersions(weighing, asymmetry, setting)[0] for setting in (0, WALK))
    assert plain > 1.5 * walking


def test_amplitudes_have_the_scatter_of_the_larger_noise(weighing: Weighing, asymmetry: Weighed) -> None:
    """Least squares with the covariances C of the channels, of data whose covariances are r·C: Σ r·B·C·Bᵀ with the gains B."""
    fit, p = DenseFit(weighing, asymmetry, 0), asymmetry.gram.shape[1]
    gains = np.split(fit.gains[-p:], len(fit.covariances), axis=1)
    expected = sum(r * b @ c @ b.T for r, b, c in zip(RATIOS, gains, fit.covariances, strict=True))
    units = np.array([column.magnitude / column.factor for column in asymmetry.variant.columns])
    found = amplitudes(weighing, "gyro_scale_asymmetry", asymmetry, ratios=RATIOS)
    assert [one.standard_uncertainty for one in found] == pytest.approx(np.sqrt(np.diag(expected)) * units, rel=2e-3)


# The shape of an effect ------------------------------------------------------------------------------------------------


class Delay(Shaped):
    """An effect whose shape is all that it has."""

    id, stage, shape_name, shape_unit = "delay", "sensor", "delay", "s"


class Unit:
    """Weights of independent noise with a variance of one, without nominal parameters."""

    def __init__(self, count: int) -> None:
        self.segment = np.zeros(count, dtype=np.int64)

    def project(self, columns: Array) -> Array:
        return columns


def acting(shape: float, by_channel: list[Array]) -> Weighed:
    """An effect with these coefficients (M,), one a channel."""
    column = Column("delay", "1", 1.0, 1.0, dict(enumerate(by_channel)), axis=None)
    energy = sum(float(one @ one) for one in by_channel)
    weights = cast(list[ChannelWeights], [Unit(len(one)) for one in by_channel])
    return Weighed(
        Reduced((column,), shape, fixed=(0,)), np.full((1, 1, 1), energy), np.zeros((1, 1)), energy, 1.0, weights
    )


def test_a_shape_is_widened_by_the_mean_ratio_of_the_channels_that_it_acts_on() -> None:
    """Energies of 9, 1 and 0: (9·1 + 1·41 + 0·1000)/10 = 5."""
    form = acting(0.2, [np.array([3.0, 0.0]), np.array([0.6, 0.8]), np.zeros(2)])
    stated = [ParameterEstimate("delay", "delay", 0.2, "s", 0.01)]
    [found] = wider(stated, form, np.array([1.0, 41.0, 1000.0]))
    assert found.standard_uncertainty == pytest.approx(0.01 * np.sqrt(5))
    assert replace(found, standard_uncertainty=0.01) == stated[0]
    assert wider(stated, form, None) == stated
    assert wider(stated, form, np.ones(3)) == stated


@pytest.mark.parametrize("ratios", [[1.0, 1.0], [9.0, 1.0], [1.0, 16.0]])
def test_shapes_scatter_as_widened(ratios: list[float]) -> None:
    """Two channels with a delayed sine of amplitude 10 and 4, in noise whose variances are `ratios` times those of the likelihood. The
    squared error over the widened variance of 4000 draws: its mean has a standard deviation of √(2/4000)."""
    time, true, sizes = np.arange(200) * 2 * np.pi / 50, 0.3, np.array([10.0, 4.0])
    draw, effect, errors = np.random.default_rng(5), Delay(), []
    grid = true + np.linspace(-0.15, 0.15, 301)

    def model(delay: float) -> Array:
        return sizes[:, None] * np.sin(time - delay)

    forms = [acting(delay, list(model(delay))) for delay in grid]
    shapes = np.array([model(delay) for delay in grid])
    for _ in range(4000):
        y = model(true) + np.sqrt(ratios)[:, None] * draw.standard_normal((2, 200))
        log = -0.5 * ((y - shapes) ** 2).sum(axis=(1, 2))
        share = np.exp(log - log.max())
        stated = exact_shape(effect, list(zip(forms, share / share.sum(), strict=True)))
        [one] = wider(stated, forms[int(np.argmax(share))], np.array(ratios))
        errors.append((one.value - true) / one.standard_uncertainty)
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 4000))
