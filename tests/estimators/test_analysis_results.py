"""From a recording to results: order, failures that stay single, limits, and JSON that comes back bit by bit."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded import from_means, segment, sensor
from test_compensation_residual import TRADITIONAL, VERIFY
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, attitude, pulses

from planrunner.base.findings import InputError
from planrunner.cli.outcome import code_of
from planrunner.estimators.analysis import analyse, combined
from planrunner.estimators.flexure_gyro.compensation_residual import CompensationResidualParameters
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.foresight import design_of
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    Estimate,
    EstimateRequest,
    EstimationError,
    UnfitDataError,
)
from planrunner.estimators.limits import hold
from planrunner.estimators.results import Results, comparable
from planrunner.plan.kinds import Record
from planrunner.plan.model import EstimateSpec, Limit
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import Influence, InputQuantity

SCHEMA = json.loads((Path(__file__).parents[2] / "schemas" / "results.schema.json").read_text(encoding="utf-8"))


def spec(estimator: str, segments: tuple[str, ...], parameters: Record, uses: tuple[str, ...] = ()) -> EstimateSpec:
    return EstimateSpec(estimator=estimator, segments=segments, uses=uses, parameters=parameters)


ESTIMATES = {
    # Written before what it uses: the order follows `uses`.
    "residual": spec("compensation_residual", ("V*",), CompensationResidualParameters(trials=1000), ("drift", "old")),
    "drift": spec("flexure_gyro_static", ("P*",), FlexureGyroStaticParameters()),
    "old": spec("flexure_gyro_static", ("T*",), FlexureGyroStaticParameters()),
}


def recording() -> list:
    rng = np.random.default_rng(0)
    return [
        from_means(
            segment(label, attitude(words)),
            dict(zip(CHANNELS, pulses(attitude(words)) + rng.normal(0, 0.03, 2), strict=True)),
            "pulse/s",
            0.03,
        )
        for label, words in (OPTIMAL | TRADITIONAL | VERIFY).items()
    ]


def limits() -> list[Limit]:
    return [
        Limit(quantity="drift.D_X_F", within="±5 deg/h", rule="guarded"),
        Limit(quantity="drift.D_X_F", within="±0.001 deg/s", rule="simple"),
        Limit(quantity="drift.D_X_F", at_most=parse_quantity("1.2 deg/h"), rule="guarded"),
        Limit(quantity="drift.D_Y_X", at_least=parse_quantity("3 deg/h/g"), rule="simple"),
    ]


def results() -> Results:
    return analyse(ESTIMATES, limits(), recording(), SITE, sensor(*CHANNELS))


def test_everything_is_made_in_the_order_of_its_use() -> None:
    found = results()
    assert list(found.estimates) == ["residual", "drift", "old"]
    assert not found.failures
    assert found.estimates["drift"].segments == tuple(OPTIMAL)
    assert [limit.verdict for limit in found.limits] == ["pass", "pass", "fail", "fail"]
    guarded = found.limits[2]
    assert guarded.value < guarded.upper < guarded.value + guarded.expanded_uncertainty
    assert "guard band" in guarded.reason
    assert 0.5 < guarded.probability < 0.975
    assert found.limits[1].upper == pytest.approx(3.6)  # deg/s written, deg/h judged
    assert found.limits[0].upper == 5.0  # exactly as written
    assert found.limits[0].coverage_factor == pytest.approx(2.776, abs=1e-3)


def test_influences_widen_what_limits_are_held_against() -> None:
    """A stated input of 3 deg/h on D_X_F alone: u grows by it in quadrature and the guarded limit of ±5 deg/h is no longer kept."""
    plain = results().estimates["drift"]

    class Influenced(FlexureGyroStatic):
        def estimate(self, request: EstimateRequest) -> Estimate:
            given = super().estimate(request)
            names = [item.name for item in given.coefficients]
            column = np.array([[3.0] if name == "D_X_F" else [0.0] for name in names])
            return replace(given, influences=(Influence(InputQuantity("fixture", 0.0, "rad", 1.0), column),))

    made = combined(
        Influenced().estimate(
            EstimateRequest("drift", tuple(recording()[:8]), FlexureGyroStaticParameters(), SITE, sensor(*CHANNELS))
        )
    )
    own = plain["D_X_F"].standard_uncertainty
    assert made["D_X_F"].standard_uncertainty == pytest.approx(math.hypot(own, 3.0))
    assert made["D_Y_F"] == plain["D_Y_F"]
    at = [item.name for item in made.coefficients].index("D_X_F")
    assert made.covariance is not None and made.data_covariance is not None
    assert made.covariance[at, at] - made.data_covariance[at, at] == pytest.approx(9.0)
    assert hold(limits()[0], {"drift": plain}).verdict == "pass"
    assert hold(limits()[0], {"drift": made}).verdict == "fail"
    again = Results.from_json(json.loads(json.dumps(Results({"drift": made}).to_json(), allow_nan=False)))
    assert again.estimates["drift"].budgets == made.budgets


def test_a_limit_says_its_rule_and_its_risks() -> None:
    """Guard band ½·U99; global risks only where a prior is stated, in the coefficient's unit."""
    plain = Limit(quantity="drift.D_X_F", within="±1.25 deg/h", guard_band=0.5, coverage=0.99)
    known = replace(plain, prior=parse_quantity("0.001 deg/s ± 0.0001 deg/s"))
    found = analyse(ESTIMATES, [plain, known], recording(), SITE, sensor(*CHANNELS))
    without, with_ = found.limits
    k = coverage_factor(4, 0.99)
    assert without.guard_band == pytest.approx(0.5 * k * without.standard_uncertainty)
    assert without.expanded_uncertainty == pytest.approx(k * without.standard_uncertainty)
    assert (without.guard_factor, without.coverage, without.coverage_factor) == pytest.approx((0.5, 0.99, k))
    assert without.false_decision == pytest.approx(
        1 - without.probability if without.verdict == "pass" else without.probability
    )
    assert math.isnan(without.consumer_risk)
    # 3.6 ± 0.36 deg/h lies 6.5 standard deviations above ±1.25: hardly any item conforms and hardly any is accepted.
    assert 0 <= with_.consumer_risk < 1e-6
    assert 0 <= with_.producer_risk < 1e-6
    angle = replace(plain, prior=parse_quantity("0.1 deg ± 0.2 deg"))
    wrong = analyse(ESTIMATES, [angle], recording(), SITE, sensor(*CHANNELS))
    assert "write it in deg/h" in wrong.failures["limit on drift.D_X_F"]


