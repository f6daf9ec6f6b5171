"""What is said of a recording before it is played back: everything at once, in one pass."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.cli import main
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment

TABLE = "label,start_s,end_s\nA,0,2\nB,2,4\nC,4,10\n"


def write(folder: Path, time: np.ndarray, x: np.ndarray | None = None, table: str = TABLE) -> Path:
    x = np.sin(time) if x is None else x
    rows = [f"{a!r},{b!r}" for a, b in zip(time.tolist(), x.tolist(), strict=True)]
    (folder / "r.csv").write_text("\n".join(["t,x", *rows]).replace("nan", ""), encoding="utf-8")
    (folder / "s.csv").write_text(table, encoding="utf-8")
    return folder


def looked_over(folder: Path, labels: str = "ABC", dwell: float | None = None) -> list[tuple[str, str, int, str]]:
    """Severity, code, line and message of what is found."""
    log = Findings()
    text = (
        "file: r.csv\nkind: imu\ntime: {column: t}\nsample_rate: 10 Hz\nsegments: {table: s.csv}\n"
        "channels: {x: {column: x, unit: deg/s}}"
    )
    made = RecordOf(RecordingParameters).read(source.parse(text, "bench.yaml"), log)
    player = RecordingPlayer.open(made, (folder / "r.csv",), folder / "s.csv", VirtualClock())
    segments = [Segment(n, label, None, "unknown", Rest(), dwell) for n, label in enumerate(labels)]
    player.look_over(segments, log)
    return [(one.severity, one.code, one.mark.line, one.message) for one in log.items]


TIME = np.arange(100) / 10


def test_a_sound_recording_has_no_findings(tmp_path):
    assert looked_over(write(tmp_path, TIME)) == []


@pytest.mark.parametrize("batch", [7, 65_536])
def test_every_fault_in_time_is_found_wherever_it_lies(tmp_path, monkeypatch, batch):
    monkeypatch.setattr(format_file, "BATCH", batch)
    time = TIME.copy()
    time[80], time[90], time[95] = time[79], np.nan, 9.0
    write(tmp_path, time)
    if batch > len(time):  # what the first rows show is said when the file is opened
        with pytest.raises(InstrumentError, match=r"row 91 \(line 92\): the time is missing"):
            looked_over(tmp_path)
        return
    ((severity, code, _, message),) = looked_over(tmp_path)
    assert (severity, code) == ("error", "recording-time")
    assert "row 81 (7.9 s after 7.9 s)" in message
    assert "row 91 (missing" in message
    assert "row 96 (9 s after 9.4 s)" in message


def test_segments_beyond_the_data_and_unknown_labels_are_all_named(tmp_path):
    table = "label,start_s,end_s\nA,-5,2\nB,2,4\nC,4,10.3\n"
    found = looked_over(write(tmp_path, TIME, table=table), "ABCDE")
    assert [(severity, code, line) for severity, code, line, _ in found] == [
        ("error", "recording-labels", 1),
        ("error", "recording-labels", 1),
        ("error", "recording-beyond", 2),
        ("error", "recording-beyond", 4),
    ]
    assert "'C' is listed from 4 s to 10.3 s, but r.csv holds 0 s to 10 s" in found[3][3]


def test_time_stamps_at_the_end_of_each_sample_are_not_beyond(tmp_path):
    assert looked_over(write(tmp_path, TIME + 0.1)) == []


def test_gaps_missing_numbers_and_overlaps_are_warnings(tmp_path):
    kept = np.r_[0:5, 15:50, 53:100]
    x = np.sin(TIME)
    x[30] = np.nan
    table = "label,start_s,end_s\nA,0,2\nB,1.5,4\nC,4,10\n"
    found = looked_over(write(tmp_path, TIME[kept], x[kept], table))
    assert {(severity, code) for severity, code, *_ in found} == {
        ("warning", "recording-gap"),
        ("warning", "recording-missing"),
        ("warning", "recording-overlap"),
    }
    told = {code: message for _, code, _, message in found}
    assert "2 places" in told["recording-gap"]
    assert "lasts 1.1 s, from 0.4 s in 'A'" in told["recording-gap"]
    assert "'x' 1 of 87" in told["recording-missing"]
    assert "'A' and 'B' share 0.5 s" in told["recording-overlap"]


def test_a_segment_in_a_pause_and_a_dwell_that_is_too_long_are_errors(tmp_path):
    kept = np.r_[0:20, 40:100]
    found = looked_over(write(tmp_path, TIME[kept]))
    assert [(severity, code, line) for severity, code, line, _ in found] == [("error", "recording-empty", 3)]
    found = looked_over(write(tmp_path, TIME), dwell=3.0)
    assert [(code, line) for _, code, line, _ in found] == [("recording-short", 2), ("recording-short", 3)]


BENCH = """planrunner_bench: 1
name: tumbled
clock: virtual
site: {latitude: 45 deg, gravity: 9.80665 m/s^2}
instruments:
  imu:
    driver: recording
    file: r.csv
    kind: imu
    time: {column: t}
    sample_rate: 100 Hz
    channels:
      accel_x: {column: x, unit: m/s^2}
      accel_y: {column: y, unit: m/s^2}
      accel_z: {column: z, unit: m/s^2}
