"""Records that hold more than the four kinds of noise: what is left is described, and the rest is named."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import simulated_noise
from recorded import from_samples, segment, sensor

from planrunner.estimators.allan.allan_deviation import AllanDeviation, AllanDeviationParameters
from planrunner.estimators.allan.described_range import DescribedRange, distortion
from planrunner.estimators.allan.fit import TERMS, NoiseFit
from planrunner.estimators.allan.lines import largest, without_lines
from planrunner.estimators.allan.phase import Phase
from planrunner.estimators.interface import Estimate, EstimateRequest
from planrunner.physics.earth import Site

SITE = Site(math.radians(40.0))
HERTZ = 50.0
Array = np.ndarray


def estimate(values: Array, hertz: float = HERTZ, **keys: Any) -> Estimate:
    time = np.arange(values.size) / hertz
    recorded = from_samples(segment("rest"), time, {"gyro": values}, {"gyro": "pulse/s"}, rows=10_007)
    parameters = AllanDeviationParameters(outputs=("gyro",), **keys)
    device = sensor("gyro", unit="pulse/s")
    return AllanDeviation().estimate(EstimateRequest("noise", (recorded,), parameters, SITE, device))


def white(seed: int, size: int = 2**16, level: float = 1.0) -> Array:
    """N = `level` pulse/√s at 50 Hz."""
    return level * math.sqrt(HERTZ) * np.random.default_rng(seed).standard_normal(size)


def error(found: Estimate, name: str, truth: float) -> float:
    one = found[f"{name}_gyro"]
    return abs(one.value - truth) / one.standard_uncertainty


@pytest.mark.parametrize("seed", range(3))
def test_a_line_at_20_hz_does_not_move_the_random_walk(seed: int) -> None:
    time = np.arange(2**16) / HERTZ
    found = estimate(white(seed) + 20 * np.sin(2 * np.pi * 20 * time + seed))
    assert error(found, "N", 1.0) < 3.5
    assert found["N_gyro"].standard_uncertainty < 0.01
    (text,) = found.warnings
    assert "periodic disturbance (20 Hz, amplitude 20" in text or "periodic disturbance (20 Hz, amplitude 19.9" in text


def test_a_vibration_whose_frequency_wanders_is_no_line() -> None:
    draw = np.random.default_rng(4)
    frequency = 20 + np.cumsum(draw.standard_normal(2**16)) / 256
    found = estimate(white(4) + 20 * np.sin(2 * np.pi * np.cumsum(frequency) / HERTZ))
    assert not [text for text in found.warnings if "periodic disturbance (" in text]
    assert [text for text in found.warnings if "At shorter averaging times" in text]


def test_lines_of_several_runs_are_subtracted_from_each() -> None:
    """What is left is the noise, without three degrees of freedom in tens of thousands."""
    noise, wave = white(5), np.sin(2 * np.pi * 7.123 * np.arange(2**16) / HERTZ)
    parts = np.split(noise + 3 * wave, [20_000, 20_500])  # the second is too short to be searched
    phases = [np.concatenate(([0.0], np.cumsum(part))) for part in parts]
    quiet, lines = without_lines(Phase(tuple(phases), 1 / HERTZ, 1, 2**16, 0, 2, 0, 0))
    assert [round(line.frequency, 3) for line in lines] == [7.123, 7.123] and len(largest(lines, 3)) == 1
    assert np.array_equal(quiet.runs[1], phases[1])
    left = np.diff(quiet.runs[2]) - noise[20_500:]
    assert np.sqrt(np.mean(left**2)) < 4 * np.std(noise) * np.sqrt(3 / left.size)


@pytest.mark.parametrize("seed", range(4))
def test_rounding_that_is_carried_over_is_named_and_its_noise_is_quantisation(seed: int) -> None:
    """Counts of four times the noise of a sample. Rounding errors of the phase are uniform: Q = count·τ0/√12."""
    count = 4 * math.sqrt(HERTZ)
    total = np.cumsum(white(seed) + 3.7)
    found = estimate(count * np.diff(np.round(total / count), prepend=0.0))
    assert error(found, "N", 1.0) < 3.5 and error(found, "Q", count / HERTZ / math.sqrt(12)) < 3.5
    assert found["N_gyro"].standard_uncertainty < 0.02
    assert [
        text
        for text in found.warnings
        if "rounded to counts of 28.3" in text and "only averaging times of 0.16 s and more" in text
    ]
    alone = estimate(np.sqrt(HERTZ) * np.round(white(seed) / math.sqrt(HERTZ)))  # nothing is carried over
    assert alone.warnings == () and error(alone, "Q", 0.0) < 3.5


def test_a_change_beyond_chance_is_added_to_the_uncertainties() -> None:
    """Variances of 4 and 9: by chance, the change has the variance 5. A change of 3 leaves √(9 − 5) = 2, and one of −1 leaves nothing."""
    moved = np.array([3.0, -3.0, -1.0, 0.0])
    chosen, fewer = (
        NoiseFit(squares, variance * np.eye(4), np.zeros(0), 1.0, 2, TERMS)
        for squares, variance in ((np.ones(4), 4.0), (1 + moved, 9.0))
    )
    left = distortion(chosen, fewer)
    assert left == pytest.approx([2.0, -2.0, 0.0, 0.0])
    ranged = DescribedRange(chosen, (), shorter=1, distortions=left[None])
    assert ranged.covariance[:2, :2] == pytest.approx(np.array([[8.0, -4.0], [-4.0, 8.0]]))
    assert ranged.covariance[2:, 2:] == pytest.approx(4 * np.eye(2))


@pytest.mark.parametrize("seed", range(3))
def test_a_filtered_output_is_named_and_its_random_walk_found(seed: int) -> None:
    """A first-order low-pass of 0.1 s: at short averaging times the deviations are lower than those of white noise."""
    values = white(seed)
    filtered = np.zeros(values.size)
    share = 1 - math.exp(-1 / (HERTZ * 0.1))
    state = 0.0
    for k, value in enumerate(values):
        state += share * (value - state)
        filtered[k] = state
    found = estimate(filtered)
    assert error(found, "N", 1.0) < 3.5
    assert [text for text in found.warnings if "At shorter averaging times" in text and "filtered" in text]


@pytest.mark.parametrize("seed", range(3))
def test_a_steady_drift_is_no_random_walk(seed: int) -> None:
    """Five pulse/s over the record, two hundred times the noise of its mean."""
    size = 2**16
    slope = 5 / (size / HERTZ)
    found = estimate(white(seed) + slope * np.arange(size) / HERTZ)
    assert found.warnings == ()
    (note,) = [text for text in found.notes if "drifts steadily" in text]
    number, spread = (float(text) for text in note.partition("(")[2].partition(")")[0].split(" ± "))
    assert abs(number - slope * 3600) < 3.5 * spread < slope * 3600
    assert error(found, "N", 1.0) < 3.5
    assert error(found, "K", 0.0) < 2


def test_a_random_walk_is_no_steady_drift() -> None:
    for seed in range(6):
        draw = np.random.default_rng([7, seed])
        values = simulated_noise.rate(draw, 2**14, 1.0, N=1.0, K=0.03)
        found = estimate(values, 1.0)
        assert not [text for text in found.notes if "drifts steadily" in text]
        assert error(found, "K", 0.03) < 3.5


def test_a_random_walk_beneath_a_drift_keeps_its_interval() -> None:
    """K with a ramp ten times as large as what it wanders itself."""
    held, drifting = 0, 0
    for seed in range(12):
        draw = np.random.default_rng([8, seed])
        size = 2**13
        walk = simulated_noise.rate(draw, size, 1.0, N=1.0, K=0.03)
        found = estimate(walk + 30 * np.arange(size) / size, 1.0)
        held += error(found, "K", 0.03) <= 2
        drifting += any("drifts steadily" in text for text in found.notes)
    assert drifting >= 10
    assert held >= 9  # 95 %: fewer than nine in one of two thousand tries
