"""`planrunner new --from-recording` for files as other loggers and programs write them. The motion is known, and so is the noise: if
the units are right, the noise that the command finds is 0.002 rad/s and 0.01 m/s^2."""

from __future__ import annotations

import functools
import gzip
import itertools
import json
import re
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.instruments.formats.guessing import guessed_channel
from planrunner.instruments.recording_look import look_at
from planrunner.reporting import recording_picture
from planrunner.reporting.recording_picture import recording_picture as draw
from tests import dataflash_bytes, ros_bytes
from tests.recording_pictures import check_picture

Array = NDArray[np.float64]
G = 9.80665
DEG = np.degrees(1.0)
RATE = 50.0
NOON = datetime(2026, 3, 4, 12, 0, 0, 5000)
GYRO_NOISE, ACCEL_NOISE = 0.002, 0.01
IN_RAD = {"rad/s": 1.0, "deg/s": 1 / DEG, "mdeg/s": 1e-3 / DEG}
IN_M = {"m/s^2": 1.0, "g": G, "mg": 1e-3 * G}


@pytest.fixture(autouse=True)
def no_picture_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than reading most of these files; `test_a_recording_is_drawn` draws."""
    monkeypatch.setattr(recording_picture, "recording_picture", lambda look: "<svg/>")


@functools.cache
def turned() -> tuple[Array, Array, Array]:
    """Time [s], gyro [rad/s] and accelerometer [m/s^2] of a unit that rests 4 s in each of 13 attitudes and turns between them."""
    draw = np.random.default_rng(3)
    attitudes = Rotation.random(13, random_state=5)
    rest, turn = round(4 * RATE), round(1.4 * RATE)
    s = (np.arange(turn) + 0.5) / turn
    attitude, omega = [], []
    for here, there in itertools.pairwise(attitudes):
        way = (here.inv() * there).as_rotvec()
        moving = (here * Rotation.from_rotvec(np.outer(s * s * (3 - 2 * s), way))).as_quat()
        attitude += [np.tile(here.as_quat(), (rest, 1)), moving]
        omega += [np.zeros((rest, 3)), np.outer(6 * s * (1 - s) * RATE / turn, way)]
    gyro = np.concatenate(omega) + np.radians([0.3, -0.2, 0.1])
    accel = Rotation.from_quat(np.concatenate(attitude)).inv().apply([0, 0, G]) + np.array([0.1, -0.05, 0.08])
    gyro += draw.normal(0, GYRO_NOISE, gyro.shape)
    return np.arange(len(gyro)) / RATE, gyro, accel + draw.normal(0, ACCEL_NOISE, accel.shape)


def rows(*columns: Array, separator: str = ",", form: str = "%.7f") -> list[str]:
    return [separator.join(form % x for x in row) for row in np.column_stack(columns).tolist()]


def text(file: Path, header: str, lines: Iterable[str], encoding: str = "utf-8") -> Path:
    file.write_bytes("\n".join([header, *lines, ""]).encode(encoding))
    return file


Write = Callable[[Path], Path]
TIME, GYRO, ACCEL = turned()
IN_DPS_G = "gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g"


def stamped(stamp: Callable[[float], str], header: str = "timestamp", name: str = "r.csv") -> Write:
    """Writes a text whose first columns are stamps."""

    def write(folder: Path) -> Path:
        lines = [f"{stamp(t)},{row}" for t, row in zip(TIME.tolist(), rows(GYRO * DEG, ACCEL / G), strict=True)]
        return text(folder / name, f"{header},{IN_DPS_G}", lines)

    return write


def at(form: str, later: timedelta = timedelta(), digits: int = 3) -> Callable[[float], str]:
    def stamp(seconds: float) -> str:
        now = NOON + later + timedelta(microseconds=round(1e6 * seconds))
        return now.strftime(form).replace("{f}", f"{now.microsecond:06d}"[:digits])

    return stamp


def vectornav(folder: Path) -> Path:
    lines = []
    for v, g in zip(ACCEL.tolist(), GYRO.tolist(), strict=True):
        fields = [*(f"{x:+08.4f}" for x in v), *(f"{x:+010.6f}" for x in g)]
        body = f"VNIMU,+00.2915,-00.1223,+00.6711,{','.join(fields)},+24.1,+101.325"
        lines.append(f"${body}*{functools.reduce(lambda a, b: a ^ b, body.encode()):02X}")
    return text(folder / "r.txt", lines[0], lines[1:])


def sbg(folder: Path) -> Path:
    names = "timestamp\taccelX\taccelY\taccelZ\tgyroX\tgyroY\tgyroZ\ttemperature"
    units = "(us)\t(m/s^2)\t(m/s^2)\t(m/s^2)\t(deg/s)\t(deg/s)\t(deg/s)\t(°C)"
    warm = np.full_like(TIME, 31.2)
    return text(folder / "r.txt", f"{names}\n{units}", rows(1e6 * TIME, ACCEL, GYRO * DEG, warm, separator="\t"))


def excel(folder: Path) -> Path:
    head = "sep=;\r\nTime;Gyro X;Gyro Y;Gyro Z;Acc X;Acc Y;Acc Z;Remark\r\ns;°/s;°/s;°/s;mg;mg;mg;\r"
    lines = rows(TIME, GYRO * DEG, 1000 * ACCEL / G, separator=";")
    return text(
        folder / "r.csv",
        head,
        [f"{line.replace('.', ',')};{'start' * (k == 0)}\r" for k, line in enumerate(lines)],
        "utf-8-sig",
    )


def shimmer(folder: Path) -> Path:
    names = ["Timestamp_Unix_CAL", *(f"{one}_{x}_CAL" for one in ("Accel_LN", "Gyro") for x in "XYZ")]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]
    head = ["sep=\t", "\t".join(f"Shimmer_5F_{name}" for name in names) + "\t", "\t".join(units) + "\t"]
    lines = rows(1.58e12 + 1000 * TIME, ACCEL, GYRO * DEG, separator="\t")
    return text(folder / "r.csv", "\n".join(head), [f"{line}\t" for line in lines])


def euroc(folder: Path) -> Path:
    names = [f"{one}_RS_S_{x} [{unit}]" for one, unit in (("w", "rad s^-1"), ("a", "m s^-2")) for x in "xyz"]
    lines = [f"{1403636579758555392 + 20_000_000 * k},{row}" for k, row in enumerate(rows(GYRO, ACCEL))]
    return text(folder / "r.csv", f"#timestamp [ns],{','.join(names)}", lines)


def ros(folder: Path) -> Path:
    vectors = [f"field.{one}" for one in ("angular_velocity", "linear_acceleration")]
    names = [name for one in vectors for name in (*(f"{one}.{x}" for x in "xyz"), f"{one}_covariance0")]
    lines = [
        f"{1556000000000000000 + 20_000_000 * k},{k},imu_link,{g},0.0,{a},0.0"
        for k, (g, a) in enumerate(zip(rows(GYRO), rows(ACCEL), strict=True))
    ]
    return text(folder / "r.csv", f"%time,field.header.seq,field.header.frame_id,{','.join(names)}", lines)


def px4(folder: Path) -> Path:
    names = ["timestamp", *(f"gyro_rad[{k}]" for k in range(3)), "gyro_integral_dt", "accelerometer_timestamp_relative"]
    names += [*(f"accelerometer_m_s2[{k}]" for k in range(3)), "accelerometer_integral_dt", "accelerometer_clipping"]
    lines = [
        f"{98000000 + 20_000 * k},{g},5000,0,{a},5000,0"
        for k, (g, a) in enumerate(zip(rows(GYRO), rows(ACCEL), strict=True))
    ]
    return text(folder / "r.csv", ",".join(names), lines)


def ios(folder: Path) -> Path:
    names = ["loggingTime(txt)", "loggingSample(N)", "accelerometerTimestamp_sinceReboot(s)"]
    names += [f"accelerometerAcceleration{x}(G)" for x in "XYZ"]
    names += ["gyroTimestamp_sinceReboot(s)", *(f"gyroRotation{x}(rad/s)" for x in "XYZ")]
    stamp = at("%Y-%m-%dT%H:%M:%S.{f}+01:00")
    lines = [
        f"{stamp(t)},{k},{81234.5 + t:.6f},{a},{81234.503 + t:.6f},{g}"
        for k, (t, a, g) in enumerate(zip(TIME.tolist(), rows(-ACCEL / G), rows(GYRO), strict=True))
    ]
    return text(folder / "r.csv", ",".join(names), lines)


def android(folder: Path) -> Path:
    names = ["seconds_elapsed", *(f"rotationRate{x}" for x in "XYZ"), *(f"acceleration{x}" for x in "XYZ")]
    return text(folder / "r.csv", ",".join(names), rows(TIME, GYRO, ACCEL))


def labview(folder: Path) -> Path:
    head = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\t\n\nChannels\t6\t\t\t\t\t\n"
    head += "".join(
        "\t".join([name, *[value] * 6]) + "\n" for name, value in (("Samples", "3500"), ("Time", "12:00:00"))
    )
    head += "".join("\t".join([name, *[value] * 6]) + "\n" for name, value in (("X0", "0.0"), ("Delta_X", "0.02")))
    head += "***End_of_Header***\t\t\t\t\t\t\nX_Value\tGyro X\tGyro Y\tGyro Z\tAccel X\tAccel Y\tAccel Z\tComment"
    return text(folder / "r.lvm", head, rows(TIME, GYRO * DEG, ACCEL / G, separator="\t"))


def movella(folder: Path) -> Path:
    head = "DeviceTag:,Dot 1\nOutputRate:,50Hz\nStartTime:,2021-05-04_11:10:11_229\n\nPacketCounter,SampleTimeFine,"
    head += "Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,"
    lines = [f"{k},{123456 + 20_000 * k},{row}," for k, row in enumerate(rows(ACCEL, GYRO * DEG))]
    return text(folder / "r.csv", head, lines)


def in_milli_degrees(folder: Path) -> Path:
    names = [*(f"A_{x} [mg]" for x in "XYZ"), *(f"G_{x} [mdps]" for x in "XYZ")]
    lines = rows(1e6 * TIME, 1000 * ACCEL / G, 1000 * GYRO * DEG, separator="\t", form="%.1f")
    return text(folder / "r.txt", "\t".join(["T [us]", *names]), lines)


def increments(folder: Path) -> Path:
    names = [*(f"dtheta_{x}" for x in "xyz"), *(f"dv_{x}" for x in "xyz")]
    return text(folder / "r.csv", ",".join(["time_s", *names]), rows(TIME, GYRO / RATE, ACCEL / RATE, form="%.9f"))


def named_increments(folder: Path) -> Path:
    names = [*(f"Delta Theta {x} (deg)" for x in "XYZ"), *(f"Delta Velocity {x} (m/s)" for x in "XYZ")]
    return text(
        folder / "r.csv", ",".join(["Time (s)", *names]), rows(TIME, GYRO * DEG / RATE, ACCEL / RATE, form="%.9f")
    )


def nameless_with_a_magnetometer(folder: Path) -> Path:
    """The field turns with the sensor, as gravity does."""
    field = ACCEL[:, [1, 2, 0]] * 4.5
    lines = rows(TIME, ACCEL, field, GYRO * DEG, separator=" ")
    return text(folder / "r.txt", lines[0], lines[1:])


def commented_names(folder: Path) -> Path:
    np.savetxt(folder / "r.txt", np.column_stack([TIME, GYRO, ACCEL]), header="t wx wy wz ax ay az", fmt="%.7f")
    return folder / "r.txt"


def shared_times(folder: Path) -> Path:
    """The clock has a resolution of 40 ms, so two rows share a time."""
    return text(
        folder / "r.csv", f"time_s,{IN_DPS_G}", rows(np.floor(TIME / 0.04 + 1e-9) * 0.04, GYRO * DEG, ACCEL / G)
    )


def row_numbers_without_a_name(folder: Path) -> Path:
    """As R and pandas write a table: the line of names has one cell less than the rows."""
    lines = [f'"{k}" {row}' for k, row in enumerate(rows(TIME, GYRO, ACCEL, separator=" "), start=1)]
    return text(folder / "r.txt", "time wx wy wz ax ay az", lines)


def message_numbers_before_the_time(folder: Path) -> Path:
    lines = [f"{k} {row}" for k, row in enumerate(rows(1.54e9 + TIME, GYRO, ACCEL, separator=" "))]
    names = [*(f"ang_vel_{x}" for x in "xyz"), *(f"lin_acc_{x}" for x in "xyz")]
    return text(folder / "r.txt", " ".join(["# timestamp", *names]), lines)


def empty_lines(folder: Path) -> Path:
    lines = [f"{row}\n" for row in rows(TIME, GYRO * DEG, ACCEL / G)]
    return text(folder / "r.csv", f"log of unit 7\n\ntime_s,{IN_DPS_G}\n", lines)


def blanks_around_commas(folder: Path) -> Path:
    names = f"time_s,{IN_DPS_G}".replace(",", " , ")
    return text(folder / "r.csv", names, rows(TIME, GYRO * DEG, ACCEL / G, separator=" , "))


def nameless_increments(folder: Path) -> Path:
    """A matrix of increments with the time in its last column, beside a matrix of results."""
    results = np.random.default_rng(4).normal(0, 1, (len(TIME), 6))
    savemat(folder / "r.mat", {"imu": np.column_stack([GYRO / RATE, ACCEL / RATE, TIME]), "avp": results})
    return folder / "r.mat"


def nameless_beside_other_columns(folder: Path) -> Path:
    """A column of zeros before the accelerometers forms a vector with two of them that is sometimes as long as gravity."""
    speed, zeros = np.full((len(TIME), 2), 1.5), np.zeros((len(TIME), 1))
    lines = rows(TIME, speed, zeros, ACCEL, ACCEL, GYRO, separator=" ")
    return text(folder / "r.txt", lines[0], lines[1:])


def parquet(column: pa.Array, name: str) -> Write:
    def write(folder: Path) -> Path:
        table = {name: column}
        for k, axis in enumerate("xyz"):
            table |= {f"gyro_{axis}_dps": GYRO[:, k] * DEG, f"acc_{axis}_g": ACCEL[:, k] / G}
        pq.write_table(pa.table(table), folder / "r.parquet")
        return folder / "r.parquet"

    return write


def numpy_dates(folder: Path) -> Path:
    table = np.zeros(len(TIME), [("time", "M8[us]"), ("gyro", "f8", 3), ("accel", "f8", 3)])
    table["time"] = np.datetime64(NOON) + (1e6 * TIME).round().astype("timedelta64[us]")
    table["gyro"], table["accel"] = GYRO, ACCEL
    np.save(folder / "r.npy", table)
    return folder / "r.npy"


def matlab_days(folder: Path) -> Path:
    savemat(folder / "r.mat", {"imu": {"t": 740045.5 + TIME / 86400, "omega": GYRO, "f": ACCEL, "fs": RATE}})
    return folder / "r.mat"


def sqlite(folder: Path) -> Path:
    connection = sqlite3.connect(folder / "r.sqlite")
    connection.execute("CREATE TABLE imu (ts TEXT, gx REAL, gy REAL, gz REAL, ax REAL, ay REAL, az REAL)")
    stamp = at("%Y-%m-%dT%H:%M:%S.{f}")
    table = [(stamp(t), *g, *a) for t, g, a in zip(TIME.tolist(), GYRO.tolist(), ACCEL.tolist(), strict=True)]
    connection.executemany("INSERT INTO imu VALUES (?, ?, ?, ?, ?, ?, ?)", table)
    connection.commit()
    connection.close()
    return folder / "r.sqlite"


def racelogic(folder: Path) -> Path:
    """Times of day as numbers: 59.98 s is followed by 100.00."""
    stamp = at("%H%M%S.{f}", timedelta(seconds=30), digits=2)
    lines = [
        f"{stamp(t)} {row}" for t, row in zip(TIME.tolist(), rows(GYRO * DEG, ACCEL / G, separator=" "), strict=True)
    ]
    return text(folder / "r.txt", "time gx_dps gy_dps gz_dps ax_g ay_g az_g", lines)


def minutes(folder: Path) -> Path:
    """Minutes and seconds, as Excel shows and saves short times; names in German."""
    stamp = at("%M:%S.{f}", digits=2)
    names = [*(f"Drehrate {x} [°/s]" for x in "XYZ"), *(f"Beschleunigung {x} [m/s²]" for x in "XYZ")]
    lines = [f"{stamp(t)};{row}" for t, row in zip(TIME.tolist(), rows(GYRO * DEG, ACCEL, separator=";"), strict=True)]
    return text(folder / "r.csv", ";".join(["Zeit", *names]), lines, "latin-1")


def witmotion(folder: Path) -> Path:
    """Angles in degrees are no rates."""
    units = [("a", "g"), ("w", "deg/s"), ("Angle", "deg")]
    names = [f"{name}{axis if name != 'Angle' else axis.upper()}({unit})" for name, unit in units for axis in "xyz"]
    lines = rows(TIME, ACCEL / G, GYRO * DEG, np.cumsum(GYRO * DEG, axis=0) / RATE, separator="\t")
    return text(folder / "r.txt", "\t".join(["Time(s)", *names]), lines)


NANOSECONDS = 1772625600005000000 + 20_000_000 * np.arange(len(TIME))
DATE, OF_DAY = "date_time", "time_of_day"


def json_lines(folder: Path) -> Path:
    """Messages of a broker: those of the IMU between others, the vectors as objects and as lists."""
    stamp = at("%Y-%m-%dT%H:%M:%S.{f}Z")
    lines = ['{"type": "hello", "firmware": "1.2"}']
    for k, (t, g, a) in enumerate(zip(TIME.tolist(), GYRO.tolist(), ACCEL.tolist(), strict=True)):
        gyro = dict(zip("xyz", g, strict=True))
        lines.append(json.dumps({"type": "imu", "timestamp": stamp(t), "gyro": gyro, "accel": a}))
        lines += [json.dumps({"type": "battery", "timestamp": stamp(t), "volt": 3.7})] * (k % 100 == 0)
    return text(folder / "r.jsonl", lines[0], lines[1:])


def json_list(name: str, document: dict[str, object] | None = None) -> Write:
    def write(folder: Path) -> Path:
        names = ["time_ms", *IN_DPS_G.split(",")]
        table = np.column_stack([1e3 * TIME, GYRO * DEG, ACCEL / G]).tolist()
        samples: object = [dict(zip(names, row, strict=True)) for row in table]
        if document is not None:
            samples = {**document, "session": {"imu": samples, "events": [{"t": 1.0, "what": "start"}]}}
        return text(folder / name, json.dumps(samples, indent=1), [])

    return write


def json_columns(folder: Path) -> Path:
    held = {"rate": RATE, "data": {"time_s": TIME.tolist(), "gyro": GYRO.tolist(), "accel": ACCEL.tolist()}}
    return text(folder / "r.json", json.dumps(held), [])


def json_of_pandas(folder: Path) -> Path:
    """As `DataFrame.to_json` writes a table by default."""
    table = {"time_s": TIME, **{f"gyro_{x}": GYRO[:, k] for k, x in enumerate("xyz")}}
    table |= {f"acc_{x}": ACCEL[:, k] for k, x in enumerate("xyz")}
    held = {name: {str(k): value for k, value in enumerate(values.tolist())} for name, values in table.items()}
    return text(folder / "r.json", json.dumps(held), [])


def sensor_events(later: float) -> Write:
    """As loggers of phones write: one row for each event of a sensor. `later`: delay of the accelerometer, ns."""

    def write(folder: Path) -> Path:
        lines = [
            f"{1e9 * t + delay:.0f},{name},{row}"
            for t, *pair in zip(TIME.tolist(), rows(GYRO), rows(ACCEL), strict=True)
            for name, row, delay in zip(("gyroscope", "accelerometer"), pair, (0, later), strict=True)
        ]
        return text(folder / "r.csv", "timestamp,sensor,x,y,z", lines)

    return write


def each_reading(*table: Array, names: str = IN_DPS_G) -> Iterable[tuple[float, str, float]]:
    """Yields time, name and value of each reading, in the order of time."""
    for t, row in zip(TIME.tolist(), np.column_stack(table).tolist(), strict=True):
        yield from ((t, name, value) for name, value in zip(names.split(","), row, strict=True))


def readings(folder: Path) -> Path:
    """As a data base of time series exports them: dates, names, values and units."""
    stamp = at("%Y-%m-%d %H:%M:%S.{f}")
    units = {"g": "deg/s", "a": "g"}
    lines = [
        f"{stamp(t)};{name};{value:.7f};{units[name[0]]}" for t, name, value in each_reading(GYRO * DEG, ACCEL / G)
    ]
    return text(folder / "r.csv", "_time;_measurement;_value;unit", lines)


def readings_in_blocks(folder: Path) -> Path:
    """As `pandas.melt` arranges them: all times of one channel, then all times of the next."""
    names = [f"{kind}_{x}" for kind in ("gyro", "accel") for x in "xyz"]
    table = {
        "time_s": np.tile(TIME, 6),
        "variable": np.repeat(names, len(TIME)),
        "value": np.column_stack([GYRO, ACCEL]).T.ravel(),
    }
    pq.write_table(pa.table(table), folder / "r.parquet")
    return folder / "r.parquet"


def readings_in_json(folder: Path) -> Path:
    lines = [
        json.dumps({"time_ms": round(1000 * t), "channel": name, "value": value})
        for t, name, value in each_reading(GYRO * DEG, ACCEL / G)
    ]
    return text(folder / "r.jsonl", lines[0], lines[1:])


def readings_twice(folder: Path) -> Path:
    names = ",".join(f"{kind}_{x}" for kind in ("gyro", "accel") for x in "xyz")
    lines = [f"{t:.2f},{name},{value:.7f}" for t, name, value in each_reading(GYRO, ACCEL, names=names)]
    return text(folder / "r.csv", "time_s,channel,value", [*lines[:99], lines[98], *lines[99:]])


def excel_workbook(stamp: Callable[[float], object]) -> Write:
    """A workbook with remarks, names and units above the samples, and another sheet before."""

    def write(folder: Path) -> Path:
        book = openpyxl.Workbook(write_only=True)
        book.create_sheet("Protocol").append(["operator", "N. N."])
        sheet = book.create_sheet("Samples 1")
        unit = "ms" if isinstance(stamp(0.0), float) else None
        for head in (
            ["Unit under test", 7],
            [],
            ["Time", *(f"{kind} {x}" for kind in ("Gyro", "Acc") for x in "XYZ"), "Remark"],
            [unit, *["°/s"] * 3, *["mg"] * 3],
        ):
            sheet.append(head)
        for k, (t, *row) in enumerate(np.column_stack([TIME, GYRO * DEG, 1000 * ACCEL / G]).tolist()):
            sheet.append([stamp(t), *row, *["start"] * (k == 0)])
        book.save(folder / "r.xlsx")
        return folder / "r.xlsx"

    return write


def tdms(*, waves: bool) -> Write:
    """As LabVIEW stores channels: their units are properties. `waves`: True if the time is that of waveforms, not a channel."""

    def write(folder: Path) -> Path:
        wave = {"wf_start_offset": 0.0, "wf_increment": 1 / RATE} if waves else {}
        names = [
            (f"{kind} {x}", unit) for kind, unit in (("AngularRate", "deg/s"), ("Acceleration", "g")) for x in "XYZ"
        ]
        table = np.column_stack([GYRO * DEG, ACCEL / G])
        channels = [
            ChannelObject("Run 1", name, table[:, k].copy(), {"unit_string": unit, **wave})
            for k, (name, unit) in enumerate(names)
        ]
        stamps = np.datetime64("2026-03-04T12:00:00", "us") + (1e6 * TIME).round().astype("m8[us]")
        channels += [] if waves else [ChannelObject("Run 1", "Time stamp", stamps)]
        with TdmsWriter(folder / "r.tdms") as writer:
            writer.write_segment([RootObject({"operator": "N. N."}), *channels])
        return folder / "r.tdms"

    return write


def ardupilot(name: str, form: Callable[[Iterable[Sequence[object]]], bytes]) -> Write:
    def write(folder: Path) -> Path:
        samples = np.column_stack([GYRO, ACCEL]).astype(np.float32).tolist()
        times = (1e6 * TIME + 5e6).round().astype(int).tolist()
        (folder / name).write_bytes(form([(t, *row) for t, row in zip(times, samples, strict=True)]))
        return folder / name

    return write


def ros_bag(name: str, form: Callable[[Iterable[tuple[int, bytes]]], bytes], message: ros_bytes.Message) -> Write:
    def write(folder: Path) -> Path:
        stamps = (1_700_000_000_000_000_000 + (1e9 * TIME).round()).astype(np.int64).tolist()
        samples = zip(stamps, GYRO.tolist(), ACCEL.tolist(), strict=True)
        (folder / name).write_bytes(form([(stamp, message(stamp, g, a)) for stamp, g, a in samples]))
        return folder / name

    return write


def ros_folder(folder: Path) -> Path:
    """A folder of rosbag2. The driver of the IMU does not state times, so all stamps are 0. Another topic has more messages."""
    bag = folder / "bag"
    bag.mkdir()
    times = ((1e9 * TIME).round() + 5e9).astype(np.int64).tolist()
    samples = zip(times, GYRO.tolist(), ACCEL.tolist(), strict=True)
    ros_bytes.database(bag / "b.db3", [(time, ros_bytes.imu_in_cdr(0, g, a)) for time, g, a in samples])
    with sqlite3.connect(bag / "b.db3") as base:
        base.execute("INSERT INTO topics VALUES (2, '/count', 'std_msgs/msg/UInt8', 'cdr', '')")
        base.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (2, ?, ?)",
            [(k, b"\0\1\0\0\7") for k in range(9999)],
        )
    base.close()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 4, relative_file_paths: [b.db3]}\n")
    return bag


def packed(write: Write, name: str) -> Write:
    def pack(folder: Path) -> Path:
        file = write(folder)
        (folder / name).write_bytes(gzip.compress(file.read_bytes(), 1))
        file.unlink()
        return folder / name

    return pack


CASES: dict[str, tuple[Write, str | None, str, str]] = {
    "vectornav": (vectornav, None, "rad/s", "m/s^2"),
    "sbg": (sbg, "us", "deg/s", "m/s^2"),
    "excel": (excel, "s", "deg/s", "mg"),
    "shimmer": (shimmer, "ms", "deg/s", "m/s^2"),
    "euroc": (euroc, "ns", "rad/s", "m/s^2"),
    "ros": (ros, "ns", "rad/s", "m/s^2"),
    "px4": (px4, "us", "rad/s", "m/s^2"),
    "ios": (ios, "s", "rad/s", "g"),
    "android": (android, "s", "rad/s", "m/s^2"),
    "labview": (labview, "s", "deg/s", "g"),
    "movella": (movella, "us", "deg/s", "m/s^2"),
    "mdps": (in_milli_degrees, "us", "mdeg/s", "mg"),
    "increments": (increments, "s", "rad/s", "m/s^2"),
    "named increments": (named_increments, "s", "deg/s", "m/s^2"),
    "magnetometer": (nameless_with_a_magnetometer, "s", "deg/s", "m/s^2"),
    "savetxt": (commented_names, "s", "rad/s", "m/s^2"),
    "row numbers": (row_numbers_without_a_name, "s", "rad/s", "m/s^2"),
    "message numbers": (message_numbers_before_the_time, "s", "rad/s", "m/s^2"),
    "empty lines": (empty_lines, "s", "deg/s", "g"),
    "blanks around commas": (blanks_around_commas, "s", "deg/s", "g"),
    "nameless increments": (nameless_increments, "s", "rad/s", "m/s^2"),
    "nameless beside others": (nameless_beside_other_columns, "s", "rad/s", "m/s^2"),
    "shared times": (shared_times, None, "deg/s", "g"),
    "iso": (stamped(at("%Y-%m-%dT%H:%M:%S.{f}Z")), DATE, "deg/s", "g"),
    "iso with offset": (stamped(at("%Y-%m-%d %H:%M:%S.{f}+0100", digits=6)), DATE, "deg/s", "g"),
    "german date": (stamped(at("%d.%m.%Y %H:%M:%S.{f}"), "Datum"), DATE, "deg/s", "g"),
    "am and pm": (stamped(at("%m/%d/%Y %I:%M:%S.{f} %p")), DATE, "deg/s", "g"),
    "midnight": (
        stamped(at("%H:%M:%S.{f}", timedelta(hours=11, minutes=59, seconds=40)), "Time"),
        OF_DAY,
        "deg/s",
        "g",
    ),
    "date and time": (stamped(at("%d.%m.%Y,%H:%M:%S.{f}"), "Date,Time"), OF_DAY, "deg/s", "g"),
    "whole seconds": (stamped(at("%H:%M:%S"), "Time"), None, "deg/s", "g"),
    "epoch in ms": (stamped(lambda t: f"{1772625600005 + round(1000 * t)}"), "ms", "deg/s", "g"),
    "datenum": (stamped(lambda t: f"{740045.5 + t / 86400:.11f}"), "days", "deg/s", "g"),
    "excel's days": (stamped(lambda t: f"{46085.5 + t / 86400:.11f}"), "days", "deg/s", "g"),
    "racelogic": (racelogic, OF_DAY, "deg/s", "g"),
    "minutes": (minutes, OF_DAY, "deg/s", "m/s^2"),
    "witmotion": (witmotion, "s", "deg/s", "g"),
    "gps": (stamped(lambda t: f"2408,{(604790 + t) % 604800:.3f}", "GPS_Week,GPS_SOW"), "s", "deg/s", "g"),
    "parquet": (parquet(pa.array(NANOSECONDS.astype("M8[ns]")), "timestamp"), DATE, "deg/s", "g"),
    "parquet in ns": (parquet(pa.array(NANOSECONDS), "timestamp"), "ns", "deg/s", "g"),
    "numpy": (numpy_dates, DATE, "rad/s", "m/s^2"),
    "matlab": (matlab_days, "days", "rad/s", "m/s^2"),
    "sqlite": (sqlite, DATE, "rad/s", "m/s^2"),
    "sensor events": (sensor_events(0), "ns", "rad/s", "m/s^2"),
    "readings": (readings, DATE, "deg/s", "g"),
    "readings in blocks": (readings_in_blocks, "s", "rad/s", "m/s^2"),
    "readings in json": (readings_in_json, "ms", "deg/s", "g"),
    "workbook": (excel_workbook(lambda t: NOON + timedelta(microseconds=round(1e6 * t))), DATE, "deg/s", "mg"),
    "workbook without dates": (excel_workbook(lambda t: 1000 * t), "ms", "deg/s", "mg"),
    "tdms waveforms": (tdms(waves=True), "s", "deg/s", "g"),
    "tdms with dates": (tdms(waves=False), DATE, "deg/s", "g"),
    "ardupilot": (ardupilot("r.bin", dataflash_bytes.binary), "us", "rad/s", "m/s^2"),
    "ardupilot as text": (ardupilot("r.log", dataflash_bytes.text), "us", "rad/s", "m/s^2"),
    "ros 1": (ros_bag("r.bag", ros_bytes.bag_of_ros1, ros_bytes.imu_of_ros1), "s", "rad/s", "m/s^2"),
    "ros 1, being written": (
        ros_bag("r.bag.active", ros_bytes.bag_of_ros1, ros_bytes.imu_of_ros1),
        "s",
        "rad/s",
        "m/s^2",
    ),
    "ros 2": (ros_bag("r.mcap", ros_bytes.mcap, ros_bytes.imu_in_cdr), "s", "rad/s", "m/s^2"),
    "ros 2 as a folder": (ros_folder, "s", "rad/s", "m/s^2"),
    "sbg, packed": (packed(sbg, "r.txt.gz"), "us", "deg/s", "m/s^2"),
    "excel, packed": (packed(excel, "r.gz"), "s", "deg/s", "mg"),
    "savetxt, packed": (packed(commented_names, "r.csv.gz"), "s", "rad/s", "m/s^2"),
    "movella, packed": (packed(movella, "r.log.gz"), "us", "deg/s", "m/s^2"),
    "json lines": (json_lines, DATE, "rad/s", "m/s^2"),
    "json list": (json_list("r.log"), "ms", "deg/s", "g"),
    "json document": (json_list("r.json", {"device": {"serial": "7", "axes": [1, 2, 3]}}), "ms", "deg/s", "g"),
    "json columns": (json_columns, "s", "rad/s", "m/s^2"),
    "pandas": (json_of_pandas, "s", "rad/s", "m/s^2"),
}


SLOW = ("workbook without dates",)  # `test_workbook_recordings` reads workbooks with numbers


@pytest.mark.parametrize(
    "case", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in CASES]
)
def test_time_units_and_axes_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    write, time, gyro, accel = CASES[case]
    file, plan = write(tmp_path), tmp_path / "begun.yaml"
    more = ["--sample-rate", f"{RATE} Hz"] if case == "vectornav" else []
    assert main(["new", "--from-recording", str(file), str(plan), *more, "--json"]) == 0, capsys.readouterr().err
    said = json.loads(capsys.readouterr().out)
    assert (said["time"] or {"unit": None})["unit"] == time
    assert said["sample_rate_hz"] == pytest.approx(RATE, rel=2e-3)
    assert said["rows"] == len(TIME)
    units = {one["channel"]: one["unit"] for one in said["channels"] if not one["channel"].startswith("temp")}
    assert units == {**{f"gyro_{x}": gyro for x in "xyz"}, **{f"accel_{x}": accel for x in "xyz"}}
    for one in said["channels"]:
        if one["channel"] in units:
            noise = GYRO_NOISE / IN_RAD[gyro] if one["channel"].startswith("gyro") else ACCEL_NOISE / IN_M[accel]
            assert one["noise"] == pytest.approx(noise, rel=0.2), one["channel"]
    assert main(["check", str(plan), "--data", str(tmp_path)]) == 0, capsys.readouterr().err


DRAWN = ("german date", "readings", "sensor events", "shared times", "tdms waveforms", "whole seconds")
"""Layouts whose samples lie in sparse columns, in one column for all channels, in waveforms or at repeated times."""


@pytest.mark.parametrize(
    "case", [pytest.param(name, marks=[] if name in DRAWN else [pytest.mark.slow]) for name in CASES]
)
def test_a_recording_is_drawn(tmp_path: Path, case: str) -> None:
    look = look_at(CASES[case][0](tmp_path), RATE if case == "vectornav" else None)
    check_picture(draw(look), [one.name for one in look.channels])


def test_a_bag_of_ros_is_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The unit has known biases. The output and the bench file list the topics."""
    bag, plan = ros_folder(tmp_path), tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(bag), str(plan)]) == 0, capsys.readouterr().err
    said, bench = capsys.readouterr().out, (tmp_path / "begun.bench.yaml").read_text()
    for topic in (
        "/imu: 3240 messages of the type sensor_msgs/msg/Imu",
        "/count: 9999 messages of the type std_msgs/msg/UInt8",
    ):
        assert f"topic {topic}\n" in said and f"# It contains the topic {topic}.\n" in bench
    assert "time: {column: '/imu.receive_time', unit: s}\n" in bench and "file: bag\n" in bench
    assert main(["check", str(plan), "--data", str(tmp_path)]) == 0, capsys.readouterr().err
    capsys.readouterr()
    assert main(["run", str(plan), "--data", str(tmp_path), "--runs", str(tmp_path / "runs"), "--quiet", "--json"]) == 0
    (estimate,) = json.loads(capsys.readouterr().out)["estimates"]
    found = {one["name"]: one for one in estimate["coefficients"]}
    for axis, truth in zip("xyz", (0.1, -0.05, 0.08), strict=True):
        bias = found[f"bias_{axis}"]
        assert abs(bias["value"] - 1000 * truth / G) < 5 * bias["standard_uncertainty"]