"""
TUMBLE = """planrunner: 1
title: Tumble
bench: bench.yaml
sensor: {kind: imu, outputs: [accel_x, accel_y, accel_z]}
segments: [{label: tumble, orientation: unknown, dwell: recorded}]
estimates:
  a:
    estimator: accelerometer_multi_position
    reference: gravity_magnitude
    segments: {detect: still, window: 0.5 s, threshold: 0.2 m/s^2, at_least: 2 s}
report: [summary.md]
"""


def test_check_tries_the_estimates_on_the_recording(tmp_path, monkeypatch, capsys):
    """Six still poses are found in the data, and nine parameters asked for."""
    rng = np.random.default_rng(5)
    poses = np.repeat(9.80665 * np.vstack([np.eye(3), -np.eye(3)]), 400, axis=0)
    values = poses + rng.normal(0, 0.02, poses.shape)
    rows = [f"{n / 100},{x},{y},{z}" for n, (x, y, z) in enumerate(values.tolist())]
    (tmp_path / "r.csv").write_text("\n".join(["t,x,y,z", *rows]), encoding="utf-8")
    (tmp_path / "bench.yaml").write_text(BENCH, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(TUMBLE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["check", "plan.yaml"]) == 0
    assert "add --data DIR" in capsys.readouterr().out
    assert main(["check", "plan.yaml", "--data", "."]) == 2
    error = capsys.readouterr().err
    assert "plan.yaml:8:5: error[recording-estimate]" in error
    assert "6 poses cannot determine 9 parameters" in error
    assert main(["check", "plan.yaml", "--data", "elsewhere"]) == 2
    assert "bench.yaml:7:5: error[recording-unfit]" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(("count", "basis", "code"), [(8, "residual", 2), (9, "residual", 2), (10, "residual", 0)])
def test_check_counts_the_poses_of_a_plan_without_any_data(tmp_path, monkeypatch, capsys, count, basis, code):
    (tmp_path / "bench.yaml").write_text(BENCH, encoding="utf-8")
    segments = ", ".join(f"{{label: P{n}, orientation: unknown, dwell: recorded}}" for n in range(count))
    text = TUMBLE.replace("{label: tumble, orientation: unknown, dwell: recorded}", segments)
    text = text.replace("{detect: still, window: 0.5 s, threshold: 0.2 m/s^2, at_least: 2 s}", "P*")
    (tmp_path / "plan.yaml").write_text(text + f"# {basis}\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["check", "plan.yaml"]) == code
    assert ("error[physics-poses]" in capsys.readouterr().err) == (code == 2)


def test_a_segment_whose_end_has_no_samples_is_named(tmp_path):
    """The time jumps by 1.5 s within the first segment, so its last samples have times of the second segment."""
    time = TIME + 1.5 * (TIME > 0.75)
    [(severity, code, line, message)] = looked_over(write(tmp_path, time, table=TABLE.replace("C,4,10", "C,4,11")))
    assert (severity, code, line) == ("warning", "recording-gap", 2)
    assert "'A' has no samples from 0.8 s to 2 s" in message and "the recorded time jumps" in message


def test_rounded_times_of_segments_are_no_gap(tmp_path):
    time = TIME[(TIME < 1.95) | (TIME > 2.05)]
    assert not [one for one in looked_over(write(tmp_path, time)) if "has no samples" in one[3]]


def test_irregular_times_are_not_missing_samples(tmp_path):
    """Every row is there, but the logger stamps each with a delay of up to 0.8 sample intervals."""
    time = TIME + np.random.default_rng(1).uniform(0, 0.08, len(TIME))
    (found,) = looked_over(write(tmp_path, time))
    assert found[:2] == ("warning", "recording-gap")
    assert "the times are irregular, although hardly any samples are missing" in found[3]
    (found,) = looked_over(write(tmp_path, np.delete(time, range(50, 60))))
    assert "samples are missing at" in found[3]
