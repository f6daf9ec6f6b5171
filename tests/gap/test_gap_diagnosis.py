"""Diagnoses of simulated recordings whose fault is known, and the calibration of what a diagnosis says of pure noise."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from planrunner.error_model.effects.interface import Shaped, effect_named
from planrunner.error_model.observed import Observed
from planrunner.gap.answer import diagnosis
from planrunner.gap.answer.apart import fitted_line
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.gap.answer.gap_description import levels
from planrunner.gap.answer.posterior import PRIORS, Posterior
from planrunner.gap.answer.posterior import posterior as whole
from planrunner.gap.hypotheses.candidates import FULL, Weighing
from planrunner.observation.refusals import ObservationError
from tests.gap.turntable import DEG, GYRO_WHITE, Fault, G, kept, record

Array = np.ndarray


def _unbalance(
    observed: Observed, omega: Array, force: Array, draw: np.random.Generator
) -> tuple[Array, Array | float]:
    return force / G @ np.array([[0, 3, 0], [-2, 0, 1], [0, 1, 0]]) * 1e-3 * DEG, 0.0


def _tilt(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array | float, Array]:
    return 0.0, observed.in_sensor_axes(np.array([2e-4, -1e-4, 0.0]) * G)


def _tone(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array | float]:
    return 2e-3 * DEG * np.sin(2 * np.pi * 3.3 * observed.time)[:, None] * np.array([1.0, 0.0, 0.0]), 0.0


def _offsets(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array | float]:
    return draw.normal(0, 8e-3 * DEG, (len(observed), 3))[observed.owner], 0.0


def _walk(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array | float]:
    steps = np.sqrt(np.diff(observed.time, prepend=observed.time[0]))
    return np.cumsum(draw.normal(0, 2e-4 * DEG, omega.shape) * steps[:, None], axis=0), 0.0


OF_A_WALK = ("gyro_bias_random_walk", "gyro_bias_step", "gyro_bias_drift", "gyro_g_sensitivity", "table_tilt")
"""The effects of a recording with a random walk, and the effects that resemble it, for tests of sizes. Tests of names use all effects."""
AMONG_ALL = pytest.param(None, marks=pytest.mark.slow, id="all")
"""All effects are hypotheses, which takes long."""


def test_nothing_is_found_in_noise() -> None:
    found = diagnose(record(seed=11))
    assert found.verdict.kind == "none"
    assert found.posterior.probability["none"] > 0.3
    assert not found.closure.resolvable
    assert min(place.p for place in found.where) > 0.01
    assert found.absorbed["table_rate_error"] < 1e-6


@pytest.mark.parametrize("fault", [None, _unbalance, _offsets])
def test_shares_add_up_within_a_factor_and_cut_the_same_gap_anew_across_factors(fault: Fault | None) -> None:
    by_factor: dict[str, float] = {}
    for place, _ in levels(Weighing(record(seed=12, fault=fault))):
        assert place.of == "gap"
        by_factor[place.factor] = by_factor.get(place.factor, 0.0) + place.share
    assert len(by_factor) > 3
    assert all(0 <= total <= 1 + 1e-9 for total in by_factor.values()), by_factor
    if fault is not None:
        assert sum(by_factor.values()) > 1.5, "which is why they are not added across factors"


def test_one_effect_is_named_measured_and_closed() -> None:
    found = diagnose(record(seed=12, fault=_unbalance))
    assert found.verdict.kind == "effect"
    assert found.verdict.effects == ("gyro_g_sensitivity",)
    estimates = {p.name: p for p in found.parameters}
    for name, true in {"K_x_y": 3e-3, "K_y_x": -2e-3, "K_z_y": 1e-3, "K_x_z": 0.0}.items():
        assert abs(estimates[name].value - true) < 4.5 * estimates[name].standard_uncertainty + 0.01 * abs(true)
        assert estimates[name].unit == "deg/s/g"
    assert found.closure.resolvable
    assert found.closure.shrinks_by > 0.6
    assert found.where[0].channel in ("gyro_x", "gyro_y")
    assert found.where[0].p < 0.01


def test_two_effects_are_named_together() -> None:
    def both(
        observed: Observed, omega: Array, force: Array, draw: np.random.Generator
    ) -> tuple[Array | float, Array | float]:
        return _unbalance(observed, omega, force, draw)[0], _tilt(observed, omega, force, draw)[1]

    found = diagnose(record(seed=13, fault=both))
    assert found.verdict.kind == "pair"
    assert found.verdict.effects == ("gyro_g_sensitivity", "table_tilt")
    tilt = {p.name: p.value for p in found.parameters if p.effect == "table_tilt"}
    # specific force gains (2, −1, 0)·1e-4 g in site axes: −ε × g·up = g·(−ε_north, ε_east, 0)
    assert tilt["about_north"] == pytest.approx(-2e-4 / DEG * 3600, rel=0.1)
    assert tilt["about_east"] == pytest.approx(-1e-4 / DEG * 3600, rel=0.2)


def test_a_named_pair_of_which_only_the_quick_evaluation_is_known_is_fitted_as_a_pair(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def both(
        observed: Observed, omega: Array, force: Array, draw: np.random.Generator
    ) -> tuple[Array | float, Array | float]:
        return _unbalance(observed, omega, force, draw)[0], _tilt(observed, omega, force, draw)[1]

    seen, few = record(seed=13, fault=both), DiagnosisOptions(effects=("gyro_g_sensitivity", "table_tilt"))
    known = diagnose(seen, few)

    def without_sets(*arguments: Any) -> Posterior:
        return replace(whole(*arguments), sets={})

    monkeypatch.setattr(diagnosis, "posterior", without_sets)
    found = diagnose(seen, few)
    assert found.verdict.effects == known.verdict.effects == ("gyro_g_sensitivity", "table_tilt")
    assert found.rest is not None and found.rest.passes
    listed = [[p.value for p in one.parameters] for one in (found, known)]
    assert listed[0] == pytest.approx(listed[1], rel=1e-6)


def test_parameters_beside_a_random_walk_have_its_uncertainty() -> None:
    def both(
        observed: Observed, omega: Array, force: Array, draw: np.random.Generator
    ) -> tuple[Array | float, Array | float]:
        walk = _walk(observed, omega, force, draw)[0]
        return 5 * (walk + _unbalance(observed, omega, force, draw)[0]), 0.0

    found = diagnose(record(seed=18, fault=both))
    assert found.verdict.effects == ("gyro_bias_random_walk", "gyro_g_sensitivity")
    estimates = [p for p in found.parameters if p.effect == "gyro_g_sensitivity"]
    true = {"K_x_y": 15e-3, "K_y_x": -10e-3, "K_z_y": 5e-3, "K_y_z": 5e-3}
    away = [(p.value - true.get(p.name, 0.0)) / p.standard_uncertainty for p in estimates]
    assert chi2.sf(np.square(away).sum(), len(away)) > 1e-3


@pytest.mark.parametrize("effects", [pytest.param(OF_A_WALK, id="few"), AMONG_ALL])
@pytest.mark.parametrize(("walk", "unbalance"), [(1, 0), (1, 6), (5, 0)])
def test_the_density_of_a_random_walk_agrees_within_its_uncertainty(
    walk: float, unbalance: float, effects: tuple[str, ...] | None
) -> None:
    """Beside a strong effect, the density does not contain the effect. Above the levels that are evaluated, its uncertainty is large."""

    def both(
        observed: Observed, omega: Array, force: Array, draw: np.random.Generator
    ) -> tuple[Array | float, Array | float]:
        wandering = _walk(observed, omega, force, draw)[0]
        return walk * wandering + unbalance * _unbalance(observed, omega, force, draw)[0], 0.0

    found = diagnose(record(seed=18, fault=both), DiagnosisOptions(effects=effects))
    assert "gyro_bias_random_walk" in found.verdict.effects
    (density,) = (p for p in found.parameters if p.effect == "gyro_bias_random_walk")
    assert abs(density.value - walk * 2e-4) < 2 * density.standard_uncertainty
    assert density.value < 2 * walk * 2e-4


@pytest.mark.parametrize(
    "effects",
    [
        pytest.param((*OF_A_WALK, "gyro_bias_temperature", "gyro_warm_up", "mount_shift"), id="few"),
        AMONG_ALL,
    ],
)
def test_what_is_not_in_the_catalogue_is_said_to_be(effects: tuple[str, ...] | None) -> None:
    found = diagnose(record(seed=14, fault=_offsets), DiagnosisOptions(effects=effects))
    assert found.verdict.kind == "unknown"
    kinds = found.posterior.kinds
    assert max(kinds, key=lambda pattern: kinds[pattern]).name == "offset per segment"


def test_a_tone_is_a_line_of_its_frequency_and_amplitude() -> None:
    found = diagnose(record(seed=14, fault=_tone))
    assert found.verdict.effects == ("gyro_line_interference",)
    estimates = {p.name: p for p in found.parameters}
    true = {"frequency": 3.3, "sin_x": 2e-3, "cos_x": 0.0, "sin_y": 0.0, "cos_y": 0.0}
    for name, value in true.items():
        assert abs(estimates[name].value - value) < 4 * estimates[name].standard_uncertainty, name


def test_the_uncertainty_of_a_line_does_not_grow_with_the_line() -> None:
    """A line of 0.02 and 2 deg/s in x alone. Limits on both sides: the errors are neither larger nor smaller than stated."""
    line, away, stated = effect_named("gyro_line_interference"), [], []
    assert isinstance(line, Shaped)
    for seed in range(40, 45):
        noise = record(seed=seed)
        for size in (0.02, 2.0):
            values = noise.values.copy()
            values[:, 0] += size * DEG * np.sin(2 * np.pi * 3.3 * noise.time)
            _, u, columns, found = fitted_line(Weighing(replace(noise, values=values)), line, 3.3)
            at = [column.name for column in columns]
            cosine, sine = found[at.index("cos_x")], found[at.index("sin_x")]
            away += [cosine[0] / cosine[1], (sine[0] - size * DEG) / sine[1]]
            stated.append([u * size, cosine[1], sine[1]])
    # Both sizes are seen in the same noise, so five seeds have ten independent errors.
    assert 1e-3 < chi2.cdf(np.square(away).sum() / 2, len(away) / 2) < 1 - 1e-3
    assert np.array(stated) == pytest.approx(np.broadcast_to(stated[0], (len(stated), 3)), rel=0.1)


def test_a_tone_beside_an_effect_leaves_both_with_their_names() -> None:
    def both(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, Array | float]:
        return _tone(observed, omega, force, draw)[0] + _unbalance(observed, omega, force, draw)[0], 0.0

    found = diagnose(record(seed=14, fault=both))
    assert found.verdict.effects == ("gyro_g_sensitivity", "gyro_line_interference")
    assert next(p.value for p in found.parameters if p.name == "frequency") == pytest.approx(3.3, abs=1e-4)


@pytest.mark.slow
def test_effects_on_the_noise() -> None:
    walk = diagnose(record(seed=15, fault=_walk))
    assert walk.verdict.effects == ("gyro_bias_random_walk",)
    noisy = diagnose(record(seed=16, noise=2.5))
    assert noisy.verdict.effects == ("gyro_noise_excess",)
    assert noisy.parameters[0].value == pytest.approx(2.5 * GYRO_WHITE / DEG, rel=0.05)
    coarse = record(seed=17)
    values = coarse.values.copy()
    values[:, :3] = np.round(values[:, :3] / (0.01 * DEG)) * 0.01 * DEG
    counted = diagnose(replace(coarse, values=values))
    assert counted.verdict.effects == ("gyro_quantization",)
    assert counted.parameters[0].value == pytest.approx(0.01)


def test_a_poorer_nominal_model_leaves_its_terms_as_candidates() -> None:
    poor = tuple(name for name in FULL if name != "gyro_misalignment")
    found = diagnose(record(seed=18), DiagnosisOptions(nominal=poor))
    assert found.verdict.effects[0] == "gyro_misalignment"


def test_the_json_is_plain_and_keeps_the_contract() -> None:
    plain = diagnose(record(seed=11)).to_json()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert plain["priors"] == PRIORS
    assert sum(plain["posterior"].values()) == pytest.approx(1)
    for name in plain["posterior"]:
        assert sorted(name.split("+")) == name.split("+")
    assert plain["closure"] == {
        "before": None,
        "after": None,
        "shrinks_by": None,
        "interval_90": None,
        "resolvable": False,
        "reason": "no effect",
        "unpredicted": [],
        "channels": [],
        "repetition": None,
    }


def test_too_few_segments_are_refused() -> None:
    with pytest.raises(ObservationError, match="has 3 segments"):
        diagnose(kept(record(), [0, 1, 2]))


def test_whitened_residuals_of_noise_are_standard() -> None:
    """Their energy, freed of the nominal parameters, has the χ² distribution of its degrees of freedom."""
    chances = []
    for seed in range(20, 30):
        for weights in Weighing(record(seed=seed)).weights:
            rest = weights[0].residual
            chances.append(chi2.sf(rest @ rest, len(rest) - weights[0].basis.shape[1]))
    assert kstest(chances, "uniform").pvalue > 1e-3


@pytest.mark.slow
def test_the_smallest_p_value_of_all_levels_is_uniform_in_noise() -> None:
    smallest = [min(place.p for place, _ in levels(Weighing(record(seed=seed)))) for seed in range(100, 200)]
    assert kstest(smallest, "uniform").pvalue > 1e-3


def test_a_known_effect_is_fitted_and_the_rest_is_diagnosed_beside_it() -> None:
    """A g-sensitivity that is known to act, with a tilt of the table: the tilt alone is named."""

    def both(
        observed: Observed, omega: Array, force: Array, draw: np.random.Generator
    ) -> tuple[Array | float, Array | float]:
        return _unbalance(observed, omega, force, draw)[0], _tilt(observed, omega, force, draw)[1]

    found = diagnose(record(seed=13, fault=both), DiagnosisOptions(given=("gyro_g_sensitivity",)))
    assert (found.verdict.kind, found.verdict.effects) == ("effect", ("table_tilt",))
    fitted = {one.name: one for one in found.given}
    assert fitted["K_x_y"].value == pytest.approx(3e-3, abs=4.5 * fitted["K_x_y"].standard_uncertainty + 3e-5)
    assert "gyro_g_sensitivity" not in found.posterior.log_evidence


def test_an_effect_that_cannot_be_fitted_cannot_be_given() -> None:
    with pytest.raises(ObservationError, match="table_rate_error"):
        diagnose(record(seed=13), DiagnosisOptions(given=("table_rate_error",)))
    with pytest.raises(ObservationError, match="measured in any case"):
        diagnose(record(seed=13), DiagnosisOptions(given=("gyro_noise_excess",)))
