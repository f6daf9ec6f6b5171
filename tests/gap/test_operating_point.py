"""Effects on the output whose size depends on the bias and the scale factors: a dead zone and a limit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from planrunner.error_model.effects.gyro_output import (
    GyroDeadZone,
    GyroSaturation,
    GyroSaturationAsymmetric,
    GyroSoftSaturation,
)
from planrunner.error_model.effects.interface import Variant
from planrunner.error_model.effects.warming import GyroWarmUp
from planrunner.error_model.observed import Observed
from planrunner.gap.answer import diagnosis
from planrunner.gap.answer.closure import closure, measured_noise, predictions, whole_choices
from planrunner.gap.answer.diagnosis import diagnose
from planrunner.gap.evidence.spectrum import NODES
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.forms import _evidence, operating_point, settled, whole_forms
from planrunner.plan.schedule import Rest, Spin
from tests.gap.test_closure import holds
from tests.gap.turntable import DEG, record

Array = np.ndarray
SAMPLING = 5.0


def test_a_clipped_output_no_longer_follows_the_nominal_parameters() -> None:
    """The table turns at 18, 40 and 90 deg/s about up; the limit is 60 deg/s. Where it clips, the effect undoes every change of the
    nominal output. Elsewhere, the effect does not change."""
    weighing = Weighing(record(seed=3, sampling=SAMPLING))
    point = operating_point(weighing, GyroSaturation(), 60.0)
    owner = weighing.spectrum.segment
    for channel in weighing.observed.of_kind("gyro"):
        largest = [np.abs(weighing.fitted()[part, channel]).max() for part in weighing.observed.segments()]
        clips = (np.array(largest) > 60.0 * DEG)[owner]
        assert clips.any()
        size = np.abs(point.nominal[channel]).max(axis=0)
        np.testing.assert_allclose(
            point.change[channel][clips] / size, -point.nominal[channel][clips] / size, atol=1e-6
        )
        np.testing.assert_allclose(point.change[channel][~clips] / size, 0.0, atol=1e-12)
    assert not any(point.change[channel].any() for channel in weighing.observed.of_kind("accel"))


def _with_dead_zone(seed: int, width: float) -> tuple[Observed, Array]:
    """A recording in which outputs below a width (rad/s) are zero, and the change (N, K) of its outputs without noise."""
    exact = record(seed=seed, sampling=SAMPLING, clean=True)
    gyros = exact.of_kind("gyro")
    changed = exact.values.copy()
    outside = np.abs(changed[:, gyros]) > width
    root = np.sqrt(np.where(outside, changed[:, gyros] ** 2 - width**2, 0.0))
    changed[:, gyros] = np.sign(changed[:, gyros]) * root
    draw = np.random.default_rng([seed, 1])
    sigma = np.array([channel.white for channel in exact.channels]) * np.sqrt(SAMPLING)
    return replace(exact, values=changed + sigma * draw.standard_normal(changed.shape)), changed - exact.values


@pytest.mark.slow
def test_the_interval_includes_the_uncertainty_of_bias_and_scale_factor() -> None:
    """Dead zones of about the size of the bias: the 90 % intervals contain the true share in as many recordings as chance allows at
    1 %. Without the operating point, they contain it too rarely."""
    held = {True: 0, False: 0}
    tries = 14
    for seed in range(tries):
        recorded, change = _with_dead_zone(seed, 0.02 * DEG)
        weighing = Weighing(recorded)
        forms = whole_forms(weighing, GyroDeadZone())
        choices = whole_choices(weighing, "gyro_dead_zone", GyroDeadZone(), forms, 1.0)
        coefficients = weighing.spectrum.project(weighing.observed, change)
        for told in (True, False):
            used = choices if told else [replace(choice, point=None) for choice in choices]
            likeliest = max(used, key=lambda choice: choice.probability)
            noise = measured_noise(weighing, likeliest, np.zeros(len(weighing.base)), False, True)
            found = closure(weighing, noise, used, 0.0, "gyro_dead_zone")
            gap, difference, _ = predictions(weighing, noise, used, coefficients)
            held[told] += holds(found, gap, difference)
    assert held[True] >= binom.ppf(0.01, tries, 0.9)
    assert held[False] < binom.ppf(0.01, tries, 0.9)


def _limited(seed: int, limit: float, sampling: float = SAMPLING, lower: float | None = None) -> tuple[Observed, Array]:
    """A recording whose gyros are limited together with their noise, and the outputs (N, K) without noise and limit. `lower`: the magnitude
    of the limit in the negative direction, by default the same."""
    exact = record(seed=seed, sampling=sampling, clean=True)
    draw = np.random.default_rng([seed, 2])
    sigma = np.array([channel.white for channel in exact.channels]) * np.sqrt(sampling)
    values = exact.values + sigma * draw.standard_normal(exact.values.shape)
    values[:, :3] = np.clip(values[:, :3], -(limit if lower is None else lower), limit)
    return replace(
        exact, values=values, channels=tuple(replace(one, resolution=0.0) for one in exact.channels)
    ), exact.values


def test_nominal_parameters_are_fitted_together_with_a_limit() -> None:
    """The limit cuts the fastest of three rates. A fit of the parameters alone, with the effect of the preceding fit subtracted, keeps the
    scale factor that the cut readings gave."""
    recorded, true = _limited(5, 85 * DEG)
    weighing, effect = Weighing(recorded), GyroSaturation()
    first = weighing.observed
    taken = [raw[:, 0] for raw in weighing.weigh([effect.at(first, 85.0)])[0].raw]
    gyros, slow = first.of_kind("gyro"), np.abs(first.rate) < 50 * DEG
    size = np.array([first.channels[index].white for index in gyros]) / np.sqrt(first.counts[0] / SAMPLING)

    def away(seen: Observed) -> float:
        assert seen.fitted is not None
        return float((np.abs(seen.fitted - true)[slow][:, gyros] / size).max())

    assert away(weighing.seen(weighing.nominal_values(taken))) > 30
    assert away(weighing.seen(settled(weighing, effect, 85.0, weighing.nominal_values(taken)))) < 3


def test_a_limit_cuts_the_noise_too() -> None:
    """Outputs from four standard deviations of the noise below a limit to four above: the means of many samples."""
    observed, _ = _limited(6, 1.0)
    sigma, limit = 0.02 * DEG, 89.5 * DEG
    noise = sigma * np.random.default_rng(1).standard_normal(200_000)
    outputs = limit + sigma * np.linspace(-4, 4, 41)
    nominal = np.zeros_like(observed.values)
    nominal[:41, 0], nominal[:41, 1] = outputs, -outputs
    scatter = np.tile(np.quantile(noise, (np.arange(256) + 0.5) / 256), (6, 1))
    at = replace(observed, fitted=nominal, scatter=scatter)
    (column,) = GyroSaturation().at(at, 89.5).columns
    expected = [float(np.minimum(output + noise, limit).mean()) - output for output in outputs]
    np.testing.assert_allclose(column.parts[0][:41], expected, atol=0.01 * sigma)
    np.testing.assert_allclose(column.parts[1][:41], -np.array(expected), atol=0.01 * sigma)
    (sharp,) = GyroSaturation().at(replace(at, scatter=None), 89.5).columns
    np.testing.assert_allclose(sharp.parts[0][:41], np.minimum(limit - outputs, 0.0), atol=1e-12)


@pytest.mark.parametrize("limit", [10.0, 30.0, pytest.param(60.0, marks=pytest.mark.slow), 89.9])
def test_readings_that_stand_at_a_limit_are_not_taken_for_precise_ones(limit: float) -> None:
    """At the limit, the readings have no noise. If they counted as precise, they alone would determine the nominal parameters. The
    limits cut all three rates, two of them or one, which a limit of 89.9 deg/s only just cuts."""
    recorded, _ = _limited(5, limit * DEG)
    found = diagnose(recorded)
    assert found.verdict.effects == ("gyro_saturation",)
    (one,) = found.parameters
    assert abs(one.value - limit) < 3 * one.standard_uncertainty


@pytest.mark.parametrize(
    ("upper", "lower"),
    [
        (60.0, 80.0),
        pytest.param(60.0, np.inf, marks=pytest.mark.slow),
        pytest.param(np.inf, 89.9, marks=pytest.mark.slow),
        pytest.param(17.0, np.inf, marks=pytest.mark.slow),
        pytest.param(85.0, 30.0, marks=pytest.mark.slow),
    ],
)
def test_limits_that_differ_between_the_directions_are_named_with_their_values(upper: float, lower: float) -> None:
    """The rates are ±18, ±40 and ±90 deg/s. With the limit of both directions as the only hypothesis, the answer was an asymmetry together
    with a nonlinearity, or unknown."""
    recorded, _ = _limited(5, upper * DEG, lower=lower * DEG)
    found = diagnose(recorded)
    assert found.verdict.effects == ("gyro_saturation_asymmetric",) and not found.verdict.something_else
    expected = {name: value for name, value in (("upper", upper), ("lower", lower)) if np.isfinite(value)}
    assert {one.name for one in found.parameters} == set(expected)
    assert all(abs(one.value - expected[one.name]) < 3 * one.standard_uncertainty for one in found.parameters)


def test_a_limit_that_the_data_do_not_show_has_no_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """The upper limit is found, the lower one is not: the result contains the upper limit alone, no limit of 0 deg/s."""
    monkeypatch.setattr(diagnosis, "whole_forms", lambda *_, **__: [])
    effect = next(way for way in GyroSaturationAsymmetric().ways_shown(_limited(5, 85 * DEG, lower=30 * DEG)[0]))
    forms = [(SimpleNamespace(variant=SimpleNamespace(shape=value)), 0.5) for value in (29.0, 31.0)]
    (one,) = diagnosis._exact_shapes(None, effect, forms)  # type: ignore[arg-type]
    assert (one.value, one.standard_uncertainty) == (30.0, 1.0)


def test_a_limit_of_one_direction_is_a_hypothesis_only_if_readings_stand_at_it() -> None:
    """Not in a recording without a limit, with counts that the noise dithers, or with the same limit in both directions. A few
    wild readings hide no limit."""
    effect = GyroSaturationAsymmetric()
    assert not effect.shown_in(record(seed=3, sampling=SAMPLING))
    assert not effect.shown_in(_limited(5, 60 * DEG)[0])
    assert not effect.shown_in(_limited(5, 200 * DEG)[0])
    one_sided, _ = _limited(5, 60 * DEG, lower=np.inf)
    wild = one_sided.values.copy()
    wild[::200, 0] = 300 * DEG
    (way,) = effect.ways_shown(replace(one_sided, values=wild))
    assert way.shape_name == "upper"


@pytest.mark.slow
def test_outputs_that_only_seem_to_be_in_a_dead_zone_leave_it() -> None:
    """A dead zone of 0.1 deg/s, in which many outputs across the table's axis lie. A fit that starts within the zone with exact
    derivatives stays there; in these recordings, it finds between 0.073 and 0.097 deg/s."""
    found = []
    for seed in range(1, 6):
        parameters = diagnose(_with_dead_zone(seed, 0.1 * DEG)[0]).parameters
        found += [one.value for one in parameters if one.effect == "gyro_dead_zone"]
    assert sum(abs(width - 0.1) < 0.002 for width in found) >= 4, found


@pytest.mark.parametrize(("seed", "width"), [(5, 0.2), (1, 0.3), (2, 0.3), (4, 0.3)])
def test_nominal_parameters_stay_near_a_dead_zone(seed: int, width: float) -> None:
    """Biases are at most 0.5 deg/s. A fit that follows every step ends with biases of up to 70 deg/s, far from the dead zone."""
    recorded, _ = _with_dead_zone(seed, width * DEG)
    weighing = Weighing(recorded).without_walks()
    values = settled(weighing, GyroDeadZone(), width, weighing.nominal_values())
    away = weighing.output_at(values)[:, :3] - recorded.omega
    assert float(np.abs(away).max()) < 1.0 * DEG


def test_a_dead_zone_is_named_alone() -> None:
    """A search that stays in the first optimum names a further effect in this recording."""
    found = diagnose(_with_dead_zone(4, 0.1 * DEG)[0])
    assert found.verdict.effects == ("gyro_dead_zone",)


def test_a_limit_at_zero_explains_nothing() -> None:
    """With a limit near zero, no output remains, and the nominal parameters explain the effect completely. What is left of its signature
    are rounding errors, which must not count as evidence."""
    weighing = Weighing(record(seed=3, sampling=SAMPLING))
    (form,) = weighing.weigh([GyroSaturation().at(weighing.seen(), 1e-11)])
    assert _evidence(weighing, form) == weighing.evidence(np.zeros(len(weighing.base)))
    (effective,) = weighing.weigh([GyroSaturation().at(weighing.seen(), 60.0)])
    assert _evidence(weighing, effective) < _evidence(weighing, form)


def test_segments_with_a_constant_output_are_evaluated_with_one_sample() -> None:
    """The output is constant at rest, and changes while the table turns or rocks. If another effect changes at rest, such as a
    warm-up, all samples are kept."""
    weighing = Weighing(_limited(5, 60 * DEG)[0])
    full, effect = weighing.observed, GyroSaturation()
    assert weighing.condensed(GyroWarmUp().at(full, 1e4).columns)[0] is weighing

    short, _ = weighing.condensed()
    still = np.array([isinstance(motion, Rest) for motion in full.motions])
    np.testing.assert_array_equal(np.diff(short.observed.bounds), np.where(still, 1, np.diff(full.bounds)))
    values = [own * 1.01 for own in weighing.nominal_values()]
    for value in (0.02, 30.0, 60.0):
        (exact,), (found,) = (one.weigh([effect.at(one.seen(values), value)]) for one in (weighing, short))
        for before, after in zip(exact.raw, found.raw, strict=True):
            np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9 * np.abs(before).max())


def test_few_samples_of_a_turn_give_the_coefficients_of_effects_on_the_output() -> None:
    """Exactly for an effect without an edge. The outputs of a limit and of a dead zone pass an edge in some segments: the deviation is at
    most a fifth of the noise of a coefficient, which is that of a sample."""
    weighing = Weighing(_limited(5, 60 * DEG, 20.0)[0])
    few, _ = weighing.of_turns()
    spins = np.array([isinstance(motion, Spin) for motion in weighing.observed.motions])
    np.testing.assert_array_equal(np.diff(few.observed.bounds)[~spins], 400)
    assert set(np.diff(few.observed.bounds)[spins]) <= {NODES - 1, NODES}
    values = [own * 1.01 for own in weighing.nominal_values()]
    for effect, shape, least in (
        (GyroSoftSaturation(), 100.0, 1e-9),
        (GyroSaturation(), 60.0, 0.2),
        (GyroDeadZone(), 0.05, 0.2),
    ):
        (exact,), (found,) = (one.weigh([effect.at(one.seen(values), shape)]) for one in (weighing, few))
        for before, after, white in zip(exact.raw, found.raw, weighing.white, strict=True):
            np.testing.assert_allclose(after, before, rtol=0, atol=max(least * white, 1e-9 * np.abs(before).max()))
    slow = GyroWarmUp().at(weighing.observed, 1e4).columns
    assert weighing.of_turns(slow)[0] is weighing


def test_the_search_for_a_limit_does_not_use_all_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    weighing = Weighing(_limited(5, 60 * DEG)[0])
    sizes = []

    def counting(self: GyroSaturation, observed: Observed, value: float) -> Variant:
        sizes.append(len(observed.time))
        return at(self, observed, value)

    at = GyroSaturation.at
    monkeypatch.setattr(GyroSaturation, "at", counting)
    assert whole_forms(weighing, GyroSaturation())
    turning = sum(
        part.stop - part.start
        for part, motion in zip(weighing.observed.segments(), weighing.observed.motions, strict=True)
        if not isinstance(motion, Rest)
    )
    assert max(sizes) <= turning + len(weighing.observed)
