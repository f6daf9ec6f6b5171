"""The real recordings in the data folder: how a bench reads them, a plan for each, and what others know of them.

The figures under `known` come from the makers of the recordings, or from plain arithmetic on the files (`docs/real-recordings.md` gives the
sources). None was taken from planrunner.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SHIPPED = Path(__file__).parents[2] / "plans"


@dataclass(frozen=True)
class Known:
    """A figure that is known. name: of the coefficient of `estimate`, as `estimate.coefficient`; value; u: its standard uncertainty, as far
    as the source lets one judge; unit. what: in words."""

    name: str
    value: float
    u: float
    unit: str
    what: str


@dataclass(frozen=True)
class Repeat:
    """A quantity that the recording shows several times. names: coefficients that should agree; what: in words."""

    names: tuple[str, ...]
    what: str


@dataclass(frozen=True)
class RealSet:
    """A recording with a plan. files: beneath the data folder; the first is the recording. plan, bench: texts. segments: the table of
    segments as a text, from the data folder; empty if the bench needs none. known, repeats: what the results are compared with. nominal:
    terms of the simulation for the diagnosis, None for no diagnosis. names: what the diagnosis must name, one of them; remark: what is
    known and cannot be compared. slow: seconds, roughly, if more than a second."""

    title: str
    files: tuple[str, ...]
    plan: str
    bench: str
    segments: Callable[[Path], str] | None = None
    known: tuple[Known, ...] = ()
    repeats: tuple[Repeat, ...] = ()
    nominal: tuple[str, ...] | None = None
    names: tuple[str, ...] = ()
    remark: str = ""
    slow: bool = False


def shipped(name: str) -> tuple[str, str]:
    """Plan and bench of a shipped example."""
    return tuple(  # type: ignore[return-value]
        (folder / f"{name}.yaml").read_text(encoding="utf-8") for folder in (SHIPPED, SHIPPED / "benches")
    )


def table(rows: list[tuple[str, float, float]]) -> str:
    return "label,start_s,end_s\n" + "".join(f"{label},{start!r},{end!r}\n" for label, start, end in rows)


def bench(imu: str, latitude: float = 45.0) -> str:
    """A bench around the keys of its one sensor."""
    lines = "\n".join("    " + line for line in imu.strip().splitlines())
    return (
        "planrunner_bench: 1\nname: real\nclock: virtual\n"
        f"site: {{latitude: {latitude} deg, gravity: 9.80665 m/s^2}}\n"
        f"instruments:\n  imu:\n    driver: recording\n    kind: imu\n{lines}\n"
    )


def plan(outputs: list[str], body: str) -> str:
    return (
        "planrunner: 1\ntitle: Real recording\nbench: ./real.bench.yaml\n"
        f"sensor: {{kind: imu, outputs: [{', '.join(outputs)}]}}\n{body.strip()}\nreport: [summary.md]\n"
    )


GYROS, ACCELS = ([f"{kind}_{axis}" for axis in "xyz"] for kind in ("gyro", "accel"))

# -- ring-laser unit, x up and then x down ------------------------------------------------------------------------------------------------


def _ring_laser() -> RealSet:
    fields = "\n".join(
        f"    {name}: {{at: {8 * k}, type: f64, little_endian: true}}"
        for k, name in enumerate(("t", "gx", "gy", "gz", "ax", "ay", "az"))
    )
    text = f"""
file: ln100/x_LN100_up.ins
continued_by: [ln100/x_LN100_down.ins]
pause_between_files: 60 s
segments: {{table: segments.csv}}
sample_rate: 64 Hz
time: {{column: t}}
format:
  type: binary
  length: 56
  fields:
{fields}
channels:
  gyro_x: {{column: gx, unit: deg/s}}
  accel_x: {{column: ax, unit: m/s^2}}
"""
    body = """
segments:
  - {label: "up-{repeat}", repeat: 5, orientation: {x: up, y: north, z: west}, dwell: recorded}
  - {label: "down-{repeat}", repeat: 5, orientation: {x: down, y: north, z: east}, dwell: recorded}
