"""Coverage of the 95 % intervals of an accelerometer triad, in known attitudes and by the magnitude of gravity: a reduced sample."""

from __future__ import annotations

import pytest
from accelerometer_coverage import SCENARIOS, World, coverage
from scipy.stats import binom

RUNS = 1000
COVERED = [
    (reference, name, world)
    for reference, worlds in SCENARIOS.items()
    for name, world in worlds.items()
    if world.declared == world.flicker and (world.stated == world.tilt or reference == "gravity_magnitude")
]


@pytest.mark.slow
@pytest.mark.parametrize(("reference", "name", "world"), COVERED, ids=[f"{one}, {name}" for one, name, _ in COVERED])
def test_intervals_hold_the_truth(reference: str, name: str, world: World) -> None:
    """12 coefficients in four experiments and 9 in three, on two bases: all within the binomial range that they keep jointly at 1 % (Šidák)
    if every interval covers 95 %."""
    each = 1 - 0.99 ** (1 / (2 * (12 * 4 + 9 * 3)))
    low, high = binom.ppf(each / 2, RUNS, 0.95), binom.ppf(1 - each / 2, RUNS, 0.95)
    for basis, found in coverage(reference, world, RUNS, 61).items():
        for coefficient, share in found.items():
            assert low <= round(share * RUNS) <= high, (name, basis, coefficient, share)


def test_what_is_covered_is_not_empty() -> None:
    assert [reference for reference, _, _ in COVERED] == ["orientation"] * 4 + ["gravity_magnitude"] * 3


@pytest.mark.slow
def test_what_nobody_states_is_not_covered() -> None:
    unsaid = {name: world for name, world in SCENARIOS["orientation"].items() if "not" in name}
    unsaid |= {f"magnitude, {n}": w for n, w in SCENARIOS["gravity_magnitude"].items() if w.flicker and not w.declared}
    assert len(unsaid) == 3
    for name, world in unsaid.items():
        reference = "gravity_magnitude" if name.startswith("magnitude") else "orientation"
        assert min(coverage(reference, world, 200, 62)["within_segment"].values()) < 0.85, name
