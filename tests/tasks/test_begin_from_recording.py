"""What `planrunner new --from-recording` makes of files: synthetic ones, whose truth is known, and the real ones of other people."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from planrunner.cli import main

DATA = Path(os.environ.get("PLANRUNNER_DATA", Path(__file__).parents[3] / "shared" / "data"))
real_data = pytest.mark.skipif(
    not (DATA / "broad").is_dir(), reason="the real recordings are not there (PLANRUNNER_DATA)"
)
RATE = 50.0
Array = NDArray[np.float64]


def tumbled(noise: float = 0.01) -> tuple[Array, Array, Array]:
    """Time, gyro [rad/s] and accelerometer [m/s^2] of a unit that rests 5 s in each of 12 directions and turns for 1 s between them."""
    draw = np.random.default_rng(8)
    directions = draw.normal(size=(12, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
    rest, turn = round(5 * RATE), round(RATE)
    accel, gyro = [], []
    for here, there in zip(directions, np.roll(directions, -1, axis=0), strict=True):
        way = np.linspace(0, 1, turn)[:, np.newaxis]
        accel += [np.tile(here, (rest, 1)), here * (1 - way) + there * way]
        gyro += [np.zeros((rest, 3)), np.tile(draw.normal(0, 1.5, 3), (turn, 1))]
    a, g = 9.81 * np.concatenate(accel), np.concatenate(gyro)
    time = np.arange(len(a)) / RATE
    return time, g + draw.normal(0, noise / 10, g.shape), a + draw.normal(0, noise, a.shape)


def begun(recording: Path, *more: str, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    """What the command says of a recording, after a check of what it wrote."""
    plan = recording.parent / "begun.yaml"
    assert main(["new", "--from-recording", str(recording), str(plan), *more, "--json"]) == 0, capsys.readouterr().err
    said: dict[str, object] = json.loads(capsys.readouterr().out)
    assert (recording.parent / "begun.svg").read_text(encoding="utf-8").startswith("<svg")
    assert main(["check", str(plan), "--data", str(recording.parent)]) == 0, capsys.readouterr().err
    capsys.readouterr()
    return said


def test_a_text_without_names_is_recognised_by_the_length_of_gravity(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, gyro, accel = tumbled()
    np.savetxt(tmp_path / "session.log", np.column_stack([gyro, accel]), fmt="%12.6f")
    said = begun(tmp_path / "session.log", "--sample-rate", f"{RATE} Hz", capsys=capsys)
    assert said["time"] is None
    found = [(one["channel"], one["column"], one["unit"]) for one in said["channels"]]  # type: ignore[attr-defined]
    kinds = [("accel", "m/s^2", 4), ("gyro", "rad/s", 1)]
    assert sorted(found) == sorted(
        (f"{kind}_{axis}", f"column_{first + k}", unit) for kind, unit, first in kinds for k, axis in enumerate("xyz")
    )
    assert len(said["still_s"]) == 12  # type: ignore[arg-type]
    plan = (tmp_path / "begun.yaml").read_text(encoding="utf-8")
    assert "gravity_magnitude" in plan and "diagnosis:" in plan
    recording = str(tmp_path / "session.log")
    assert main(["diagnose", str(tmp_path / "begun.yaml"), "--recording", recording]) == 0, capsys.readouterr().err
    capsys.readouterr()


def test_names_units_and_the_time_of_a_header(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = tumbled()
    table = np.column_stack(
        [np.arange(len(time)), 1000 * time, np.degrees(gyro), accel / 9.81, np.full(len(time), 23.5)]
    )
    header = "n;t_ms;gyr_x_dps;gyr_y_dps;gyr_z_dps;acc_x_g;acc_y_g;acc_z_g;temperature_degC"
    lines = ["# logger 7", header, *(";".join(f"{value:.6f}".replace(".", ",") for value in row) for row in table)]
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="latin-1")
    said = begun(tmp_path / "log.csv", capsys=capsys)
    assert said["time"] == {"column": "t_ms", "unit": "ms"}
    assert said["sample_rate_hz"] == pytest.approx(RATE)
    units = {one["channel"]: one["unit"] for one in said["channels"]}  # type: ignore[attr-defined]
    assert units == {
        **{f"gyro_{axis}": "deg/s" for axis in "xyz"},
        **{f"accel_{axis}": "g" for axis in "xyz"},
        "temperature": "degC",
    }
    noise = {one["channel"]: one["noise"] for one in said["channels"]}  # type: ignore[attr-defined]
    assert noise["accel_y"] == pytest.approx(0.01 / 9.81, rel=0.2)
    assert said["other_columns"] == ["n"]


def test_raw_counts_of_a_matrix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, gyro, accel = tumbled()
    savemat(tmp_path / "raw.mat", {"acc": (accel / 9.81 * 16384).round(), "gyr": (np.degrees(gyro) * 131).round()})
    said = begun(tmp_path / "raw.mat", "--sample-rate", "50 Hz", capsys=capsys)
    assert all(one["counts"] for one in said["channels"])  # type: ignore[attr-defined]
    assert "per_unit: 163" in (tmp_path / "begun.bench.yaml").read_text(encoding="utf-8")


def test_a_recording_at_rest_gets_an_allan_deviation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw = np.random.default_rng(4)
    np.savez(tmp_path / "rest.npz", time=np.arange(20_000) / 200, omega_z=draw.normal(0.1, 0.02, 20_000))
    said = begun(tmp_path / "rest.npz", capsys=capsys)
    assert said["sample_rate_hz"] == pytest.approx(200)
    assert "allan_deviation" in (tmp_path / "begun.yaml").read_text(encoding="utf-8")


def test_a_clock_that_repeats_itself_is_not_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows with the time of the row before; the mean interval, 10.1 ms, is longer than the usual one."""
    draw = np.random.default_rng(4)
    steps = np.where(np.arange(5000) % 100 == 50, 0.02, 0.01)
    time = np.cumsum(steps)
    time[[700, 1800]] = time[[699, 1799]]
    np.savez(tmp_path / "jitter.npz", time=time, omega_z=draw.normal(0.1, 0.02, 5000))
    said = begun(tmp_path / "jitter.npz", capsys=capsys)
    assert said["time"] is None
    assert said["sample_rate_hz"] == pytest.approx(100 / 1.01, rel=1e-3)
    assert "in 2 rows the time of the file does not increase" in (tmp_path / "begun.bench.yaml").read_text()


