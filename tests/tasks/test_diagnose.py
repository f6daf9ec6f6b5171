"""From a recording to its diagnosis: what is refused, what is remarked, and what a user sees of a recording with a known effect."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from jsonschema import Draft202012Validator
from threadpoolctl import threadpool_info, threadpool_limits

from planrunner.base.findings import Findings, InputError
from planrunner.cli import main
from planrunner.cli.exit_codes import DONE, WRONG_INPUT
from planrunner.instruments import recording_file
from planrunner.tasks import diagnose as diagnosing
from planrunner.tasks.check import check_plan
from planrunner.tasks.diagnose import Recorded, diagnose_recorded, observe, recorded_file, recorded_run
from tests.recorded_imu import SHORT, TURNED, Row, write_recording

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads((ROOT / "schemas" / "diagnosis.schema.json").read_text(encoding="utf-8"))
PLAN = """planrunner: 1
title: Six positions and six rates
bench: bench.yaml
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
defaults: {temperature: 25 degC, dwell: 6 s}
segments:
"""


def listed() -> list[Row]:
    """Six positions, and turns both ways about each axis."""
    made = [Row(f"P{n}", axes, 6) for n, axes in enumerate(SHORT.split(", "), 1)]
    made += [Row(f"R{axis}{rate:+d}", axes, 6, rate) for axis, axes in TURNED.items() for rate in (60, -60)]
    return [Row(**{**row.__dict__, "start": 600 + 10.0 * n}) for n, row in enumerate(made)]


def laboratory(folder: Path, segments: list[Row] | None = None, **changes) -> Path:
    """plan.yaml, bench.yaml, recording.parquet and segments.csv in a folder."""
    segments = listed() if segments is None else segments
    text = PLAN
    for row in segments:
        x, y, z = row.axes.split()
        rate = f", rate: {row.rate} deg/s" if row.rate else ""
        text += f"  - {{label: {row.label}, orientation: {{x: {x}, y: {y}, z: {z}}}{rate}}}\n"
    (folder / "plan.yaml").write_text(text, encoding="utf-8")
    bench = (ROOT / "plans" / "benches" / "imu_recording.yaml").read_text(encoding="utf-8")
    (folder / "bench.yaml").write_text(bench, encoding="utf-8")
    write_recording(folder, listed=segments, **changes)
    return folder


def change(folder: Path, **columns) -> None:
    """Columns of the recording as functions of what they were."""
    table = pq.read_table(folder / "recording.parquet").to_pydict()
    for name, act in columns.items():
        table[name] = act(np.array(table[name]))
    pq.write_table(pa.table(table), folder / "recording.parquet")


def replace(path: Path, before: str, after: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")


def look(folder: Path) -> list[str]:
    """Findings of the recording, as text."""
    recorded = recorded_file(folder / "plan.yaml", None, folder / "recording.parquet", folder / "segments.csv")
    return [str(finding) for finding in observe(recorded)[1]]


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        look(folder)
    return "\n".join(map(str, caught.value.findings))


def set_at(start: int, end: int, value: float):
    def act(values):
        values[start:end] = value
        return values

    return act


def test_a_sound_recording_raises_no_remark(tmp_path):
    assert look(laboratory(tmp_path)) == []


def test_a_recording_shorter_than_the_plan_is_refused(tmp_path):
    laboratory(tmp_path)
    replace(tmp_path / "plan.yaml", "dwell: 6 s", "dwell: 7 s")
    found = refused(tmp_path)
    assert "error[recording-short]: the recording is shorter than the plan: 'P1' dwells 7 s" in found
    assert found.count("recording-short") == len(listed())


def test_a_recording_that_ends_early_is_refused(tmp_path):
    laboratory(tmp_path)
    table = pq.read_table(tmp_path / "recording.parquet")
    pq.write_table(table.slice(0, table.num_rows - 100), tmp_path / "recording.parquet")
    assert "error[recording-beyond]: 'Rz-60' is listed from 710 s to 716 s" in refused(tmp_path)


def test_a_missing_column_is_refused(tmp_path):
    laboratory(tmp_path)
    table = pq.read_table(tmp_path / "recording.parquet")
    pq.write_table(table.drop_columns(["gyro_y_deg_per_s"]), tmp_path / "recording.parquet")
    assert "has no column 'gyro_y_deg_per_s'" in refused(tmp_path)


def test_a_label_without_a_row_in_the_table_is_refused(tmp_path):
    laboratory(tmp_path)
    replace(tmp_path / "segments.csv", "Rx+60", "Rx+61")
    assert "segments.csv has no segment 'Rx+60'" in refused(tmp_path)


def test_a_recording_without_rates_and_forces_is_refused(tmp_path):
    laboratory(tmp_path)
    bench = (tmp_path / "bench.yaml").read_text(encoding="utf-8")
    kept = [line for line in bench.splitlines() if not line.strip().startswith(("gyro", "accel"))]
    (tmp_path / "bench.yaml").write_text("\n".join(kept), encoding="utf-8")
    replace(tmp_path / "plan.yaml", "[gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]", "[sensor_temperature]")
    assert "error[gap-unfit]" in refused(tmp_path)


def test_one_segment_is_refused(tmp_path):
    laboratory(tmp_path, listed()[:1])
    assert "error[gap-one-segment]: the recording contains only the segment 'P1'" in refused(tmp_path)


def test_missing_numbers_are_left_out_and_remarked(tmp_path):
    laboratory(tmp_path)
    change(tmp_path, gyro_x_deg_per_s=set_at(10, 13, np.nan))
    (said,) = look(tmp_path)
    assert "warning[gap-missing-numbers]: 3 rows with a missing number were left out" in said


def test_a_spike_is_left_out_and_remarked(tmp_path):
    laboratory(tmp_path)
    given = tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv"
    before = observe(recorded_file(*given))[0]
    change(tmp_path, gyro_x_deg_per_s=set_at(300, 301, 200.0))
    (said,) = look(tmp_path)
    left_out = "1 spike or repeated sample was left out of the diagnosis; it is a spike of gyro_x in "
    assert f"warning[gap-left-out]: {left_out}" in said
    after = observe(recorded_file(*given))[0]
    assert np.abs(after.values - before.values).max() < 0.01  # rad/s; the spike has 3.5


def test_a_segment_without_a_complete_row_is_refused(tmp_path):
    laboratory(tmp_path)
    change(tmp_path, accel_z_m_per_s2=set_at(300, 600, np.nan))
    assert "error[gap-missing-numbers]: no complete row in 'P2'" in refused(tmp_path)


def test_a_jump_of_the_clock_is_remarked(tmp_path):
    laboratory(tmp_path)
    replace(tmp_path / "plan.yaml", "dwell: 6 s", "dwell: recorded")
    replace(tmp_path / "segments.csv", "600.000,606.000", "600.000,607.000")

    def jump(time):
        time[200:300] += 0.7
        return time

    change(tmp_path, time_s=jump)
    (said,) = look(tmp_path)
    assert "warning[gap-clock]: time jumps within 'P1': by 0.72 s in 'P1'" in said


def leave_out(folder: Path, rows: Iterable[int]) -> None:
    table = pq.read_table(folder / "recording.parquet")
    kept = np.delete(np.arange(table.num_rows), np.array(list(rows)))
    pq.write_table(table.take(kept), folder / "recording.parquet")


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (range(150, 300, 2), "the sample rate changes within 'P1': from the declared 50 Hz to about 25 Hz in 'P1'"),
        (
            [k for k in range(200, 300) if k % 5],
            "the sample rate changes within 'P1': from the declared 50 Hz to about 10 Hz",
        ),
        (range(100, 150), "time jumps within 'P1': by 1.02 s in 'P1'"),
        ([*range(50, 80), *range(150, 180)], "time jumps within 'P1': by 0.62 s in 'P1'"),
        (range(10, 300, 30), "time jumps within 'P1': by 0.04 s in 'P1'"),
        (range(1, 300, 2), "not sampled at the declared 50 Hz: 'P1'"),
    ],
)
def test_a_change_of_the_rate_is_no_jump_of_time(tmp_path, rows, said):
    """Half of the segment at half the rate, its last third at a fifth; one gap and two gaps; 3 % of the samples lost one by one; and a
    segment at half the rate throughout."""
    laboratory(tmp_path)
    replace(tmp_path / "plan.yaml", "dwell: 6 s", "dwell: recorded")
    leave_out(tmp_path, rows)
    (found,) = look(tmp_path)
    assert f"warning[gap-clock]: {said}" in found


def test_another_sample_rate_is_remarked(tmp_path):
    """12 % off: within what the player takes for jitter of the first rows, beyond what a clock may be off."""
    laboratory(tmp_path)
    replace(tmp_path / "bench.yaml", "sample_rate: 50 Hz", "sample_rate: 44 Hz")
    said = look(tmp_path)
    assert "warning[gap-clock]: not sampled at the declared 44 Hz: 'P1', 'P2', 'P3' and 9 more segments" in said[0]


def test_full_scale_is_remarked(tmp_path):
    laboratory(tmp_path)
    replace(
        tmp_path / "bench.yaml",
        "gyro_x_deg_per_s, unit: deg/s,",
        "gyro_x_deg_per_s, unit: deg/s, full_scale: 60 deg/s,",
    )
    change(tmp_path, gyro_x_deg_per_s=lambda values: np.clip(values, -60, 60))
    (said,) = look(tmp_path)
    assert "warning[gap-saturated]: 'gyro_x' reaches its full scale of 60 deg/s in 'Rx" in said


def test_a_channel_that_stands_still_is_refused(tmp_path):
    laboratory(tmp_path)
    change(tmp_path, accel_y_m_per_s2=lambda values: 0 * values + 1.5)
    assert "error[gap-dead-channel]: 'accel_y' stays at 1.5 m/s^2 in every segment" in refused(tmp_path)


def test_a_channel_stuck_in_some_segments_is_remarked(tmp_path):
    """Clipped without a declared full scale, or a logger that hangs."""
    laboratory(tmp_path)
    change(tmp_path, gyro_x_deg_per_s=lambda values: np.clip(values, -30, 30))
    (said,) = look(tmp_path)
    assert "warning[gap-saturated]: 'gyro_x' has the same value throughout 'Rx+60', 'Rx-60'" in said


def test_means_in_place_of_samples_are_refused(tmp_path):
    laboratory(tmp_path)
    change(tmp_path, gyro_x_deg_per_s=lambda values: np.repeat(values.reshape(12, -1).mean(axis=1), values.size // 12))
    assert "error[gap-no-noise]: 'gyro_x' has one value per segment and no noise" in refused(tmp_path)


def diagnosed_with(folder: Path, keys: str) -> None:
    """`diagnosis` in the plan."""
    text = (folder / "plan.yaml").read_text(encoding="utf-8")
    (folder / "plan.yaml").write_text(
        text.replace("segments:\n", f"diagnosis: {keys}\nsegments:\n", 1), encoding="utf-8"
    )


def test_the_plan_says_what_is_looked_at(tmp_path):
    laboratory(tmp_path)
    diagnosed_with(tmp_path, "{outputs: [gyro_x, gyro_y], segments: [R*, P1], nominal: [earth_rate]}")
    recorded = recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv")
    seen, _ = observe(recorded)
    assert [channel.name for channel in seen.channels] == ["gyro_x", "gyro_y"]
    assert sorted(seen.labels) == ["P1", "Rx+60", "Rx-60", "Ry+60", "Ry-60", "Rz+60", "Rz-60"]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("{outputs: [gyro_q]}", "error[gap-unfit]: 'gyro_q' is not an output of this plan's sensor"),
        ("{segments: Q*}", "error[meaning-undefined-label]: no segment is labelled 'Q*'"),
        ("{nominal: [gyro_scale]}", "error[form-choice]: 'gyro_scale' is not known here"),
        (
            "{segments: {detect: still, window: 0.5 s, threshold: 0.0001 m/s^2, at_least: 1 s}}",
            "error[gap-unfit]: no interval at rest was found in the recording",
        ),
        (
            "{segments: {detect: still, window: 0.5 s, threshold: 0.1 m/s^2, at_least: 1 s, channels: [gyro_x]}}",
            "intervals at rest are found from accelerations",
        ),
    ],
)
def test_what_is_wrong_with_a_plans_diagnosis_is_said_with_its_place(tmp_path, keys, words):
    laboratory(tmp_path)
    diagnosed_with(tmp_path, keys)
    said = refused(tmp_path)
    assert words in said and "plan.yaml:6:" in said


def test_a_wrong_unit_that_hides_the_intervals_at_rest_is_said(tmp_path):
    """The threshold is in the right unit, so the noise of readings in mg that are declared as m/s² is far above it."""
    laboratory(tmp_path)
    diagnosed_with(tmp_path, "{segments: {detect: still, window: 0.5 s, threshold: 0.1 m/s^2, at_least: 1 s}}")
    table = pq.read_table(tmp_path / "recording.parquet").to_pandas()
    force = [name for name in table.columns if name.startswith("accel")]
    table[force] *= 1000 / 9.80665
    table[force] += np.random.default_rng(1).normal(0, 5, table[force].shape)
    table.to_parquet(tmp_path / "recording.parquet")
    said = refused(tmp_path)
    assert "no interval at rest was found in the recording; the root mean square of the specific force is 10" in said


@pytest.mark.parametrize("wrong", [True, False])
def test_one_accelerometer_does_not_show_a_wrong_unit(tmp_path, wrong):
    """A vibrating sensor at rest with z up: x does not measure gravity, so only all accelerometers together show a wrong unit."""
    laboratory(tmp_path, [row for row in listed() if row.axes.endswith("up") and not row.rate])
    keys = "{segments: {detect: still, window: 0.5 s, threshold: 0.1 m/s^2, at_least: 1 s, channels: [accel_x]}}"
    diagnosed_with(tmp_path, keys)
    table = pq.read_table(tmp_path / "recording.parquet").to_pandas()
    force = [name for name in table.columns if name.startswith("accel")]
    table[force] *= 1000 / 9.80665 if wrong else 1.0
    table[force] += np.random.default_rng(1).normal(0, 0.5, table[force].shape)
    table.to_parquet(tmp_path / "recording.parquet")
    said = refused(tmp_path)
    assert "no interval at rest was found in the recording" in said
    assert ("the root mean square of the specific force is 102 g" in said) == wrong
    assert ("the root mean square" in said) == wrong


def test_some_orientations_unknown_and_others_not_is_refused(tmp_path):
    laboratory(tmp_path)
    replace(
        tmp_path / "plan.yaml",
        "{label: P1, orientation: {x: up, y: north, z: west}}",
        "{label: P1, orientation: unknown}",
    )
    assert "the orientation of segment 'P1' is unknown, but other segments have known orientations" in refused(tmp_path)


@pytest.mark.parametrize("count", [4, 5, 6, 7])
def test_few_segments_give_an_answer_or_an_error(tmp_path, count):
    laboratory(tmp_path, listed()[:count])
    recorded = recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv")
    found = diagnose_recorded(recorded).to_json()
    Draft202012Validator(SCHEMA).validate(found)
    assert found["verdict"]["kind"] == "none"


def rising(sensed):
    """A gyro bias that changes by 0.1 deg/s, with a time constant of five minutes from power-on."""
    decay = np.exp(-(sensed.time[:, None] - 600) / 300)
    return 0 * sensed.rate - np.array([0.1, 0.0, 0.0]) * decay, 0 * sensed.force


def test_cutting_two_long_segments_makes_a_diagnosis_possible(tmp_path):
    """The recording stays as it is; the plan and the table of segments name more pieces of it."""
    long = [Row("still", "up north west", 60, start=600.0), Row("turning", "up north west", 60, 60, start=670.0)]
    laboratory(tmp_path, long, effect=rising)
    replace(tmp_path / "plan.yaml", "dwell: 6 s", "dwell: 60 s")
    given = tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv"
    with pytest.raises(InputError) as caught:
        diagnose_recorded(recorded_file(*given))
    (refused,) = caught.value.findings
    assert refused.code == "gap-unfit" and "cut long segments" in refused.hint
    pieces = [Row(f"{row.label}-{n}", row.axes, 30, row.rate, start=row.start + 30 * n) for row in long for n in (0, 1)]
    (tmp_path / "other").mkdir()
    laboratory(tmp_path / "other", pieces)
    replace(tmp_path / "other" / "plan.yaml", "dwell: 6 s", "dwell: 30 s")
    cut = tmp_path / "other" / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "other" / "segments.csv"
    verdict = diagnose_recorded(recorded_file(*cut)).to_json()["verdict"]
    assert verdict["effects"] == ["gyro_warm_up"]


def test_a_channel_that_the_plan_does_not_use_may_stand_still(tmp_path):
    laboratory(tmp_path)
    change(tmp_path, accel_y_m_per_s2=lambda values: 0 * values + 1.5)
    replace(tmp_path / "plan.yaml", "accel_x, accel_y, accel_z", "accel_x, accel_z")
    assert look(tmp_path) == []


def test_too_few_segments_to_hold_any_out_are_remarked(tmp_path):
    laboratory(tmp_path, listed()[:3])
    said = look(tmp_path)
    assert any("warning[gap-no-held-out]: 3 segments are too few: with" in text for text in said)


def test_a_nominal_model_that_does_not_fit_at_all_is_refused(tmp_path):
    """Two stretches change their labels: the rates go the other way round."""
    laboratory(tmp_path)
    text = (tmp_path / "segments.csv").read_text(encoding="utf-8")
    for axis in "xyz":
        text = (
            text.replace(f"R{axis}+60", "aside").replace(f"R{axis}-60", f"R{axis}+60").replace("aside", f"R{axis}-60")
        )
    (tmp_path / "segments.csv").write_text(
        text.replace("P1,", "x,").replace("Rx+60,", "P1,").replace("x,", "Rx+60,"), encoding="utf-8"
    )
    assert "error[gap-nominal-misfit]: 'gyro_x' does not follow the plan" in refused(tmp_path)


def test_a_bench_that_maps_no_columns_is_refused(tmp_path):
    laboratory(tmp_path, [row for row in listed() if row.label == "P5"])
    replace(tmp_path / "plan.yaml", "temperature: 25 degC, ", "")
    with pytest.raises(InputError) as caught:
        recorded_file(tmp_path / "plan.yaml", "virtual_imu", tmp_path / "recording.parquet")
    assert [finding.code for finding in caught.value.findings] == ["recording-no-mapping"]


def test_the_table_of_segments_lies_beside_the_recording_unless_it_is_named(tmp_path):
    laboratory(tmp_path)
    replace(tmp_path / "bench.yaml", "table: segments.csv", "table: elsewhere/segments.csv")
    recorded = recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet")
    assert [item.label for item in recorded.segments] == [row.label for row in listed()]
    (tmp_path / "segments.csv").rename(tmp_path / "other.csv")
    with pytest.raises(InputError, match="recording-unfit"):
        recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet")
    recorded = recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "other.csv")
    assert len(recorded.segments) == len(listed())


def divided(folder: Path) -> Path:
    """A laboratory whose recording is in two files, the second in a folder beside the first."""
    laboratory(folder)
    table = pq.read_table(folder / "recording.parquet")
    half = table.num_rows // 2
    (folder / "later").mkdir()
    pq.write_table(table.slice(half), folder / "later" / "second.parquet")
    pq.write_table(table.slice(0, half), folder / "recording.parquet")
    replace(folder / "bench.yaml", "    file: ", "    continued_by: [later/second.parquet]\n    file: ")
    return folder


def test_files_that_continue_the_recording_are_read(tmp_path):
    laboratory(tmp_path)
    whole, _ = observe(recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet"))
    (tmp_path / "divided").mkdir()
    folder = divided(tmp_path / "divided")
    parts, _ = observe(recorded_file(folder / "plan.yaml", None, folder / "recording.parquet"))
    assert np.array_equal(parts.values, whole.values)


def test_a_missing_or_unknown_continuation_is_refused(tmp_path):
    folder = divided(tmp_path)
    (folder / "recording.parquet").rename(folder / "other.parquet")
    with pytest.raises(InputError, match=r"continue recording\.parquet \(`continued_by`\), but not other\.parquet"):
        recorded_file(folder / "plan.yaml", None, folder / "other.parquet")
    (folder / "other.parquet").rename(folder / "recording.parquet")
    (folder / "later" / "second.parquet").unlink()
    with pytest.raises(InputError, match=r"second\.parquet"):
        recorded_file(folder / "plan.yaml", None, folder / "recording.parquet")


def test_only_the_outputs_of_the_plan_are_looked_at(tmp_path):
    laboratory(tmp_path)
    replace(tmp_path / "plan.yaml", "[gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]", "[gyro_x, gyro_z]")
    seen, _ = observe(recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet"))
    assert [channel.name for channel in seen.channels] == ["gyro_x", "gyro_z"]
    # Since power-on, and the encoder's angle: P1 begins 600 s after it.
    assert seen.time[0] == pytest.approx(600.0)
    assert np.degrees(np.ptp(seen.angle[seen.segments()[6]])) == pytest.approx(60 * (6 - 0.02))


def test_an_unknown_nominal_term_is_refused(tmp_path, capsys):
    laboratory(tmp_path)
    given = [str(tmp_path / "plan.yaml"), "--recording", str(tmp_path / "recording.parquet")]
    assert main(["diagnose", *given, "--nominal", "gyro_bias", "gyro_scale"]) == WRONG_INPUT
    assert "error[gap-nominal]: 'gyro_scale' is not a nominal term" in capsys.readouterr().err


def test_a_plan_alone_and_a_run_with_a_recording_are_wrong_arguments(tmp_path, capsys):
    laboratory(tmp_path)
    assert main(["diagnose", str(tmp_path / "plan.yaml")]) == WRONG_INPUT
    assert "error[gap-arguments]: a plan alone contains nothing to diagnose" in capsys.readouterr().err
    assert main(["diagnose", str(tmp_path), "--recording", "r.parquet"]) == WRONG_INPUT
    assert "--recording cannot be given for a run folder" in capsys.readouterr().err
    assert main(["diagnose", str(tmp_path)]) == WRONG_INPUT
    assert "this is not a run folder" in capsys.readouterr().err


def test_a_long_recording_is_read_anew_and_is_the_same(tmp_path, monkeypatch):
    laboratory(tmp_path)
    given = tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv"
    held = recorded_file(*given)
    monkeypatch.setattr(recording_file, "HELD", 100)
    streamed = recorded_file(*given)
    for one, other in zip(held.segments, streamed.segments, strict=True):
        assert one.statistics.mean == pytest.approx(other.statistics.mean, rel=1e-14)
        assert one.statistics.count == other.statistics.count
        for first, second in zip(one.blocks(["gyro_x"]), other.blocks(["gyro_x"]), strict=True):
            assert np.array_equal(first.channels["gyro_x"], second.channels["gyro_x"])


@pytest.mark.parametrize("jobs", [1, 2])
def test_linear_algebra_has_as_many_threads_as_jobs(tmp_path, monkeypatch, jobs):
    """Two threads take several times as long as one: what the environment asks for does not count."""

    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    seen = []

    def observe(*_: object) -> object:
        seen.append(threads())
        return refuse()

    monkeypatch.setattr(diagnosing, "corrected_observation", observe)
    recorded = recorded_file(
        laboratory(tmp_path) / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv"
    )
    with threadpool_limits(3 - jobs, user_api="blas"):
        if threads() != {3 - jobs}:
            pytest.skip("this linear algebra cannot be told how many threads to use")
        with pytest.raises(InputError):
            diagnose_recorded(recorded, jobs=jobs)
    assert seen == [{jobs}]


def refuse():
    raise InputError(Findings())


def asymmetry(sensed):
    """Scale factors that differ between the two senses of rotation, by 400, -300 and 500 ppm."""
    return np.abs(sensed.rate) * np.array([2.0, -1.5, 2.5]) * 1e-4, 0 * sensed.force


def turned_round(plan: Path) -> None:
    """The segments of a plan in the opposite order."""
    head, *segments = plan.read_text(encoding="utf-8").split("  - ")
    plan.write_text("  - ".join([head, *reversed(segments)]), encoding="utf-8")


def retaken(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of the folder's plan with a segment taken again."""
    monkeypatch.chdir(folder)
    assert main(["run", "plan.yaml", "--data", ".", "--quiet", "--flushed"]) == DONE
    (run,) = (folder / "runs").iterdir()
    again = ["--retake", "P3", "--reason", "a door was open", "--data", ".", "--quiet"]
    assert main(["resume", str(run), *again]) == DONE
    return run


