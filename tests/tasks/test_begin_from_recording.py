"""What `planrunner new --from-recording` makes of files: synthetic ones, whose truth is known, and the real ones of other people."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from planrunner.cli import main
from planrunner.reporting import recording_picture
from tests.recording_pictures import check_picture

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


NOT_DRAWN = "<svg/>"


@pytest.fixture
def drawn() -> None:
    """The fast suite draws the recordings of the tests that use this fixture: drawing takes as long as all else."""


@pytest.fixture(autouse=True, params=["some", pytest.param("all", marks=pytest.mark.slow)])
def drawing(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recordings with `drawn` are drawn, and as slow tests all recordings."""
    if request.param == "some" and "drawn" not in request.fixturenames:
        monkeypatch.setattr(recording_picture, "recording_picture", lambda look: NOT_DRAWN)


def begun(recording: Path, *more: str, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    """What the command says of a recording, after a check of what it wrote."""
    plan = recording.parent / "begun.yaml"
    assert main(["new", "--from-recording", str(recording), str(plan), *more, "--json"]) == 0, capsys.readouterr().err
    said: dict[str, object] = json.loads(capsys.readouterr().out)
    svg = (recording.parent / "begun.svg").read_text(encoding="utf-8")
    if svg != NOT_DRAWN:
        check_picture(svg, [one["channel"] for one in said["channels"]])  # type: ignore[attr-defined]
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


@pytest.mark.usefixtures("drawn")
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


@pytest.mark.usefixtures("drawn")
def test_pauses_are_pointed_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = np.concatenate([300.0 * k + np.arange(500) / 50 for k in range(4)])
    omega = np.random.default_rng(4).normal(0.1, 0.02, 2000)
    np.savez(tmp_path / "bursts.npz", time=time, omega_z=omega)
    begun(tmp_path / "bursts.npz", capsys=capsys)
    bench = (tmp_path / "begun.bench.yaml").read_text()
    assert "in 3 places: each piece is a segment.\n    pauses: 145 s\n" in bench


def test_bursts_at_equal_intervals_have_one_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bursts of 5 s: every tenth window contains a pause of the same length."""
    time = np.concatenate([300.0 * k + np.arange(260) / 50 for k in range(25)])
    omega = np.random.default_rng(4).normal(0.1, 0.02, len(time))
    np.savez(tmp_path / "bursts.npz", time=time, omega_z=omega)
    begun(tmp_path / "bursts.npz", capsys=capsys)
    assert "The rate changes" not in (tmp_path / "begun.bench.yaml").read_text()


def test_the_interval_of_a_slow_recording_is_no_pause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sample every ten seconds, and one pause of five minutes."""
    time = 10.0 * np.arange(400) + 300.0 * (np.arange(400) >= 200)
    omega = np.random.default_rng(4).normal(0.1, 0.02, 400)
    table = np.column_stack([time, omega])
    np.savetxt(tmp_path / "slow.csv", table, delimiter=",", header="time_s,omega_z", comments="")
    begun(tmp_path / "slow.csv", capsys=capsys)
    assert "by 310 s or more in 1 place." in (tmp_path / "begun.bench.yaml").read_text()


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


def turned(rate: float = 100.0) -> tuple[Array, Array, Array]:
    """Time, gyro [rad/s] and accelerometer [m/s^2] of a unit that rests 4 s in each of 12 attitudes and turns between them, from
    the quaternions of its attitude: gravity follows its gyros. The biases are 0.3 deg/s and 0.1 m/s^2."""
    draw = np.random.default_rng(3)
    attitudes = Rotation.random(12, random_state=5)
    rest, turn = round(4 * rate), round(1.4 * rate)
    quaternion, omega = [], []
    for here, there in itertools.pairwise(attitudes):
        way = (here.inv() * there).as_rotvec()
        s = (np.arange(turn) + 0.5) / turn
        quaternion += [
            np.tile(here.as_quat(), (rest, 1)),
            (here * Rotation.from_rotvec(np.outer(s * s * (3 - 2 * s), way))).as_quat(),
        ]
        omega += [np.zeros((rest, 3)), np.outer(6 * s * (1 - s) * rate / turn, way)]
    gyro = np.concatenate(omega)
    accel = Rotation.from_quat(np.concatenate(quaternion)).inv().apply([0, 0, 9.81])
    gyro += np.radians(0.3) + draw.normal(0, 0.002, gyro.shape)
    return np.arange(len(gyro)) / rate, gyro, accel + 0.1 + draw.normal(0, 0.01, accel.shape)


def csv(file: Path, header: str, *columns: Array, before: str = "", form: str = "%.6f") -> Path:
    """A text file with one row for each sample; NaN becomes an empty field."""
    rows = [",".join("" if np.isnan(x) else form % x for x in row) for row in np.column_stack(columns).tolist()]
    file.write_text("\n".join([f"{before}{header}", *rows, ""]), encoding="utf-8")
    return file


def units(said: dict[str, object]) -> dict[str, str]:
    return {one["channel"]: one["unit"] for one in said["channels"]}  # type: ignore[attr-defined]


NAMES = "time,gx,gy,gz,ax,ay,az"


@pytest.mark.parametrize(("unit", "factor"), [("rad/s", 1.0), ("deg/s", 180 / np.pi), ("deg/h", 3600 * 180 / np.pi)])
def test_the_turns_show_the_unit_of_the_gyros(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: str, factor: float
) -> None:
    """A wrong value of -999 in one gyro does not change what the turns show."""
    time, gyro, accel = turned()
    gyro *= factor
    gyro[700:703] = -999
    said = begun(csv(tmp_path / "r.csv", NAMES, time, gyro, accel), capsys=capsys)
    assert {units(said)[f"gyro_{axis}"] for axis in "xyz"} == {unit}
    bench = (tmp_path / "begun.bench.yaml").read_text()
    assert bench.count("the unit was determined from the turns") == 3 and "different axes" not in bench


@pytest.mark.parametrize(
    ("order", "signs", "note"),
    [
        ((0, 1, 2), (1, -1, 1), "gyro_x turns about -x, gyro_y turns about y, gyro_z turns about -z"),
        ((1, 0, 2), (1, 1, 1), "gyro_x turns about -y, gyro_y turns about -x, gyro_z turns about -z"),
    ],
)
def test_a_left_handed_triad_is_pointed_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], order: list[int], signs: list[int], note: str
) -> None:
    """The accelerometers are exchanged or reversed; a turn is a pseudovector, so that the other gyros appear reversed."""
    time, gyro, accel = turned()
    begun(csv(tmp_path / "r.csv", NAMES, time, gyro, accel[:, list(order)] * signs), capsys=capsys)
    assert note in (tmp_path / "begun.bench.yaml").read_text()


