"""The formats of recordings: each written by its own library, read back to the same numbers; and files that mean harm."""

from __future__ import annotations

import json
import pickle
import sqlite3
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter
from numpy.typing import NDArray
from scipy.io import savemat

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.formats import arrays, json_samples, workbook
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment

ROWS = 1000
TIME = 5.0 + np.arange(ROWS) / 100
RATE = np.random.default_rng(3).normal(0.0, 2.0, (ROWS, 3)).round(6)


def described(keys: str) -> tuple[RecordingParameters, list[str]]:
    """A recording of 100 Hz as the bench describes it, and what is wrong with the description."""
    log = Findings()
    text = f"kind: imu\nsample_rate: 100 Hz\n{keys}"
    made = RecordOf(RecordingParameters).read(source.parse(text, "bench.yaml"), log)
    return made, [one.message for one in log]


def player(folder: Path, keys: str) -> RecordingPlayer:
    parameters, faults = described(keys)
    assert faults == []
    return RecordingPlayer.open(parameters, [folder / name for name in parameters.files], None, VirtualClock())


def read(folder: Path, keys: str) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Times, from that of the first row, and channels."""
    blocks = list(player(folder, keys).stream(Segment(0, "all", None, "unknown", Rest(), None)))
    names = blocks[0].channels
    time = np.concatenate([block.time for block in blocks])
    return time, {name: np.concatenate([block.channels[name] for block in blocks]) for name in names}


def columns(names: Mapping[str, str]) -> str:
    return (
        "channels: {"
        + ", ".join(f"{name}: {{column: '{column}', unit: deg/s}}" for name, column in names.items())
        + "}"
    )


def write_semicolons(folder: Path) -> str:
    lines = ["t;x;y;z"] + [
        ";".join(f"{value!r}".replace(".", ",") for value in (float(t), *map(float, row)))
        for t, row in zip(TIME, RATE, strict=True)
    ]
    (folder / "r.csv").write_text("\n".join(lines), encoding="utf-8")
    keys = "file: r.csv\nformat: {type: text, separator: semicolon, decimal: comma}\ntime: {column: t}\n"
    return keys + columns({"x": "x", "z": "z"})


def write_blanks(folder: Path) -> str:
    np.savetxt(folder / "r.log", np.column_stack([TIME, RATE]), fmt="%14.8f", delimiter=" \t ")
    keys = "file: r.log\nformat: {type: text, separator: blanks, names: [t, a, b, c]}\ntime: {column: t}\n"
    return keys + columns({"x": "a", "z": "c"})


def write_blanks_after_remarks(folder: Path) -> str:
    np.savetxt(
        folder / "r.log", np.column_stack([TIME, RATE]), fmt="%14.8f", header="device 7\n t  x  y  z", comments=""
    )
    keys = "file: r.log\nformat: {type: text, separator: blanks, skip: 1}\ntime: {column: t}\n"
    return keys + columns({"x": "x", "z": "z"})


def write_after_remarks(folder: Path) -> str:
    """Lines of name,value before the header, in UTF-16."""
    lines = ["device,7", "range,250", "t,x,y,z"] + [
        ",".join(repr(float(value)) for value in (t, *row)) for t, row in zip(TIME, RATE, strict=True)
    ]
    (folder / "r.txt").write_text("\r\n".join(lines), encoding="utf-16")
    return "file: r.txt\nformat: {type: text, skip: 2, encoding: utf-16}\ntime: {column: t}\n" + columns(
        {"x": "x", "z": "z"}
    )


def write_binary(folder: Path) -> str:
    table = np.column_stack([TIME, RATE]).astype("<f8")
    (folder / "r.bin").write_bytes(b"HEAD" + table.tobytes())
    fields = ", ".join(f"{name}: {{at: {8 * k}, type: f64, little_endian: true}}" for k, name in enumerate("txyz"))
    keys = f"file: r.bin\nformat: {{type: binary, skip: 4, length: 32, fields: {{{fields}}}}}\ntime: {{column: t}}\n"
    return keys + columns({"x": "x", "z": "z"})


def write_matlab(folder: Path) -> str:
    savemat(folder / "r.mat", {"imu": {"t": TIME, "rate": RATE}, "text": "free"}, do_compression=True)
    return "file: r.mat\ntime: {column: imu.t}\n" + columns({"x": "'imu.rate[1]'".strip("'"), "z": "imu.rate[3]"})


def write_hdf5(folder: Path, name: str = "r.h5") -> str:
    with h5py.File(folder / name, "w") as file:
        file["imu/t"] = TIME
        file.create_dataset("imu/rate", data=RATE, compression="gzip")
    return f"file: {name}\ntime: {{column: imu/t}}\n" + columns({"x": "imu/rate[1]", "z": "imu/rate[3]"})


def write_matlab_7_3(folder: Path) -> str:
    """As MATLAB does: HDF5 behind 512 bytes of its own, matrices transposed."""
    with h5py.File(folder / "r.mat", "w", userblock_size=512) as file:
        file["t"] = TIME[np.newaxis]
        file["rate"] = RATE.T
    with (folder / "r.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")
    return "file: r.mat\ntime: {column: t}\n" + columns({"x": "rate[1]", "z": "rate[3]"})


def write_numpy(folder: Path) -> str:
    np.save(folder / "r.npy", np.column_stack([TIME, RATE]))
    return "file: r.npy\ntime: {column: 'data[1]'}\n" + columns({"x": "data[2]", "z": "data[4]"})


def write_numpy_table(folder: Path) -> str:
    table = np.zeros(ROWS, [("t", "f8"), ("x", "f8"), ("z", "f8")])
    table["t"], table["x"], table["z"] = TIME, RATE[:, 0], RATE[:, 2]
    np.save(folder / "r.npy", table)
    return "file: r.npy\ntime: {column: t}\n" + columns({"x": "x", "z": "z"})


def write_numpy_packed(folder: Path) -> str:
    np.savez_compressed(folder / "r.npz", t=TIME, rate=RATE)
    return "file: r.npz\ntime: {column: t}\n" + columns({"x": "rate[1]", "z": "rate[3]"})


def write_sqlite(folder: Path) -> str:
    with sqlite3.connect(folder / "r.db") as base:
        base.execute("CREATE TABLE notes (text TEXT)")
        base.execute('CREATE TABLE samples (t REAL, x REAL, "the ""z""" REAL)')
        rows = [(float(t), float(row[0]), float(row[2])) for t, row in zip(TIME, RATE, strict=True)]
        base.executemany("INSERT INTO samples VALUES (?, ?, ?)", rows)
    base.close()
    keys = "file: r.db\nformat: {type: sqlite, table: samples}\ntime: {column: t}\n"
    return keys + columns({"x": "x", "z": 'the "z"'})