def test_what_is_looked_at_stands_in_the_order_of_time(tmp_path, monkeypatch):
    """The file's order, the plan's order turned round, and a run of that with a segment taken again."""
    laboratory(tmp_path)
    given = tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv"
    first = recorded_file(*given)
    wanted = observe(first)[0]
    assert wanted.labels == tuple(row.label for row in listed())
    turned_round(tmp_path / "plan.yaml")
    other = recorded_file(*given)
    assert [item.label for item in other.segments] == [item.label for item in first.segments][::-1]
    for recorded in (other, recorded_run(retaken(tmp_path, monkeypatch))):
        found, remarks = observe(recorded)
        assert not remarks.errors
        assert found.labels == wanted.labels
        for name in ("time", "values", "omega", "force", "bounds"):
            assert np.array_equal(getattr(found, name), getattr(wanted, name)), name


@pytest.mark.slow
def test_the_answer_does_not_depend_on_the_order_of_the_plan(tmp_path, capsys, monkeypatch):
    laboratory(tmp_path, effect=asymmetry)
    given = [str(tmp_path / "plan.yaml"), "--recording", str(tmp_path / "recording.parquet"), "--json"]
    assert main(["diagnose", *given]) == DONE
    found = json.loads(capsys.readouterr().out)
    turned_round(tmp_path / "plan.yaml")
    assert main(["diagnose", *given]) == DONE
    assert json.loads(capsys.readouterr().out) == found
    run = retaken(tmp_path, monkeypatch)
    capsys.readouterr()
    assert main(["diagnose", str(run), "--json"]) == DONE
    again = json.loads(capsys.readouterr().out)
    assert again["verdict"] == found["verdict"]
    assert again["posterior"] == pytest.approx(found["posterior"], abs=1e-6)


