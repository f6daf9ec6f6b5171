"""Declared flicker in tilted scale factors, against variances of contrasts summed over a grid of times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t
from tilted_recording import SITE, Gyro, estimate, plan_mounting, series

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.interface import DesignRequest, Estimate, Setup
from planrunner.estimators.method import designed
from planrunner.estimators.tilted.evaluation import Group
from planrunner.estimators.tilted.parameters import ScaleFactorTiltedParameters
from planrunner.estimators.tilted.scale_factor_tilted import ScaleFactorTilted
from planrunner.estimators.tilted.scatter import half_drift, moved_alike, moved_further
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.uncertainty.influences import BudgetLine, InputQuantity, Inputs

AXIS = {"x": (0.0, 0.0)}  # along the rotation axis: it sees all of the rate and a constant part of the Earth's
RATES = (36.0, -36.0, 12.0, -12.0, 6.0)
DWELL, STEP = 60.0, 90.0  # s
B, NOISE = 2e-5, 3e-5  # deg/s
NAME = "bias instability gyro_x"
DECLARED = Inputs({NAME: InputQuantity(NAME, 0.0, "deg/s", B)})
BATCHES = 32


def recording(repeats: int, added: dict[int, float] | None = None, drift: float = 0.0) -> list[RecordedSegment]:
    """One segment every STEP; added: to the mean of a segment, deg/s."""
    plain = [
        one
        for n in range(repeats)
        for one in series(
            AXIS, {"x": Gyro(1.0003, bias=1e-3)}, 20.0, n + 1, RATES, lambda rate: DWELL, error=NOISE, drift=drift
        )
    ]
    found = []
    for k, one in enumerate(plain):
        mean = one.statistics.mean + (added or {}).get(k, 0.0)
        statistics = replace(one.statistics, mean=mean, start=k * STEP, end=k * STEP + DWELL)
        found.append(replace(one, statistics=statistics))
    return found


def kernel(n: int, points: int = 400, dwell: float = DWELL, step: float = STEP) -> np.ndarray:
    """Mean of −ln|t − t′|/π over segments i and j: by midpoints, and (3/2 − ln T)/π for one with itself. Enough for contrasts, for which
    any constant in the covariance of flicker cancels."""
    grid = (np.arange(points) + 0.5) / points * dwell
    found = np.empty((n, n))
    for lag in range(n):
        apart = np.abs(grid[:, None] - grid[None, :] + lag * step)
        mean = math.log(dwell) - 1.5 if lag == 0 else float(np.log(apart).mean())
        for i in range(n - lag):
            found[i, i + lag] = found[i + lag, i] = -mean / math.pi
    return found


def weights(repeats: int) -> dict[str, np.ndarray]:
    """K and F0 by all means: least squares through F_j − F_r, averaged over the repeats."""
    x = np.array(RATES)
    slope = (x - x.mean()) / np.sum((x - x.mean()) ** 2)
    offset = 1 / len(x) - slope * x.mean()
    found = {}
    for name, own in (("K_x", slope), ("F0_x", offset)):
        zero = -own.sum() / 2
        found[name] = np.tile(np.concatenate([[zero], own, [zero]]), repeats) / repeats
    return found


def line(found: Estimate, coefficient: str, quantity: str) -> BudgetLine | None:
    budget = next(one for one in found.budgets if one.coefficient == coefficient)
    return next((one for one in budget.lines if one.quantity == quantity), None)


def white_left() -> float:
    """Variance of a mean's noise without what flicker adds to the scatter of 32 batch means."""
    return NOISE**2 - B**2 * math.log(BATCHES) / (math.pi * (BATCHES - 1))


def test_within_segments_flicker_acts_through_all_means() -> None:
    repeats = 2
    recorded = recording(repeats)
    found = estimate(recorded, AXIS, DECLARED, earth_rate="averaged", uncertainty="within_segment")
    covariance = kernel(len(recorded))
    for name, own in weights(repeats).items():
        flicker, data = line(found, name, NAME), line(found, name, "data")
        assert flicker is not None and flicker.added and data is not None
        assert flicker.contribution == pytest.approx(B * math.sqrt(own @ covariance @ own), rel=1e-3)
        assert data.contribution == pytest.approx(math.sqrt(white_left() * own @ own), rel=1e-6)
        assert line(found, name, "zero drift gyro_x") is None
    assert any("one sample of that flicker" in text for text in found.notes)


