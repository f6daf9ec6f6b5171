"""Recordings without any noise, as a simulation of another house or a hand-worked example gives them: every shipped kind of plan runs to
its end on them and finds what was written.

The files are written here, kinematics by hand; readings are means over their interval, which is all that a level turn needs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.cli import main
from planrunner.cli.exit_codes import DONE
from tests.directions import WORDS

PLANS = Path(__file__).parents[2] / "plans"
EARTH = 15.041067 / 3600  # deg/s
G = 9.80665


@dataclass(frozen=True)
class Stretch:
    """A segment of a file: its label and its channels, each (n,)."""

    label: str
    channels: Mapping[str, np.ndarray]


def write(folder: Path, name: str, stretches: Sequence[Stretch], rate: float, suffixes: Mapping[str, str]) -> None:
    """`name`.parquet and `name`.segments.csv, the stretches 5 s apart. rate: Hz; suffixes: of the columns, by channel."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    time: list[np.ndarray] = []
    columns: dict[str, list[np.ndarray]] = {channel: [] for channel in suffixes}
    rows, start = ["label,start_s,end_s"], 0.0
    for one in stretches:
        n = len(next(iter(one.channels.values())))
        time.append(start + np.arange(n) / rate)
        for channel, values in columns.items():
            values.append(one.channels[channel])
        rows.append(f"{one.label},{start:.6f},{start + n / rate:.6f}")
        start += n / rate + 5
    table = {"time_s": np.concatenate(time)}
    table |= {f"{channel}{suffix}": np.concatenate(columns[channel]) for channel, suffix in suffixes.items()}
    pq.write_table(pa.table(table), folder / f"{name}.parquet")
    (folder / f"{name}.segments.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def ended(folder: Path, plan: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, dict]]:
    """`check` with the recording, then a run in the folder: the coefficients of every estimate, by name."""
    code = main(["check", str(plan), "--data", str(folder), "--quiet"])
    assert code == DONE, capsys.readouterr().err
    options = ["--data", str(folder), "--runs", str(folder / "runs"), "--quiet", "--flushed", "--json"]
    capsys.readouterr()
    code = main(["run", str(plan), *options])
    said = capsys.readouterr()
    assert code == DONE, said
    results = json.loads(said.out)
    assert not results["failures"]
    for estimate in results["estimates"]:
        for item in estimate["coefficients"]:
            assert math.isfinite(item["value"]), item
    return {
        estimate["name"]: {item["name"]: item for item in estimate["coefficients"]} for estimate in results["estimates"]
    }


def near(found: Mapping[str, dict], wanted: Mapping[str, float], by: float = 1e-8) -> None:
    """Coefficients of one estimate, by their units; uncertainties are numbers and not negative."""
    for name, value in wanted.items():
        assert found[name]["value"] == pytest.approx(value, rel=by, abs=by), name
        assert 0 <= found[name]["standard_uncertainty"] < math.inf, name


def adapted(folder: Path, plan: str, bench: str) -> Path:
    """A shipped plan on a bench of this folder, without the run information that it asks for."""
    lines = (PLANS / f"{plan}.yaml").read_text(encoding="utf-8").splitlines()
    text = "\n".join(
        "bench: bench.yaml" if line.startswith("bench:") else line for line in lines if not line.startswith("record:")
    )
    (folder / "bench.yaml").write_text(bench, encoding="utf-8")
    (folder / f"{plan}.yaml").write_text(text + "\n", encoding="utf-8")
    return folder / f"{plan}.yaml"


@pytest.mark.slow
def test_rate_staircase(tmp_path, capsys):
    """Scale 1.01, bias 0.3 deg/s; across, the slope of a misalignment."""
    stretches = []
    for rate in (60, 120, 180, 240, 360, 540, 720):
        y = np.full(1200, 1.01 * rate + 0.3)
        one = {"gyro_x": 0.002 * y + 0.1, "gyro_y": y, "gyro_z": np.full(1200, -0.2)}
        stretches.append(
            Stretch(f"R{rate}", {f"{kind}_{name}": v for kind in ("lsm", "bno") for name, v in one.items()})
        )
    suffixes = dict.fromkeys(stretches[0].channels, "_deg_per_s")
    write(tmp_path, "rimu_jig/rate_staircase", stretches, 100.0, suffixes)
    for name, found in ended(tmp_path, PLANS / "rimu_rate_staircase.yaml", capsys).items():
        near(
            found,
            {
                f"K_{name}_gyro_y": 1.01,
                f"F0_{name}_gyro_y": 0.3,
                f"K_{name}_gyro_x": 0.00202,
                f"F0_{name}_gyro_z": -0.2,
            },
        )


@pytest.mark.slow
def test_tumbled_accelerometers(tmp_path, capsys):
    stretches = []
    for n in range(37):
        angle = math.radians(-10.0125 * n)
        # Turned by `angle` about y: up is seen along x with -sin, along z with cos.
        x, z = -math.sin(angle), math.cos(angle)
        one = {"x": 1.02 * x + 0.01 + 0.003 * z, "y": 0.004 + 0.0 * x, "z": 0.99 * z - 0.02}
        stretches.append(
            Stretch(f"P{n:02}", {f"{k}_accel_{a}": np.full(300, v) for k in ("lsm", "bno") for a, v in one.items()})
        )
    write(tmp_path, "rimu_jig/pitch_tumble", stretches, 100.0, dict.fromkeys(stretches[0].channels, "_g"))
    for found in ended(tmp_path, PLANS / "rimu_pitch_tumble.yaml", capsys).values():
        near(found, {"bias_x": 10.0, "bias_y": 4.0, "bias_z": -20.0, "scale_z": 0.99, "misalignment_z_x": 0.0})


def test_still_spans(tmp_path, capsys):
    """Poses on a spiral over the sphere, turned between in 2 s at constant rate."""
    n = 20
    k = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / n), math.pi * (1 + math.sqrt(5)) * k
    poses = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)
    parts = []
    for before, after in zip([poses[0], *poses], poses, strict=False):
        share = np.linspace(0, 1, 200, endpoint=False)[:, None]
        between = (1 - share) * before + share * after
        parts += [between / np.linalg.norm(between, axis=1, keepdims=True), np.tile(after, (400, 1))]
    force = G * np.concatenate(parts)
    force = force * [1.01, 0.98, 1.02] + [0.1, -0.2, 0.3]
    one = {f"accel_{a}": force[:, i] for i, a in enumerate("xyz")} | {
        f"gyro_{a}": 0 * force[:, i] for i, a in enumerate("xyz")
    }
    write(
        tmp_path,
        "mikoff_mpu9150/imu0",
        [Stretch("tumble", one)],
        100.0,
        {name: "_m_per_s2" if name.startswith("a") else "_rad_per_s" for name in one},
    )
    found = ended(tmp_path, PLANS / "mpu9150_imu0.yaml", capsys)["accelerometer"]
    near(found, {"scale_x": 1.01, "scale_y": 0.98, "scale_z": 1.02, "gamma_xy": 0.0, "bias_y": -200 / G})