estimates:
  gyro: {estimator: error_model, outputs: {gyro_x: [gyro_bias, gyro_scale_factor]}}
  accel: {estimator: error_model, outputs: {accel_x: [accel_bias, accel_scale_factor]}}
"""
    # The latitude was not written down; this is the one at which the Earth's vertical rate is the known 11.73 deg/h.
    latitude = math.degrees(math.asin(11.73 / 15.041067))
    return RealSet(
        "ring-laser unit at rest, x up and down",
        ("ln100/x_LN100_up.ins", "ln100/x_LN100_down.ins"),
        plan(["gyro_x", "accel_x"], body),
        bench(text, round(latitude, 4)),
        segments=lambda _: table(
            [
                (f"{way}-{k + 1}", begin + 59.0 * k, begin + 59.0 * k + 58.0)
                for way, begin in (("up", 10771.0), ("down", 11132.0))
                for k in range(5)
            ]
        ),
        known=(Known("gyro.gyro_scale_factor_x", 0.0, 500.0, "ppm", "half the difference of gyro x is 11.73 °/h"),),
    )


# -- tumbled and turned on the jig, by hand, and in the chamber: the shipped examples -----------------------------------------------------


def _staircase() -> RealSet:
    return RealSet(
        "rate staircase of two gyros",
        ("rimu_jig/rate_staircase.parquet", "rimu_jig/rate_staircase.segments.csv"),
        *shipped("rimu_rate_staircase"),
        known=(
            Known("bno.K_bno_gyro_y", 1.0028, 0.0003, "1", "scale factor of BNO y"),
            Known("lsm.K_lsm_gyro_y", 0.846, 0.003, "1", "scale factor of LSM y"),
            Known("lsm.F0_lsm_gyro_x", 2.2, 0.05, "deg/s", "bias of LSM x at rest"),
            Known("lsm.F0_lsm_gyro_y", -5.7, 0.05, "deg/s", "bias of LSM y at rest"),
            Known("lsm.F0_lsm_gyro_z", -4.9, 0.05, "deg/s", "bias of LSM z at rest"),
        ),
        nominal=("earth_rate", "gyro_misalignment"),
        names=("gyro_bias", "gyro_scale_factor"),
    )


def _pitch_tumble() -> RealSet:
    return RealSet(
        "pitch tumble of two accelerometer triads",
        ("rimu_jig/pitch_tumble.parquet", "rimu_jig/pitch_tumble.segments.csv"),
        *shipped("rimu_pitch_tumble"),
        known=(
            Known("bno.scale_x", 0.954, 0.0005, "1", "scale factor of BNO"),
            Known("bno.scale_z", 0.954, 0.0005, "1", "scale factor of BNO"),
        ),
        nominal=("accel_bias", "accel_misalignment"),
        names=("accel_scale_factor",),
    )


_TUMBLED = """
segments:
  - {label: tumble, orientation: unknown, dwell: recorded}
estimates:
  accelerometer:
    estimator: accelerometer_multi_position
    reference: gravity_magnitude
    segments: {detect: still, window: 0.5 s, threshold: 0.14 m/s^2, at_least: 2 s}
diagnosis:
  nominal: [accel_bias]
  segments: {detect: still, window: 0.5 s, threshold: 0.14 m/s^2, at_least: 2 s}
"""


def _tumbled_by_hand(unit: int) -> RealSet:
    if unit == 1:
        text = """
file: mikoff_mpu9150/imu1.log
sample_rate: 100 Hz
time: sample_count
format: {type: text, separator: blanks, names: [ax, ay, az, gx, gy, gz]}
channels:
  accel_x: {column: ax, unit: m/s^2, noise: 0.046 m/s^2}
  accel_y: {column: ay, unit: m/s^2, noise: 0.046 m/s^2}
  accel_z: {column: az, unit: m/s^2, noise: 0.068 m/s^2}
