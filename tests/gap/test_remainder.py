"""What explains nearly all of a gap is named beside whatever else there is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from planrunner.error_model.effects.interface import Variant
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.diagnosis import diagnose
from planrunner.gap.answer.posterior import Posterior, log_prior
from planrunner.gap.answer.verdict import Verdict, as_probable, leading, verdict
from planrunner.gap.hypotheses.candidates import Candidate
from tests.gap.turntable import record

Array = np.ndarray

SIGNATURES = ("gyro_bias", "gyro_scale_factor", "gyro_dead_zone")


def _leading(evidence: dict[str, float], top: str) -> tuple[str, str] | None:
    """With equal prior probabilities of all hypotheses."""
    return leading(evidence, evidence, top, SIGNATURES)


TERMS = {"none": 0.0, "gyro_bias": 9000.0, "gyro_scale_factor": 400.0, "gyro_bias+gyro_scale_factor": 9600.0}


def test_a_remainder_does_not_hide_the_term() -> None:
    """9600 of 10 000: 96 % of the energy."""
    assert _leading(TERMS | {"unknown": 10_000.0}, "unknown") == ("gyro_bias+gyro_scale_factor", "unknown")
    walk = "gyro_bias_random_walk+gyro_scale_factor"
    assert _leading(TERMS | {walk: 10_000.0}, walk) == (
        "gyro_bias+gyro_scale_factor",
        "gyro_bias_random_walk",
    )


def test_the_form_of_a_strong_effect_is_residue() -> None:
    """99.2 % of what anything at all could explain."""
    assert _leading({"none": 0.0, "gyro_dead_zone": 9030.0, "unknown": 9100.0}, "unknown") == (
        "gyro_dead_zone",
        "unknown",
    )


@pytest.mark.parametrize(
    ("evidence", "top"),
    [
        (TERMS | {"unknown": 10_200.0}, "unknown"),  # 94 %
        ({"none": 0.0, "gyro_bias": 1200.0, "unknown": 1210.0}, "unknown"),  # 49 σ
        (
            {"none": 0.0, "gyro_dead_zone": 9000.0, "unknown": 9100.0},
            "unknown",
        ),  # 98.9 %, and no term of a nominal model
        ({"none": 0.0, "gyro_bias_random_walk": 9099.0, "unknown": 9100.0}, "unknown"),  # noise may take any form
        (TERMS, "gyro_bias+gyro_scale_factor"),  # named in any case
    ],
)
def test_otherwise_the_likeliest_hypothesis_stands(evidence: dict[str, float], top: str) -> None:
    assert _leading(evidence, top) is None


def test_a_further_effect_that_explains_nothing_is_not_named() -> None:
    """It adds 0.3 nats of evidence, but a pair has a smaller prior probability than an effect."""
    evidence = {"none": 0.0, "gyro_dead_zone": 9030.0, "gyro_dead_zone+gyro_warm_up": 9030.3, "unknown": 9100.0}
    prior = {name: log_prior(name, 25) for name in evidence}
    weights = {name: value + prior[name] for name, value in evidence.items()}
    among = (*SIGNATURES, "gyro_warm_up")
    assert leading(evidence, weights, "unknown", among) == ("gyro_dead_zone", "unknown")
    weights["gyro_dead_zone+gyro_warm_up"] += 10.0
    assert leading(evidence, weights, "unknown", among) == ("gyro_dead_zone+gyro_warm_up", "unknown")


def test_what_explains_distinctly_more_is_no_other_name_for_it() -> None:
    evidence = {"a": 100.0, "b": 101.0, "c": 99.0, "d": 110.0}
    alike = as_probable(evidence, evidence, "a")
    assert alike == pytest.approx({"a": 1.0, "b": 1.0, "c": 0.36788}, rel=1e-4)


@dataclass
class _Named:
    id: str
    stage: str = "sensor"

    def variants(self, observed: Observed) -> list[Variant]:
        return []


def _candidate(name: str, log_bayes: float) -> Candidate:
    """As a verdict sees one that no other resembles."""
    return Candidate(_Named(name), (), np.array([log_bayes]))


def _verdict(found: Posterior, candidates: list[Candidate]) -> Verdict:
    """Without a recording behind them: candidates without columns are held against nothing."""
    return verdict(None, found, candidates)  # type: ignore[arg-type]


def test_a_second_effect_beside_a_remainder_is_residue_too() -> None:
    """A dead zone of 237 σ: what a warm-up adds to it is 0.8 %, and something else 1 %."""
    evidence = {"none": 0.0, "gyro_dead_zone": 56_201.0, "gyro_dead_zone+gyro_warm_up": 56_650.0, "unknown": 57_212.0}
    found = Posterior(
        {"unknown": 1.0} | dict.fromkeys(evidence, 0.0) | {"unknown": 1.0}, evidence, {}, {}, log_weights=evidence
    )
    said = _verdict(found, [_candidate("gyro_dead_zone", 56_201.0), _candidate("gyro_warm_up", 100.0)])
    assert (said.kind, said.effects, said.residue) == ("effect", ("gyro_dead_zone",), "unknown")


def test_an_effect_that_may_act_instead_of_a_nominal_term_is_in_the_class() -> None:
    """To and fro at one speed, a limit of the output and a scale factor explain nearly the same; the set with the limit is likelier."""
    evidence = {
        "none": 0.0,
        "gyro_scale_factor": 99_900.0,
        "gyro_saturation": 99_700.0,
        "gyro_warm_up": 50_000.0,
        "gyro_saturation+gyro_warm_up": 100_000.0,
    }
    best = "gyro_saturation+gyro_warm_up"
    found = Posterior({best: 1.0} | dict.fromkeys(evidence, 0.0) | {best: 1.0}, evidence, {}, {}, log_weights=evidence)
    candidates = [_candidate(name, value) for name, value in evidence.items() if "+" not in name and name != "none"]
    said = _verdict(found, candidates)
    assert (said.kind, said.effects) == ("indistinguishable", ("gyro_scale_factor",))
    assert said.members == ("gyro_scale_factor", "gyro_saturation")


def test_terms_of_a_nominal_model_leave_no_residue_of_form() -> None:
    evidence = {"none": 0.0, "gyro_bias": 9400.0, "gyro_bias+gyro_scale_factor": 9600.0}
    found = Posterior(
        {"gyro_bias+gyro_scale_factor": 1.0, "gyro_bias": 0.0, "none": 0.0}, evidence, {}, {}, log_weights=evidence
    )
    said = _verdict(found, [_candidate("gyro_bias", 9400.0), _candidate("gyro_scale_factor", 300.0)])
    assert (said.kind, said.effects) == ("pair", ("gyro_bias", "gyro_scale_factor"))


def test_a_weak_effect_where_the_strong_one_does_not_act_is_no_residue() -> None:
    """An asymmetry of the gyros; the accelerometers' biases follow the temperature, with a seventieth of its energy."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array]:
        return 3e-4 * np.abs(omega), np.outer(observed.warmth, [2e-5, -1.4e-5, 1.4e-5])

    said = diagnose(record(seed=12, fault=fault)).verdict
    assert (said.kind, said.effects, said.residue) == ("pair", ("accel_bias_temperature", "gyro_scale_asymmetry"), None)