def imu_bench(latitude: float, rate: float, name: str, more: str = "") -> str:
    channels = "\n".join(
        f"      {kind}_{a}: {{column: {kind}_{a}, unit: {unit}{more}}}"
        for kind, unit in (("gyro", "deg/s"), ("accel", "m/s^2"))
        for a in "xyz"
    )
    return f"""planrunner_bench: 1
name: noise-free
clock: virtual
site: {{latitude: {latitude} deg, gravity: {G} m/s^2}}
instruments:
  imu:
    driver: recording
    file: {name}.parquet
    kind: imu
    time: {{column: time_s, unit: s}}
    sample_rate: {rate} Hz
    segments: {{table: {name}.segments.csv}}
    channels:
{channels}
"""


def level(
    axes: str, seconds: float, rate: float, turning: float = 0.0, latitude: float = 45.0
) -> tuple[np.ndarray, np.ndarray]:
    """Mean rates [deg/s] and forces [m/s^2], both (n, 3), of a unit whose axes point along these words and that turns about up."""
    n = round(seconds * rate)
    edges = np.radians(turning) * np.arange(n + 1) / rate
    north, up = EARTH * math.cos(math.radians(latitude)), EARTH * math.sin(math.radians(latitude))
    if turning:
        width = edges[1] - edges[0]
        s, c = (np.cos(edges[:-1]) - np.cos(edges[1:])) / width, (np.sin(edges[1:]) - np.sin(edges[:-1])) / width
    else:
        s, c = np.zeros(n), np.ones(n)
    seen = np.stack([north * s, north * c, np.full(n, up + turning)], axis=1)
    m = np.array([WORDS[word] for word in axes.split()], dtype=float)
    return seen @ m.T, np.tile(m @ [0, 0, G], (n, 1))


