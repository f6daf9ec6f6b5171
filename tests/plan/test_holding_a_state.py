"""Settling by readings, limits while recording and prompts: what a plan may say, and what becomes of it in a schedule."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from planrunner.bench.model import models, read_bench
from planrunner.bench.scheduling import build_schedule
from planrunner.plan.expand import expand
from planrunner.plan.model import parse_plan
from planrunner.plan.schedule import Schedule, Watch

HEAD = """\
planrunner: 1
title: Holding
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
"""


def scheduled(text: str, **known: Any) -> tuple[Schedule, list[str]]:
    """The schedule on the virtual bench, of which `known` says something else, and the codes of the errors."""
    plan, log = parse_plan(HEAD + text, "plan.yaml")
    assert plan is not None
    bench = replace(models(read_bench("virtual")[0]), **known)
    schedule = build_schedule(expand(plan, log), bench, log)
    return schedule, [finding.code for finding in log.errors]


STATE = "segments:\n  - {label: A, orientation: unknown, temperature: 40 degC, dwell: 10 s, KEYS}\n"


def state(keys: str) -> str:
    return STATE.replace("KEYS", keys)


def test_settling_and_watching_in_si() -> None:
    schedule, errors = scheduled(
        state(
            "soak: {for: 10 min, temperature_drift: 0.3 K/min, within: 3 h}, "
            "settle: {for: 5 s, rate_error: 1.8 deg/s, position_error: 36 arcsec, within: 2 min}, "
            "watch: {temperature_error: 0.5 K, lost_frames: 0.1 %, doubts: note, retakes: 2}"
        )
    )
    (segment,) = schedule.segments
    assert not errors
    assert segment.soaked is not None and (segment.soaked.duration, segment.soaked.patience) == (600.0, 10800.0)
    assert segment.soaked.limits == {"temperature_drift": pytest.approx(0.005)}
    assert segment.stable is not None
    assert segment.stable.limits == {
        "position_error": pytest.approx(math.radians(0.01)),
        "rate_error": pytest.approx(math.pi / 100),
    }
    assert (segment.soak, segment.settle) == (600.0, 5.0)  # what is planned for
    assert segment.watch is not None and segment.watch.lost == pytest.approx(1e-3)
    assert replace(segment.watch, lost=1e-3) == Watch({"temperature_error": 0.5}, 1e-3, None, False, 2)


def test_times_alone_stay_times() -> None:
    (segment,) = scheduled(state("soak: 10 min, settle: 5 s"))[0].segments
    assert (segment.soak, segment.settle) == (600.0, 5.0)
    assert segment.soaked is None and segment.stable is None and segment.watch is None


@pytest.mark.parametrize(
    ("keys", "code"),
    [
        ("settle: {for: 30 s, within: 10 min}", "meaning-stability"),
        ("settle: {for: 30 s, rate_error: 1 deg/s, within: 10 s}", "meaning-stability"),
        ("settle: {for: 30 s, rate_error: 1 deg/s}", "form-missing-key"),
        ("settle: {for: 30 s, rate_error: 1 deg, within: 1 min}", "meaning-dimension"),
        ("settle: {for: 30 s, rate_eror: 1 deg/s, within: 1 min}", "form-unknown-key"),
        ("soak: {for: 30 s, temperature_error: 0.5 degC, within: 1 min}", "meaning-range"),
        ("watch: {temperature_error: 0.5 degC}", "meaning-range"),
        ("watch: {retakes: 11}", "form-range"),
        ("watch: {lost_frames: -1 %}", "meaning-range"),
        ("watch: {doubts: ignore}", "form-choice"),
        ("watch: 5 arcsec", "form-type"),
        ("prompt: [a, b]", "form-type"),
        ("prompt: 'Turn to {face}'", "meaning-label"),
    ],
)
def test_what_is_refused(keys: str, code: str) -> None:
    assert scheduled(state(keys))[1] == [code]


@pytest.mark.parametrize(
    ("keys", "known", "refused"),
    [
        ("watch: {rate_error: 1 deg/s}", {"measures": False}, True),
        ("settle: {for: 1 s, rate_error: 1 deg/s, within: 2 s}", {"measures": False}, True),
        ("watch: {lost_frames: 0 %}", {"counts": False}, True),
        ("watch: {retakes: 3}", {"measures": False, "counts": False}, False),
        ("settle: 3 s", {"measures": False, "counts": False}, False),
    ],
)
def test_what_the_bench_cannot_measure(keys: str, known: dict[str, bool], refused: bool) -> None:
    assert scheduled(state(keys), **known)[1] == (["physics-unmeasured"] if refused else [])


def test_watching_is_inherited_as_a_whole_and_swept_settling_is_labelled() -> None:
    schedule, errors = scheduled(
        "defaults: {orientation: unknown, dwell: 1 s, watch: {lost_frames: 1 %, retakes: 1}}\n"
        "segments:\n"
        "  - {label: A}\n"
        "  - {label: B, watch: {corrupt_frames: 0 %}}\n"
        "  - for_each: {settle: {quick: 1 s, measured: {for: 2 s, rate_error: 1 deg/s, within: 9 s}}}\n"
    )
    assert not errors
    a, b, quick, measured = schedule.segments
    assert (a.watch, b.watch) == (Watch({}, 0.01, None, True, 1), Watch({}, None, 0.0, True, 0))
    assert (quick.label, quick.settle, quick.stable) == ("quick", 1.0, None)
    assert measured.label == "measured" and measured.stable is not None and measured.stable.patience == 9.0


def test_prompts_stand_before_the_first_step_and_every_value() -> None:
    schedule, errors = scheduled(
        "defaults: {orientation: unknown, dwell: 1 s}\n"
        "segments:\n"
        "  - prompt: Mount it\n"
        "    label: mounted\n"
        "    steps:\n"
        "      - {label: a, prompt: Close the door}\n"
        "      - label: b\n"
        "  - {label: tumble, prompt: 'Face {repeat} of {sample_rate} Hz', repeat: 2, for_each: {sample_rate: [1 Hz, 2 Hz]}}\n"
    )
    assert not errors
    assert [(segment.label, segment.prompts) for segment in schedule.segments] == [
        ("mounted/a", ("Mount it", "Close the door")),
        ("mounted/b", ()),
        ("tumble/r1/1Hz", ("Face 1 of 1 Hz",)),
        ("tumble/r1/2Hz", ("Face 1 of 2 Hz",)),
        ("tumble/r2/1Hz", ("Face 2 of 1 Hz",)),
        ("tumble/r2/2Hz", ("Face 2 of 2 Hz",)),
    ]
    assert schedule.segments[0].marks["prompt"].line == 6
