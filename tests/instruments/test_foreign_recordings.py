"""Real recordings in the formats of their makers: read as they are, to the figures that are known of them."""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment

DATA = Path(os.environ.get("PLANRUNNER_DATA", Path(__file__).parents[3] / "shared" / "data"))
pytestmark = pytest.mark.skipif(
    not (DATA / "ln100").is_dir(), reason="the real recordings are not there (PLANRUNNER_DATA)"
)


def read(keys: str, folder: Path = DATA) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]], Sequence[str]]:
    """Times, channels, and what a check of the recording says."""
    log = Findings()
    made = RecordOf(RecordingParameters).read(source.parse(f"kind: imu\n{keys}", "bench.yaml"), log)
    assert list(log) == []
    player = RecordingPlayer.open(made, [folder / name for name in made.files], None, VirtualClock())
    whole = Segment(0, "all", None, "unknown", Rest(), None)
    player.look_over([whole], log)
    blocks = list(player.stream(whole))
    channels = {name: np.concatenate([block.channels[name] for block in blocks]) for name in blocks[0].channels}
    return np.concatenate([block.time for block in blocks]), channels, [one.code for one in log]


def test_ring_laser_records_of_seven_numbers() -> None:
    """Half the difference of gyro x, up and down, is the Earth's vertical rate at the site: 11.73 deg/h.

    The numbers of the gyros are deg/s: in rad/s the rate would be 57 times as high.
    """
    fields = ", ".join(
        f"{name}: {{at: {8 * k}, type: f64, little_endian: true}}"
        for k, name in enumerate(("t", "gx", "gy", "gz", "ax", "ay", "az"))
    )
    means = {}
    for way in ("up", "down"):
        keys = (
            f"file: ln100/x_LN100_{way}.ins\nsample_rate: 64 Hz\ntime: {{column: t}}\n"
            f"format: {{type: binary, length: 56, fields: {{{fields}}}}}\n"
            "channels: {gyro_x: {column: gx, unit: deg/s}, accel_x: {column: ax, unit: m/s^2}}"
        )
        time, channels, said = read(keys)
        assert said == []
        assert time[-1] == pytest.approx(300, abs=1)
        means[way] = (channels["gyro_x"].mean(), channels["accel_x"].mean())
    half = (means["up"][0] - means["down"][0]) / 2 * 3600
    assert abs(half) == pytest.approx(11.73, abs=0.01)
    assert abs(means["up"][1] - means["down"][1]) / 2 == pytest.approx(9.80, abs=0.03)


def test_both_records_of_the_ring_laser_as_one_recording() -> None:
    fields = "t: {at: 0, type: f64, little_endian: true}, gx: {at: 8, type: f64, little_endian: true}"
    keys = (
        "file: ln100/x_LN100_up.ins\ncontinued_by: ln100/x_LN100_down.ins\npause_between_files: 60 s\npauses: 30 s\n"
        f"sample_rate: 64 Hz\ntime: {{column: t}}\nformat: {{type: binary, length: 56, fields: {{{fields}}}}}\n"
        "channels: {gyro_x: {column: gx, unit: deg/s}}"
    )
    log = Findings()
    made = RecordOf(RecordingParameters).read(source.parse(f"kind: imu\n{keys}", "bench.yaml"), log)
    player = RecordingPlayer.open(made, [DATA / name for name in made.files], None, VirtualClock())
    means = []
    for index in range(2):
        segment = Segment(index, "up" if index == 0 else "down", None, "unknown", Rest(), None)
        means.append(np.concatenate([block.channels["gyro_x"] for block in player.stream(segment)]).mean())
    assert abs(means[0] - means[1]) / 2 * 3600 == pytest.approx(11.73, abs=0.01)


