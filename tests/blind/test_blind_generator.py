"""The generator stands alone, strengths are what they are said to be, and a case is the same whoever makes it."""

from __future__ import annotations

import ast
import itertools
from pathlib import Path

import numpy as np
import pytest

from tests.blind import generator
from tests.blind.device import SENSORS, Sensor, Triad, clean_output, fault, ideal
from tests.blind.effects import CATALOGUE, FOREIGN
from tests.blind.motion import Fault, Schedule, Site
from tests.blind.noise import Metric, flicker_basis, noise
from tests.blind.plans import PLANS, X_UP, Segment, read_segments, write_segments
from tests.blind.signatures import change, excess_energy, excess_ratio

HERE = Path(__file__).parent
MEETS_THE_PRODUCT = {"product.py"}  # where a case is handed to the diagnosis
SHARES_WORK = {"planrunner.base.workers", "planrunner.cli.arguments", "planrunner.base.findings"}
"""These hand out items to processes, with their arguments and messages. They compute nothing."""


@pytest.mark.parametrize("path", sorted(HERE.glob("*.py")), ids=lambda p: p.name)
def test_nothing_of_the_product_is_imported(path: Path) -> None:
    if path.name in MEETS_THE_PRODUCT:
        return
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        assert not [name for name in names if name.split(".")[0] == "planrunner" and name not in SHARES_WORK], path


def test_composition_and_plans_are_as_many_as_promised() -> None:
    assert len(PLANS) >= 5 and len(SENSORS) >= 2 and len(FOREIGN) >= 8
    assert sum(generator.COMPOSITION.values()) == pytest.approx(1)
    kinds = [generator.assigned(5, n) for n in range(2000)]
    for kind, share in generator.COMPOSITION.items():
        assert sum(k[2] == kind for k in kinds) / 2000 == pytest.approx(share, abs=0.04)
    assert {k[0] for k in kinds} == set(PLANS) and {k[1] for k in kinds} == set(SENSORS)


@pytest.mark.parametrize("plan", PLANS)
def test_plans_are_written_and_read_again(plan: str, tmp_path: Path) -> None:
    write_segments(tmp_path / "s.csv", PLANS[plan])
    assert read_segments(tmp_path / "s.csv") == PLANS[plan]
    ends = [0.0, *(s.end for s in PLANS[plan])]
    assert all(s.start > end for s, end in zip(PLANS[plan], ends, strict=False))
    assert len({s.label for s in PLANS[plan]}) == len(PLANS[plan])


def test_energy_of_an_asymmetry_worked_by_hand() -> None:
    plan = (
        Segment("s", "static", X_UP, 10.0, start=0.0),
        Segment("p", "rate", X_UP, 4.0, 60.0, start=20.0),
        Segment("m", "rate", X_UP, 4.0, -60.0, start=30.0),
    )
    mems = SENSORS["mems"]
    schedule = Schedule(plan, 50.0, Site(earth_rate=0.0))
    difference = change(schedule, mems, ideal(mems), [*fault("gyro_scale_asymmetry", 1e-3, 0, 0).values()])
    at_rest, turning = 500, 400
    expected = 0.06**2 * at_rest * turning / (at_rest + turning) / 0.01**2  # what a mean leaves of a step of 0.06
    assert Metric(schedule, mems, (1.0, 1.0)).energy(difference) == pytest.approx(expected, rel=1e-6)
    assert Metric(schedule, mems, (2.0, 1.0)).energy(difference) == pytest.approx(expected / 4, rel=1e-6)


def test_energy_in_flicker_is_the_generalised_least_squares_one() -> None:
    sensor = Sensor("s", 2.0, Triad(1e-3, 2e-3, 1e-9), None)
    schedule = Schedule(
        (Segment("a", "static", X_UP, 30.0, start=0.0), Segment("b", "rate", X_UP, 30.0, 20.0, start=60.0)), 2.0
    )
    difference = np.column_stack([np.sin(schedule.time / 9), schedule.time / 50, np.cos(schedule.time)])
    basis = flicker_basis(schedule.time)
    density = np.tile(2e-3**2 / np.pi * np.log(generator_step()), 2 * 36)
    covariance = 1e-3**2 * np.eye(120) + (basis * density) @ basis.T
    inverse = np.linalg.inv(covariance)
    nominal = np.column_stack([schedule.nominal.rate, np.ones(120)])
    weighed = inverse - inverse @ nominal @ np.linalg.pinv(nominal.T @ inverse @ nominal) @ nominal.T @ inverse
    expected = np.trace(difference.T @ weighed @ difference)
    assert Metric(schedule, sensor, (1.0, 1.0)).energy(difference) == pytest.approx(expected, rel=1e-5)


def generator_step() -> float:
    return (0.5 / 2e-5) ** (1 / 35)


def test_scale_factors_and_biases_are_no_gap_and_a_rate_error_is_absorbed() -> None:
    around = generator.signatures("poor", "mems")
    device = generator.random_device(SENSORS["mems"], np.random.default_rng(2))
    schedule = around.schedule
    nominal = clean_output(schedule, SENSORS["mems"], device, {}) - clean_output(
        schedule, SENSORS["mems"], ideal(SENSORS["mems"]), {}
    )
    assert around.metric.energy(nominal) < 1e-6 * np.sum(around.metric.scaled(nominal) ** 2)
    error = change(schedule, SENSORS["mems"], device, [*fault("table_rate_error", 1e-3).values()])
    assert generator.kept_share(around, error) < generator.GONE