"""
        texts, file = (plan(ACCELS, _TUMBLED), bench(text)), "imu1.log"
    else:
        texts, file = shipped(f"mpu9150_imu{unit}"), f"imu{unit}.parquet"
    return RealSet(
        f"MPU-9150, unit {unit}, tumbled by hand",
        (f"mikoff_mpu9150/{file}",),
        *texts,
        nominal=("accel_bias",),
        names=("accel_misalignment", "accel_scale_factor"),
        remark="known are only the residuals of |f|, 1.9 to 2.4 mm/s²",
    )


def _thermal_vacuum() -> RealSet:
    rad = math.pi / 180
    return RealSet(
        "gyro in a thermal-vacuum chamber",
        ("psim_thermal_vacuum/TVCtest3_7_20.csv",),
        *shipped("psim_gyro_thermal_vacuum"),
        known=tuple(
            Known(f"temperature.gyro_{axis}_T1", slope * rad, 0.0005 * rad, "rad/s/K", f"slope of gyro {axis}")
            for axis, slope in (("x", 0.060), ("y", -0.028), ("z", 0.003))
        ),
        nominal=("gyro_bias",),
        names=("gyro_bias_temperature",),
    )


# -- array of eight units, twisted by hand ------------------------------------------------------------------------------------------------

_ARRAY_UNITS = 8


def _array(which: int, spans: list[tuple[float, float]]) -> RealSet:
    fields = "\n".join(
        f"    {kind}{unit}{axis}: {{at: {8 + 12 * unit + 6 * k + 2 * a}, type: i16}}"
        for unit in (0, 2, 4)
        for k, kind in enumerate("ag")
        for a, axis in enumerate("xyz")
    )
    channels = "\n".join(
        f"  {kind}_{unit}_{axis}: {{column: {kind[0]}{unit}{axis}, unit: {text}, per_unit: {scale}, "
        f"noise: {noise}, full_scale: {full}}}"
        for unit in (0, 2, 4)
        for kind, text, scale, noise, full in (
            ("accel", "g", 2048, "0.004 g", "15.99 g"),
            ("gyro", "deg/s", 16.4, "0.1 deg/s", "1998 deg/s"),
        )
        for axis in "xyz"
    )
    text = f"""
file: imu_array/exp_{which}.bin
sample_rate: 62.5 Hz
time: {{column: clock, per_second: 64000000, wraps: 4294967296}}
segments: {{table: segments.csv}}
format:
  type: binary
  skip: 4
  sync: AA
  length: 106
  checksum: {{type: sum16}}
  fields:
    clock: {{at: 4, type: u32}}
{fields}
channels:
{channels}
"""
    effects = "[accel_bias, accel_scale_factor, accel_misalignment, lever_arm]"
    outputs = {unit: [f"accel_{unit}_{axis}" for axis in "xyz"] for unit in (2, 4)}
    named = {f"part_{k}": span for k, span in enumerate(spans, start=1)}
    estimates = "\n".join(
        f"  unit_{unit}_{axis}: {{estimator: error_model, outputs: {{accel_{unit}_{axis}: {effects}}}}}"
        for unit in outputs
        for axis in "xyz"
    )
    positions = "\n".join(
        f"  position_{unit}: {{estimator: repeatability, uses: [{', '.join(f'unit_{unit}_{axis}' for axis in 'xyz')}], quantities: {{"
        + ", ".join(
            f"r_{along}: [{', '.join(f'unit_{unit}_{axis}.lever_arm_r_{along}_accel_{unit}_{axis}' for axis in 'xyz')}]"
            for along in "xyz"
        )
        + "}}"
        for unit in outputs
    )
    body = f"""
defaults:
  orientation: unknown
  dwell: recorded
  motion: {{recorded: {{rates: [gyro_0_x, gyro_0_y, gyro_0_z], forces: [accel_0_x, accel_0_y, accel_0_z]}}}}
segments:
  - {{label: "part_{{repeat}}", repeat: {len(named)}}}
