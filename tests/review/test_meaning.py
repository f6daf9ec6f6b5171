"""The meaning of plans and benches: equal for equivalent spellings, different for everything that changes what is done or learned."""

from __future__ import annotations

import hashlib
import json
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from respelling import respelled

from planrunner.base.findings import InputError
from planrunner.bench.model import Bench, read_bench
from planrunner.plan.model import Plan, parse_plan
from planrunner.review.meaning import Meaning, digest_of_bench, meaning_of_bench, meaning_of_plan

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "plans").glob("*.yaml"))

SMALL = """\
planrunner: 1
title: t
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
defaults: {settle: 30 s, dwell: 2 min, orientation: {x: up, y: north}}
segments:
  - {label: A, temperature: 25 degC}
  - {label: B, motion: {rate: 10 deg/s}}
  - {label: C, motion: {rock: {amplitude: 3 deg, frequency: 0.2 Hz}}}
"""


def plan_of(text: str) -> Plan:
    plan, log = parse_plan(text, "plan")
    assert plan is not None and not log.errors, list(map(str, log))
    return plan


def digest_of_plan(plan: Plan, bench: Bench | None = None) -> str:
    return meaning_of_plan(plan, bench).digest()


def meaning(text: str) -> Meaning:
    return meaning_of_plan(plan_of(text))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_another_spelling_has_the_same_digest(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    rng = random.Random(path.stem)
    other = respelled(text, rng)
    assert other != text
    assert meaning(other).document() == meaning(text).document()
    assert digest_of_plan(plan_of(other)) == digest_of_plan(plan_of(text))


@pytest.mark.parametrize("name", ["flexure_gyro_eight_position", "imu_multi_position", "platform_rocking"])
def test_segments_written_out_mean_what_the_sweep_means(name: str) -> None:
    text = (ROOT / "plans" / f"{name}.yaml").read_text(encoding="utf-8")
    other = respelled(text, random.Random(3), expanded=True)
    assert "for_each" not in other
    assert meaning(other).document() == meaning(text).document()


@pytest.mark.parametrize(
    ("stated", "equivalent"),
    [
        ("settle: 30 s", "settle: 0.5 min"),
        ("dwell: 2 min", "dwell: 2.0e0 min"),
        ("{x: up, y: north}", "{y: north, z: west}"),
        ("{x: up, y: north}", "{quaternion: [1, 0, -1, 0]}"),
        ("{rate: 10 deg/s}", "{rate: -10 deg/s, sense: clockwise}"),
        ("{rate: 10 deg/s}", "{rate: 0.17453292519943295 rad/s, about: up}"),
        ("motion: {rate: 10 deg/s}", "rate: 10 deg/s"),
        ("label: A,", "label: A, motion: rest,"),
        ("label: A,", "label: A, motion: {rate: 0 deg/s},"),
        ("label: A,", "label: A, on_break: retake, soak: 0 s,"),
        ("frequency: 0.2 Hz}", "frequency: 0.2 Hz}, for: 2 min"),
        ("frequency: 0.2 Hz}", "frequency: 0.2 Hz, phases: 0 deg}"),
        ("title: t", "title: u"),
        ("title: t", "title: t\ndescription: words"),
        ("title: t", "title: t\nreport: [summary.md, report.html]\ndiagnosis: {segments: [C, A, B]}"),
    ],
)
def test_equivalent(stated: str, equivalent: str) -> None:
    assert SMALL.count(stated) >= 1
    assert meaning(SMALL.replace(stated, equivalent)).document() == meaning(SMALL).document()


@pytest.mark.parametrize(
    ("stated", "other"),
    [
        ("settle: 30 s", "settle: 31 s"),
        ("settle: 30 s", "settle: {for: 30 s, within: 10 min, position_error: 5 arcsec}"),
        ("dwell: 2 min", "dwell: 120.0001 s"),
        ("{x: up, y: north}", "{x: up, y: south}"),
        ("{x: up, y: north}", "unknown"),
        ("{rate: 10 deg/s}", "{rate: 10 deg/s, sense: clockwise}"),
        ("{rate: 10 deg/s}", "{rate: 10 deg/s, about: down}"),
        ("label: A,", "label: a,"),
        ("label: A,", "label: A, on_break: keep,"),
        ("label: A,", "label: A, soak: 1 s,"),
        ("label: A,", "label: A, mode: caged,"),
        ("label: A,", "label: A, sample_rate: 100 Hz,"),
        ("label: A,", "label: A, conditioning: true,"),
        ("label: A,", "label: A, prompt: Turn the fixture,"),
        ("label: A,", "label: A, watch: {retakes: 1},"),
        ("temperature: 25 degC", "temperature: {ramp_to: 25 degC}"),
        ("frequency: 0.2 Hz}", "frequency: 0.2 Hz}, for: 1 min"),
        ("frequency: 0.2 Hz}", "frequency: 0.2 Hz}, after: 1 min"),
        ("  - {label: A, temperature: 25 degC}\n", ""),
        ("bench: virtual", "bench: virtual_imu"),
        ("[torquer_x]", "[torquer_y]"),
        ("title: t", "title: t\nrecord: {operator: required}"),
        ("title: t", "title: t\nreport: [summary.md]"),
        ("title: t", "title: t\ndiagnosis: {segments: [A]}"),
        ("title: t", "title: t\nmounting: {x: {angle: 54.7356 deg ± 20 arcsec}}"),
        ("title: t", "title: t\nestimates: {d: {estimator: flexure_gyro_static}}"),
    ],
)
def test_different(stated: str, other: str) -> None:
    assert SMALL.count(stated) >= 1
    assert digest_of_plan(plan_of(SMALL.replace(stated, other))) != digest_of_plan(plan_of(SMALL))


def test_a_limit_about_zero_is_its_two_bounds_and_rules_count() -> None:
    text = SMALL + "estimates: {d: {estimator: flexure_gyro_static}}\nlimits: [{quantity: d.X, %s}]\n"
    within = digest_of_plan(plan_of(text % "within: ±0.5 deg/h"))
    assert within == digest_of_plan(plan_of(text % "at_least: -0.5 deg/h, at_most: 1800 arcsec/h, rule: guarded"))
    for other in ("within: ±0.6 deg/h", "within: ±0.5 deg/h, rule: simple", "within: ±0.5 deg/h, guard_band: 0.5"):
        assert digest_of_plan(plan_of(text % other)) != within


def test_selected_segments_count_not_the_patterns() -> None:
    text = SMALL + "estimates: {d: {estimator: flexure_gyro_static, segments: %s}}\n"
    assert digest_of_plan(plan_of(text % "[A, C]")) == digest_of_plan(plan_of(text % "['[AC]']"))
    assert digest_of_plan(plan_of(text % "[A, C]")) != digest_of_plan(plan_of(text % "[A, B]"))


def test_the_canonical_form_by_hand() -> None:
    """One segment written down by hand, in the order and with the numbers of RFC 8785, section 3.2."""
    segment = json.loads(meaning(SMALL).canonical())["plan"]["segments"][0]
    assert segment == {
        "conditioning": False,
        "dwell": {"unit": "s", "value": 120},
        "label": "A",
        "motion": "rest",
        "on_break": "retake",
        "orientation": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        "prompts": [],
        "settle": {"unit": "s", "value": 30},
        "soak": {"unit": "s", "value": 0},
        "temperature": {"unit": "K", "value": 298.15},
    }
    canonical = meaning(SMALL).canonical()
    assert canonical.startswith(b'{"plan":{"bench":{"name":"virtual"},"diagnosis":{"nominal":["gyro_bias",')
    assert digest_of_plan(plan_of(SMALL)) == hashlib.sha256(canonical).hexdigest()


def test_the_bench_is_part_of_the_digest_if_it_is_given() -> None:
    plan, bench = plan_of(SMALL), read_bench("virtual")[0]
    other = read_bench("virtual_imu")[0]
    assert len({digest_of_plan(plan), digest_of_plan(plan, bench), digest_of_plan(plan, other)}) == 3
    assert digest_of_bench(bench) in json.dumps(meaning_of_plan(plan, bench).document())
    # With the bench at hand, its name in the plan says no more.
    assert digest_of_plan(plan_of(SMALL.replace("bench: virtual", "bench: x.yaml")), bench) == digest_of_plan(
        plan, bench
    )


@pytest.mark.parametrize(
    "broken",
    [
        SMALL.replace("label: B", "label: A"),
        SMALL.replace("amplitude: 3 deg, frequency: 0.2 Hz}", "amplitude: 3 deg, frequency: 0.2 Hz}, for: 9 min"),
        SMALL.replace("settle: 30 s", "settle: 30"),
    ],
)
def test_a_plan_with_errors_has_no_meaning(broken: str) -> None:
    plan, _ = parse_plan(broken, "plan")
    assert plan is not None
    with pytest.raises(InputError):
        meaning_of_plan(plan)


def test_lines_name_segments_by_their_labels() -> None:
    found = list(meaning(SMALL).lines())
    assert 'segments["B"].motion.rate: {"unit":"rad s^-1","value":0.174532925199}' in found
    assert found == list(meaning(respelled(SMALL, random.Random(1))).lines())


def test_a_key_without_a_value_is_not_in_the_canonical_form() -> None:
    """So a digest outlives a version of planrunner that has more keys."""

    def members(value: object) -> Iterator[object]:
        if isinstance(value, dict):
            for part in value.values():
                yield part
                yield from members(part)
        elif isinstance(value, list):
            for part in value:
                yield from members(part)

    for document in (meaning(SMALL).document(), meaning_of_bench(read_bench("virtual")[0]).document()):
        assert None not in list(members(document))