def test_raw_counts_without_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A clock in us, accelerometers with 16384 counts per g, and gyros with 131 counts per deg/s."""
    lines = rows(1e6 * TIME + 3e6, (ACCEL / G * 16384).round(), (GYRO * DEG * 131).round(), form="%.0f")
    file = text(tmp_path / "r.csv", lines[0], lines[1:])
    assert main(["new", "--from-recording", str(file), str(tmp_path / "begun.yaml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["time"]["unit"] == "us" and len(said["channels"]) == 6
    found = {one["channel"]: one for one in said["channels"]}
    assert all(one["counts"] for one in found.values())
    assert found["accel_x"]["noise"] == pytest.approx(ACCEL_NOISE / G, rel=0.2)


def test_raw_counts_of_a_novatel_receiver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Increments of 0.05 m/s/32768 and 0.1 deg/3600/256 per count at 50 Hz, in the order z, -y, x, over the end of a GPS week."""
    counts = np.column_stack([ACCEL / RATE / 0.05 * 32768, GYRO * DEG / RATE / 0.1 * 3600 * 256]).round().astype(int)
    lines = []
    for t, (ax, ay, az, gx, gy, gz) in zip(TIME.tolist(), counts.tolist(), strict=True):
        week, second = divmod(2408 * 604800 + 604790 + t, 604800)
        body = f"RAWIMUSA,{week:.0f},{second:.3f};{week:.0f},{second:.9f},00000077,{az},{-ay},{ax},{gz},{-gy},{gx}"
        lines.append(f"%{body}*{zlib.crc32(body.encode(), 0xFFFFFFFF) ^ 0xFFFFFFFF:08x}")
    file = text(tmp_path / "r.txt", "[USB1]", lines)
    assert main(["new", "--from-recording", str(file), str(tmp_path / "begun.yaml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["time"]["column"] == "time_s" and said["sample_rate_hz"] == pytest.approx(RATE, rel=1e-3)
    found = {one["channel"]: one for one in said["channels"]}
    assert list(found) == [f"{kind}_{x}" for kind in ("accel", "gyro") for x in "xyz"]
    assert all(one["counts"] for one in found.values())
    assert found["accel_x"]["noise"] == pytest.approx(ACCEL_NOISE / G, rel=0.2)
    assert "axes" not in said or not said["axes"]
    assert main(["check", str(tmp_path / "begun.yaml"), "--data", str(tmp_path)]) == 0, capsys.readouterr().err


def words(folder: Path) -> Path:
    lines = rows(TIME, GYRO * DEG, ACCEL / G)
    lines[700] = f"{TIME[700]:.6f},ERR,ERR,ERR,---,---,---"
    return text(folder / "r.csv", f"time_s,{IN_DPS_G}", lines)


def thousands(folder: Path) -> Path:
    table = np.column_stack([85_000 + 1000 * TIME, GYRO * DEG, 1000 * ACCEL / G])
    return text(
        folder / "r.csv", f"time_ms,{IN_DPS_G}", (",".join(f'"{x:,.3f}"' for x in row) for row in table.tolist())
    )


def names_again(folder: Path) -> Path:
    lines = rows(TIME, GYRO * DEG, ACCEL / G)
    lines.insert(700, f"time_s,{IN_DPS_G}")
    return text(folder / "r.csv", f"time_s,{IN_DPS_G}", lines)


def sensors_in_turn(folder: Path) -> Path:
    """One table of two sensors that do not measure at the same time."""
    pairs = zip(rows(TIME, GYRO), rows(TIME + 0.003, ACCEL), strict=True)
    lines = [line for one, other in pairs for line in (f"{one},,,", other.replace(",", ",,,,", 1))]
    return text(folder / "r.csv", "time_s,gx,gy,gz,ax,ay,az", lines)


def means(folder: Path) -> Path:
    return text(
        folder / "r.csv", "state,n,mean_deg_per_s,sd_deg_per_s", ["a,9,0.01,0.1", "b,9,10.2,0.1", "c,9,-9.9,0.1"]
    )


def sensors_apart(folder: Path) -> Path:
    """The accelerometer measures 1 ms after the gyro."""
    return sensor_events(1e6)(folder)


def workbook_of_words(folder: Path) -> Path:
    book = openpyxl.Workbook()
    for _ in range(9):
        book.active.append(["a", "b", "c"])
    book.save(folder / "r.xlsx")
    return folder / "r.xlsx"


def written(content: bytes) -> Write:
    def write(folder: Path) -> Path:
        (folder / "r.log").write_bytes(content)
        return folder / "r.log"

    return write


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (words, "line 702: 'ERR' in column 'gx_dps' is not a number; correct it, or leave it empty"),
        (thousands, "'85,000.000' in column 'time_ms' is not a number; write numbers without thousands separators"),
        (
            names_again,
            "is not a number; this line repeats the names of the columns",
        ),
        (sensors_in_turn, "no row contains both gyros and accelerometers: each row belongs to one of the two sensors"),
        (means, "For a table of means, see docs/real-recordings.md (key `summary`)"),
        (sensors_apart, "'gyroscope.x' and 'accelerometer.x' have no readings at the same time"),
        (readings_twice, "row 100 (line 101): the time of 'gyro_z' does not increase: 0.32 s after 0.32 s"),
        (
            written(gzip.compress(b"t,gx\n")),
            "has no lines of numbers in its first 65536 bytes; its first line is 't,gx'",
        ),
        (
            written(gzip.compress(b"PK\x03\x04")),
            "is a compressed file, but contains no table of text: unpack it first (gzip)",
        ),
        (written(gzip.compress(ros_bytes.bag_of_ros1([]))), "is a compressed file, but contains no table of text"),
        (written(gzip.compress(bytes(range(9)))), "is a compressed file, but contains no table of text"),
        (written(gzip.compress(b"t,gx\n" * 99)[:-20]), "r.log cannot be unpacked: it ends too early"),
        (written(b"BZh91AY&SY"), "is a compressed file: unpack it first (bzip2)"),
        (
            written(b"PK\x03\x04" + bytes(200)),
            "is an archive or an Excel workbook: unpack it first, or rename the workbook",
        ),
        (written(b"\xd0\xcf\x11\xe0" + bytes(200)), "is an old Excel workbook: save it as an Excel workbook (.xlsx)"),
        (written(b"TDSm" + bytes(200)), "is a TDMS file of LabVIEW: rename it with the extension .tdms"),
        (workbook_of_words, "r.xlsx has no sheet with rows of numbers in its first 200 rows"),
        (written(b"#ROSBAG V2.0\n" + bytes(200)), "r.log is damaged: a record has an unexpected form"),
        (written(ros_bytes.bag_of_ros1([])), "r.log contains no messages"),
        (written(b'{"t": 0.0, "gx": 1}\n' * 50), "no column of this recording looks like a time that increases"),
        (written(b"t=0.0 gx=1\n" * 50), "its first line is 't=0.0 gx=1'"),
    ],
)
def test_what_is_not_read_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Write, message: str
) -> None:
    assert main(["new", "--from-recording", str(write(tmp_path)), str(tmp_path / "begun.yaml")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "begun.yaml").exists()


def test_unread_columns_of_sensors_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A word in a column of numbers; the other columns are read."""
    lines = rows(TIME, GYRO * DEG, ACCEL / G)
    lines[700] = ",".join([*lines[700].split(",")[:5], "ERR", lines[700].split(",")[6]])
    file = text(tmp_path / "r.csv", f"time_s,{IN_DPS_G}", lines)
    assert main(["new", "--from-recording", str(file), str(tmp_path / "begun.yaml")]) == 0
    message = f"r.csv, line 702: 'ERR' in column '{IN_DPS_G.split(',')[4]}' is not a number"
    assert message in capsys.readouterr().out
    assert f"# Not read: {message}" in (tmp_path / "begun.bench.yaml").read_text()


@pytest.mark.parametrize("up", "xyz")
def test_a_nameless_recording_at_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str], up: str) -> None:
    """With one axis up, every set of three columns that contains this axis is as long as gravity."""
    draw = np.random.default_rng(6)
    accel = draw.normal(0, ACCEL_NOISE, (3000, 3)) + G * np.eye(3)["xyz".index(up)]
    lines = rows(np.arange(3000) / RATE, draw.normal(0, GYRO_NOISE, (3000, 3)), accel)
    file = text(tmp_path / "r.csv", lines[0], lines[1:])
    assert main(["new", "--from-recording", str(file), str(tmp_path / "begun.yaml"), "--json"]) == 0
    columns = {one["channel"]: one["column"] for one in json.loads(capsys.readouterr().out)["channels"]}
    assert columns == {
        f"{kind}_{x}": f"column_{k + 2}" for k, (kind, x) in enumerate(itertools.product(("gyro", "accel"), "xyz"))
    }


def test_few_turns_about_an_axis_show_its_sign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nine turns are about x alone, and six also about z and y: in the median, the sign of the gyro z makes no difference."""
    draw = np.random.default_rng(7)
    ways = (
        [(70, 0, 0)] * 5
        + [(0, 20, 80), (30, -60, 30)]
        + [(-80, 0, 0)] * 4
        + [(0, 60, -20), (20, 30, 70), (10, 70, 0), (0, 10, 80)]
    )
    rest, turn = round(4 * RATE), round(1.4 * RATE)
    s = (np.arange(turn) + 0.5) / turn
    here, attitude, omega = Rotation.identity(), [], []
    for way in np.radians(ways):
        moving = (here * Rotation.from_rotvec(np.outer(s * s * (3 - 2 * s), way))).as_quat()
        attitude += [np.tile(here.as_quat(), (rest, 1)), moving]
        omega += [np.zeros((rest, 3)), np.outer(6 * s * (1 - s) * RATE / turn, way)]
        here = here * Rotation.from_rotvec(way)
    accel = Rotation.from_quat(np.concatenate(attitude)).inv().apply([0, 0, 1.0])
    gyro = np.concatenate(omega) * [1, 1, -1] + draw.normal(0, GYRO_NOISE, accel.shape)
    file = text(tmp_path / "r.csv", "t,gx,gy,gz,ax,ay,az", rows(np.arange(len(gyro)) / RATE, gyro, accel))
    assert main(["new", "--from-recording", str(file), str(tmp_path / "begun.yaml")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "gyro_x turns about x, gyro_y turns about y, gyro_z turns about -z" in said
    assert "gyro_x: {column: gx, unit: rad/s" in (tmp_path / "begun.bench.yaml").read_text()


LEVELS = (0, 10, 0, 30, 0, 90, 0, -10, 0, -30, 0, -90, 0)


def staircase(folder: Path) -> tuple[Path, list[tuple[float, float]]]:
    """A file of a rate table that turns about z at each of the rates for 8 s and accelerates at 30 deg/s^2, and the times [s] from
    which to which it turns at each rate. The scale factor of the gyro is 1.002, its bias is 0.1 deg/s."""
    draw = np.random.default_rng(2)
    rates, dwells, last, count = [], [], 0.0, 0
    for level in LEVELS:
        ramp = np.linspace(last, level, round(abs(level - last) / 30 * RATE), endpoint=False)
        dwell = np.full(round(8 * RATE), float(level))
        dwells.append(((count + len(ramp)) / RATE, (count + len(ramp) + len(dwell)) / RATE))
        rates += [ramp, dwell]
        last, count = level, count + len(ramp) + len(dwell)
    rate = np.concatenate(rates)
    gyro = np.column_stack([0.3 + 0 * rate, -0.2 + 0 * rate, 1.002 * rate + 0.1]) + draw.normal(0, 0.05, (count, 3))
    accel = draw.normal([0.01, -0.005, 1.0], 0.001, (count, 3))
    return text(folder / "r.csv", f"time_s,{IN_DPS_G}", rows(np.arange(count) / RATE, gyro, accel)), dwells


def test_the_plan_of_a_rate_table_leaves_out_spin_up_and_stop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the rates of the table, the plan gives the scale factor that the file was made with."""
    file, dwells = staircase(tmp_path)
    plan = tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(file), str(plan)]) == 0
    stretches = re.findall(
        r"dwell_\d+: {start: ([\d.]+) s, end: ([\d.]+) s}", (tmp_path / "begun.bench.yaml").read_text()
    )
    spans = [(float(start), float(end)) for start, end in stretches]
    assert len(spans) == len(dwells)
    assert all(
        begin <= start < end <= stop and end - start > 5
        for (start, end), (begin, stop) in zip(spans, dwells, strict=True)
    )
    assert main(["check", str(plan), "--data", str(tmp_path)]) == 0, capsys.readouterr().err
    assert main(["diagnose", str(plan), "--recording", str(file)]) == 2
    assert "the sensor has the same direction to gravity in all segments" in capsys.readouterr().err
    stated = plan.read_text()
    for number, level in enumerate(LEVELS, start=1):
        motion = f", rate: {level} deg/s" if level else ""
        stated = stated.replace(
            f"dwell_{number}, orientation: unknown", f"dwell_{number}, orientation: {{x: east, z: up}}{motion}"
        )
    estimate = "estimates:\n  scale: {estimator: scale_factor, segments: '*', outputs: [gyro_z]}\nreport:"
    plan.write_text(stated.replace("report:", estimate))
    assert main(["run", str(plan), "--data", str(tmp_path), "--runs", str(tmp_path / "runs"), "--quiet", "--json"]) == 0
    (estimate,) = json.loads(capsys.readouterr().out)["estimates"]
    found = {one["name"]: one for one in estimate["coefficients"]}
    for name, truth in (("K_gyro_z", 1.002), ("F0_gyro_z", 0.1)):
        assert abs(found[name]["value"] - truth) < 4 * found[name]["standard_uncertainty"]


def test_a_rate_that_changes_does_not_end_the_intervals_at_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Until 55 s, every second row is left out. All intervals at rest are found, and no sample counts as lost."""
    kept = np.concatenate([np.arange(0, 2750, 2), np.arange(2750, len(TIME))])
    file = text(tmp_path / "r.csv", f"time_s,{IN_DPS_G}", rows(TIME[kept], GYRO[kept] * DEG, ACCEL[kept] / G))
    plan = tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(file), str(plan)]) == 0
    assert main(["check", str(plan), "--data", str(tmp_path)]) == 0, capsys.readouterr().err
    said = capsys.readouterr().err
    assert "the sample rate changes: about 50 Hz from 55.0" in said and "recording-gap" not in said
    assert main(["run", str(plan), "--data", str(tmp_path), "--runs", str(tmp_path / "runs"), "--quiet", "--json"]) == 0
    printed = capsys.readouterr()
    assert "the sample rate changes" in printed.err
    (estimate,) = json.loads(printed.out)["estimates"]
    found = {one["name"]: one for one in estimate["coefficients"]}
    for axis, truth in zip("xyz", (0.1, -0.05, 0.08), strict=True):
        bias = found[f"bias_{axis}"]
        assert bias["unit"] == "mg"
        assert abs(bias["value"] - 1000 * truth / G) < 5 * bias["standard_uncertainty"]


@pytest.mark.parametrize(
    ("value", "said"), [(0.0, "'gyro_y' is 0 in every row"), (7.5, "'gyro_y' is 7.5 in every row")]
)
def test_check_and_run_warn_of_a_dead_channel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], value: float, said: str
) -> None:
    gyro = GYRO * DEG
    gyro[:, 1] = value
    file, plan = text(tmp_path / "r.csv", f"time_s,{IN_DPS_G}", rows(TIME, gyro, ACCEL / G)), tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(file), str(plan)]) == 0
    capsys.readouterr()
    for command in (["check"], ["run", "--runs", str(tmp_path / "runs"), "--quiet"]):
        assert main([command[0], str(plan), "--data", str(tmp_path), *command[1:]]) == 0
        assert said in capsys.readouterr().err