def test_one_failure_leaves_the_others() -> None:
    estimates = ESTIMATES | {
        "old": spec("flexure_gyro_static", ("X*",), FlexureGyroStaticParameters()),
        "typo": spec("flexure_gyro_statics", ("P*",), FlexureGyroStaticParameters()),
        "broken": spec("scale_factor", ("P*",), Record()),
        "self": spec("compensation_residual", ("V*",), CompensationResidualParameters(), ("self", "drift")),
    }
    missing = [Limit(quantity="old.D_X_F", within="±1 deg/h"), Limit(quantity="drift.D_X_G", within="±1 deg/h")]
    wrong = [Limit(quantity="drift.SF_X", within="±1 deg/h")]
    found = analyse(estimates, [*missing, *wrong], recording(), SITE, sensor(*CHANNELS))
    assert list(found.estimates) == ["drift"]
    assert "no recorded segment has a label that matches X*" in found.failures["old"]
    assert "uses the estimate 'old', which could not be made" in found.failures["residual"]
    assert "flexure_gyro_statics" in found.failures["typo"]
    assert "failed unexpectedly (AttributeError" in found.failures["broken"]
    assert "uses the estimate 'self', which could not be made" in found.failures["self"]
    assert "'old' gave no result to compare with the limit" in found.failures["limit on old.D_X_F"]
    assert "has no coefficient 'D_X_G'" in found.failures["limit on drift.D_X_G"]
    assert "write it in (deg/h)/(pulse/s)" in found.failures["limit on drift.SF_X"]


def test_too_little_memory_is_said_with_what_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    def large(self: FlexureGyroStatic, request: EstimateRequest) -> Estimate:
        raise MemoryError

    monkeypatch.setattr(FlexureGyroStatic, "estimate", large)
    found = analyse(ESTIMATES, [], recording(), SITE, sensor(*CHANNELS))
    assert "the memory is too small" in found.failures["drift"] and "use fewer segments" in found.failures["drift"]