estimates:
{estimates}
{positions}
diagnosis: {{outputs: [accel_2_x, accel_2_y, accel_2_z]}}
"""
    return RealSet(
        f"array of eight units, twisted by hand ({which})",
        (f"imu_array/exp_{which}.bin",),
        plan([one for own in outputs.values() for one in own], body),
        bench(text),
        segments=lambda _: table([(label, *span) for label, span in named.items()]),
        repeats=tuple(
            Repeat(
                tuple(f"unit_{unit}_{axis}.lever_arm_r_{along}_accel_{unit}_{axis}" for axis in "xyz"),
                f"position of unit {unit} along {along}, from its accelerometers",
            )
            for unit in outputs
            for along in "xyz"
        ),
        nominal=("accel_bias", "accel_scale_factor", "accel_misalignment"),
        names=("lever_arm",),
        slow=True,
    )


# -- Ferraris calibrations: three turns of 360 deg by hand --------------------------------------------------------------------------------

_HZ = 102.4


def _ferraris_sections(root: Path) -> dict[str, tuple[int, int]]:
    found = json.loads((root / "ferraris" / "example_ferraris_session_list.json").read_text(encoding="utf-8"))
    return {name: (one["start"], one["end"]) for name, one in found.items()}


def _annotated_sections(root: Path) -> dict[str, tuple[int, int]]:
    """First and last row of each section that the file names in its first column."""
    found: dict[str, tuple[int, int]] = {}
    with (root / "ferraris" / "annotated_session.csv").open(encoding="utf-8") as file:
        next(file)
        for row, line in enumerate(file):
            name = line.partition(",")[0]
            found[name] = (found.get(name, (row, 0))[0], row + 1)
    return found


def _ferraris(annotated: bool) -> RealSet:
    rate = 2 * _HZ if annotated else _HZ
    file = "annotated_session" if annotated else "example_ferraris_session"
    sections = _annotated_sections if annotated else _ferraris_sections
    whole = -360.0 * (-1 if annotated else 1)  # deg, by the sign of the recorded rates
    scale = 16.4 if annotated else 1.0
    text = f"""
file: ferraris/{file}.csv
sample_rate: {rate} Hz
time: sample_count
segments: {{table: segments.csv}}
channels:
  gyro_x: {{column: gyr_x, unit: deg/s, per_unit: {scale}}}
  gyro_y: {{column: gyr_y, unit: deg/s, per_unit: {scale}}}
  gyro_z: {{column: gyr_z, unit: deg/s, per_unit: {scale}}}
"""
    seconds = {
        False: {"x_rot": 323, "y_rot": 324, "z_rot": 307},
        True: {"x_rot": 1305, "y_rot": 1093, "z_rot": 1420},
    }[annotated]
    still = "\n".join(
        f"  - {{label: {axis}_{way}, orientation: {_upright(axis, way == 'p')}, dwell: recorded}}"
        for axis in "xyz"
        for way in "pa"
    )
    turned = "\n".join(
        f"  - {{label: {label}, orientation: {_upright(label[0], True)}, dwell: recorded, "
        f"motion: {{rate: {whole * rate / rows:.9g} deg/s, about: up}}}}"
        for label, rows in seconds.items()
    )
    estimates = "\n".join(
        f"  scale_{axis}: {{estimator: error_model, outliers: keep, outputs: "
        f"{{gyro_{axis}: [gyro_bias, gyro_scale_factor, gyro_misalignment]}}}}"
        for axis in "xyz"
    )
    body = f"""