def test_pauses_are_pointed_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = np.concatenate([300.0 * k + np.arange(500) / 50 for k in range(4)])
    omega = np.random.default_rng(4).normal(0.1, 0.02, 2000)
    np.savez(tmp_path / "bursts.npz", time=time, omega_z=omega)
    begun(tmp_path / "bursts.npz", capsys=capsys)
    assert "in 3 places. To make each piece a segment: pauses: 145 s" in (tmp_path / "begun.bench.yaml").read_text()


def test_the_interval_of_a_slow_recording_is_no_pause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sample every ten seconds, and one pause of five minutes."""
    time = 10.0 * np.arange(400) + 300.0 * (np.arange(400) >= 200)
    omega = np.random.default_rng(4).normal(0.1, 0.02, 400)
    table = np.column_stack([time, omega])
    np.savetxt(tmp_path / "slow.csv", table, delimiter=",", header="time_s,omega_z", comments="")
    begun(tmp_path / "slow.csv", capsys=capsys)
    assert "by 310 s and more in 1 place." in (tmp_path / "begun.bench.yaml").read_text()


def test_a_unit_that_swings_all_the_time_is_not_at_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its gyro scatters alike in all windows; no Allan deviation of a motion is proposed."""
    draw = np.random.default_rng(4)
    time = np.arange(6000) / 100
    rate = 60 * np.sin(2 * np.pi * 0.2 * time) + draw.normal(0, 0.1, 6000)
    np.savez(tmp_path / "swing.npz", time=time, omega_z=rate)
    said = begun(tmp_path / "swing.npz", capsys=capsys)
    assert said["still_s"] == []
    assert "allan_deviation" not in (tmp_path / "begun.yaml").read_text()
    assert "noise:" not in (tmp_path / "begun.bench.yaml").read_text()


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda path: path.write_bytes(bytes(range(256)) * 9), "is not a text file"),
        (lambda path: path.write_text("a;b\nx;y\n"), "has no lines of numbers"),
        (
            lambda path: path.write_text("t,u\n" + "\n".join(f"{k},{k}" for k in range(50))),
            "no column looks like a gyro",
        ),
        (
            lambda path: path.write_text("gx,gy\n" + "\n".join("1,2" for _ in range(50))),
            "looks like a time that increases",
        ),
    ],
)
def test_what_cannot_be_guessed_is_said_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Callable[[Path], object], said: str
) -> None:
    write(tmp_path / "r.log")
    plan = tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(tmp_path / "r.log"), str(plan)]) == 2
    assert said in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.log"]


def test_files_that_exist_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "r.npy", np.zeros((9, 3)))
    (tmp_path / "begun.bench.yaml").write_text("mine", encoding="utf-8")
    assert main(["new", "--from-recording", str(tmp_path / "r.npy"), str(tmp_path / "begun.yaml")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "begun.bench.yaml").read_text(encoding="utf-8") == "mine"


REAL = {
    "mikoff_mpu9150/imu1.log": ("100 Hz", "gravity_magnitude"),
    "mikoff_mpu9150/imu0.parquet": (None, "gravity_magnitude"),
    "mpu6050_multi_position/imu_static_test.csv": ("100 Hz", "allan_deviation"),
    "ferraris/example_ferraris_session.csv": ("102.4 Hz", "docs/plan-language.md"),
    "broad/04_undisturbed_slow_rotation_with_breaks_A.mat": ("285.714 Hz", "docs/plan-language.md"),
    "psim_thermal_vacuum/TVCtest3_7_20.csv": (None, "allan_deviation"),
    "rimu_jig/rate_staircase.parquet": (None, "docs/plan-language.md"),
    "two_imus_encoder/raw_yaw_medium.mat": (None, "docs/plan-language.md"),
}


@real_data
@pytest.mark.parametrize("name", REAL)
def test_real_recordings_get_a_plan_that_passes_its_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    rate, estimator = REAL[name]
    given = [] if rate is None else ["--sample-rate", rate]
    plan = tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(DATA / name), str(plan), *given]) == 0, capsys.readouterr().err
    assert estimator in plan.read_text(encoding="utf-8")
    assert main(["check", str(plan), "--data", str((DATA / name).parent)]) == 0, capsys.readouterr().err