def test_data_that_do_not_give_an_estimate_are_no_wrong_input(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what waits for it; beside an error of the plan the input is wrong all the same."""

    def silent(self: FlexureGyroStatic, request: EstimateRequest) -> Estimate:
        raise UnfitDataError("the gyro is silent")

    sound = analyse(ESTIMATES, [], recording(), SITE, sensor(*CHANNELS))
    assert (sound.unfit, code_of(sound)) == ((), 0)
    monkeypatch.setattr(FlexureGyroStatic, "estimate", silent)
    found = analyse(ESTIMATES, limits()[:1], recording(), SITE, sensor(*CHANNELS))
    assert set(found.unfit) == set(found.failures) == {"drift", "old", "residual", f"limit on {limits()[0].quantity}"}
    assert code_of(found) == 1
    again = Results.from_json(json.loads(json.dumps(found.to_json(), allow_nan=False)))
    assert code_of(again) == 1
    wrong = ESTIMATES | {"typo": spec("flexure_gyro_statics", ("P*",), FlexureGyroStaticParameters())}
    assert code_of(analyse(wrong, [], recording(), SITE, sensor(*CHANNELS))) == 2
    older = found.to_json()
    del older["unfit"]
    assert code_of(Results.from_json(older)) == 2  # what earlier versions said


def test_json_comes_back_bit_by_bit_and_fits_its_schema() -> None:
    import jsonschema

    found = results()
    data = found.to_json()
    text = json.dumps(data, allow_nan=False)
    jsonschema.Draft202012Validator(SCHEMA).validate(json.loads(text))
    again = Results.from_json(json.loads(text))
    assert json.dumps(again.to_json(), allow_nan=False) == text
    for name, estimate in found.estimates.items():
        assert np.array_equal(again.estimates[name].covariance, estimate.covariance)
        assert again.estimates[name].coefficients == estimate.coefficients
        assert again.estimates[name].tables == estimate.tables
        assert again.estimates[name].plots == estimate.plots
    assert again.limits == found.limits
    assert again.segments[0]["channels"]["torquer_x"]["mean"] == found.segments[0]["channels"]["torquer_x"]["mean"]


def test_numbers_that_json_lacks() -> None:
    odd = Estimate("odd", "x", (Coefficient("a", math.nan, "1", math.inf, math.inf),), np.array([[math.inf]]))
    data = json.loads(json.dumps(Results({"odd": odd}).to_json(), allow_nan=False))
    again = Results.from_json(data).estimates["odd"]
    assert math.isnan(again["a"].value)
    assert math.isinf(again["a"].standard_uncertainty)
    assert math.isinf(again.covariance[0, 0])


def test_schema_notices_what_is_missing() -> None:
    import jsonschema

    validator = jsonschema.Draft202012Validator(SCHEMA)
    validator.check_schema(SCHEMA)
    for key in ("planrunner_results", "estimates", "limits", "failures", "segments"):
        data = results().to_json()
        del data[key]
        assert not validator.is_valid(data)
    data = results().to_json()
    data["estimates"][0]["coefficients"][0]["extra_key"] = 1
    assert not validator.is_valid(data)


def test_other_formats_are_refused() -> None:
    for other in (1, 2, 99):
        with pytest.raises(InputError, match="no results in a format"):
            Results.from_json({**results().to_json(), "planrunner_results": other})
    with pytest.raises(InputError, match="incomplete or changed"):
        Results.from_json({"planrunner_results": 3, "estimates": [{}]})


def test_texts_keep_what_translations_need() -> None:
    found = results()
    (again,) = [one for one in Results.from_json(found.to_json()).estimates.values() if one.name == "drift"]
    notes = found.estimates["drift"].notes
    assert notes
    assert [(text.template, text.values) for text in again.notes] == [(text.template, text.values) for text in notes]
    assert all(one.description.template for one in again.coefficients)


def test_texts_with_and_without_a_template_compare_as_equal() -> None:
    new = json.loads(json.dumps(results().to_json()))
    plain = json.loads(json.dumps(results().to_json()))
    for estimate in plain["estimates"]:
        for key in ("notes", "warnings"):
            estimate[key] = [{"text": text["text"]} for text in estimate[key]]
    assert plain != new
    assert comparable(plain) == comparable(new)
    new["estimates"][0]["coefficients"][0]["value"] += 1.0
    assert comparable(plain) != comparable(new)


@pytest.mark.parametrize("bad", ["{name.__class__}", "{name:9999999d}", "{name!r}", "{0}", "{lacking}"])
def test_a_template_in_results_cannot_ask_for_more_than_its_values(bad: str) -> None:
    data = results().to_json()
    data["estimates"][0]["notes"] = [{"text": "a", "template": bad, "values": {"name": 1}}]
    with pytest.raises(InputError, match="incomplete or changed"):
        Results.from_json(data)


def test_same_recording_gives_the_same_bytes() -> None:
    first, second = (json.dumps(results().to_json()) for _ in range(2))
    assert first == second


def test_design_of_each_estimate_from_the_schedule() -> None:
    segments: list[Segment] = [recorded.segment for recorded in recording()]
    designs: dict[str, Design] = {}
    for name in ("drift", "old", "residual"):
        design = design_of(name, ESTIMATES[name], segments, SITE, sensor(*CHANNELS), designs)
        assert design is not None
        designs[name] = design
    assert [block.output for block in designs["drift"].blocks] == list(CHANNELS)
    lost = spec("flexure_gyro_static", ("X*",), FlexureGyroStaticParameters())
    with pytest.raises(EstimationError, match=r"no segment has a label that matches X\*"):
        design_of("lost", lost, segments, SITE, sensor(*CHANNELS), {})
    with pytest.raises(EstimationError, match="it uses 'drift', which has no design"):
        design_of("residual", ESTIMATES["residual"], segments, SITE, sensor(*CHANNELS), {})
