"""The sums against published figures, hand-worked cases, plain numpy and another package."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.estimators.allan import kernel as allan_kernel
from planrunner.estimators.allan.phase import Phase
from planrunner.estimators.allan.table import deviations, octave_factors

# NBS Monograph 140, annex 8.E: nine frequencies; deviations as in NIST SP 1065, 12.4.
NINE = (892, 809, 823, 798, 671, 644, 883, 903, 677)
# NIST SP 1065, 12.4: 1000 points, averaging factors 1, 10 and 100.
THOUSAND = {
    "overlapping": (2.922319e-01, 9.159953e-02, 3.241343e-02),
    "modified": (2.922319e-01, 6.172376e-02, 2.170921e-02),
    "hadamard": (2.943883e-01, 9.581083e-02, 3.237638e-02),
}


def phase_of(values: np.ndarray, interval: float = 1.0) -> Phase:
    x = np.concatenate([[0.0], np.cumsum(np.asarray(values, dtype=float))])
    return Phase((x,), interval, 1, len(values), 0, 0, 0, 0)


def found(values: np.ndarray, kind: str, factors: list[int]) -> list[float]:
    return [row.value for row in deviations(phase_of(values), kind, np.array(factors), 0.95)]


def thousand() -> np.ndarray:
    """n₀ = 1234567890, n_{i+1} = 16807·n_i mod 2147483647, each divided by the modulus."""
    numbers = [1234567890]
    while len(numbers) < 1000:
        numbers.append(16807 * numbers[-1] % 2147483647)
    return np.array(numbers) / 2147483647


def test_generator_is_the_published_one() -> None:
    values = thousand()
    assert values[0] == pytest.approx(0.5748904732, abs=1e-10)
    assert values.mean() == pytest.approx(4.897745e-01, abs=1e-7)
    assert values.std(ddof=1) == pytest.approx(2.884664e-01, abs=1e-7)


@pytest.mark.parametrize("kind", THOUSAND)
def test_thousand_points(kind: str) -> None:
    assert found(thousand(), kind, [1, 10, 100]) == pytest.approx(THOUSAND[kind], rel=2e-7)


@pytest.mark.parametrize(
    ("kind", "published"),
    [
        ("overlapping", (91.22945, 85.95287)),
        ("modified", (91.22945, 74.78849)),
        ("hadamard", (70.80607, 85.61487)),
    ],
)
def test_nine_frequencies(kind: str, published: tuple[float, float]) -> None:
    assert found(np.array(NINE), kind, [1, 2]) == pytest.approx(published, rel=2e-7)


def test_by_hand() -> None:
    """y = 0, 2, 1, 5: first differences 2, −1, 4, so σ²(1) = (4 + 1 + 16)/(2·3); pair means 1, 1.5, 3: one difference 2, σ²(2) = 2."""
    assert found(np.array([0, 2, 1, 5]), "overlapping", [1, 2]) == pytest.approx([math.sqrt(3.5), math.sqrt(2)])
    # Second differences −3, 5: σ_H² = (9 + 25)/(6·2).
    assert found(np.array([0, 2, 1, 5]), "hadamard", [1]) == pytest.approx([math.sqrt(34 / 12)])


def test_a_ramp_is_seen_by_the_allan_and_not_by_the_hadamard_deviation() -> None:
    ramp = 0.3 * np.arange(1000.0)
    for factor, value in zip([1, 8, 64], found(ramp, "overlapping", [1, 8, 64]), strict=True):
        assert value == pytest.approx(0.3 * factor / math.sqrt(2), rel=1e-10)
    assert max(found(ramp, "hadamard", [1, 8])) < 1e-9


@pytest.mark.parametrize("size", [5, 2047, 2048, 2049, 2050, 9001])
def test_sums_equal_plain_numpy_wherever_pieces_end(size: int) -> None:
    x = np.cumsum(np.random.default_rng(size).standard_normal(size))
    factors = np.array([m for m in (1, 2, 3, 7, 64, 1023, 1024, 2048, 3000) if 3 * m < size])
    second = [np.sum((x[2 * m :] - 2 * x[m:-m] + x[: -2 * m]) ** 2) for m in factors]
    third = [np.sum((x[3 * m :] - 3 * x[2 * m : -m] + 3 * x[m : -2 * m] - x[: -3 * m]) ** 2) for m in factors]
    modified = []
    for m in factors:
        steps = x[2 * m :] - 2 * x[m:-m] + x[: -2 * m]
        modified.append(np.sum(np.convolve(steps, np.ones(m), "valid") ** 2))
    assert allan_kernel.second_differences(x, factors) == pytest.approx(second, rel=1e-12)
    assert allan_kernel.third_differences(x, factors) == pytest.approx(third, rel=1e-11)
    assert allan_kernel.averaged_second_differences(x, factors) == pytest.approx(modified, rel=1e-10)


@pytest.mark.filterwarnings("ignore")
def test_another_package_agrees() -> None:
    other = pytest.importorskip("allantools", reason="allantools is not installed (extra `dev`)")
    values = 5 + np.random.default_rng(3).standard_normal(20_000)
    factors = octave_factors(np.array([20_001]))
    for kind, function in (("overlapping", other.oadev), ("modified", other.mdev), ("hadamard", other.ohdev)):
        used = [int(m) for m in factors if 4 * m <= 20_000]
        _, theirs, _, _ = function(values, rate=1.0, data_type="freq", taus=used)
        x = np.concatenate([[0.0], np.cumsum(values - values.mean())])
        rows = deviations(Phase((x,), 1.0, 1, values.size, 0, 0, 0, 0), kind, np.array(used), 0.95)
        assert [row.value for row in rows][: len(theirs)] == pytest.approx(
            theirs, rel=1e-12 if kind == "overlapping" else 1e-9
        )


def test_nothing_is_written_beside_the_source() -> None:
    from pathlib import Path

    folder = Path(allan_kernel.__file__).parent
    assert not list(folder.rglob("*.nbi")) and not list(folder.rglob("*.nbc"))