def json_rows() -> list[dict[str, object]]:
    return [
        {"t": float(t), "rate": {"x": float(row[0])}, "list": [None, float(row[2])]}
        for t, row in zip(TIME, RATE, strict=True)
    ]


def write_json_lines(folder: Path) -> str:
    (folder / "r.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in json_rows()), encoding="utf-8")
    return "file: r.jsonl\ntime: {column: t}\n" + columns({"x": "rate.x", "z": "list[2]"})


def write_json_list(folder: Path) -> str:
    """With a BOM, and a list that a key names."""
    held = {"a": json_rows()[:5], "b": {"imu": json_rows()}}
    (folder / "r.json").write_text(json.dumps(held, indent=2), encoding="utf-8-sig")
    keys = "file: r.json\nformat: {type: json, samples: b.imu}\ntime: {column: t}\n"
    return keys + columns({"x": "rate.x", "z": "list[2]"})


def write_json_columns(folder: Path) -> str:
    held = {"t": TIME.tolist(), "rates": RATE.tolist(), "calibration": [1.0, 0.5]}
    (folder / "r.json").write_text(json.dumps(held), encoding="utf-8")
    return "file: r.json\ntime: {column: t}\n" + columns({"x": "rates[1]", "z": "rates[3]"})


def write_excel(folder: Path) -> str:
    book = openpyxl.Workbook()
    book.active.title = "notes"
    sheet = book.create_sheet("Run 3")
    for row in [["serial", 7], [], ["t", "x", "remark", "z"]]:
        sheet.append(row)
    for k, (t, row) in enumerate(zip(TIME.tolist(), RATE.tolist(), strict=True)):
        sheet.append([t, row[0], "start" if k == 0 else None, row[2]])
        if k == 500:
            sheet.append([])
    book.save(folder / "r.xlsx")
    keys = "file: r.xlsx\nformat: {type: excel, sheet: Run 3, skip: 2}\ntime: {column: t}\n"
    return keys + columns({"x": "x", "z": "z"})


def write_tdms(folder: Path) -> str:
    """Three writes, a channel of texts and another group; the time is that of the waveforms."""
    wave = {"wf_start_offset": 5.0, "wf_increment": 0.01}
    with TdmsWriter(folder / "r.tdms") as writer:
        for rows in np.split(RATE, [300, 310]):
            channels = [
                ChannelObject("IMU", name, rows[:, k].copy(), wave) for k, name in enumerate(("x", "y", "it's/z"))
            ]
            writer.write_segment(
                [*channels, ChannelObject("IMU", "note", ["a"]), ChannelObject("slow", "x", rows[:5, 0].copy())]
            )
    keys = "file: r.tdms\ntime: {column: IMU/wf_time_s}\n"
    return keys + 'channels: {x: {column: IMU/x, unit: deg/s}, z: {column: "IMU/it\'s/z", unit: deg/s}}'


WRITERS = (
    write_tdms,
    write_excel,
    write_json_lines,
    write_json_list,
    write_json_columns,
    write_semicolons,
    write_blanks,
    write_blanks_after_remarks,
    write_after_remarks,
    write_binary,
    write_matlab,
    write_hdf5,
    write_matlab_7_3,
    write_numpy,
    write_numpy_table,
    write_numpy_packed,
    write_sqlite,
)


@pytest.mark.parametrize("batch", [65_536, 77])
@pytest.mark.parametrize("write", WRITERS)
def test_every_format_gives_the_numbers_that_its_library_wrote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[Path], str], batch: int
) -> None:
    monkeypatch.setattr(format_file, "BATCH", batch)
    monkeypatch.setattr(json_samples, "ROWS", batch)
    monkeypatch.setattr(workbook, "ROWS", batch)
    time, channels = read(tmp_path, write(tmp_path))
    np.testing.assert_allclose(time, TIME - TIME[0], rtol=0, atol=2e-9)
    np.testing.assert_allclose(channels["x"], RATE[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(channels["z"], RATE[:, 2], rtol=0, atol=1e-12)


def test_frames_with_a_checksum_and_a_counter_that_wraps(tmp_path: Path) -> None:
    """Bytes between frames, a frame with a wrong sum and a cut last frame are left out and counted; the clock passes 2^16."""
    frames = []
    for k in range(400):
        body = b"\xaa\x55" + struct.pack(">Hh", (60_000 + 250 * k) % 65_536, k - 200)
        frames.append(body + struct.pack(">H", sum(body) & 0xFFFF))
    frames[100] = frames[100][:-1] + bytes([frames[100][-1] ^ 1])
    (tmp_path / "r.bin").write_bytes(b"".join(frames[:200]) + b"noise" + b"".join(frames[200:]) + frames[0][:5])
    keys = (
        "file: r.bin\nformat: {type: binary, length: 8, sync: AA 55, checksum: {type: sum16}, fields: "
        "{clock: {at: 2, type: u16}, rate: {at: 4, type: i16, scale: 0.5, zero: 1}}}\n"
        "time: {column: clock, per_second: 25000, wraps: 65536}\n" + columns({"x": "rate"})
    )
    time, channels = read(tmp_path, keys)
    kept = np.delete(np.arange(400), 100)
    np.testing.assert_allclose(time, kept / 100, atol=1e-9)
    np.testing.assert_allclose(channels["x"], 0.5 * (kept - 200) + 1)
    log = Findings()
    player(tmp_path, keys).look_over([Segment(0, "all", None, "unknown", Rest(), None)], log)
    said = [one.message for one in log if one.code == "recording-corrupt"]
    assert any("2 records that are corrupt or not where they are expected" in one for one in said), said
    assert any("13 bytes outside of good records" in one for one in said), said


def test_rows_without_time_are_counted_through_all_files(tmp_path: Path) -> None:
    for number, part in enumerate(np.split(RATE, [300, 310])):
        np.savetxt(tmp_path / f"r{number}.csv", part, delimiter=",", header="x,y,z", comments="")
    time, channels = read(
        tmp_path, "file: r0.csv\ncontinued_by: [r1.csv, r2.csv]\ntime: sample_count\n" + columns({"x": "x"})
    )
    np.testing.assert_allclose(time, np.arange(ROWS) / 100, atol=1e-9)
    np.testing.assert_allclose(channels["x"], RATE[:, 0])


def test_files_whose_time_begins_anew(tmp_path: Path) -> None:
    for name, part in (("up.npy", slice(0, 400)), ("down.npy", slice(400, ROWS))):
        np.save(tmp_path / name, np.column_stack([TIME[: RATE[part].shape[0]], RATE[part]]))
    keys = "file: up.npy\ncontinued_by: down.npy\ntime: {column: 'data[1]'}\n" + columns({"x": "data[2]"})
    with pytest.raises(InstrumentError, match=r"down\.npy: it begins at 5 s, but the file before it ends at 8\.99 s"):
        read(tmp_path, keys)
    time, channels = read(tmp_path, keys + "\npause_between_files: 30 s")
    np.testing.assert_allclose(channels["x"], RATE[:, 0])
    assert time[400] - time[399] == pytest.approx(30)
    parted = player(tmp_path, keys + "\npause_between_files: 30 s\npauses: 10 s")
    assert [round(one.seconds, 6) for one in parted.parted] == [4.0, 6.0]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("format: {type: binary, length: 8, fields: {x: {at: 6, type: i32}}}", "'x' ends after the record of 8 bytes"),
        ("format: {type: binary, length: 8, fields: {}}", "a record without fields gives no samples"),
        (
            "format: {type: binary, length: 8, fields: {x: {at: 0, type: i32}}, checksum: {type: crc8}}",
            "a checksum is verified only in records that begin with sync bytes",
        ),
        ("format: {type: csv}", "unknown type 'csv'"),
        ("format: {type: parquet, skip: 3}", "unknown key 'skip'"),
        (
            "time: {column: t, unit: ms, per_second: 5}",
            "the unit of the time is given twice, by `unit` and by `per_second`",
        ),
        ("time: {column: t, wraps: 0}", "a positive number is needed here"),
    ],
)
def test_a_description_that_contradicts_itself(keys: str, said: str) -> None:
    _, faults = described(f"file: r.bin\n{columns({'x': 'x'})}\n{keys}")
    assert said in faults