@pytest.mark.parametrize("stated", ["stretches: {other: {start: 0 s, end: 1 s}}", "pauses: 5 s"])
def test_a_named_table_replaces_the_segments_of_the_bench_file(tmp_path, stated):
    laboratory(tmp_path)
    bench = tmp_path / "bench.yaml"
    lines = bench.read_text(encoding="utf-8").splitlines()
    (own,) = [line for line in lines if line.strip().startswith("segments:")]
    replace(bench, own.strip(), stated)
    given = tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv"
    assert {item.label for item in recorded_file(*given).segments} == {row.label for row in listed()}


def test_segments_that_share_samples_are_refused(tmp_path):
    laboratory(tmp_path)
    replace(tmp_path / "plan.yaml", "dwell: 6 s", "dwell: recorded")
    replace(tmp_path / "segments.csv", "610.000,616.000", "605.000,616.000")
    assert "error[gap-overlap]: 'P1' and 'P2' share 1 s of the recording" in refused(tmp_path)


def test_a_known_effect_is_named(tmp_path, capsys):
    named_from_file(tmp_path, capsys)


@pytest.mark.slow
def test_a_known_effect_is_named_from_run_as_from_file(tmp_path, capsys, monkeypatch):
    found = named_from_file(tmp_path, capsys)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "plan.yaml", "--data", ".", "--quiet", "--flushed"]) == DONE
    (run,) = (tmp_path / "runs").iterdir()
    capsys.readouterr()
    assert main(["diagnose", str(run), "--json"]) == DONE
    again = json.loads(capsys.readouterr().out)
    assert again["verdict"] == found["verdict"]
    assert again["posterior"] == pytest.approx(found["posterior"], abs=1e-6)


def named_from_file(tmp_path, capsys):
    """The diagnosis of a recording with an asymmetry, as JSON."""
    laboratory(tmp_path, effect=asymmetry)
    page, given = tmp_path / "page.html", ["--segments", str(tmp_path / "segments.csv")]
    given = [str(tmp_path / "plan.yaml"), "--recording", str(tmp_path / "recording.parquet"), *given]
    assert main(["diagnose", *given, "--json", "--html", str(page)]) == DONE
    found = json.loads(capsys.readouterr().out)
    Draft202012Validator(SCHEMA).validate(found)
    assert "gyro_scale_asymmetry" in {*found["verdict"]["effects"], *found["verdict"]["class"]}
    assert found["where"][0]["channel"].startswith("gyro")
    assert "gyro_scale_asymmetry" in page.read_text(encoding="utf-8")
    return found


def test_a_sensor_on_a_stabilised_platform_is_refused() -> None:
    """Gimbals keep it level while the table turns, so neither the plan nor the table gives its input."""
    sound = check_plan(Path(__file__).parents[2] / "plans" / "platform_rocking.yaml").sound()
    with pytest.raises(InputError, match="gimbals decouple the outputs"):
        observe(Recorded(sound, (), "runs/platform"))
