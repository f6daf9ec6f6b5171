"""What `check` says beforehand of estimates that the planned segments cannot give, and that `run` refuses the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from planrunner.base.findings import Finding
from planrunner.tasks.check import Checked, check_plan

PLAN = """\
planrunner: 1
title: estimates
bench: {bench}
sensor: {{kind: {kind}, outputs: [gyro_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, dwell: {dwell}, settle: 0 s}}
segments:
{segments}
estimates:
  e: {{{estimate}}}
"""
Check = Callable[..., Checked]


@pytest.fixture
def check(tmp_path: Path) -> Check:
    def made(
        segments: str, estimate: str, dwell: str = "30 s", bench: str = "virtual_mems", kind: str = "imu"
    ) -> Checked:
        path = tmp_path / "plan.yaml"
        text = PLAN.format(segments=segments, estimate=estimate, dwell=dwell, bench=bench, kind=kind)
        path.write_text(text, encoding="utf-8")
        return check_plan(path)

    return made


def said(checked: Checked) -> Sequence[Finding]:
    return [finding for finding in checked.findings if finding.severity != "note"]


RATES = '  - {label: R, for_each: {rate: "±10, ±50 deg/s"}ORIENTATION}'
ABOUT_X = RATES.replace("ORIENTATION", ", orientation: {x: up, y: north, z: west}")


def test_a_spin_about_another_axis_than_the_one_fitted(check: Check) -> None:
    checked = check(ABOUT_X, "estimator: scale_factor, outputs: gyro_z")
    (finding,) = said(checked)
    assert (finding.code, finding.severity) == ("physics-input-axis", "warning")
    assert (finding.mark.line, finding.mark.column) == (9, 41)
    assert "90 deg" in finding.message
    assert "along x" in finding.hint
    K = next(one for one in checked.designs["e"].predicted if one.name == "K_gyro_z")
    assert (
        abs(K.value) < K.standard_uncertainty
    )  # it is the misalignment, and is known as well as a scale factor would be


def test_an_axis_across_beside_one_along_is_a_misalignment(check: Check) -> None:
    assert said(check(ABOUT_X, "estimator: scale_factor, outputs: [gyro_x, gyro_z]")) == []
    assert said(check(RATES.replace("ORIENTATION", ""), "estimator: scale_factor, outputs: gyro_z")) == []


def test_one_sample_is_no_dwell(check: Check) -> None:
    segments = RATES.replace("ORIENTATION", "")
    (finding,) = said(check(segments, "estimator: scale_factor, outputs: gyro_z", dwell="10 ms"))
    assert (finding.code, finding.severity) == ("physics-few-samples", "warning")
    assert "1 sample" in finding.message
    assert said(check(segments, "estimator: scale_factor, outputs: gyro_z", dwell="320 ms")) == []
    noise = "estimator: scale_factor, outputs: gyro_z, uncertainty: within_segment"
    assert "physics-basis" in [one.code for one in check(segments, noise, dwell="10 ms").findings.errors]


def test_as_many_segments_as_coefficients(check: Check) -> None:
    two = '  - {label: R, for_each: {rate: "±10 deg/s"}}'
    (finding,) = check(two, "estimator: scale_factor, outputs: gyro_z").findings.errors
    assert finding.code == "physics-basis"
    assert not check(two, "estimator: scale_factor, outputs: gyro_z, uncertainty: within_segment").findings.errors


def test_averaging_times_beyond_the_dwell(check: Check) -> None:
    rest = "  - {label: A, dwell: 5 min}"
    allan = "estimator: allan_deviation, outputs: gyro_z"
    (finding,) = said(check(rest, f"{allan}, fit_up_to: 5 h"))
    assert (finding.code, finding.severity) == ("physics-averaging", "warning")
    assert "10 h" in finding.hint
    assert finding.mark.column > 40  # at the key
    assert said(check(rest, f"{allan}, fit_up_to: 1 min")) == []
    (finding,) = said(check(rest, f"{allan}, taus: [1 s, 10 s, 20 s, 200 s]"))
    assert finding.code == "physics-averaging"
    assert "200 s" in finding.message
    for impossible in ("taus: [200 s]", "fit_up_to: 5 ms"):
        (finding,) = check(rest, f"{allan}, {impossible}").findings.errors
        assert finding.code == "physics-estimate"


@pytest.mark.parametrize(("dwell", "outputs"), [("0.13 s", {"gyro_x", "gyro_y"}), ("10 s", set())])
def test_counts_that_are_coarse_beside_the_noise(dwell: str, outputs: set[str], check: Check) -> None:
    """0.18″/√s in counts of 0.09″: within 0.13 s the noise need not fill one."""
    estimate = "estimator: allan_deviation, outputs: [gyro_x, gyro_y]"
    checked = check("  - {label: A}", estimate, dwell=dwell, bench="virtual_gyro_triad", kind="gyro-triad")
    found = said(checked)
    assert {one.code for one in found} == ({"physics-resolution"} if outputs else set())
    assert {name for one in found for name in ("gyro_x", "gyro_y") if name in one.message} == outputs


STILL = "segments: {detect: still, window: 0.5 s, threshold: 0.5 m/s^2, at_least: 1 s"
POSES = (
    "  - {label: P, for_each: {orientation: {"
    + ", ".join(
        f"Q{number}: {{from: {{x: east, y: north, z: up}}, rotate: [x {37 * number} deg, y {53 * number} deg]}}"
        for number in range(12)
    )
    + "}}}"
)


@pytest.mark.parametrize("estimator", ["imu_multi_position", "scale_factor", "repeatability", "allan_deviation"])
def test_only_some_estimators_look_for_spans(estimator: str, check: Check) -> None:
    more = {"imu_multi_position": ", gyros: [gyro_x, gyro_y, gyro_z]", "repeatability": ", channels: gyro_x"}
    checked = check(POSES, f"estimator: {estimator}, {STILL}}}{more.get(estimator, '')}")
    assert [one.code for one in checked.findings.errors] == ["physics-estimate"]
    assert "does not search for spans" in checked.findings.errors[0].message


@pytest.mark.parametrize("channels", ["[gyro_x, gyro_y, gyro_z]", "[accel_x]", "[lsm_x, lsm_y, lsm_z]"])
def test_stillness_on_other_channels(channels: str, check: Check) -> None:
    triad = "estimator: accelerometer_multi_position, reference: gravity_magnitude"
    checked = check(POSES, f"{triad}, {STILL}, channels: {channels}}}")
    assert [one.code for one in checked.findings.errors] == ["physics-estimate"]
    assert said(check(POSES, f"{triad}, {STILL}}}")) == []


def test_poses_that_cannot_give_nine_parameters(check: Check) -> None:
    triad = "estimator: accelerometer_multi_position, reference: gravity_magnitude, segments: P"
    assert not check(POSES, triad).findings.errors
    upright = "  - {label: P, repeat: 12}"
    (finding,) = check(upright, triad).findings.errors
    assert finding.code == "physics-estimate"
    assert "poses" in finding.message