def refusal(folder: Path, keys: str) -> str:
    with pytest.raises(InstrumentError) as caught:
        read(folder, keys)
    assert len(str(caught.value)) < 600
    return str(caught.value)


def test_an_array_that_is_not_there_is_answered_with_those_that_are(tmp_path: Path) -> None:
    keys = write_matlab(tmp_path).replace("imu.rate[3]", "imu.gyro[3]")
    assert "its arrays are imu.t (1 × 1000), imu.rate (1000 × 3)" in refusal(tmp_path, keys)


def test_arrays_of_different_lengths(tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", t=TIME[:-1], rate=RATE)
    keys = "file: r.npz\ntime: {column: t}\n" + columns({"x": "rate[1]"})
    assert "'t' has 999 rows and 'rate[1]' has 1000" in refusal(tmp_path, keys)


def test_the_separator_is_named_where_it_is_another_one(tmp_path: Path) -> None:
    keys = write_semicolons(tmp_path).replace("format: {type: text, separator: semicolon, decimal: comma}\n", "")
    assert "`format: {type: text, separator: semicolon}`" in refusal(tmp_path, keys)


class Thing:
    """An object whose unpickling would show."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return (Path.touch, (Path("unpickled"),))  # type: ignore[return-value]


def test_pickled_objects_are_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "r.npy", np.array([Thing()], dtype=object), allow_pickle=True)
    assert b"unpickled" in pickle.dumps(Thing())
    refusal(tmp_path, "file: r.npy\ntime: sample_count\n" + columns({"x": "data"}))
    assert not (tmp_path / "unpickled").exists()


def test_links_of_hdf5_to_other_files_are_not_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    write_hdf5(outside, "secret.h5")
    inside = tmp_path / "data"
    inside.mkdir()
    with h5py.File(inside / "r.h5", "w") as file:
        file["t"] = TIME
        file["x"] = h5py.ExternalLink(str(outside / "secret.h5"), "imu/t")
        layout = h5py.VirtualLayout(shape=(ROWS,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(outside / "secret.h5"), "imu/t", shape=(ROWS,))
        file.create_virtual_dataset("y", layout)
        file.create_dataset("z", (10,), "f8", external=[(str(outside / "secret.h5"), 0, 80)])
        file["s"] = h5py.SoftLink("/x")
    for name in "xyzs":
        assert f"no column '{name}'" in refusal(inside, "file: r.h5\ntime: {column: t}\n" + columns({"x": name}))


def test_an_array_that_unpacks_to_more_than_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrays, "MAX_UNPACKED", 1_000_000)
    savemat(tmp_path / "r.mat", {"x": np.zeros(1_000_000)}, do_compression=True)
    assert (tmp_path / "r.mat").stat().st_size < 20_000
    message = "its arrays have more than 0.001 GB"
    assert message in refusal(tmp_path, "file: r.mat\ntime: sample_count\n" + columns({"x": "x"}))
    np.savez_compressed(tmp_path / "r.npz", x=np.zeros(1_000_000))
    assert message in refusal(tmp_path, "file: r.npz\ntime: sample_count\n" + columns({"x": "x"}))


def test_a_view_of_sqlite_is_not_run(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "r.db") as base:
        base.execute("CREATE VIEW samples AS SELECT 1.0 AS t, 2.0 AS x")
    base.close()
    assert "has no tables" in refusal(tmp_path, "file: r.db\ntime: {column: t}\n" + columns({"x": "x"}))


def test_a_database_whose_schema_is_damaged(tmp_path: Path) -> None:
    """The message of SQLite shows the damaged text, which is not UTF-8."""
    with sqlite3.connect(tmp_path / "r.db") as base:
        base.execute("CREATE TABLE samples(t REAL, x REAL)")
    base.close()
    whole = (tmp_path / "r.db").read_bytes()
    (tmp_path / "r.db").write_bytes(whole.replace(b"samples(t ", b"samples(\xcc "))
    assert refusal(tmp_path, "file: r.db\ntime: {column: t}\n" + columns({"x": "x"})).startswith("r.db")


@pytest.mark.parametrize(
    "name", ["r.mat", "r.npy", "r.npz", "r.h5", "r.db", "r.ulg", "r.parquet", "r.json", "r.xlsx", "r.tdms"]
)
@pytest.mark.parametrize(
    "content",
    [b"", b"PK\x03\x04", b"TDSm" + bytes(200), b"\x89HDF\r\n\x1a\n", bytes(range(256)) * 20, zlib.compress(b"x" * 999)],
)
def test_a_file_that_is_none_of_its_format_is_refused_in_words(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    assert refusal(tmp_path, f"file: {name}\ntime: {{column: t}}\n" + columns({"x": "x"})).startswith(name)


def test_channels_of_tdms_of_different_lengths(tmp_path: Path) -> None:
    keys = write_tdms(tmp_path).split("channels")[0]
    said = refusal(tmp_path, keys + columns({"x": "slow/x"}))
    assert "r.tdms: 'slow/x' has 15 rows and 'IMU/wf_time_s' has 1000" in said
    said = refusal(tmp_path, keys + columns({"x": "x"}))
    assert "r.tdms has no column 'x'; its columns are 'IMU/wf_time_s', 'IMU/x'" in said


@pytest.mark.parametrize("size", range(0, 3000, 61))
def test_a_tdms_file_that_is_cut_is_read_up_to_there_or_refused(tmp_path: Path, size: int) -> None:
    keys = write_tdms(tmp_path)
    whole = (tmp_path / "r.tdms").read_bytes()
    (tmp_path / "r.tdms").write_bytes(whole[:size])
    said, kept = "r.tdms", RATE[:0, 0]
    try:
        kept = read(tmp_path, keys)[1]["x"]
    except InstrumentError as error:
        said = str(error)
    assert said.startswith("r.tdms")
    np.testing.assert_array_equal(kept, RATE[: len(kept), 0])