def test_more_noise_than_declared_is_no_residue_of_form() -> None:
    """0.7 % of what a lever arm and it explain together: noise is measured where no form shows."""
    evidence = {"none": 0.0, "lever_arm": 2000.0, "gyro_noise_excess+lever_arm": 2015.0}
    probability = {"gyro_noise_excess+lever_arm": 1.0, "lever_arm": 0.0, "none": 0.0}
    for levels, kind in ((frozenset({"gyro_noise_excess"}), "pair"), (frozenset(), "effect")):
        found = Posterior(probability, evidence, {}, {}, levels, log_weights=evidence)
        said = _verdict(found, [_candidate("lever_arm", 2000.0)])
        assert said.kind == kind


@pytest.mark.parametrize(
    ("both", "kind", "residue"),
    [
        (2015.0, "effect", True),  # 0.7 %
        (2050.0, "pair", True),  # 2.4 %
        (2150.0, "pair", False),  # 7 %
    ],
)
@pytest.mark.parametrize("second", ["gyro_warm_up", "gyro_bias_random_walk"])
def test_a_weak_second_effect_is_named_and_said_to_be_residue_perhaps(
    second: str, both: float, kind: str, residue: bool
) -> None:
    """Also one that acts on the noise and has no signature of its own."""
    pair = "+".join(sorted(["gyro_dead_zone", second]))
    evidence = {"none": 0.0, "gyro_dead_zone": 2000.0, pair: both}
    found = Posterior({pair: 1.0, "none": 0.0}, evidence, {}, {}, log_weights=evidence)
    signatures = [_candidate("gyro_dead_zone", 2000.0)]
    if second == "gyro_warm_up":
        signatures.append(_candidate(second, 100.0))
    said = _verdict(found, signatures)
    assert (said.kind, said.residue) == (kind, second if residue else None)