segments:
{still}
{turned}
estimates:
{estimates}
"""
    known = (16.678, 16.188, 16.253) if annotated else (370.0 / 360, 353.7 / 360, 359.4 / 360)
    return RealSet(
        "Ferraris calibration in counts" if annotated else "Ferraris calibration",
        (f"ferraris/{file}.csv",),
        plan(GYROS, body),
        bench(text),
        segments=lambda root: table(
            [(label, (first - 0.5) / rate, (last - 0.5) / rate) for label, (first, last) in sections(root).items()]
        ),
        known=tuple(
            Known(
                f"scale_{axis}.gyro_scale_factor_{axis}",
                (value / scale - 1) * 1e6,
                3000.0,  # a turn by hand ends within a degree
                "ppm",
                f"a turn of 360° about {axis} by hand",
            )
            for axis, value in zip("xyz", known, strict=True)
        ),
    )


def _upright(axis: str, up: bool) -> str:
    """An orientation with an axis up or down."""
    second, third = {"x": ("y", "z"), "y": ("z", "x"), "z": ("x", "y")}[axis]
    return f"{{{axis}: {'up' if up else 'down'}, {second}: east, {third}: {'north' if up else 'south'}}}"


# -- two units and an encoder -------------------------------------------------------------------------------------------------------------


def _encoder(file: str, axis: str, about: str, known: float, averaging: str = "2 s") -> RealSet:
    """The stepper moves in jerks of several hertz, which the gyro smooths: means over two seconds show its scale factor."""
    text = f"""
file: two_imus_encoder/{file}.mat
sample_rate: 100 Hz
time: sample_count
segments: {{table: segments.csv}}
channels:
  gyro_{axis}: {{column: all_gyro_2_{axis}, unit: deg/s, noise: 0.1 deg/s}}
  encoder: {{column: all_encoder, unit: deg}}
"""
    parts = {f"part_{k}": (-60.0 + 120.0 * k, 50.0 + 120.0 * k) for k in range(1, 13)}
    effects = "[gyro_bias, gyro_scale_factor]"
    quarters = "\n".join(
        f"  part_{k}: {{estimator: error_model, segments: [{', '.join(f'part_{j}' for j in range(3 * k - 2, 3 * k + 1))}], "
        f"outputs: {{gyro_{axis}: {effects}}}}}"
        for k in range(1, 5)
    )
    body = f"""
defaults:
  orientation: {{x: east, y: north, z: up}}
  dwell: recorded
  motion: {{about: {about}, recorded: {{angle: encoder, averaging: {averaging}}}}}
segments:
  - {{label: "part_{{repeat}}", repeat: {len(parts)}}}
estimates:
  gyro: {{estimator: error_model, outputs: {{gyro_{axis}: {effects}}}}}
{quarters}
"""
    return RealSet(
        f"gyro on a stepper with an encoder ({file})",
        (f"two_imus_encoder/{file}.mat",),
        plan([f"gyro_{axis}"], body),
        bench(text),
        segments=lambda _: table([(label, *span) for label, span in parts.items()]),
        known=(
            Known(
                f"gyro.gyro_scale_factor_{axis}", (abs(known) - 1) * 1e6, 1000.0, "ppm", f"{known} against the encoder"
            ),
        ),
        repeats=(
            Repeat(tuple(f"part_{k}.gyro_scale_factor_{axis}" for k in range(1, 5)), "scale factor in four quarters"),
        ),
        nominal=("gyro_bias",),
        names=("gyro_scale_factor",),
        slow=True,
    )


# -- under cameras ------------------------------------------------------------------------------------------------------------------------


def _cameras(file: str, spans: list[tuple[float, float]], known: tuple[float, float]) -> RealSet:
    channels = "\n".join(
        f"  gyro_{axis}: {{column: 'imu_gyr[{k}]', unit: rad/s, noise: 0.005 rad/s}}\n"
        f"  accel_{axis}: {{column: 'imu_acc[{k}]', unit: m/s^2, noise: 0.1 m/s^2}}"
        for k, axis in enumerate("xyz", start=1)
    )
    quaternion = "\n".join(f"  q_{name}: {{column: 'opt_quat[{k}]', unit: '1'}}" for k, name in enumerate("wxyz", 1))
    text = f"""
