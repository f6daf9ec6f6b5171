"""Ramps that do not arrive, soaks too short for the sensor: held against two lags integrated numerically and times worked by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import Finding
from planrunner.error_model.segment_columns import states_of
from planrunner.instruments.models import ChamberModel
from planrunner.tasks.check import check_plan

PLAN = """\
planrunner: 1
title: temperatures
bench: virtual_mems
sensor: {{kind: imu, outputs: [gyro_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, dwell: 5 min}}
segments:
{segments}
"""


@pytest.fixture
def found(tmp_path: Path) -> Callable[..., dict[str, list[Finding]]]:
    """The findings of a plan with these segments, by code. The bench: 3 K/min, lag of the air 2 min, of the sensor 4 min, 25 degC."""

    def check(*segments: str) -> dict[str, list[Finding]]:
        path = tmp_path / "plan.yaml"
        path.write_text(PLAN.format(segments="\n".join(f"  - {segment}" for segment in segments)), encoding="utf-8")
        codes: dict[str, list[Finding]] = {}
        for finding in check_plan(path).findings:
            codes.setdefault(finding.code, []).append(finding)
        return codes

    return check


@pytest.mark.parametrize(("air", "sensor"), [(120.0, 240.0), (120.0, 120.0), (300.0, 60.0)])
def test_the_lag_behind_a_ramp_is_that_of_two_integrated_lags(air: float, sensor: float) -> None:
    chamber = ChamberModel(200.0, 400.0, ramp=0.05, lag=air)
    step, setpoint, warm, body = 0.05, 0.0, 0.0, 0.0
    for number in range(1, 60_001):
        now = number * step
        before, setpoint = setpoint, max(-30.0, -0.05 * now)
        middle = (before + setpoint) / 2
        warm, last = warm + step * (middle - warm) / air, warm
        body += step * ((warm + last) / 2 - body) / sensor
        if number % 10_000 == 0:
            assert chamber.behind(-30.0, sensor, now) == pytest.approx(setpoint - body, abs=2e-3)
    assert chamber.behind(-30.0, sensor, 1e6) == pytest.approx(0.0, abs=1e-9)


def test_a_ramp_that_its_dwell_cuts_off(found: Callable[..., dict[str, list[Finding]]]) -> None:
    cold = "{label: cold, temperature: -40 degC, soak: 2 h}"
    (finding,) = found(cold, "{label: ramp, temperature: {ramp_to: 70 degC}}")["physics-ramp"]
    assert finding.severity == "error"
    assert (finding.mark.line, finding.mark.column) == (8, 32)
    assert "36.7 min" in finding.message  # 110 K at 3 K/min
    assert "-25 degC" in finding.message  # 5 min at 3 K/min from -40 degC
    (finding,) = found(cold, "{label: ramp, temperature: {ramp_to: 70 degC}, dwell: 37 min}")["physics-ramp"]
    assert finding.severity == "warning"  # the setpoint arrives, the air does not
    assert "physics-ramp" not in found(cold, "{label: ramp, temperature: {ramp_to: 70 degC}, dwell: 42 min}")
    assert "physics-ramp" not in found(cold, "{label: ramp, temperature: {ramp_to: -25 degC}, dwell: 10 min}")


def test_a_soak_is_held_against_the_declared_lag(found: Callable[..., dict[str, list[Finding]]]) -> None:
    (finding,) = found("{label: cold, temperature: -40 degC}")["physics-soak"]
    assert finding.severity == "warning"
    assert finding.mark.line == 7
    assert "soak for at least" in finding.hint
    minutes = float(finding.hint.split("soak for at least ")[1].split()[0])
    assert 5 < minutes < 20  # from 6 K or so down to 0.5 K with 4 min
    assert "physics-soak" not in found(f"{{label: cold, temperature: -40 degC, soak: {minutes + 0.1:g} min}}")
    assert "physics-soak" in found(f"{{label: cold, temperature: -40 degC, soak: {minutes - 0.2:g} min}}")
    assert "physics-soak" not in found("{label: same, temperature: 25 degC}")  # nothing changes
    measured = "{label: cold, temperature: -40 degC, soak: {temperature_drift: 0.1 K/min, for: 2 min, within: 2 h}}"
    assert "physics-soak" not in found(measured)  # the readings decide
    two = "{label: cold, temperature: -40 degC, dwell: 1 s}", "{label: again, temperature: -40 degC, dwell: 1 s}"
    assert len(found(*two)["physics-soak"]) == 1  # the second waits for the same change
    assert len(found(*two, "{label: hot, temperature: 60 degC}")["physics-soak"]) == 2


def test_what_a_ramp_left_behind_counts(found: Callable[..., dict[str, list[Finding]]]) -> None:
    ramp = "{label: ramp, temperature: {ramp_to: 60 degC}, dwell: 20 min}"
    assert "physics-soak" in found(ramp, "{label: hot, temperature: 60 degC}")
    assert "physics-soak" not in found(ramp, "{label: hot, temperature: 60 degC, soak: 1 h}")


def test_a_segment_without_a_temperature_is_where_the_chamber_was_left(tmp_path: Path) -> None:
    """60 degC, nothing, a ramp to -20 degC, nothing: the last change warms, and from the ramp on it cools."""
    segments = [
        "{label: a}",
        "{label: b, temperature: 60 degC, soak: 1 h}",
        "{label: c}",
        "{label: d, temperature: {ramp_to: -20 degC}, dwell: 1 h}",
        "{label: e}",
    ]
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN.format(segments="\n".join(f"  - {segment}" for segment in segments)), encoding="utf-8")
    schedule = check_plan(path).schedule
    assert schedule is not None
    assert [one.begins_at for one in schedule.segments] == [None, *[pytest.approx(333.15)] * 3, pytest.approx(253.15)]
    start, seconds = (np.array([getattr(one, key) for one in schedule.segments]) for key in ("start", "dwell"))
    states = states_of(schedule.segments, start, seconds, 5.0)
    assert states.celsius == pytest.approx([25, 60, 60, 20, -20])
    assert states.last_change.tolist() == [0, 1, 1, -1, -1]
