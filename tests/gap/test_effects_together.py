"""Effects that change each other: a limit or a dead zone acts on the sum of the true input and of all other effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from planrunner.error_model.effects.interface import effect_named
from planrunner.error_model.effects.table import TableAzimuth
from planrunner.error_model.observed import Observed
from planrunner.gap.answer import sets
from planrunner.gap.answer.closure import predictions
from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
from planrunner.gap.answer.sets import sets_of
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import BENT, candidates_of
from planrunner.plan.schedule import Rock
from tests.gap.test_closure import holds
from tests.gap.turntable import DEG, G, record

Array = np.ndarray
SAMPLING = 5.0
K = np.array([[0.02, 0.01, 0.03], [0.04, -0.03, 0.02], [0.03, 0.02, -0.05]]) * DEG / G
"""Change of the three gyros per specific force along x, y and z, in rad/s per m/s²."""


def _g_sensitivity(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
    return force @ K.T, 0.0


def _noisy(exact: Observed, outputs: Array, seed: int) -> Observed:
    draw = np.random.default_rng([seed, 5])
    sigma = np.array([channel.white for channel in exact.channels]) * np.sqrt(SAMPLING)
    channels = tuple(replace(one, resolution=0.0) for one in exact.channels)
    return replace(exact, values=outputs + sigma * draw.standard_normal(outputs.shape), channels=channels)


def _limited(seed: int) -> Observed:
    exact = record(seed=seed, sampling=SAMPLING, clean=True, fault=_g_sensitivity)
    recorded = _noisy(exact, exact.values, seed)
    recorded.values[:, :3] = np.clip(recorded.values[:, :3], -89.9 * DEG, 89.9 * DEG)
    return recorded


def _without_small_rates(seed: int) -> Observed:
    exact = record(seed=seed, sampling=SAMPLING, clean=True, fault=_g_sensitivity)
    outputs, width = exact.values.copy(), 0.02 * DEG
    gyros = outputs[:, :3]
    outputs[:, :3] = np.sign(gyros) * np.sqrt(np.maximum(gyros**2 - width**2, 0.0))
    return _noisy(exact, outputs, seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("made", "name", "size"), [(_limited, "gyro_saturation", 89.9), (_without_small_rates, "gyro_dead_zone", 0.02)]
)
def test_an_effect_on_the_output_acts_on_the_other_effects(
    made: Callable[[int], Observed], name: str, size: float, seed: int
) -> None:
    """Both effects are named, and nothing else; the size of the first and the sensitivities agree with the truth. The matrix of the
    device changes the sensitivities by up to 1 %."""
    found = diagnose(made(seed))
    assert set(found.verdict.effects) == {name, "gyro_g_sensitivity"}
    assert not found.verdict.something_else
    (one,) = [p for p in found.parameters if p.effect == name]
    assert abs(one.value - size) < 4 * one.standard_uncertainty
    elements = [p for p in found.parameters if p.effect == "gyro_g_sensitivity"]
    true = (K.T * G / DEG).ravel()
    for p, value in zip(elements, true, strict=True):
        assert abs(p.value - value) < 4 * p.standard_uncertainty + 0.01 * np.abs(true).max()


def test_a_limited_output_does_not_show_another_effect() -> None:
    """The specific force along the axis of the table is the same at all rates, so that the g-sensitivity would be as large in segments
    that the limit cuts as in the others."""
    found = diagnose(_limited(1), DiagnosisOptions(effects=("gyro_g_sensitivity", "gyro_saturation")))
    weighing, pair = found.grounds.weighing, found.posterior.sets["gyro_g_sensitivity+gyro_saturation"]
    owner, whole = weighing.spectrum.segment, weighing.seen()
    assert pair.on_others is not None
    columns = pair.columns("gyro_g_sensitivity")
    seen = 0
    for channel in weighing.observed.of_kind("gyro"):
        largest = [np.abs(whole.nominal_output[part, channel]).min() for part in weighing.observed.segments()]
        cut = (np.array(largest) > 89.95 * DEG)[owner]
        seen += int(cut.sum())
        energy = (pair.weighed.raw[channel][:, columns] ** 2).sum(axis=1)
        assert energy[cut].max(initial=0.0) < 1e-8 * energy[~cut].max()
    assert seen > 0


def test_a_set_is_evaluated_again_only_while_its_evidence_increases(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit in one direction, which is not among the hypotheses: no set of effects explains it, so the amplitudes do not converge."""
    exact = record(seed=5, sampling=SAMPLING, clean=True)
    recorded = _noisy(exact, exact.values, 5)
    recorded.values[:, :3] = np.minimum(recorded.values[:, :3], 60 * DEG)
    courses: list[list[float]] = []
    acting, evaluated = sets._acting_on_others, sets._evaluated

    def noted(weighing: Weighing, one: sets.EffectSet) -> sets.EffectSet:
        courses.append([])
        return acting(weighing, one)

    def with_evidence(weighing: Weighing, members: tuple[sets.Member, ...]) -> sets.EffectSet:
        found = evaluated(weighing, members)
        if courses:
            courses[-1].append(found.evidence)
        return found

    monkeypatch.setattr(sets, "_acting_on_others", noted)
    monkeypatch.setattr(sets, "_evaluated", with_evidence)
    weighing = Weighing(recorded)
    effects = [effect_named(f"gyro_{name}") for name in ("dead_zone", "soft_saturation", "scale_asymmetry")]
    candidates = candidates_of(weighing, effects)
    for pair in [sets.evaluated(weighing, [one, candidates[2]]) for one in candidates[:2]]:
        sets._acting_on_others(weighing, pair)
    assert max(map(len, courses)) > 1
    for course in courses:
        assert (np.diff(course)[:-1] > 0).all()