file: broad/{file}.mat
sample_rate: 285.7142857 Hz
time: sample_count
segments: {{table: segments.csv}}
channels:
{channels}
{quaternion}
"""
    named = {f"part_{k}": span for k, span in enumerate(spans, start=1)}
    effects = "[gyro_bias, gyro_scale_factor, gyro_misalignment, reference_latency]"
    outputs = "{" + ", ".join(f"gyro_{axis}: {effects}" for axis in "xyz") + "}"
    middle_part = len(spans) // 2
    parts = {"first": list(named)[:middle_part], "second": list(named)[middle_part:]}
    halves = "\n".join(
        f"  {name}: {{estimator: error_model, segments: [{', '.join(own)}], outputs: {outputs}}}"
        for name, own in parts.items()
    )
    body = f"""
defaults:
  orientation: unknown
  dwell: recorded
  motion: {{recorded: {{attitude: [q_w, q_x, q_y, q_z], averaging: 50 ms}}}}
segments:
  - {{label: "part_{{repeat}}", repeat: {len(named)}}}
estimates:
  gyro: {{estimator: error_model, outputs: {outputs}}}
{halves}
diagnosis: {{outputs: [gyro_x, gyro_y, gyro_z]}}
"""
    middle, half = (known[0] + known[1]) / 2, (known[1] - known[0]) / 2
    return RealSet(
        f"hand-held unit under cameras ({file[:2]})",
        (f"broad/{file}.mat",),
        plan(GYROS, body),
        bench(text),
        segments=lambda _: table([(label, *span) for label, span in named.items()]),
        known=tuple(
            Known(
                f"gyro.gyro_scale_factor_{axis}",
                (middle - 1) * 1e6,
                half * 1e6 / math.sqrt(3),
                "ppm",
                f"{known[0]} to {known[1]} against the cameras",
            )
            for axis in "xyz"
        ),
        repeats=tuple(
            Repeat(tuple(f"{half}.gyro_scale_factor_{axis}" for half in parts), f"scale factor {axis} in both halves")
            for axis in "xyz"
        ),
        nominal=("gyro_bias", "gyro_scale_factor", "gyro_misalignment"),
        slow=True,
    )


# -- MPU-6050: raw counts -----------------------------------------------------------------------------------------------------------------


def _counts_at_rest() -> RealSet:
    keys = "format: {type: text, skip: 4}\nsample_rate: 100 Hz\ntime: sample_count"
    channels = "\n".join(f"  gyro_{axis}: {{column: g{axis}, unit: count}}" for axis in "xyz")
    body = """
segments:
  - {label: rest, orientation: unknown, dwell: recorded}
estimates:
  noise: {estimator: allan_deviation, outputs: [gyro_x, gyro_y, gyro_z]}
"""
    return RealSet(
        "MPU-6050 at rest, in counts",
        ("mpu6050_multi_position/imu_static_test.csv",),
        plan(GYROS, body),
        bench(f"file: mpu6050_multi_position/imu_static_test.csv\n{keys}\nchannels:\n{channels}"),
        remark="the known biases (−427.5, 147.9 and −80.7 counts) are from another recording",
    )


def _turned_by_90() -> RealSet:
    keys = "format: {type: text, skip: 4}\nsample_rate: 100 Hz\ntime: sample_count\nsegments: {table: segments.csv}"
    channels = "  gyro_x: {column: gx, unit: deg/s, per_unit: 131}"
    seconds = 15.0
    body = f"""
defaults: {{orientation: {{x: up, y: north, z: west}}, dwell: recorded}}
segments:
  - {{label: before}}
  - {{label: turn, motion: {{rate: {90 / seconds!r} deg/s, about: up}}}}
  - {{label: after}}
estimates:
  scale: {{estimator: error_model, outliers: keep, outputs: {{gyro_x: [gyro_bias, gyro_scale_factor]}}}}