def test_frames_of_an_array_of_eight_units() -> None:
    """Against `struct`, one frame after the other."""
    axes = [f"{kind}{axis}{unit}" for unit in range(8) for kind in "ag" for axis in "xyz"]
    fields = ", ".join(f"{name}: {{at: {8 + 2 * k}, type: i16}}" for k, name in enumerate(axes))
    keys = (
        "file: imu_array/exp_1.bin\nsample_rate: 62.5 Hz\ntime: {column: clock, per_second: 64000000, wraps: 4294967296}\n"
        "format: {type: binary, skip: 4, sync: AA, length: 106, checksum: {type: sum16}, fields: "
        f"{{clock: {{at: 4, type: u32}}, {fields}}}}}\n"
        "channels: {gyro_z7: {column: gz7, unit: deg/s, per_unit: 16.4}, accel_x0: {column: ax0, unit: g, per_unit: 2048}}"
    )
    time, channels, _ = read(keys)
    raw = (DATA / "imu_array" / "exp_1.bin").read_bytes()[4:]
    whole = [raw[k : k + 106] for k in range(0, len(raw) - 105, 106)]
    good = [one for one in whole if one[0] == 0xAA and sum(one[:104]) == struct.unpack(">H", one[104:])[0]]
    assert len(time) == len(good)
    numbers = np.array([struct.unpack(">48h", one[8:104]) for one in good])
    np.testing.assert_array_equal(channels["gyro_z7"], numbers[:, 47] / 16.4)
    np.testing.assert_array_equal(channels["accel_x0"], numbers[:, 0] / 2048)
    steps = np.diff(time)
    assert np.median(steps) == pytest.approx(1 / 62.5, rel=1e-3)
    assert time[-1] > 2**32 / 64e6  # the clock wrapped


def test_text_aligned_with_blanks_and_without_a_header() -> None:
    keys = (
        "file: mikoff_mpu9150/imu1.log\nsample_rate: 100 Hz\ntime: sample_count\n"
        "format: {type: text, separator: blanks, names: [ax, ay, az, gx, gy, gz]}\n"
        "channels: {accel_x: {column: ax, unit: m/s^2}, accel_y: {column: ay, unit: m/s^2}, accel_z: {column: az, unit: m/s^2}}"
    )
    time, channels, said = read(keys)
    table = np.loadtxt(DATA / "mikoff_mpu9150" / "imu1.log")
    assert said == []
    assert len(time) == len(table)
    np.testing.assert_allclose(np.column_stack(list(channels.values())), table[:, :3], rtol=0, atol=1e-12)


def test_raw_counts_behind_four_lines_of_settings() -> None:
    keys = (
        "file: mpu6050_multi_position/imu_static_test.csv\nsample_rate: 100 Hz\ntime: sample_count\nformat: {type: text, skip: 4}\n"
        "channels: {gyro_x: {column: gx, unit: deg/s, per_unit: 131}, gyro_y: {column: gy, unit: deg/s, per_unit: 131}, "
        "gyro_z: {column: gz, unit: deg/s, per_unit: 131}}"
    )
    _, channels, _ = read(keys)
    means = [131 * values.mean() for values in channels.values()]
    assert means == pytest.approx([-427.5, 147.9, -80.7], abs=15)  # of the calibration, another recording of the unit


def test_matlab_files_of_two_units_and_an_encoder() -> None:
    """Yaw of unit 2 against the encoder: a factor of -1.006. The clock has bad steps, so rows are counted."""
    keys = (
        "file: two_imus_encoder/raw_yaw_slow.mat\nsample_rate: 100 Hz\ntime: sample_count\n"
        "channels: {gyro_z: {column: all_gyro_2_z, unit: deg/s}, encoder: {column: all_encoder, unit: deg}}"
    )
    time, channels, _ = read(keys)
    assert len(time) == 149_827
    rate = np.gradient(channels["encoder"], 0.01)
    smooth = np.ones(50) / 50
    turned, sensed = (np.convolve(one, smooth, "same") for one in (rate, channels["gyro_z"]))
    moving = np.abs(turned) > 2
    factor = np.polyfit(turned[moving], sensed[moving], 1)[0]
    assert factor == pytest.approx(-1.006, abs=0.03)


def test_matrices_of_a_matlab_file() -> None:
    keys = (
        "file: broad/04_undisturbed_slow_rotation_with_breaks_A.mat\nsample_rate: 285.7142857 Hz\ntime: sample_count\n"
        "channels: {accel_x: {column: 'imu_acc[1]', unit: m/s^2}, accel_y: {column: 'imu_acc[2]', unit: m/s^2}, "
        "accel_z: {column: 'imu_acc[3]', unit: m/s^2}}"
    )
    _, channels, _ = read(keys)
    norm = np.sqrt(sum(values[:2000] ** 2 for values in channels.values()))
    assert 9.83 - 0.02 < np.median(norm) < 9.87 + 0.02