def test_what_is_planned_is_expected_with_flicker() -> None:
    """Noise of 1e-4 deg/s·√s over each dwell, and flicker through all means."""
    planned = tuple(replace(one.segment, start=k * STEP) for k, one in enumerate(recording(2)))
    model = SensorModel("gyro", (OutputModel("gyro_x", "deg/s", noise=NoiseModel(1e-4)),), 10.0)
    setup = Setup(None, plan_mounting(AXIS), DECLARED)
    parameters = ScaleFactorTiltedParameters(earth_rate="averaged")
    design = designed(ScaleFactorTilted(), DesignRequest("scale", planned, parameters, SITE, model, setup=setup))
    expected = {one.name: one.standard_uncertainty for one in design.predicted}
    covariance = 1e-8 / DWELL * np.eye(len(planned)) + B**2 * kernel(len(planned))
    for name, own in weights(2).items():
        assert expected[name] == pytest.approx(math.sqrt(own @ covariance @ own), rel=1e-3)


def test_residuals_scale_noise_and_flicker_together() -> None:
    """Generalised least squares written out: φ = yᵀPy/(n − 2), P = V⁻¹ − V⁻¹X(XᵀV⁻¹X)⁻¹XᵀV⁻¹; then u² = φ·gᵀVg and the zeros' noise."""
    added = {1: 9e-5, 2: -4e-5, 3: 7e-5, 4: 1e-5, 5: -8e-5}
    recorded = recording(1, added)
    found = estimate(recorded, AXIS, DECLARED, earth_rate="averaged", uncertainty="residual")
    n, tied = len(RATES), B**2 * kernel(len(recorded))
    offset = 100 * B**2  # keeps the matrix positive definite; constants do not count
    among = tied[1:-1, 1:-1] + offset + white_left() * np.eye(n)
    matrix = np.column_stack([np.ones(n), RATES])
    inverse = np.linalg.inv(among)
    normal = np.linalg.inv(matrix.T @ inverse @ matrix)
    y = np.array(list(added.values()))
    factor = y @ (inverse - inverse @ matrix @ normal @ matrix.T @ inverse) @ y / (n - 2)
    for name, own in weights(1).items():
        data, flicker = line(found, name, "data"), line(found, name, NAME)
        rates, zeros = own[1:-1], own[[0, -1]]
        scaled, known = factor * (own @ tied @ own + white_left() * rates @ rates), white_left() * zeros @ zeros
        variance, samples = scaled + known, len(recorded) * (BATCHES - 1)
        assert data is not None and data.contribution == pytest.approx(math.sqrt(variance), rel=1e-3)
        assert found[name].standard_uncertainty == data.contribution
        freedom = variance**2 / (scaled**2 / (n - 2) + known**2 / samples)
        assert found[name].degrees_of_freedom == pytest.approx(freedom, rel=1e-3)
        assert flicker is not None and not flicker.added
        assert line(found, name, "zero drift gyro_x") is None


def test_what_flicker_gives_all_repeats_alike_is_added_to_their_scatter() -> None:
    """Variance of the mean of repeats less what their scatter s²/q shows of it in the mean, where that is positive."""
    repeats, added = 3, {1: 4e-5, 9: -6e-5, 12: 2e-5, 17: 3e-5}
    n = len(RATES) + 2
    covariance = B**2 * kernel(repeats * n)
    without, with_it = (
        estimate(recording(repeats, added), AXIS, stated, earth_rate="averaged", uncertainty="repeats")
        for stated in (None, DECLARED)
    )
    seen = {}
    for name, own in weights(repeats).items():
        each = np.zeros((repeats, repeats * n))
        for k in range(repeats):
            each[k, k * n : (k + 1) * n] = repeats * own[k * n : (k + 1) * n]
        between = each - each.mean(axis=0)
        scatter = np.trace(between @ covariance @ between.T) / (repeats - 1)
        seen[name] = own @ covariance @ own - scatter / repeats
        before, after = without[name], with_it[name]
        variance = after.standard_uncertainty**2 - before.standard_uncertainty**2
        assert variance == pytest.approx(max(seen[name], 0.0), rel=1e-2, abs=1e-4 * before.standard_uncertainty**2)
        freedom = before.degrees_of_freedom * (after.standard_uncertainty / before.standard_uncertainty) ** 4
        assert after.degrees_of_freedom == pytest.approx(freedom, rel=1e-6)
    assert seen["F0_x"] > 0.1 * without["F0_x"].standard_uncertainty ** 2


