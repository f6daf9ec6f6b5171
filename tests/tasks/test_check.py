"""The checks of meaning and physics on whole plans: what is found, where, and that all of it is found in one run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from planrunner.cli import main
from planrunner.tasks.check import Checked, Document, check_plan
from tests.conftest import FLAGSHIP, ROOT

Write = Callable[..., Path]
P1 = "P1: {x: up, y: north, z: west}"


def line_of(path: Path, text: str) -> int:
    return next(n for n, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if text in line)


def codes(checked: Checked) -> list[str]:
    return [finding.code for finding in checked.findings if finding.severity == "error"]


def test_every_shipped_plan_passes() -> None:
    for path in sorted((ROOT / "plans").rglob("*.yaml")):
        if {"benches", "suites"} & set(path.parts) or path.name == "answers.yaml" or path.name.endswith(".bench.yaml"):
            continue
        checked = check_plan(path)
        assert checked.ok, list(map(str, checked.findings))


def test_the_patents_printed_first_position_is_refused_where_it_stands(plan_file: Write) -> None:
    path = plan_file((P1, "P1: {x: up, y: west, z: north}"))
    checked = check_plan(path)
    (finding,) = checked.findings.errors
    assert finding.code == "meaning-left-handed"
    assert finding.mark.line == line_of(path, "P1:")
    assert finding.mark.column == path.read_text().splitlines()[finding.mark.line - 1].index("{") + 1
    for repair in ("{x: up, y: north, z: west}", "{x: up, y: west, z: south}", "{x: up, y: east, z: north}"):
        assert repair in finding.hint


def test_a_plan_and_a_bench_that_are_no_files_are_checked_alike(plan_file: Write) -> None:
    path = plan_file((P1, "P1: {x: up, y: west, z: north}"))
    bench = ROOT / "plans" / "benches" / "virtual.yaml"
    in_memory = check_plan(Document(path.read_bytes(), str(path)), Document(bench.read_bytes(), str(bench)))
    assert list(map(str, in_memory.findings)) == list(map(str, check_plan(path, bench).findings))
    assert in_memory.findings.errors
    empty = check_plan(path, Document(b"", "given.yaml")).findings.errors
    assert any(finding.mark.file == "given.yaml" for finding in empty)


def test_a_run_checks_its_plan_once(plan_file: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(*given: object) -> Checked:
        raise AssertionError("checked again")

    monkeypatch.setattr("planrunner.tasks.estimate.check_plan", again)
    settings = ["--set", "device_serial=1", "--set", "operator=demo", "--quiet"]
    assert main(["run", str(plan_file()), *settings, "--runs", str(tmp_path)]) == 0
    (folder,) = (path for path in tmp_path.iterdir() if (path / "run.json").exists())
    assert (folder / "analyses" / "1" / "results.json").exists()


def test_all_errors_in_one_run(plan_file: Write) -> None:
    path = plan_file(
        (P1, "P1: {x: up, y: west, z: north}"),
        ("temperature: 25 degC", "temperature: 125 degC"),
        ("estimator: flexure_gyro_static, segments: T*", "estimator: flexure_gyro_statics, segments: T*"),
        ("drift.D_X_F", "drfit.D_X_F"),
        ("settle: 30 s", "settle: 30 m"),
    )
    found = codes(check_plan(path))
    assert {
        "meaning-left-handed",
        "physics-temperature",
        "form-unknown-estimator",
        "meaning-unknown-estimate",
        "meaning-dimension",
    } <= set(found)


def test_a_rank_deficient_design_names_the_terms(plan_file: Write) -> None:
    path = plan_file(
        ("segments: P*, uncertainty", "segments: P*, terms: [accel_x_accel_z, accel_y_accel_z], uncertainty")
    )
    errors = [f for f in check_plan(path).findings.errors if f.code == "physics-rank"]
    assert errors
    assert "accel_x_accel_z" in errors[0].message
    assert "accel_y_accel_z" in errors[0].message
    assert errors[0].mark.line == line_of(path, "drift: {")


def test_two_positions_cannot_give_six_coefficients(plan_file: Write) -> None:
    path = plan_file(
        (
            "drift: {estimator: flexure_gyro_static, segments: P*",
            "drift: {estimator: flexure_gyro_static, segments: [P1, P2]",
        )
    )
    assert "physics-rank" in codes(check_plan(path)) or "physics-estimate" in codes(check_plan(path))


@pytest.mark.parametrize(
    ("segment", "code"),
    [
        ("{label: a, orientation: {x: up, y: north}, rate: 500 deg/s}", "physics-rate"),
        (
            "{label: a, orientation: {x: up, y: north}, motion: {rock: {amplitude: 30 deg, frequency: 5 Hz}}}",
            "physics-acceleration",
        ),
        ("{label: a, orientation: {x: up, y: north}, temperature: -80 degC}", "physics-temperature"),
        ("{label: a, orientation: {x: up, y: north}, temperature: {ramp_to: 120 degC}}", "physics-temperature"),
        (
            "{label: a, orientation: {from: {x: east, y: north}, rotate: [z 30 deg]}, motion: {rate: 10 deg/s, about: south}}",
            "physics-rate-axis",
        ),
        ("{label: a, orientation: {x: up, y: north}, rate: 9**9**9 deg/s}", "form-quantity"),
        ("{label: a, orientation: {x: up, y: north}, rate: nan deg/s}", "form-quantity"),
        ("{label: a, orientation: {x: up, y: north}, rate: 30 Hz}", "meaning-dimension"),
        ("{label: a, orientation: {x: up, y: north}, rate: 30}", "form-unit-missing"),
        ("{label: a, orientation: {x: up, y: north}, dwell: 0 s}", "meaning-range"),
        ("{label: a, orientation: {x: up, y: north}, dwell: -2 min}", "meaning-range"),
        ("{label: a, orientation: {x: up, y: north}, dwell: {turns: 1}}", "meaning-turns"),
        ("{label: a, orientation: {x: up, y: up}}", "meaning-orientation"),
        ("{label: P1, orientation: {x: up, y: north}}", "meaning-label-repeated"),
        ("{orientation: {x: up, y: north}}", "meaning-label"),
        ("{label: a, orientation: {x: up, y: north}, mode: caged}", "physics-mode"),
        ("{label: a}", "meaning-no-orientation"),
        ("{label: a, orientaton: {x: up, y: north}}", "form-unknown-key"),
    ],
)
def test_states_that_cannot_be(plan_file: Write, segment: str, code: str) -> None:
    path = plan_file(("\nestimates:", f"\n  - {segment}\nestimates:"))
    checked = check_plan(path)
    assert code in codes(checked), list(map(str, checked.findings))
    line = line_of(path, segment)
    assert line in [f.mark.line for f in checked.findings if f.code == code]


def test_part_of_a_turn_at_a_low_rate_is_a_warning_with_its_figure(plan_file: Write) -> None:
    tilted = "{from: {x: east, y: north}, rotate: [x 54.7356 deg]}"
    segment = "{label: slow, orientation: " + tilted + ", rate: 1 deg/s, dwell: 30 s}"
    path = plan_file(("\nestimates:", f"\n  - {segment}\nestimates:"))
    warnings = [f for f in check_plan(path).findings if f.code == "physics-whole-turns"]
    assert len(warnings) == 1
    whole = plan_file(
        ("\nestimates:", f"\n  - {segment.replace('dwell: 30 s', 'dwell: {turns: 1}')}\nestimates:"), name="whole.yaml"
    )
    assert not [f for f in check_plan(whole).findings if f.code == "physics-whole-turns"]


def test_a_cable_that_winds_up(plan_file: Write, tmp_path: Path) -> None:
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    bench = bench.replace("{name: outer,", "{name: outer, lowest: -200 deg, highest: 200 deg,")
    (tmp_path / "limited.yaml").write_text(bench, encoding="utf-8")
    segment = "{label: a, orientation: {x: east, y: north}, rate: 20 deg/s, dwell: {turns: 1}}"
    path = plan_file(("bench: virtual", "bench: limited.yaml"), ("\nestimates:", f"\n  - {segment}\nestimates:"))
    assert "physics-cable-wrap" in codes(check_plan(path))


def test_a_bench_without_a_table_neither_turns_nor_moves_the_sensor(plan_file: Write, tmp_path: Path) -> None:
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    start, end = bench.index("  table:\n"), bench.index("  chamber:\n")
    bench = (bench[:start] + bench[end:]).replace("safe_order: [table, chamber, gyro]", "safe_order: [chamber, gyro]")
    (tmp_path / "bare.yaml").write_text(bench, encoding="utf-8")
    assert "physics-no-table" in codes(check_plan(plan_file(("bench: virtual", "bench: bare.yaml"))))


def test_a_limit_narrower_than_the_uncertainty_to_expect_is_foreseen(plan_file: Write) -> None:
    path = plan_file(("within: ±5 deg/h", "within: ±0.001 deg/h"))
    assert any(f.code == "physics-limit" and f.severity == "warning" for f in check_plan(path).findings)


def test_a_guard_band_of_its_own_is_foreseen_and_a_prior_must_fit(plan_file: Write) -> None:
    """U of D_X_F is some 0.013 deg/h: a limit of ±0.008 deg/h can be passed with a quarter of it as guard band."""
    narrow = "within: ±0.008 deg/h"
    assert any(f.code == "physics-limit" for f in check_plan(plan_file(("within: ±5 deg/h", narrow))).findings)
    quarter = plan_file(("within: ±5 deg/h", f"{narrow}, guard_band: 0.25"))
    assert not any(f.code == "physics-limit" for f in check_plan(quarter).findings)
    path = plan_file(
        ("drift.D_X_F, within: ±5 deg/h", "drift.D_X_F, within: ±5 deg/h, prior: 1 deg/h"),
        ("drift.D_Y_F, within: ±5 deg/h", "drift.D_Y_F, within: ±5 deg/h, prior: 1 deg ± 1 deg"),
    )
    found = {f.code: f.mark.line for f in check_plan(path).findings.errors}
    assert found == {
        "meaning-uncertainty": line_of(path, "prior: 1 deg/h"),
        "meaning-dimension": line_of(path, "prior: 1 deg ±"),
    }


def test_limits_on_unknown_or_other_quantities(plan_file: Write) -> None:
    path = plan_file(
        ("drift.D_X_F, within: ±5 deg/h", "drift.D_X_Q, within: ±5 deg/h"),
        ("drift.D_Y_F, within: ±5 deg/h", "drift.D_Y_F, within: ±5 g"),
    )
    assert {"meaning-unknown-quantity", "meaning-dimension"} <= set(codes(check_plan(path)))


def test_bench_and_sensor_must_fit(plan_file: Write) -> None:
    other = check_plan(plan_file(("kind: flexure-gyro", "kind: imu")))
    (message,) = [finding.message for finding in other.findings.errors if finding.code == "meaning-sensor-kind"]
    assert message == "the plan is for a sensor of kind 'imu', but the bench has one of kind 'flexure-gyro'"
    assert "meaning-sensor-output" in codes(check_plan(plan_file(("[torquer_x, torquer_y]", "[torquer_x, torquer_w]"))))
    missing = check_plan(plan_file(("bench: virtual", "bench: virtuel")))
    (finding,) = missing.findings.errors
    assert finding.code == "meaning-unknown-bench"
    assert "virtual" in finding.hint
    assert finding.mark.line == line_of(FLAGSHIP, "bench: virtual")


def test_the_flagship_predicts_what_its_positions_give() -> None:
    checked = check_plan(FLAGSHIP)
    drift = checked.judged["drift"][0]
    assert drift.determinant == pytest.approx(706.081, abs=5e-4)
    assert drift.condition == pytest.approx(2.61, abs=5e-3)
    traditional = checked.judged["traditional"][0]
    assert traditional.determinant == pytest.approx(88.26, abs=5e-3)
    assert traditional.condition == pytest.approx(3.83, abs=5e-3)


def test_a_wrong_cycle_is_not_called_no_cycle_by_its_dwell(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    text = (ROOT / "plans" / "rotation_stop_navigation.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("[A +180 C, C +90 D, D -180 B, B -90 A, A", "[A +90 C, C +90 D, D -180 B, B -90 A, A"))
    found = codes(check_plan(path))
    assert "meaning-cycle-landing" in found
    assert "meaning-turns" not in found


def test_an_axis_of_the_mounting_that_cannot_be_read_is_found_once(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    text = (ROOT / "plans" / "scale_factor_tilted.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("x: {angle: 54.7356 deg", "x: {angle: 54.7356 s", 1), encoding="utf-8")
    assert codes(check_plan(path)) == ["meaning-dimension"]


def test_a_dwell_holds_at_least_one_sample(plan_file: Write) -> None:
    path = plan_file(("dwell: 2 min", "dwell: 2 min, sample_rate: 0.001 Hz"))
    (finding,) = check_plan(path).findings.errors
    assert finding.code == "physics-samples"
    assert "120 s" in finding.message
    assert "0.001 Hz" in finding.message
    assert check_plan(plan_file(("dwell: 2 min", "dwell: 2 min, sample_rate: 0.01 Hz"))).ok


def test_a_guard_band_without_a_guarded_rule_is_refused(plan_file: Write) -> None:
    path = plan_file(("within: ±5 deg/h, rule: guarded", "within: ±5 deg/h, rule: simple, guard_band: 1"))
    found = check_plan(path).findings.errors
    assert {finding.code for finding in found} == {"meaning-limit"}
    assert found[0].mark.line == line_of(path, "guard_band")


def test_pure_numbers_have_no_unit_in_findings(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    text = (ROOT / "plans" / "imu_multi_position.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("at_least: 0.99, at_most: 1.01", "at_least: 0.99 deg"), encoding="utf-8")
    (finding,) = check_plan(path).findings.errors
    assert finding.message == "imu.gyro_scale_x is a pure number, so deg cannot be compared with it"
    assert finding.hint == "write the limit without a unit"
