"""Priors go to what the plan can show, and effects on the noise are weighed together with each other."""

from __future__ import annotations

from math import comb
from types import SimpleNamespace

import numpy as np
import pytest

from planrunner.base import plugins
from planrunner.error_model.observed import Observed
from planrunner.gap.answer import posterior
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import candidates_of
from planrunner.plan.schedule import Rock
from tests.gap.turntable import DEG, RATE, G, kept, record

Array = np.ndarray


def test_an_effect_that_cannot_act_takes_no_part_of_the_prior() -> None:
    """At one temperature and without rocking: half of the prior for the effects that are left, evenly."""
    whole = record(seed=6)
    cool = [
        i
        for i, part in enumerate(whole.segments())
        if whole.temperature[part][0] == 25.0 and not isinstance(whole.motions[i], Rock)
    ]
    found = diagnose(kept(whole, cool)).posterior
    single = [name for name in found.log_evidence if "+" not in name and name not in ("none", "unknown")]
    assert "gyro_bias_temperature" not in single
    assert "gyro_bandwidth" not in single
    prior = {size: 1 / comb(len(single), size) for size in (1, 2, 3, 4)}
    prior = {1: 0.50 * prior[1], 2: 0.10 * prior[2], 3: 0.05 / 4 * prior[3], 4: 0.05 / 8 * prior[4]}
    pair = next(
        name for name, value in found.log_evidence.items() if "+" in name and np.isfinite(value) and alone(name)
    )
    for name in (*single, pair):
        odds = found.probability[name] / found.probability["none"]
        same = [other for other in found.log_evidence if other == name or (alone(name) and cause(other) == cause(name))]
        expected = sum(np.exp(found.log_evidence[other]) * prior[len(other.split("+"))] for other in same) / 0.20
        assert odds == pytest.approx(expected, rel=2e-3)


ON_NOISE = {"gyro_noise_excess", "gyro_quantization", "accel_noise_excess", "accel_quantization"}
QUICK = (*sorted(ON_NOISE), "gyro_g_sensitivity")
RIVALS = ("gyro_bias_random_walk", "gyro_bias_step", "gyro_bias_temperature", "gyro_g2_sensitivity", "table_tilt")
AMONG_ALL = pytest.param(None, marks=pytest.mark.slow, id="all")
"""All effects are hypotheses, which takes long."""


def cause(name: str) -> set[str]:
    return set(name.split("+")) - ON_NOISE


def alone(name: str) -> bool:
    """Whether no effect on the level of the noise is among the effects."""
    return cause(name) == set(name.split("+"))


@pytest.mark.parametrize("effects", [pytest.param((*QUICK, *RIVALS), id="few"), AMONG_ALL])
def test_noise_is_reported_beside_a_cause_and_is_no_rival_of_it(effects: tuple[str, ...] | None) -> None:
    """Noise six times as strong as declared, which no wrong declaration explains, beside an unbalance."""

    def unbalance(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return force / G @ draw.normal(0.0, 1.0, (3, 3)) * 0.1 * DEG, 0.0

    made = diagnose(record(seed=11, fault=unbalance, noise=6.0), DiagnosisOptions(effects=effects))
    found, said = made.posterior, made.verdict
    assert not [name for name in found.probability if cause(name) and not alone(name)]
    assert sum(found.probability.values()) == pytest.approx(1.0)
    assert (said.kind, said.effects, said.noise) == ("effect", ("gyro_g_sensitivity",), ("gyro_noise_excess",))
    assert found.noise["gyro_noise_excess"] > 0.99
    assert "gyro_noise_excess" in {one.effect for one in made.parameters}


def test_noise_is_reported_beside_something_else() -> None:
    """Noise six times as strong as declared, beside an offset of every segment, which no effect of the catalogue explains."""

    def offsets(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return draw.normal(0.0, 0.05 * DEG, (len(observed), 3))[observed.owner], 0.0

    found = diagnose(record(seed=11, fault=offsets, noise=6.0), DiagnosisOptions(effects=QUICK))
    assert (found.verdict.kind, found.verdict.noise) == ("unknown", ("gyro_noise_excess",))
    assert found.posterior.noise["gyro_noise_excess"] > 0.99
    assert found.posterior.noise["accel_noise_excess"] < 0.5


@pytest.mark.parametrize("effects", [pytest.param((*QUICK, *RIVALS), id="few"), AMONG_ALL])
def test_a_walk_is_found_beside_more_noise(effects: tuple[str, ...] | None) -> None:
    def walk(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        gaps = np.diff(observed.time, prepend=observed.time[0])
        steps = draw.normal(0.0, 1.0, omega.shape) * np.sqrt(gaps + 1 / RATE)[:, None]
        return 2e-4 * DEG * np.cumsum(steps, axis=0), 0.0

    found = diagnose(record(seed=8, fault=walk, noise=4.0), DiagnosisOptions(effects=effects))
    assert next(iter(found.posterior.probability)) == "gyro_bias_random_walk"
    assert found.verdict.noise == ("gyro_noise_excess",)


def test_averaging_over_a_shape_never_gains() -> None:
    """Beside a strong effect the best shape of another at an undeclared walk is not the best at the declared noise."""

    def unbalance(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return force / G @ draw.normal(0.0, 1.0, (3, 3)) * 3e-3 * DEG, 0.0

    weighing = Weighing(record(seed=11, fault=unbalance))
    effects = [plugins.load("planrunner.effects", name)() for name in plugins.names("planrunner.effects")]
    candidates = candidates_of(weighing, [effect for effect in effects if effect.stage != "covariance"])
    shaped = [c for c in candidates if len(c.variants) > 1 and np.isfinite(c.log_bayes).any()]
    assert len(shaped) > 3
    assert all(c.shape_cost <= 0 for c in shaped)


def test_events_beside_a_pair_that_was_evaluated_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pair has the largest evidence, but was not evaluated in full. Events are then evaluated in addition to its first effect. A
    random walk that explains much less has no more events than this effect."""
    monkeypatch.setattr(posterior, "ShortOffsets", lambda _: None)
    monkeypatch.setattr(
        posterior, "events_beside", lambda weighing, *_: np.full(4, weighing if isinstance(weighing, float) else 9.0)
    )
    weighing = SimpleNamespace(likeliest=(0, 0), base=[0.0], beside=lambda known: known, likeliest_with=lambda *_: 0)
    kinds = SimpleNamespace(events=np.zeros((1, 4)))
    candidates = [SimpleNamespace(id=name, log_bayes=np.zeros(1), best=at) for name, at in (("a", 3.0), ("b", 5.0))]
    found = {"none": 0.0, "a": 100.0, "b": 20.0, "a+b": 101.0, "walk": 40.0}
    events = posterior._Events(weighing, kinds, candidates, {}, found, "walk")  # type: ignore[arg-type]
    assert [events.beside(name).tolist() for name in ("a", "b", "a+b", "walk")] == [[3.0] * 4] * 4
    likelier = posterior._Events(weighing, kinds, candidates, {}, found | {"walk": 95.0}, "walk")  # type: ignore[arg-type]
    assert likelier.beside("walk").tolist() == [9.0] * 4