def test_few_poses_are_enough_for_a_diagnosis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Five poses cannot calibrate accelerometers; the plan has no estimate, and its diagnosis runs."""
    some = TIME < 26
    file = text(tmp_path / "r.csv", f"time_s,{IN_DPS_G}", rows(TIME[some], GYRO[some] * DEG, ACCEL[some] / G))
    plan = tmp_path / "begun.yaml"
    assert main(["new", "--from-recording", str(file), str(plan)]) == 0
    assert "accelerometer_multi_position" not in plan.read_text() and "diagnosis:" in plan.read_text()
    assert main(["diagnose", str(plan), "--recording", str(file)]) == 0, capsys.readouterr().err


def test_the_earth_rate_in_several_poses_is_no_rate_table(tmp_path: Path) -> None:
    """Gyros with a noise of 0.6 deg/h per sample rest in 12 directions. Their means differ by up to 22 deg/h."""
    draw = np.random.default_rng(0)
    rate, up = 15.041067 / 3600, np.random.default_rng(1).normal(size=(12, 3))
    up /= np.linalg.norm(up, axis=1)[:, np.newaxis]
    gyro, accel = [], []
    for one in up:
        north = np.cross(one, [0.3, 0.5, 0.81])
        north /= np.linalg.norm(north)
        gyro += [rate * (one + north) / np.sqrt(2) + draw.normal(0, 1.7e-4, (400, 3)), draw.normal(0, 20, (70, 3))]
        accel += [one + draw.normal(0, 1e-4, (400, 3)), one + draw.normal(0, 0.1, (70, 3))]
    stacked = np.concatenate(gyro), np.concatenate(accel)
    time = np.arange(len(stacked[0])) / RATE
    look = look_at(text(tmp_path / "r.csv", f"time_s,{IN_DPS_G}", rows(time, *stacked)))
    assert len(look.still) == 12 and look.dwells == ()


def test_one_window_is_left_out_at_each_end_of_slow_dwells(tmp_path: Path) -> None:
    """At 2 Hz, a window of 5 rows lasts 2.5 s."""
    draw = np.random.default_rng(2)
    rate = np.repeat([0.0, 10.0, 0.0, 30.0, 0.0], 60)
    gyro = np.column_stack([0 * rate, 0 * rate, rate]) + draw.normal(0, 0.05, (len(rate), 3))
    accel = draw.normal([0.01, -0.005, 1.0], 0.001, (len(rate), 3))
    file = text(tmp_path / "r.csv", f"time_s,{IN_DPS_G}", rows(np.arange(len(rate)) / 2, gyro, accel))
    look = look_at(file)
    assert look.windows.length == pytest.approx(2.5)
    assert len(look.dwells) >= 3
    for still, dwell in zip(look.still, look.dwells, strict=True):
        assert (dwell.start - still.start, still.end - dwell.end) == pytest.approx((2.5, 2.5))


@pytest.mark.parametrize("header", ["time_s,note,note", "time_s,gyro_t,gyro_t"])
def test_columns_of_the_same_name_are_left_out(tmp_path: Path, header: str) -> None:
    lines = [f"{t:.2f},a,b,{row}" for t, row in zip(TIME.tolist(), rows(GYRO * DEG, ACCEL / G), strict=True)]
    assert len(look_at(text(tmp_path / "r.csv", f"{header},{IN_DPS_G}", lines)).channels) == 6


def test_repeated_names_without_other_channels_are_refused(tmp_path: Path) -> None:
    file = text(tmp_path / "r.csv", "time_s,x,y,z,x,y,z", rows(TIME, GYRO, ACCEL))
    with pytest.raises(InputError):
        look_at(file)


@pytest.mark.parametrize(
    ("name", "sensed"),
    [
        ("imu_realtime_acc_x", "accel"),
        ("validation_gyro_x", "gyro"),
        ("labs_ax", "accel"),
        ("acc_time", ""),
        ("accTimestamp", ""),
        ("gyro_valid", ""),
        ("acc_abs", ""),
        ("accAbs", ""),
    ],
)
def test_words_that_tell_no_sample_count_only_as_words(name: str, sensed: str) -> None:
    assert guessed_channel(name).sensed == sensed