def test_a_lag_beside_another_effect_has_no_amplitude() -> None:
    """The lag of a gyro is described by its time constant alone, in a set as well as alone. The table rocks by 3 deg at 0.5 Hz."""
    tau, p = 0.004, np.pi

    def lagging(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        rocked = np.array([isinstance(motion, Rock) for motion in observed.motions])[observed.owner]
        lagged = (observed.rate - tau * observed.acceleration) / (1 + (p * tau) ** 2)
        slower = np.where(rocked, lagged - observed.rate, 0.0)
        return slower[:, None] * observed.attitude[observed.owner, :, 2] + force @ K.T, 0.0

    exact = record(seed=2, sampling=SAMPLING, clean=True, fault=lagging)
    found = diagnose(_noisy(exact, exact.values, 2))
    assert set(found.verdict.effects) == {"gyro_bandwidth", "gyro_g_sensitivity"}
    (one,) = [own for own in found.parameters if own.effect == "gyro_bandwidth"]
    assert one.name == "tau"
    assert abs(one.value - tau) < 4 * one.standard_uncertainty
    assert one.standard_uncertainty < 0.02 * tau


@pytest.mark.parametrize("angle", [0.2, -0.25])
def test_a_strong_nonlinear_effect_is_fitted_with_its_secant(angle: float) -> None:
    """The horizontal rate of the Earth, turned by 0.2 rad, is about eleven standard deviations of the noise; the linear approximation
    misses it by one. The fit uses the rotation itself, although it explains hardly more."""

    def turned(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        north = 15.041067 * DEG / 3600 * np.cos(observed.site.latitude)
        away = north * np.array([np.sin(angle), np.cos(angle) - 1, 0.0])
        back = Rotation.from_rotvec(-observed.angle[:, None] * np.array([0.0, 0.0, 1.0]))
        return np.einsum("nij,nj->ni", observed.attitude[observed.owner], back.apply(away)), 0.0

    recorded = record(seed=4, sampling=SAMPLING, fault=turned)
    weighing = Weighing(recorded)
    effect = TableAzimuth()
    (candidate,) = candidates_of(weighing, [effect])
    best = candidate.best
    size = np.array([column.magnitude for column in best.variant.columns])
    (exact,) = weighing.weigh(effect.around(weighing.observed, best.amplitudes[0] * size))
    (linear,) = weighing.weigh(effect.variants(weighing.observed))
    assert float(best.log_bayes.max()) > BENT
    for own, secant, tangent in zip(best.raw, exact.raw, linear.raw, strict=True):
        if secant.any():
            assert np.linalg.norm(own - secant) < 0.05 * np.linalg.norm(own - tangent)


def _walking(seed: int, density: float) -> tuple[Observed, Array]:
    """A recording with g-sensitivity and a random walk of the gyros with a density in rad/s/√s, and the change (N, K) of the outputs by
    both. The random walk continues between the segments."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        own = np.random.default_rng([seed, 6])
        steps = np.sqrt(np.diff(observed.time, prepend=observed.time[0]))
        walk = np.cumsum(own.standard_normal((len(observed.time), 3)) * steps[:, None], axis=0) * density
        return 0.2 * force @ K.T + walk, 0.0

    with_both = record(seed=seed, sampling=SAMPLING, clean=True, fault=fault)
    without = record(seed=seed, sampling=SAMPLING, clean=True)
    return _noisy(with_both, with_both.values, seed), with_both.values - without.values


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_random_walk_within_the_segments_is_no_noise(seed: int) -> None:
    """The random walk has about as much energy within the segments as the noise. The level of the noise is stated, not only limited. It
    agrees with the energy of the noise that was added, within three standard deviations of the stated degrees of freedom, and contains
    less than half of the energy of the random walk."""
    recorded, change = _walking(seed, 1e-5)
    exact = record(seed=seed, sampling=SAMPLING, clean=True)
    found = diagnose(recorded)
    weighing, noise = found.grounds.weighing, found.grounds.noise
    assert noise is not None
    added = weighing.spectrum.project(weighing.observed, recorded.values - exact.values - change)
    walked = weighing.spectrum.project(weighing.observed, change)
    gyros, within = weighing.observed.of_kind("gyro"), weighing.spectrum.frequency > 0
    true = np.concatenate([noise.weights[c].whiten(added[:, [c]])[within, 0] for c in gyros])
    both = np.concatenate([noise.weights[c].whiten((added + walked)[:, [c]])[within, 0] for c in gyros])
    more = float((both**2).mean() / (true**2).mean()) - 1
    assert more > 0.5
    group = noise.group[gyros[0]][within][0]
    assert not noise.limits[group]
    level = noise.scale[gyros[0]][within][0] ** 2
    assert abs(level / (true**2).mean() - 1) < min(3 * np.sqrt(2 / noise.degrees[group]), more / 2)


@pytest.mark.slow
def test_intervals_beside_a_random_walk_contain_the_true_share() -> None:
    """A random walk beside a named effect: the 90 % intervals of the closure contain the true share as often as chance allows at 1 %."""
    held, tries = 0, 12
    for seed in range(tries):
        recorded, change = _walking(seed, 2e-6)
        found = diagnose(recorded)
        weighing, noise = found.grounds.weighing, found.grounds.noise
        if noise is None or not found.closure.resolvable:
            tries -= 1
            continue
        coefficients = weighing.spectrum.project(weighing.observed, change)
        gap, difference, _ = predictions(weighing, noise, found.grounds.choices, coefficients)
        held += holds(found.closure, gap, difference)
    assert tries >= 6
    assert held >= binom.ppf(0.01, tries, 0.9)


@pytest.mark.parametrize("flicker", [0.0, 0.5])
def test_the_quick_evidence_of_pairs_agrees_with_the_full_evidence(flicker: float) -> None:
    """Also if the declared flicker, in units of the white noise at 1 s, is too large, so that the declared noise is improbable."""

    def asymmetry(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        return 1.5e-4 * np.abs(omega), 0.0

    observed = record(seed=64, fault=asymmetry)
    channels = tuple(replace(channel, flicker=channel.white * flicker) for channel in observed.channels)
    weighing = Weighing(replace(observed, channels=channels))
    names = ("gyro_scale_asymmetry", "mount_shift", "table_tilt", "gyro_axis_delay", "gyro_scale_temperature")
    candidates = candidates_of(weighing, [effect_named(name) for name in names])
    sets = sets_of(weighing, candidates, lambda size: -4.0 * size, walks=False)
    both = sets.quick.keys() & sets.full.keys()
    assert len(both) >= 4
    for key in both:
        if "gyro_scale_asymmetry" in key:
            assert sets.quick[key] == pytest.approx(sets.full[key].evidence, abs=0.5)