def test_nothing_is_said_of_axes_that_the_motion_does_not_show(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The gyros of `tumbled` have nothing to do with its accelerometers."""
    time, gyro, accel = tumbled()
    begun(csv(tmp_path / "r.csv", NAMES, time, gyro, accel), capsys=capsys)
    assert "axes" not in (tmp_path / "begun.bench.yaml").read_text()


@pytest.mark.usefixtures("drawn")
def test_rows_of_slower_instruments_are_set_aside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A log of three messages: every tenth row is one of the thermometer, with the fields of the others empty."""
    time, gyro, accel = turned()
    full = np.column_stack([time, gyro, accel, np.full(len(time), np.nan)])
    slow = np.full((len(time) // 10, 8), np.nan)
    slow[:, 0], slow[:, 7] = time[3::10][: len(slow)] + 0.0003, 25.0 + 0.01 * np.arange(len(slow))
    table = np.concatenate([full, slow])
    said = begun(csv(tmp_path / "r.csv", f"{NAMES},baro_temp", *table[np.argsort(table[:, 0])].T), capsys=capsys)
    assert said["sample_rate_hz"] == pytest.approx(100, rel=0.01)
    assert "temperature" not in units(said) and units(said)["accel_x"] == "m/s^2"
    assert len(said["still_s"]) >= 11  # type: ignore[arg-type]
    assert "from a slower instrument: baro_temp" in (tmp_path / "begun.bench.yaml").read_text()


def test_small_counts_are_not_milli_g(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """800 counts are 1 g, as in the 16-bit registers of an ADIS16470; the gyros of the same registers are counts as well."""
    time, gyro, accel = turned()
    said = begun(
        csv(tmp_path / "r.csv", NAMES, time, gyro * 573, accel * 800 / 9.81, form="%.0f"),
        "--sample-rate",
        "100 Hz",
        capsys=capsys,
    )
    assert all(one["counts"] for one in said["channels"])  # type: ignore[attr-defined]
    assert said["channels"][3]["noise"] == pytest.approx(0.01 / 9.81, rel=0.2)  # type: ignore[index]


@pytest.mark.parametrize(
    ("header", "before", "start", "per_row", "expected"),
    [
        ("tick_ms", "", 60_000, 10, {"column": "tick_ms", "unit": "ms", "wraps": 65536}),
        ("SampleTimeFine", "", 7_000, 100, {"column": "SampleTimeFine", "per_second": 10_000}),
        ("clock", "// Sample rate: 100.0Hz\n", 7_000, 168, {"column": "clock", "per_second": 16_800}),
        ("clock", "# update frequency = 0.1 kHz\n", 7_000, 10, {"column": "clock", "unit": "ms"}),
    ],
)
def test_counters_are_times(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    header: str,
    before: str,
    start: int,
    per_row: int,
    expected: dict[str, object],
) -> None:
    time, gyro, accel = turned()
    count = start + per_row * np.arange(float(len(time)))
    wraps = expected.get("wraps")
    count = count if wraps is None else count % 65536
    file = csv(tmp_path / "r.csv", NAMES.replace("time", header), count, gyro, accel, before=before)
    said = begun(file, capsys=capsys)
    assert said["time"] == expected
    assert said["sample_rate_hz"] == pytest.approx(100)
    assert said["still_s"][-1][0] == pytest.approx(54.0, abs=1)  # type: ignore[index]


def test_the_unit_of_a_time_without_a_name_is_called_a_guess(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time, gyro, accel = turned()
    begun(csv(tmp_path / "r.csv", NAMES, 1000 * time, gyro, accel), capsys=capsys)
    assert "unit: ms} # the unit is a guess from the size of the steps" in (tmp_path / "begun.bench.yaml").read_text()


@pytest.mark.parametrize(
    ("before", "per_row", "unit", "doubt"),
    [
        ("# MPU-6050, filter cutoff frequency: 42 Hz\n# device 7\n", 0.01, "s", True),
        ("# GNSS update rate: 4 Hz\n# IMU output data rate: 100 Hz\n", 0.01, "s", False),
        ("# magnetometer rate 20 Hz\n", 10, "ms", True),
        ("# heartbeat rate: 4 Hz\n# sample rate: 100 Hz\n", 10, "ms", False),
        ("# sampling rate: 50 Hz\n", 10, "ms", True),
        ("# heartbeat rate: 3 Hz\n", 10, "ms", True),
        ("# sample rate: 5 Hz\n", 0.01, "s", True),
    ],
)
def test_a_stated_rate_counts_only_if_a_unit_of_time_confirms_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], before: str, per_row: float, unit: str, doubt: bool
) -> None:
    """The header states rates of filters, other instruments, or a wrong sample rate; the rows are 10 ms apart."""
    _, gyro, accel = turned()
    count = per_row * np.arange(float(len(gyro)))
    said = begun(csv(tmp_path / "r.csv", NAMES.replace("time", "t"), count, gyro, accel, before=before), capsys=capsys)
    assert said["time"] == {"column": "t", "unit": unit}
    assert said["sample_rate_hz"] == pytest.approx(100)
    assert ("the unit is a guess" in (tmp_path / "begun.bench.yaml").read_text().split("channels:")[0]) == doubt


def test_a_counter_that_only_the_header_explains_is_called_a_guess(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, gyro, accel = turned()
    count = 168 * np.arange(float(len(gyro)))
    file = csv(tmp_path / "r.csv", NAMES.replace("time", "t"), count, gyro, accel, before="// Sample rate:\t100.0Hz\n")
    begun(file, capsys=capsys)
    line = "per_second: 16800} # guessed from the header line '// Sample rate:100.0Hz'"
    assert line in (tmp_path / "begun.bench.yaml").read_text()


def _exchanged(count: Array) -> None:
    count[[70_000, 70_001]] = count[[70_001, 70_000]]


def _repeated(count: Array) -> None:
    count[70_001] = count[70_000]


def _exchanged_at_zero(count: Array) -> None:
    k = int(np.flatnonzero(np.diff(count) < 0)[-1])
    count[[k, k + 1]] = count[[k + 1, k]]


@pytest.mark.parametrize("spoil", [_exchanged, _repeated, _exchanged_at_zero])
def test_a_step_back_is_no_return_of_a_counter_to_zero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[[Array], None]
) -> None:
    """A counter of ms with 16 bits, which returns to zero 12 times in 800 s. Long after the first return, two rows are exchanged, or
    one time is repeated."""
    draw = np.random.default_rng(4)
    count = 10 * np.arange(80_000.0) % 65536
    spoil(count)
    table = np.zeros(len(count), [("tick_ms", "f8"), ("gyro", "f8", 3), ("acc", "f8", 3)])
    table["tick_ms"] = count
    table["gyro"], table["acc"] = draw.normal(0, 0.1, (80_000, 3)), draw.normal([0, 0, 9.81], 0.01, (80_000, 3))
    np.save(tmp_path / "r.npy", table)
    said = begun(tmp_path / "r.npy", capsys=capsys)
    assert said["time"] is None and said["sample_rate_hz"] == pytest.approx(100)
    assert said["still_s"][-1][-1] == pytest.approx(800, abs=1)  # type: ignore[index]
    bench = (tmp_path / "begun.bench.yaml").read_text()
    assert "time: sample_count # in 1 row the time of the file does not increase" in bench and "pauses" not in bench


@pytest.mark.usefixtures("drawn")
def test_windows_without_numbers_have_no_scatter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A unit at rest whose accelerometers have numbers in 12 of 20 seconds."""
    time, draw = np.arange(10_000) / 100, np.random.default_rng(4)
    gyro, accel = draw.normal(0, 0.002, (10_000, 3)), draw.normal([0, 0, 9.81], 0.01, (10_000, 3))
    accel[(time % 20) >= 12] = np.nan
    said = begun(csv(tmp_path / "r.csv", NAMES, time, gyro, accel), capsys=capsys)
    assert len(said["still_s"]) == 5  # type: ignore[arg-type]
    noise = {one["channel"]: one["noise"] for one in said["channels"]}  # type: ignore[attr-defined]
    assert noise["accel_x"] == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize(
    ("level", "unit", "counts"),
    [(9.81, "m/s^2", False), (-1.15, "g", False), (9.81 * 0.8, "m/s^2", False), (16384, "g", True)],
)
def test_a_single_accelerometer_along_the_vertical_shows_its_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], level: float, unit: str, counts: bool
) -> None:
    time, gyro, _ = turned()
    acc = level + np.random.default_rng(3).normal(0, 0.01, len(time))
    said = begun(csv(tmp_path / "r.csv", "time_s,acc_x,gyro_x", time, acc, gyro[:, 0] * 0), capsys=capsys)
    one = next(one for one in said["channels"] if one["channel"] == "accel_x")  # type: ignore[attr-defined]
    assert (one["unit"], one["counts"]) == (unit, counts)


def test_the_second_rate_does_not_begin_at_a_shorter_first_interval(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time, gyro, accel = turned()
    kept = np.concatenate([np.arange(0, 100, 2), np.arange(100, 3000), np.arange(3000, len(time), 2)])
    begun(csv(tmp_path / "r.csv", NAMES, time[kept], gyro[kept], accel[kept]), capsys=capsys)
    assert "about 50 Hz from 30 s" in (tmp_path / "begun.bench.yaml").read_text()


def test_a_rate_that_changes_is_pointed_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = turned()
    kept = np.concatenate([np.arange(3000), np.arange(3000, len(time), 2)])
    said = begun(csv(tmp_path / "r.csv", NAMES, time[kept], gyro[kept], accel[kept]), capsys=capsys)
    assert "The rate changes: about 50 Hz from 30 s" in (tmp_path / "begun.bench.yaml").read_text()
    assert said["still_s"][-1][0] == pytest.approx(54.0, abs=1.1)  # type: ignore[index]


@pytest.mark.usefixtures("drawn")
def test_a_dead_channel_is_pointed_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = turned()
    gyro[:, 1] = 0
    begun(csv(tmp_path / "r.csv", NAMES, time, gyro, accel), capsys=capsys)
    lines = (tmp_path / "begun.bench.yaml").read_text().splitlines()
    assert [line.split(":")[0].strip() for line in lines if "never changes" in line] == ["gyro_y"]


@pytest.mark.usefixtures("drawn")
def test_columns_named_by_their_axis_keep_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, _, accel = turned()
    said = begun(csv(tmp_path / "r.csv", "seconds,z,y,x", time, accel[:, ::-1]), capsys=capsys)
    assert {one["channel"]: one["column"] for one in said["channels"]} == {  # type: ignore[attr-defined]
        f"accel_{axis}": axis for axis in "xyz"
    }


def test_quoted_numbers_and_a_comma_at_the_end_of_each_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = turned()
    rows = [",".join(f'"{x:.6f}"' for x in row) for row in np.column_stack([time, gyro, accel]).tolist()]
    text = "\r\n".join(["Time (s),Gyr X,Gyr Y,Gyr Z,Acc X,Acc Y,Acc Z,", *(f"{row}," for row in rows), ""])
    (tmp_path / "r.csv").write_text(text, encoding="utf-8-sig", newline="")
    said = begun(tmp_path / "r.csv", capsys=capsys)
    assert len(units(said)) == 6 and said["time"] == {"column": "Time (s)", "unit": "s"}


def test_comments_and_an_unfinished_line_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = turned()
    file = csv(tmp_path / "r.csv", NAMES, time, gyro, accel)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:900], "# sync lost", *lines[900:], "61.6,0.01,"]))
    said = begun(file, capsys=capsys)
    assert said["rows"] == len(time)
    assert main(["check", str(tmp_path / "begun.yaml"), "--data", str(tmp_path)]) == 0
    assert (
        "2 lines with a different number of columns from the header, such as '# sync lost'" in capsys.readouterr().err
    )


def test_vectors_in_a_table_of_numpy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = turned()
    table = np.zeros(len(time), [("t", "f8"), ("gyro", "f4", 3), ("acc", "f4", 3)])
    table["t"], table["gyro"], table["acc"] = time, gyro, accel
    np.save(tmp_path / "r.npy", table)
    said = begun(tmp_path / "r.npy", capsys=capsys)
    assert said["rows"] == len(time)
    columns = {one["column"] for one in said["channels"]}  # type: ignore[attr-defined]
    assert columns == {f"{name}[{k}]" for name in ("gyro", "acc") for k in (1, 2, 3)}


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


def test_counts_that_hide_all_noise_give_a_threshold_above_zero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Accelerations rounded to 1 m/s^2: no reading changes at rest, so the threshold cannot follow from the scatter. `check` refuses
    a threshold of zero."""
    _, gyro, accel = tumbled()
    head = "gyro_x_rad/s,gyro_y_rad/s,gyro_z_rad/s,accel_x_m/s^2,accel_y_m/s^2,accel_z_m/s^2"
    samples = np.column_stack([gyro, np.round(accel)])
    np.savetxt(tmp_path / "coarse.csv", samples, "%.6f", ",", header=head, comments="")
    plan = tmp_path / "coarse.yaml"
    new = ["new", "--from-recording", str(tmp_path / "coarse.csv"), str(plan), "--sample-rate", f"{RATE} Hz"]
    assert main(new) == 0, capsys.readouterr().err
    assert "threshold: 1e-06 m/s^2" in plan.read_text(encoding="utf-8")
    main(["check", str(plan)])
    assert "meaning-range" not in "".join(capsys.readouterr())


def test_short_pieces_with_long_pauses_become_segments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Twelve pieces of 20 s in an hour; the biases drift from piece to piece, which is no motion of a rate table. The gyros are in
    deg/s, as their noise shows."""
    draw = np.random.default_rng(9)
    time = np.arange(36_000) / 10
    time = time[time % 300 < 20]
    gyro = np.outer(time / 1000, [0.2, -0.1, 0.05]) + draw.normal(0, 0.02, (len(time), 3))
    accel = np.array([0, 0, 9.81]) + draw.normal(0, 0.004, gyro.shape)
    said = begun(csv(tmp_path / "r.csv", NAMES, time, gyro, accel), capsys=capsys)
    assert units(said)["gyro_x"] == "deg/s"
    bench, plan = (tmp_path / "begun.bench.yaml").read_text(), (tmp_path / "begun.yaml").read_text()
    assert "\n    pauses: 140 s\n" in bench and "stretches" not in bench
    assert '{label: "part_{repeat}", repeat: 12, orientation: unknown, dwell: recorded}' in plan
    assert main(["check", str(tmp_path / "begun.yaml"), "--data", str(tmp_path)]) == 0, capsys.readouterr().err


@pytest.mark.usefixtures("drawn")
def test_a_slow_recording_at_rest_is_at_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At 10 Hz, half a second contains five samples."""
    draw = np.random.default_rng(10)
    gyro = draw.normal(0, 2e-4, (12_000, 3))
    accel = np.array([0, 0, 9.81]) + draw.normal(0, 0.004, gyro.shape)
    said = begun(csv(tmp_path / "r.csv", NAMES, np.arange(12_000) / 10, gyro, accel), capsys=capsys)
    assert units(said)["gyro_x"] == "rad/s"
    assert sum(end - begin for begin, end in said["still_s"]) > 1100  # type: ignore[attr-defined]
    assert "allan_deviation" in (tmp_path / "begun.yaml").read_text()


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (
            "t[s],wx[dps],wy[dps],wz[dps],ax[g],ay[g],az[g]",
            "name the unit g, but their vector at rest has the length of gravity in m/s^2",
        ),
        ("t[ms],wx,wy,wz,ax,ay,az", "the unit leads to an unusual sample rate: check it"),
    ],
)
def test_units_in_names_that_the_numbers_contradict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], header: str, words: str
) -> None:
    time, gyro, accel = turned()
    assert (
        main(
            [
                "new",
                "--from-recording",
                str(csv(tmp_path / "r.csv", header, time, gyro, accel)),
                str(tmp_path / "b.yaml"),
            ]
        )
        == 0
    )
    assert words in " ".join(capsys.readouterr().out.split())


def test_names_in_two_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, gyro, accel = turned()
    file = csv(tmp_path / "r.csv", "s,X,Y,Z,X,Y,Z", time, gyro, accel, before="Time,Gyroscope,,,Accelerometer,,\n")
    said = begun(file, capsys=capsys)
    assert units(said) == {**{f"gyro_{x}": "rad/s" for x in "xyz"}, **{f"accel_{x}": "m/s^2" for x in "xyz"}}
    assert main(["check", str(tmp_path / "begun.yaml"), "--data", str(tmp_path)]) == 0, capsys.readouterr().err


def test_rest_in_two_orientations_gets_no_allan_deviation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The accelerometers change by 2 g from the first to the second half, which is no noise."""
    draw = np.random.default_rng(11)
    time = np.arange(12_000) / 100 + 60.0 * (np.arange(12_000) >= 6000)
    accel = np.outer(np.where(time < 60, 9.81, -9.81), [1, 0, 0]) + draw.normal(0, 0.004, (12_000, 3))
    begun(csv(tmp_path / "r.csv", NAMES, time, draw.normal(0, 2e-4, accel.shape), accel), capsys=capsys)
    assert "allan_deviation" not in (tmp_path / "begun.yaml").read_text()
