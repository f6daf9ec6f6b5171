"""What a motion asks of table and sampling: joint limits with ramps and settling, Nyquist, sample rates, what nothing can carry out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from planrunner.base.findings import Finding
from planrunner.tasks.check import check_plan

PLAN = """\
planrunner: 1
title: motions
bench: {bench}
sensor: {{kind: {kind}, outputs: [gyro_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, dwell: 10 s, settle: 0 s}}
segments:
  - {{label: S, {segment}}}
"""
Found = Callable[..., Sequence[Finding]]


@pytest.fixture
def found(tmp_path: Path) -> Found:
    """The errors and warnings of a plan of one segment."""

    def check(segment: str, bench: str = "virtual_mems", kind: str = "imu") -> Sequence[Finding]:
        path = tmp_path / "plan.yaml"
        path.write_text(PLAN.format(segment=segment, bench=bench, kind=kind), encoding="utf-8")
        return [finding for finding in check_plan(path).findings if finding.severity != "note"]

    return check


def codes(findings: Sequence[Finding]) -> list[str]:
    return [finding.code for finding in findings]


def test_rocking_faster_than_the_sampling_shows(found: Found) -> None:
    motion = "motion: {rock: {amplitude: 0.001 deg, frequency: FREQUENCY Hz}}, sample_rate: 50 Hz"
    (finding,) = found(motion.replace("FREQUENCY", "30"))
    assert (finding.code, finding.severity) == ("physics-nyquist", "warning")
    assert "a motion of 20 Hz" in finding.message  # 50 - 30
    assert (finding.mark.line, finding.mark.column) == (7, 31)
    assert "as a constant" in found(motion.replace("FREQUENCY", "50"))[0].message
    assert "a motion of 10 Hz" in found(motion.replace("FREQUENCY", "60"))[0].message
    assert codes(found(motion.replace("FREQUENCY", "25"))) == ["physics-nyquist"]
    assert codes(found(motion.replace("FREQUENCY", "24"))) == []


def test_a_sample_rate_that_the_sensor_does_not_give(found: Found) -> None:
    (finding,) = found("sample_rate: 500 Hz")
    assert (finding.code, finding.severity) == ("physics-sample-rate", "error")
    assert "100 Hz at most" in finding.message
    assert codes(found("sample_rate: 100 Hz")) == []
    assert codes(found("sample_rate: 20 Hz")) == []


def test_a_dwell_without_a_sample(found: Found) -> None:
    assert codes(found("dwell: 9 ms")) == ["physics-samples"]
    assert codes(found("dwell: 10 ms")) == []
    assert codes(found("dwell: 0.5 s, sample_rate: 1 Hz")) == ["physics-samples"]


def test_only_a_recording_has_a_length(found: Found) -> None:
    (finding,) = found("dwell: recorded")
    assert finding.code == "physics-dwell"
    assert finding.mark.line == 7


def test_a_limited_axis_counts_ramps_and_settling(found: Found) -> None:
    # 370 deg; 10 deg/s at 5 deg/s^2: two ramps of 2 s, worth 20 deg together.
    spin = "rate: 10 deg/s, settle: SETTLE s, dwell: DWELL s"
    fits = spin.replace("SETTLE", "5").replace("DWELL", "29.9")  # 10 * (5 + 29.9 + 2) = 369 deg
    assert "physics-cable-wrap" not in codes(found(fits, "virtual_imu"))
    beyond = spin.replace("SETTLE", "5").replace("DWELL", "30.1")
    (finding,) = [one for one in found(beyond, "virtual_imu") if one.severity == "error"]
    assert finding.code == "physics-cable-wrap"
    assert "371 deg" in finding.message


def test_the_sense_of_a_spin_counts_at_a_limit(found: Found) -> None:
    turned = "orientation: {from: {x: east, y: north, z: up}, rotate: [z 180 deg]}, dwell: 20 s, motion: {rate: 10 deg/s, about: ABOUT}"
    for about in ("up", "down"):
        errors = [one for one in found(turned.replace("ABOUT", about), "virtual_imu") if one.severity == "error"]
        assert len(errors) <= 1
    # From +180 deg (or -180 deg) one sense reaches 400 deg and the other 40 deg: exactly one of them is refused.
    refused = [
        about
        for about in ("up", "down")
        if "physics-cable-wrap" in codes(found(turned.replace("ABOUT", about), "virtual_imu"))
    ]
    assert len(refused) == 1


def test_one_angle_cannot_describe_three_rings(found: Found) -> None:
    rock = "motion: {rock: {amplitude: 1 deg, frequency: 0.5 Hz, phases: [0 deg, 90 deg]}}"
    assert codes(found(rock, "virtual_imu_nominal")) == ["physics-table-angle"]
    assert codes(found(rock, "virtual_mems")) == []


def test_a_joint_that_was_stopped_carries_no_other_axis(tmp_path: Path) -> None:
    def errors(second: str) -> list[str]:
        path = tmp_path / "plan.yaml"
        first = "motion: {rate: 50 deg/s, about: up}, dwell: {turns: 1}"
        path.write_text(
            PLAN.format(bench="virtual_mems", kind="imu", segment=first) + f"  - {{label: T, {second}}}\n",
            encoding="utf-8",
        )
        return codes(check_plan(path).findings.errors)

    north = "motion: {rate: 10 deg/s, about: north}"
    assert errors(north) == []  # the table takes its orientation first
    assert errors(f"{north}, orientation: unknown") == ["physics-rate-axis"]
    assert errors("motion: {rate: 10 deg/s, about: up}, orientation: unknown") == []