def test_scaled_residuals_cover_the_offset_a_little_too_often() -> None:
    """The line is that of least squares, not of the noise's covariance: what flicker does to the offset shows in part in the residuals,
    which are large when the offset is off. Drawn from the covariance alone, with flicker of 1 deg/h as in tilted_coverage.py."""
    rates = np.array([300.0, -300.0, 100.0, -100.0, 20.0, -20.0])
    repeats, dwell = 6, 36.0
    n, m = len(rates), len(rates) + 2
    averages = np.zeros((n + 1, repeats * m))
    for k in range(repeats):
        averages[:n, k * m + 1 : k * m + 1 + n] = np.eye(n) / repeats
        averages[n, [k * m, k * m + m - 1]] = 0.5 / repeats
    flicker = averages @ kernel(repeats * m, dwell=dwell, step=dwell) @ averages.T / 3600**2
    white = (5e-5) ** 2 / dwell / repeats
    large = 10 * np.abs(flicker).max()  # constants do not count, and make it positive definite
    slow = flicker + large
    x = np.column_stack([np.ones(n), rates])
    inverse = np.linalg.inv(slow[:n, :n] + white * np.eye(n))
    left = inverse - inverse @ x @ np.linalg.inv(x.T @ inverse @ x) @ x.T @ inverse
    own = np.append(np.linalg.pinv(x)[0], 0.0)
    own[n] = -own.sum()
    zeros = white / 2 * own[n] ** 2
    whole = slow + white * np.diag([1.0] * n + [0.5])
    drawn = np.random.default_rng(5).standard_normal((200_000, n + 1)) @ np.linalg.cholesky(whole).T
    factor = np.einsum("ij,jk,ik->i", drawn[:, :n], left, drawn[:, :n]) / (n - 2)
    variance = factor * (own @ flicker @ own + white * own[:n] @ own[:n]) + zeros
    freedom = variance**2 / ((variance - zeros) ** 2 / (n - 2) + zeros**2 / 1e4)
    share = np.mean(np.abs(drawn @ own) <= t.ppf(0.975, freedom) * np.sqrt(variance))
    assert 0.955 < share < 0.960


def test_flicker_that_is_nothing_leaves_the_residuals_as_they_are() -> None:
    recorded = recording(2, {3: 5e-5, 9: -6e-5, 12: 2e-5})
    little = Inputs({NAME: InputQuantity(NAME, 0.0, "deg/s", 1e-9)})
    with_it, without = (estimate(recorded, AXIS, stated, uncertainty="residual") for stated in (little, None))
    for name in ("K_x", "asymmetry_x", "nonlinearity_x"):
        assert with_it[name].standard_uncertainty == pytest.approx(without[name].standard_uncertainty, rel=1e-6)


def test_zeros_that_move_further_than_declared_are_reported_and_added() -> None:
    """A drift of 20·B from zero to zero; half of it less the noise of both zeros."""
    drift = 20 * B
    found = estimate(recording(2, drift=drift), AXIS, DECLARED, earth_rate="averaged", uncertainty="within_segment")
    (text,) = [one for one in found.warnings if "changed by more than" in one]
    assert "gyro_x" in text and "bias instability" in text
    moved, flicker = line(found, "F0_x", "zero drift gyro_x"), line(found, "F0_x", NAME)
    assert moved is not None and moved.added and flicker is not None and flicker.added
    expected = math.sqrt(drift**2 - 2 * white_left()) / 2 / math.sqrt(3)
    assert moved.standard_uncertainty == pytest.approx(expected, rel=1e-6)
    repeats = estimate(recording(2, drift=drift), AXIS, DECLARED, uncertainty="repeats")
    assert not [one for one in repeats.warnings if "changed by more than" in one]
    assert line(repeats, "F0_x", NAME) is None