@pytest.mark.slow
def test_noise_has_the_declared_level_and_flicker() -> None:
    schedule = Schedule((Segment("a", "static", X_UP, 2000.0, start=0.0),), 20.0)
    white = noise(schedule, SENSORS["mems"], np.array([1, 1, 1, 2, 2, 2.0]), np.random.default_rng(1))
    assert white.std(axis=0) == pytest.approx(SENSORS["mems"].sigma() * [1, 1, 1, 2, 2, 2], rel=0.02)
    flat = Sensor("flat", 20.0, Triad(0.0, 1.0, 1e-9), None)
    floors = []
    for seed in range(30):
        means = noise(schedule, flat, np.ones(3), np.random.default_rng(seed)).reshape(100, 400, 3).mean(axis=1)
        floors.append(np.mean(np.diff(means, axis=0) ** 2) / 2)
    assert np.sqrt(np.mean(floors)) == pytest.approx(0.664, rel=0.08)  # Allan deviation of flicker: √(2 ln2/π)·B


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    ["gyro_scale_asymmetry", "gyro_dead_zone", "gyro_saturation", "table_wobble", "backlash", "gyro_bandwidth"],
)
def test_an_effect_has_the_strength_that_was_asked_for(effect: str) -> None:
    around = generator.signatures("rocking", "mems")
    work = generator.Work(around, (1.0, 1.0), generator.random_device(SENSORS["mems"], np.random.default_rng(1)))
    drawn = generator.one_effect(work, [effect], 150.0, np.random.default_rng(4))
    assert work.energy(drawn) == pytest.approx(150.0, rel=0.05)


def test_strength_of_noise_is_in_units_of_the_trust_in_what_is_declared() -> None:
    assert excess_energy(excess_ratio(36.0)) == pytest.approx(36.0)
    assert excess_ratio(36.0) == pytest.approx(np.exp(0.12))


@pytest.mark.parametrize("factor", [1.0, 0.6, 1.8])
def test_excess_noise_begins_where_a_wrong_declaration_ends(factor: float) -> None:
    """Whatever the declaration, the true level is 2·exp(0.02·√λ) times the declared one."""
    mems, rng = SENSORS["mems"], np.random.default_rng(2)
    work = generator.Work(generator.signatures("poor", "mems"), (factor, 1.0), generator.random_device(mems, rng))
    drawn = generator.one_effect(work, ["gyro_noise_excess"], 144.0, rng)
    assert factor * (1 + drawn.theta[0]) == pytest.approx(2 * np.exp(0.24))
    assert generator.strength_of(work, drawn) == pytest.approx(144.0)


@pytest.mark.slow
def test_beside_excess_noise_the_other_effect_has_its_strength_in_that_noise() -> None:
    """A pair's strength is in units of the true noise: three times the noise leaves a ninth of the energy."""
    mems, rng = SENSORS["mems"], np.random.default_rng(3)
    work = generator.Work(generator.signatures("poor", "mems"), (1.0, 1.0), generator.random_device(mems, rng))
    noisy = Fault("gyro_noise_excess", np.array([2.0]))
    skewed = generator.one_effect(work.under(noisy), ["gyro_scale_asymmetry"], 150.0, rng)
    assert work.energy(skewed) == pytest.approx(9 * 150.0, rel=1e-3)
    entries = generator.label_of("x", "pair", [skewed, noisy], work, False)["entries"]
    assert entries[0]["lambda"] == pytest.approx(150.0, rel=1e-3)
    drawn = (generator.draw("x", "poor", "mems", "pair", np.random.default_rng(seed)).label for seed in range(40))
    both = list(itertools.islice((pair for pair in drawn if "gyro_noise_excess" in pair["effects"]), 3))
    assert both and all(3.8 <= entry["lambda"] <= 1.05e4 for pair in both for entry in pair["entries"])


def test_a_case_depends_on_nothing_but_seed_and_number() -> None:
    numbers = [
        n for n in range(60) if generator.assigned(11, n)[0] == "poor" and generator.assigned(11, n)[1] == "mems"
    ][:3]
    first = {n: generator.make(11, n) for n in numbers}
    for n in reversed(numbers):
        again = generator.make(11, n)
        assert again.label == first[n].label
        assert all(np.array_equal(again.columns[name], first[n].columns[name]) for name in again.columns)


def test_labels_say_what_was_done() -> None:
    rng = np.random.default_rng(8)
    for kind in ("none", "single", "pair", "unknown"):
        case = generator.draw("x", "poor", "fog", kind, rng)
        entries = case.label["entries"]
        assert len(entries) == {"none": 0, "single": 1, "pair": 2, "unknown": 1}[kind]
        for entry in entries:
            assert entry["effect"] in (FOREIGN if kind == "unknown" else CATALOGUE)
            assert entry["effect"] in entry["class"]
            assert entry["absorbed"] or 3.8 <= entry["lambda"] <= 1.05e4
            assert sum(entry["channels"]) == pytest.approx(1, abs=1e-4) or entry["absorbed"]
        assert list(case.columns)[:3] == ["time_s", "table_angle_deg", "temperature_degC"]
        assert all(np.isfinite(column).all() for column in case.columns.values())


def test_a_resonance_seen_at_one_rate_looks_like_an_asymmetry() -> None:
    """Turning at one rate either way shows a function of |rate| at one place, as a scale factor of two senses does; at six rates not."""
    resonance = Fault("rate_resonance", np.array([1e-3, -2e-3, 1.5e-3]), (55.0,))
    found = {}
    for plan in ("poor", "rates"):
        around = generator.signatures(plan, "fog")
        difference = change(around.schedule, around.sensor, ideal(around.sensor), [resonance])
        found[plan] = around.inseparable("rate_resonance", difference, 1e4)
    assert "gyro_scale_asymmetry" in found["poor"] and found["rates"] == ["rate_resonance"]
