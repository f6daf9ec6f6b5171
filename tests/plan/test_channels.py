"""Channels that estimates name: what the bench's sensor does not have is told by the check, at the entry, for every estimator."""

from __future__ import annotations

from pathlib import Path

import pytest

from planrunner.base.findings import Finding
from planrunner.tasks.check import check_plan

from ..conftest import ROOT

IMU = "imu_multi_position.yaml"
NAVIGATION = "rotation_stop_navigation.yaml"
ROCKING = "platform_rocking.yaml"
TEMPERATURE = "imu_over_temperature.yaml"
TILTED = "scale_factor_tilted.yaml"


def errors_of(folder: Path, plan: str, old: str, new: str) -> tuple[str, list[Finding]]:
    text = (ROOT / "plans" / plan).read_text(encoding="utf-8")
    assert old in text
    path = folder / plan
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path.read_text(encoding="utf-8"), check_plan(path).findings.errors


@pytest.mark.parametrize(
    ("plan", "old", "new", "wrong", "closest"),
    [
        (IMU, "[gyro_x, gyro_y, gyro_z]", "[gyro_x, gyro_y, giro_z]", "giro_z", "gyro_z"),
        (IMU, "[accel_x, accel_y, accel_z]", "[acel_x, accel_y, accel_z]", "acel_x", "accel_x"),
        (NAVIGATION, "at-rest],", "at-rest], gyros: [gyro_x, gyro_q, gyro_z],", "gyro_q", "gyro_"),
        (ROCKING, "estimator: rocking_drift", "estimator: rocking_drift\n    rings: [tabel_outer]", "tabel_", "table_"),
        (
            ROCKING,
            "estimator: rocking_drift",
            "estimator: rocking_drift\n    gimbals: [gimbal_outer, gimbal_midle, gimbal_inner]",
            "gimbal_midle",
            "gimbal_middle",
        ),
        (TEMPERATURE, "temperature_channel: sensor_", "temperature_channel: sensr_", "sensr_", "sensor_temperature"),
        (TEMPERATURE, "channels: [gyro_x, gyro_y,", "channels: [gyro_x, gyroy,", "gyroy", "gyro_y"),
        (
            TILTED,
            "estimator: scale_factor_tilted",
            "estimator: scale_factor_tilted\n    temperature: thermometer",
            "thermometer",
            "known here",
        ),
    ],
)
def test_a_channel_that_the_sensor_lacks_is_reported_at_its_place(
    tmp_path: Path, plan: str, old: str, new: str, wrong: str, closest: str
) -> None:
    text, found = errors_of(tmp_path, plan, old, new)
    (error,) = [one for one in found if one.code == "meaning-sensor-output"]
    assert closest in error.hint
    line = text.splitlines()[error.mark.line - 1]
    assert line[error.mark.column - 1 :].startswith(wrong)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[gyro_x, gyro_y, gyro_z]", "[gyro_x, gyro_x, gyro_z]"),
        ("[accel_x, accel_y, accel_z]", "[gyro_x, accel_y, accel_z]"),
    ],
)
def test_a_channel_named_twice_is_refused_within_a_triad_and_between_triads(tmp_path: Path, old: str, new: str) -> None:
    _, found = errors_of(tmp_path, IMU, old, new)
    (error,) = found
    assert error.code == "meaning-channel-twice"
    assert "gyro_x" in error.message


def test_a_replayed_recording_may_hold_channels_that_its_bench_does_not_name(tmp_path: Path) -> None:
    _, found = errors_of(tmp_path, "rimu_pitch_tumble.yaml", "    outputs: [lsm_accel_x,", "    outputs: [other,")
    assert "meaning-sensor-output" not in [one.code for one in found]