def test_a_steady_change_is_in_the_residuals_and_an_offset_is_not() -> None:
    """Undeclared drift: on the residual basis it acts on F0 alone, within segments on K as well."""
    recorded = recording(2, drift=20 * B)
    residual, within = (
        estimate(recorded, AXIS, earth_rate="averaged", uncertainty=basis) for basis in ("residual", "within_segment")
    )
    x = np.array(RATES)
    spread = math.sqrt((20 * B) ** 2 - 2 * NOISE**2) / 2 / math.sqrt(3)
    steady = np.linspace(-1, 1, len(x)) @ (x - x.mean()) / np.sum((x - x.mean()) ** 2)
    acting = line(within, "K_x", "zero drift gyro_x")
    assert acting is not None and acting.contribution == pytest.approx(spread * abs(steady), rel=1e-6)
    assert line(residual, "K_x", "zero drift gyro_x") is None
    acting = line(residual, "F0_x", "zero drift gyro_x")
    assert acting is not None and acting.contribution == pytest.approx(spread, rel=1e-6)


def test_the_noise_of_the_zeros_is_no_drift() -> None:
    drift = np.array([[3.0], [-1.0]])
    between = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, -0.5, 0.5]])
    empty = np.empty(0)
    group = Group("", 293.15, ("a", "b"), empty, np.empty((2, 0), dtype=np.int64), between, between, empty, drift)
    sigma = np.array([1.0, 1.0, 2.0, 2.0])
    # (9 − 2 + 1 − 2)/2 = 3
    assert half_drift([group], 0, sigma, shared=False) == pytest.approx(math.sqrt(3) / 2)
    assert half_drift([group], 0, 3 * sigma, shared=False) == 0
    assert half_drift([group], 0, sigma, shared=True) == pytest.approx(0.5)  # |(3 − 1)/2|/2


def zeros(drift: Sequence[float]) -> Group:
    """A group of repeats whose zeros moved by so much, each zero of one segment."""
    q, empty = len(drift), np.empty(0)
    between = np.kron(np.eye(q), np.array([-1.0, 1.0]))
    moved = np.array(drift)[:, None]
    return Group("", 293.15, ("",) * q, empty, np.empty((q, 0), dtype=np.int64), between, between, empty, moved)


def test_a_drift_within_the_noise_of_the_zeros_is_not_added() -> None:
    """χ² of two drifts, each of variance 2σ²: 1 % lies at −2·ln 0.01 = 9.21."""
    sigma, square = np.ones((4, 1)), -2 * math.log(0.01)
    for size, expected in ((0.99, set()), (1.01, {0})):
        each = math.sqrt(square * size)  # Σd²/(2σ²) = 2·each²/2
        assert moved_further([zeros([each, -each])], sigma, ()) == expected
    assert moved_further([zeros([1e-12, 0.0])], np.zeros((4, 1)), ()) == {0}
    assert moved_further([zeros([0.0, 0.0])], np.zeros((4, 1)), ()) == set()


def test_repeats_show_whether_the_zeros_moved_alike() -> None:
    """F of the mean drifts: (3·4² + 3·1²)/2 over a scatter of 1 with 4 degrees of freedom is 25.5, beyond 18.0 (F 2, 4 at 1 %)."""
    assert moved_alike([zeros([3.0, 4.0, 5.0]), zeros([0.0, 1.0, 2.0])]) == {0}
    assert moved_alike([zeros([2.0, 3.0, 4.0]), zeros([0.0, 1.0, 2.0])]) == set()  # 15
    assert moved_alike([zeros([1.0, 1.0])]) == {0}
    assert moved_alike([zeros([0.0, 0.0])]) == set()
