"""When an amplitude changed and with what: figures worked by hand, drawn fleets with a known change, and fleets without one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.gap.fleet.amplitudes import AmplitudeKey
from planrunner.gap.fleet.attribution import ALL_RUNS, Estimates, Source, Uncertain
from planrunner.gap.fleet.changes import ChangeKind, changes
from planrunner.gap.fleet.lots import shared_by_lots

Array = NDArray[np.float64]
NIGHTS, DEVICES, BENCHES = 8, ("17", "18", "19"), ("b1", "b2")


def fleet(
    rng: np.random.Generator, scatter: float = 0.0, devices: tuple[str, ...] = DEVICES
) -> tuple[Array, Array, dict[Source, list[str]], Array]:
    """Values about constant parts of devices and benches, s = 0.6; every device on every bench in every night. The days of the runs."""
    rows = [(night, bench, device) for night in range(NIGHTS) for bench in BENCHES for device in devices]
    parts = {name: rng.normal(0, 5) for name in (*BENCHES, *devices)}
    s = np.full(len(rows), 0.6)
    y = np.array([parts[bench] + parts[device] for _, bench, device in rows]) + rng.normal(
        0, math.hypot(0.6, scatter), len(rows)
    )
    groups = {
        Source.BENCH: [bench for _, bench, _ in rows],
        Source.DEVICE: [device for _, _, device in rows],
        Source.OCCASION: [str(k) for k in range(len(rows))],
    }
    return y, s, groups, np.array([night + 0.01 * k for k, (night, _, _) in enumerate(rows)])


def test_a_step_worked_by_hand() -> None:
    """One device on two benches. b1 has 0, 0, 10, 10 with s = 1, b2 has 0 four times: the step is 10, and its variance 1/2 + 1/2. Parts of
    device and benches have rank 2, so with the step 8 − 3 degrees of freedom are left, and χ² = 0."""
    groups = {Source.BENCH: ["b1", "b2"] * 4, Source.DEVICE: ["D"] * 8, Source.OCCASION: list("abcdefgh")}
    (found,) = changes(Estimates(np.array([0.0, 0, 0, 0, 10, 0, 10, 0]), np.ones(8), groups), range(8))
    assert (found.kind, found.sources[0], found.before) == (ChangeKind.STEP, (Source.BENCH, "b1"), 2)
    assert (found.size, found.standard_uncertainty) == pytest.approx((10, 1))
    assert found.degrees_of_freedom == 5 and found.expanded == pytest.approx(2.571, abs=5e-4)  # t of any table, 97.5 %
    assert found.runs == (0, 2, 4, 6)
    assert (found.earliest, found.latest) == (1, 2)
    from scipy.stats import t

    # The step of each bench after its second run, of all runs after 2 to 6, of the device likewise, and four drifts; on one device, device
    # and all runs are the same.
    assert found.p == pytest.approx(2 * t.sf(10, 5) * (2 + 5 + 5 + 4))


def test_a_step_is_that_of_statsmodels() -> None:
    """statsmodels 0.15.0, `WLS(y, [1, device, bench, step], weights=1/s²)`: 5.02 with the standard error 0.1095445115 for a fixed scale.
    The scale of the residuals is 0.6458, and counts as 1 here. The last two runs are on b2: all runs may have changed as well."""
    groups = {
        Source.BENCH: ["b1", "b1", "b2", "b2"] * 3,
        Source.DEVICE: ["D", "E"] * 6,
        Source.OCCASION: list("abcdefghijkl"),
    }
    y = np.array([1.0, 2.1, 3.2, 4.0, 1.1, 1.9, 3.0, 4.2, 0.9, 2.0, 8.1, 9.2])
    (found,) = changes(Estimates(y, np.array([0.1, 0.2] * 6), groups), range(12))
    assert found.sources == ((Source.BENCH, "b2"), (Source.COMMON, ALL_RUNS)) and found.before == 4
    assert (found.size, found.standard_uncertainty) == pytest.approx((5.02, 0.10954451150103328))


def test_a_bench_that_tilts_is_named_with_size_and_night() -> None:
    right = inside = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        y, s, groups, days = fleet(rng)
        since = int(rng.integers(2, NIGHTS - 2))
        y = y + 4.0 * np.array(
            [bench == "b2" and day >= since for bench, day in zip(groups[Source.BENCH], days, strict=True)]
        )
        found = changes(Estimates(y, s, groups), days.tolist(), amplitudes=10)
        assert len(found) == 1
        (one,) = found
        assert one.sources == ((Source.BENCH, "b2"),) and one.kind is ChangeKind.STEP
        right += one.earliest < 3 * since <= one.latest
        inside += abs(one.size - 4.0) <= 2 * one.standard_uncertainty
    assert right >= 0.9 * 40 and inside >= 0.85 * 40  # 95 % less three standard deviations of 40 draws


def test_the_interval_of_a_step_holds_it_in_95_of_100_cases() -> None:
    """Four runs of one device that scatter thirty times as much as stated: ν = 2. Twice the standard uncertainty would hold 82 %."""
    groups = {Source.BENCH: ["b"] * 4, Source.DEVICE: ["D"] * 4, Source.OCCASION: list("abcd")}
    rng, count, true = np.random.default_rng(3), 400, 1e5
    inside = 0
    for _ in range(count):
        y = np.array([0.0, 0.0, true, true]) + rng.normal(0, 30, 4)
        (found,) = changes(Estimates(y, np.ones(4), groups), range(4))
        inside += abs(found.size - true) <= found.expanded
    assert abs(inside / count - 0.95) < 3 * math.sqrt(0.95 * 0.05 / count)


@pytest.mark.parametrize("scatter", [0.0, 2.0])
def test_a_fleet_without_a_change_says_nothing(scatter: float) -> None:
    """At most 1 % of fleets, also if the runs scatter more than their uncertainties say."""
    false = sum(
        bool(changes(Estimates(y, s, groups), days.tolist()))
        for seed in range(100)
        for y, s, groups, days in [fleet(np.random.default_rng(1000 + seed), scatter)]
    )
    assert false <= 1 + 3 * math.sqrt(1)


def test_a_device_that_drifts_is_not_a_series_of_steps() -> None:
    y, s, groups, days = fleet(np.random.default_rng(5))
    own = np.array([device == "18" for device in groups[Source.DEVICE]])
    (found,) = changes(Estimates(y + own * 1.5 * days, s, groups), days.tolist())
    assert (found.kind, found.sources) == (ChangeKind.DRIFT, ((Source.DEVICE, "18"),))
    assert abs(found.size - 1.5) < 2.6 * found.standard_uncertainty


def test_what_the_runs_cannot_distinguish_is_listed_together() -> None:
    """One device on one bench."""
    y = np.array([0.0] * 5 + [9.0] * 5)
    groups = {Source.BENCH: ["b"] * 10, Source.DEVICE: ["D"] * 10, Source.OCCASION: list("abcdefghij")}
    (found,) = changes(Estimates(y, np.ones(10), groups), range(10))
    assert found.sources == ((Source.BENCH, "b"), (Source.DEVICE, "D"), (Source.COMMON, ALL_RUNS))


def test_a_new_device_or_a_single_outlier_is_no_change() -> None:
    groups = {Source.BENCH: ["b"] * 10, Source.DEVICE: ["D"] * 5 + ["E"] * 5, Source.OCCASION: list("abcdefghij")}
    assert changes(Estimates(np.array([0.0] * 5 + [9.0] * 5), np.ones(10), groups), range(10)) == ()
    same = {**groups, Source.DEVICE: ["D"] * 10}
    assert changes(Estimates(np.array([0.0] * 9 + [9.0]), np.ones(10), same), range(10)) == ()


# -- lots --------------------------------------------------------------------------------------------------------------


def test_devices_of_a_lot_are_named_if_all_of_them_and_no_others_differ() -> None:
    """Three of six devices: by chance 1/20. Means 11 and 1, each of three levels with U = 1: U = √(1/3 + 1/3)."""
    key = AmplitudeKey("accel_thermal", "x", "mg/K")
    levels = {name: [Uncertain(value, 1.0)] for name, value in zip("abcdef", [10.0, 11, 12, 0, 1, 2], strict=True)}
    lots = dict.fromkeys("abc", "17") | dict.fromkeys("def", "16")
    seventeen = next(one for one in shared_by_lots(key, levels, lots) if one.lot == "17")
    assert (seventeen.devices, seventeen.others) == (("a", "b", "c"), 3)
    assert seventeen.chance == pytest.approx(0.05)
    assert (seventeen.difference, seventeen.expanded) == pytest.approx((10, math.sqrt(2 / 3)))
    assert not list(shared_by_lots(key, {**levels, "d": [Uncertain(9.5, 1.0)]}, lots))  # another device has it too
    assert not list(shared_by_lots(key, {**levels, "a": [Uncertain(2.5, 1.0)]}, lots))  # a device of the lot has it not
    few = {name: levels[name] for name in "abde"}
    assert not list(shared_by_lots(key, few, lots))  # 1/6 by chance


def test_a_device_that_stepped_is_one_device_of_its_lot() -> None:
    """Three of six devices, each at 5 and then at 11: means 8 and 1; U = √(3·(√2/2)²)/3 of the lot, √3/3 of the others. One that stepped
    to where the others are does not differ from them any more."""
    key = AmplitudeKey("accel_thermal", "x", "mg/K")
    others = {name: [Uncertain(value, 1.0)] for name, value in zip("def", [0.0, 1, 2], strict=True)}
    stepped = {name: [Uncertain(5.0, 1.0), Uncertain(11.0, 1.0)] for name in "abc"}
    (found,) = shared_by_lots(key, {**stepped, **others}, dict.fromkeys("abc", "17"))
    assert found.devices == ("a", "b", "c") and found.others == 3 and found.chance == pytest.approx(0.05)
    assert (found.difference, found.expanded) == pytest.approx((7, math.sqrt(1 / 6 + 1 / 3)))
    stepped["a"] = [Uncertain(5.0, 1.0), Uncertain(2.5, 1.0)]
    assert not list(shared_by_lots(key, {**stepped, **others}, dict.fromkeys("abc", "17")))