"""
    return RealSet(
        "MPU-6050 turned by 90°",
        ("mpu6050_multi_position/imu_90_x_rot.csv",),
        plan(["gyro_x"], body),
        bench(f"file: mpu6050_multi_position/imu_90_x_rot.csv\n{keys}\nchannels:\n{channels}"),
        segments=lambda _: table([("before", 0.0, 15.0), ("turn", 15.0, 30.0), ("after", 30.0, 80.0)]),
        known=(
            Known("scale.gyro_scale_factor_x", (90.25 / 90 - 1) * 1e6, 3000.0, "ppm", "the turn integrates to 90.25°"),
        ),
    )


def _too_few_poses() -> RealSet:
    channels = "\n".join(f"  accel_{axis}: {{column: a{axis}, unit: g, per_unit: 16384}}" for axis in "xyz")
    text = (
        "file: mpu6050_multi_position/example_data_calibration.csv\nformat: {type: text, skip: 4}\n"
        f"sample_rate: 100 Hz\ntime: sample_count\nchannels:\n{channels}"
    )
    body = """
segments:
  - {label: tumble, orientation: unknown, dwell: recorded}
estimates:
  accelerometer:
    estimator: accelerometer_multi_position
    reference: gravity_magnitude
    segments: {detect: still, window: 0.5 s, threshold: 0.02 g, at_least: 1.5 s}
"""
    return RealSet(
        "MPU-6050 in several poses, in counts",
        ("mpu6050_multi_position/example_data_calibration.csv",),
        plan(ACCELS, body),
        bench(text),
        remark="not enough distinct poses for nine parameters",
    )


# -- a rocket on its pad ------------------------------------------------------------------------------------------------------------------


def _rocket() -> RealSet:
    text = """
file: rocket_firm/jackpot_launch_1.csv
sample_rate: 100 Hz
time: {column: timestamp_seconds, unit: s}
segments: {table: segments.csv}
channels:
  accel_x: {column: raw_acceleration_x_gs, unit: g, full_scale: 20 g}
  accel_y: {column: raw_acceleration_y_gs, unit: g, full_scale: 20 g}
  accel_z: {column: raw_acceleration_z_gs, unit: g, full_scale: 20 g}
  gyro_x: {column: raw_angular_rate_x_deg_per_s, unit: deg/s}
  gyro_y: {column: raw_angular_rate_y_deg_per_s, unit: deg/s}
  gyro_z: {column: raw_angular_rate_z_deg_per_s, unit: deg/s}
  temperature: {column: temperature_celsius, unit: degC}
"""
    body = """
segments:
  - {label: pad, orientation: unknown, dwell: recorded}
estimates:
  noise: {estimator: allan_deviation, outputs: [accel_x, accel_y, accel_z]}
"""
    return RealSet(
        "rocket on its pad",
        ("rocket_firm/jackpot_launch_1.csv",),
        plan([*ACCELS, *GYROS], body),
        bench(text),
        segments=lambda _: table([("pad", 129.1, 134.4)]),
        remark="the only known figure is that |f| is about 1 g on the pad",
    )


_SLOW_TURNS = [(30.0 + 24 * k, 54.0 + 24 * k) for k in range(1, 8)]
SETS: tuple[RealSet, ...] = (
    _ring_laser(),
    _staircase(),
    _pitch_tumble(),
    *(_tumbled_by_hand(unit) for unit in (0, 1, 2)),
    _thermal_vacuum(),
    _array(2, _SLOW_TURNS + [(515.0 + 10 * k, 525.0 + 10 * k) for k in range(1, 4)]),
    _ferraris(False),
    _ferraris(True),
    _encoder("raw_yaw_slow", "z", "down", -1.006),
    _encoder("raw_yaw_medium", "z", "down", -1.006, "0.7 s"),
    _encoder("raw_pitch_slow", "y", "north", 0.985),
    _cameras(
        "04_undisturbed_slow_rotation_with_breaks_A",
        [(31.0, 44.0), (45.0, 58.0), (69.0, 83.0), (112.0, 126.0), (127.1, 139.0), (152.0, 164.0), (165.0, 176.0)],
        (0.994, 1.001),
    ),
    _cameras("32_disturbed_attached_magnet_1cm", [(6.0 + 22.0 * k, 27.0 + 22.0 * k) for k in range(7)], (0.994, 1.001)),
    _counts_at_rest(),
    _turned_by_90(),
    _too_few_poses(),
    _rocket(),
)