POSITIONS = """east north up, west south up, east south down, west north down, up east north, up west south,
down east south, down west north, north up east, south up west, south down east, north down west"""
TURNED = {"X": "up east north", "Y": "north up east", "Z": "east north up"}


@pytest.mark.slow
def test_twelve_positions_and_six_rates(tmp_path, capsys):
    bias, scale = np.array([0.05, -0.02, 0.01]), np.array([1.001, 0.998, 1.003])
    a_bias, a_scale = np.array([0.03, -0.01, 0.02]), np.array([0.999, 1.002, 1.001])
    stretches = []
    rows = [(f"P{n:02}", axes, 0.0) for n, axes in enumerate(POSITIONS.replace("\n", " ").split(", "), 1)]
    rows += [(f"{k}/{r:+d}deg_s", axes, float(r)) for k, axes in TURNED.items() for r in (90, -90)]
    for label, axes, turning in rows:
        omega, force = level(axes, 120, 50, turning)
        omega, force = omega * scale + bias, force * a_scale + a_bias
        stretches.append(
            Stretch(
                label,
                {f"gyro_{a}": omega[:, i] for i, a in enumerate("xyz")}
                | {f"accel_{a}": force[:, i] for i, a in enumerate("xyz")},
            )
        )
    write(tmp_path, "r", stretches, 50.0, dict.fromkeys(stretches[0].channels, ""))
    plan = adapted(tmp_path, "imu_multi_position", imu_bench(45.0, 50, "r"))
    for one in ended(tmp_path, plan, capsys).values():
        near(one, {f"gyro_scale_{a}": scale[i] for i, a in enumerate("xyz")})
        near(one, {f"accel_scale_{a}": a_scale[i] for i, a in enumerate("xyz")})
        near(one, {f"gyro_bias_{a}": 3600 * bias[i] for i, a in enumerate("xyz")})


def test_navigation_after_an_alignment(tmp_path, capsys):
    rate, latitude = 10, 45.0
    stretches = []
    for label, seconds in (("warm-up", 60), ("align", 600), ("rest", 1800)):
        omega, force = level("east north up", seconds, rate, latitude=latitude)
        stretches.append(
            Stretch(
                label,
                {f"gyro_{a}": omega[:, i] for i, a in enumerate("xyz")}
                | {f"accel_{a}": force[:, i] for i, a in enumerate("xyz")},
            )
        )
    write(tmp_path, "r", stretches, rate, dict.fromkeys(stretches[0].channels, ""))
    (tmp_path / "bench.yaml").write_text(imu_bench(latitude, rate, "r"), encoding="utf-8")
    plan = tmp_path / "plan.yaml"
    plan.write_text(
        """planrunner: 1
title: At rest
bench: bench.yaml
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
defaults: {orientation: {x: east, y: north, z: up}, dwell: recorded, on_break: keep}
segments: [{label: warm-up}, {label: align}, {label: rest}]
estimates:
  free: {estimator: strapdown_navigation, segments: [warm-up, align, rest]}
report: [report.html, summary.md]
""",
        encoding="utf-8",
    )
    found = ended(tmp_path, plan, capsys)["free"]
    near(found, {"heading": 0.0, "pitch": 0.0, "roll": 0.0}, 1e-6)
    near(found, {"radial_error": 0.0}, 0.01)
