"""ROS bags: written byte by byte and by the package rosbags, in every form; messages of other types; and bags that are damaged or mean
harm."""

from __future__ import annotations

import bz2
import contextlib
import functools
import os
import re
import shutil
import sqlite3
import struct
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.formats import bag_files, ros_messages, rosbag
from planrunner.instruments.formats.choice import Format, open_file
from planrunner.instruments.formats.file import AnyFile, NoKeys, TimeStamps
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment
from tests import ros_bytes

COUNT = 350
CHANNELS = [f"/imu.{vector}.{x}" for vector in ("angular_velocity", "linear_acceleration") for x in "xyz"]
MORE = ["/imu.orientation.w", *(f"/imu.{one}_covariance[9]" for one in ("orientation", "linear_acceleration"))]
BIG_ENDIAN = functools.partial(ros_bytes.imu_in_cdr, order=">")
ODD_FRAME = functools.partial(ros_bytes.imu_in_cdr, frame="i")
Write = Callable[[Path], Path]


def put(name: str, content: bytes) -> Write:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


def opened(path: Path, *channels: str, time: str | None = "/imu.header.stamp", given: Format | None = None) -> AnyFile:
    stamps = TimeStamps(time, period=0.01)
    return open_file(path, path.name, stamps, {one: one for one in channels or CHANNELS}, given)


def read(file: AnyFile) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    file.look()
    parts = list(file.rows())
    names = parts[0][1]
    return np.concatenate([time for time, _ in parts]), {
        name: np.concatenate([values[name] for _, values in parts]) for name in names
    }


def refusal(file: AnyFile) -> str:
    with pytest.raises(InstrumentError) as caught:
        read(file)
    assert len(str(caught.value)) < 700
    return str(caught.value)


# -- the same samples in every form ------------------------------------------------------------------------------------


def of_ros1(compression: Writer1.CompressionFormat | None) -> Write:
    """Written by rosbags, together with another topic."""

    def write(folder: Path) -> Path:
        store = get_typestore(Stores.ROS1_NOETIC)
        writer = Writer1(folder / "r.bag")
        if compression is not None:
            writer.set_compression(compression)
        number = store.types["std_msgs/msg/Float64"]
        with writer:
            other = writer.add_connection("/other", "std_msgs/msg/Float64", typestore=store)
            imu = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
            for time, data in ros_bytes.samples(COUNT, ros_bytes.imu_of_ros1):
                writer.write(other, time, store.serialize_ros1(number(1.5), "std_msgs/msg/Float64"))
                writer.write(imu, time, data)
        return folder / "r.bag"

    return write


def of_ros2(plugin: StoragePlugin, mode: CompressionMode, version: int = 9, name: str = "") -> Write:
    """Written by rosbags as a folder. `name`: the file of the folder that is read; by default the folder."""

    def write(folder: Path) -> Path:
        store = get_typestore(Stores.ROS2_HUMBLE)
        writer = Writer2(folder / "bag", version=version, storage_plugin=plugin)  # type: ignore[arg-type]
        if mode is not CompressionMode.NONE:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        number = store.types["std_msgs/msg/Float64"]
        with writer:
            other = writer.add_connection("/other", "std_msgs/msg/Float64", typestore=store)
            imu = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
            for time, data in ros_bytes.samples(COUNT, ros_bytes.imu_in_cdr):
                writer.write(other, time, store.serialize_cdr(number(1.5), "std_msgs/msg/Float64"))
                writer.write(imu, time, data)
        return folder / "bag" / name if name else folder / "bag"

    return write


def in_database(folder: Path) -> Path:
    return ros_bytes.database(folder / "r.db3", ros_bytes.samples(COUNT, ros_bytes.imu_in_cdr))


def split(folder: Path) -> Path:
    """A folder with two files of an old version of rosbag2, which states their paths relative to the folder above."""
    whole = ros_bytes.samples(COUNT, ros_bytes.imu_in_cdr)
    (folder / "bag").mkdir()
    ros_bytes.database(folder / "bag" / "bag_0.db3", whole[:200])
    ros_bytes.database(folder / "bag" / "bag_1.db3", whole[200:])
    listing = "rosbag2_bagfile_information:\n  version: 2\n  relative_file_paths: [bag/bag_0.db3, bag/bag_1.db3]\n"
    (folder / "bag" / "metadata.yaml").write_text(listing)
    return folder / "bag"


def without_a_suffix(folder: Path) -> Path:
    return put("recorded", ros_bytes.mcap(ros_bytes.samples(COUNT, ros_bytes.imu_in_cdr)))(folder)


ROS1, CDR = (ros_bytes.samples(COUNT, write) for write in (ros_bytes.imu_of_ros1, ros_bytes.imu_in_cdr))
FORMS: dict[str, Write] = {
    "ros 1, by hand": put("r.bag", ros_bytes.bag_of_ros1(ROS1)),
    "ros 1, not closed": put("r.bag", ros_bytes.bag_of_ros1(ROS1, closed=False)),
    "ros 1, active": put("r.bag.active", ros_bytes.bag_of_ros1(ROS1, closed=False)),
    "ros 1": of_ros1(None),
    "ros 1 in bz2": of_ros1(Writer1.CompressionFormat.BZ2),
    "ros 1 in lz4": of_ros1(Writer1.CompressionFormat.LZ4),
    "mcap, by hand": put("r.mcap", ros_bytes.mcap(CDR)),
    "mcap, no chunks": put("r.mcap", ros_bytes.mcap(CDR, chunked=False)),
    "mcap, no summary": put("r.mcap", ros_bytes.mcap(CDR, summary=False)),
    "mcap, big-endian": put("r.mcap", ros_bytes.mcap(ros_bytes.samples(COUNT, BIG_ENDIAN))),
    "mcap, short frame": put("r.mcap", ros_bytes.mcap(ros_bytes.samples(COUNT, ODD_FRAME))),
    "mcap, no definition": put("r.mcap", ros_bytes.mcap(CDR, definition="", schema="")),
    "mcap of ros 1": put(
        "r.mcap",
        ros_bytes.mcap(ROS1, kind="sensor_msgs/Imu", definition=ros_bytes.IMU_1, schema="ros1msg", encoding="ros1"),
    ),
    "mcap, other name": without_a_suffix,
    "mcap folder": of_ros2(StoragePlugin.MCAP, CompressionMode.NONE),
    "mcap in a folder": of_ros2(StoragePlugin.MCAP, CompressionMode.NONE, name="bag.mcap"),
    "mcap in zstd": of_ros2(StoragePlugin.MCAP, CompressionMode.STORAGE),
    "db3, by hand": in_database,
    "db3, split": split,
    "db3 folder": of_ros2(StoragePlugin.SQLITE3, CompressionMode.NONE),
    "db3 folder, version 8": of_ros2(StoragePlugin.SQLITE3, CompressionMode.NONE, 8),
    "db3 in a folder": of_ros2(StoragePlugin.SQLITE3, CompressionMode.NONE, name="bag.db3"),
    "db3, messages in zstd": of_ros2(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("batch", [7, rosbag.BATCH])
def test_every_form_gives_the_numbers_that_were_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, batch: int
) -> None:
    monkeypatch.setattr(rosbag, "BATCH", batch)
    path = FORMS[form](tmp_path)
    given = (
        None
        if path.suffix in (".bag", ".mcap", ".db3") or path.is_dir()
        else Format(type="rosbag", parameters=NoKeys())
    )
    file = opened(path, *CHANNELS, *MORE, "/imu.receive_time", given=given)
    time, found = read(file)
    np.testing.assert_allclose(time, 1_700_000_000 + np.arange(COUNT) / 100, rtol=0, atol=3e-7)
    np.testing.assert_array_equal(np.column_stack([found[one] for one in CHANNELS]), ros_bytes.truth(COUNT))
    assert {one: set(found[one].tolist()) for one in MORE} == dict(zip(MORE, ({0.8}, {1.0}, {3.0}), strict=True))
    np.testing.assert_allclose(found["/imu.receive_time"] - time, 0.002, atol=3e-7)
    unclosed = "not closed" in form or "active" in form
    assert file.remarks == (
        ("messages that the recorder did not write to the file before it stopped (the bag was not closed)",) * unclosed
    )
    assert file.rows_about() == COUNT


def test_units_and_order_of_the_columns(tmp_path: Path) -> None:
    file = opened(FORMS["ros 1, by hand"](tmp_path))
    columns = file.columns()
    assert columns[:2] == ["/imu.header.stamp", "/imu.header.seq"] and columns[-1] == "/imu.receive_time"
    assert len(columns) == 2 + 37 + 1
    units = file.units()
    assert {units[one] for one in CHANNELS[:3]} == {"rad/s"} and {units[one] for one in CHANNELS[3:]} == {"m/s^2"}
    assert units["/imu.header.stamp"] == units["/imu.receive_time"] == "s" and len(units) == 8
    assert file.contents() == ("topic /imu: 350 messages of the type sensor_msgs/Imu",)


def test_the_time_of_reception_and_counted_rows(tmp_path: Path) -> None:
    path = FORMS["mcap, by hand"](tmp_path)
    time, _ = read(opened(path, time="/imu.receive_time"))
    assert time[0] == pytest.approx(1_700_000_000.002, abs=3e-7)
    time, _ = read(opened(path, time=None))
    np.testing.assert_allclose(time, np.arange(COUNT) / 100, atol=1e-12)


def test_the_example_of_the_documentation_is_played_back(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "recording-formats.md").read_text(encoding="utf-8")
    example = re.search(r"## ROS bags\n\n```yaml\nimu:\n(.*?)```", page, re.DOTALL)
    assert example is not None
    keys = "\n".join(line[2:] for line in example[1].splitlines() if "driver:" not in line)
    log = Findings()
    parameters = RecordOf(RecordingParameters).read(source.parse(keys, "bench.yaml"), log)
    assert parameters is not None and not list(log)
    path = put(parameters.file, ros_bytes.mcap(CDR, topic="/imu/data"))(tmp_path)
    player = RecordingPlayer.open(parameters, [path], None, VirtualClock())
    blocks = list(player.stream(Segment(0, "all", None, "unknown", Rest(), None)))
    for channel, column in (("gyro_x", 0), ("accel_x", 3)):
        values = np.concatenate([block.channels[channel] for block in blocks])
        np.testing.assert_array_equal(values, ros_bytes.truth(COUNT)[:, column])


# -- types of messages -------------------------------------------------------------------------------------------------

NUMBERS = ["bool", "float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))]


class RandomTypes:
    """Definitions of types with random fields, and random messages of them."""

    def __init__(self, seed: int):
        self.draw = np.random.default_rng(seed)
        self.texts: list[str] = []
        for depth in range(3):
            self.texts.append("".join(self._line(k, depth) for k in range(self.draw.integers(1, 7))))

    def _line(self, number: int, depth: int) -> str:
        kinds = [*NUMBERS, "string", *(["time", "duration"] if depth else []), *(f"Part{k}" for k in range(depth))]
        kind = str(self.draw.choice(kinds))
        kind = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}.get(kind, kind)
        return f"{kind}{self.draw.choice(['', '', '', '[3]', '[]', '[70]'])} field_{number}\n"

    @property
    def definition(self) -> str:
        parts = [f"{ros_bytes.LINE}MSG: own/Part{k}\n{text}" for k, text in enumerate(self.texts[:-1])]
        times = (
            f"{ros_bytes.LINE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
            f"{ros_bytes.LINE}MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
        )
        return self.texts[-1] + "".join(parts) + times

    def value(self, store: Typestore, desc: FieldDesc) -> object:
        if desc[0] == Nodetype.NAME:
            return self.message(store, desc[1])
        if desc[0] == Nodetype.BASE:
            return self._plain(desc[1][0])
        element, count = desc[1]
        size = count if desc[0] == Nodetype.ARRAY else int(self.draw.integers(0, 5))
        values = [self.value(store, element) for _ in range(size)]
        plain = element[0] == Nodetype.BASE and element[1][0] != "string"
        return np.array(values, element[1][0]) if plain else values

    def _plain(self, kind: str) -> object:
        if kind == "string":
            return "é" * int(self.draw.integers(0, 5))
        if kind == "bool":
            return bool(self.draw.integers(0, 2))
        if kind.startswith("float"):
            return float(np.dtype(kind).type(self.draw.normal()))
        limits = np.iinfo(kind)
        return int(self.draw.integers(limits.min, limits.max, dtype=kind, endpoint=True))

    def message(self, store: Typestore, name: str) -> object:
        if name.startswith("builtin_interfaces"):
            return store.types[name](*self.draw.integers(0, 10**9, 2).tolist())
        fields = store.fielddefs[name][1]
        return store.types[name](*(self.value(store, desc) for _, desc in fields))  # type: ignore[arg-type]


def numbers_of(store: Typestore, value: object, desc: FieldDesc, name: str) -> dict[str, float]:
    """The numeric fields of a value that rosbags has drawn or decoded, without lists, texts and arrays of more than 64 elements."""
    if desc[0] == Nodetype.SEQUENCE:
        return {}
    if desc[0] == Nodetype.ARRAY:
        element, count = desc[1]
        values = zip(range(1, count + 1), value, strict=True)  # type: ignore[call-overload]
        parts = [numbers_of(store, one, element, f"{name}[{k}]") for k, one in values if count <= 64]
        return {key: number for part in parts for key, number in part.items()}
    if desc[0] == Nodetype.BASE:
        return {} if isinstance(value, str) else {name: float(value)}  # type: ignore[arg-type]
    kind = str(desc[1])
    if kind in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
        return {name: value.sec + 1e-9 * value.nanosec}  # type: ignore[attr-defined]
    found: dict[str, float] = {}
    for field, inner in store.fielddefs[kind][1]:
        found.update(numbers_of(store, getattr(value, field), inner, f"{name}.{field}" if name else field))
    return found


@pytest.mark.parametrize("seed", range(60))
def test_random_types_are_decoded_as_rosbags_decodes_them(seed: int) -> None:
    random = RandomTypes(seed)
    definition = random.definition
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, "own/Whole"))
    for is_cdr in (True, False):
        of_type = ros_messages.message_type("own/Whole", definition, is_cdr=is_cdr)
        fields = list(of_type.fields())
        reader = ros_messages.MessageReader(of_type, fields)
        for turn in range(4):
            message = random.message(store, "own/msg/Whole")
            if is_cdr:
                data = store.serialize_cdr(message, "own/msg/Whole", little_endian=turn % 2 == 0)
            else:
                data = store.serialize_ros1(message, "own/msg/Whole")
            found = reader.values([reader.numbers(bytes(data))])
            expected = numbers_of(store, message, (Nodetype.NAME, "own/msg/Whole"), "")
            assert list(found) == list(expected)
            for name in fields:
                assert found[name][0] == pytest.approx(expected[name], rel=1e-15, abs=1e-9), name


def test_every_type_of_ros_has_fields_or_a_reason() -> None:
    unread = set()
    for name in get_typestore(Stores.ROS2_HUMBLE).fielddefs:
        try:
            ros_messages.message_type(name, "", is_cdr=True).fields()
        except ros_messages.UnreadableTypeError as error:
            unread.add(str(error))
    assert unread == set()


def test_a_magnetometer_a_thermometer_and_a_barometer(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = {"MagneticField": ("magnetic_field", "T"), "Temperature": ("temperature", "degC")}
    kinds["FluidPressure"] = ("fluid_pressure", "Pa")
    vector, header = store.types["geometry_msgs/msg/Vector3"], store.types["std_msgs/msg/Header"]
    writer = Writer2(tmp_path / "bag", version=9)
    with writer:
        for kind, (field, _) in kinds.items():
            name = f"sensor_msgs/msg/{kind}"
            made = writer.add_connection(f"/{field}", name, typestore=store)
            for k in range(20):
                stamp = header(store.types["builtin_interfaces/msg/Time"](5, k * 10**7), "")
                own = (vector(k, 2.0, 3.0), np.zeros(9)) if kind == "MagneticField" else (100.0 + k, 0.0)
                writer.write(made, k, store.serialize_cdr(store.types[name](stamp, *own), name))
    for kind, (field, unit) in kinds.items():
        column = f"/{field}.{field}.x" if kind == "MagneticField" else f"/{field}.{field}"
        file = opened(tmp_path / "bag", column, time=f"/{field}.header.stamp")
        time, found = read(file)
        np.testing.assert_allclose(time, 5 + np.arange(20) / 100)
        np.testing.assert_array_equal(found[column], (0 if kind == "MagneticField" else 100) + np.arange(20))
        assert file.units()[column] == unit


NESTED = "".join(f"{ros_bytes.LINE}MSG: own/T{k}\nT{k + 1}[64] a\nT{k + 1}[64] b\n" for k in range(15))
RECURSIVE = f"Node next\n{ros_bytes.LINE}MSG: own/Node\nNode next\n"


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("float64 x\nThing thing\n", "contains the type own/msg/Thing, whose definition is not in the bag"),
        (RECURSIVE, "contains types in types, more than 16 deep"),
        (f"T0[64] a\n{NESTED}{ros_bytes.LINE}MSG: own/T15\nfloat64 x\n", "has more than 5000 fields"),
        ("float64 x\nfloat64[99999999999999999999] y\n", "contains an array that is longer than any message"),
        ("float64 x; import os\n", "has a definition that is not in the form of a .msg file of ROS"),
        ("float64 x\n" * 40_000, "has a definition of more than 300000 characters"),
        ("wstring name\nfloat64 x\n", "contains the type own/msg/wstring, whose definition is not in the bag"),
        ("", "is not part of ROS, and the bag does not contain its definition"),
    ],
)
def test_a_type_that_cannot_be_read(tmp_path: Path, definition: str, reason: str) -> None:
    content = ros_bytes.mcap([(1, b"\0\1\0\0" + bytes(8))], topic="/own", kind="own/msg/Whole", definition=definition)
    file = opened(put("r.mcap", content)(tmp_path), "/own.x", time="/own.receive_time")
    assert (
        "r.mcap has no column '/own.receive_time'; it also lacks '/own.x'; the messages of /own cannot be read: its type "
        f"own/msg/Whole {reason}"
    ) in refusal(file)


def test_no_definition_is_executed(tmp_path: Path) -> None:
    """The names in a definition would be part of the code that rosbags generates."""
    marker = tmp_path / "executed"
    harm = f"__import__('pathlib').Path({str(marker)!r}).touch()"
    for definition in (
        f"float64 x = {harm}\n",
        f"float64 x\nstring A={harm}\n",
        f"float64 x\n{ros_bytes.LINE}MSG: own/{harm}\nfloat64 y\n",
    ):
        for kind in ("own/msg/Whole", f"own/msg/W:\n    {harm}\nclass V"):
            content = ros_bytes.mcap([(k, b"\0\1\0\0" + bytes(8)) for k in range(9)], kind=kind, definition=definition)
            file = opened(put("r.mcap", content)(tmp_path), "/imu.x", time="/imu.receive_time")
            with contextlib.suppress(InstrumentError):
                read(file)
    assert not marker.exists()


# -- what a bag does not contain ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["ros 1", "mcap folder", "db3 folder"])
@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (["/imv.angular_velocity.x"], "has no column '/imv.angular_velocity.x'; its topics are /"),
        (
            ["/imu.angular_velocity.u"],
            "has no column '/imu.angular_velocity.u'; did you mean '/imu.angular_velocity.",
        ),
        (["/imu"], "has no column '/imu'; its topics are /"),
        (["/other.data"], "its columns belong to the topics /imu and /other, whose messages have different times"),
    ],
)
def test_columns_that_a_bag_does_not_have(tmp_path: Path, form: str, columns: list[str], said: str) -> None:
    assert said in refusal(opened(FORMS[form](tmp_path), *columns))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("r.bag", ros_bytes.bag_of_ros1([])),
        ("r.bag", ros_bytes.bag_of_ros1([], closed=False)),
        ("r.mcap", ros_bytes.mcap([])),
        ("r.mcap", ros_bytes.mcap([], summary=False)),
    ],
)
def test_a_bag_without_messages(tmp_path: Path, name: str, content: bytes) -> None:
    assert refusal(opened(put(name, content)(tmp_path))).startswith(f"{name} contains no messages")
    path = ros_bytes.database(tmp_path / "r.db3", [])
    assert refusal(opened(path)).startswith("r.db3 contains no messages")


@pytest.mark.parametrize("is_cdr", [True, False])
def test_a_message_of_another_size_is_named(tmp_path: Path, is_cdr: bool) -> None:
    whole = list(CDR if is_cdr else ROS1)
    for wrong in (
        b"",
        b"\0",
        whole[0][1][:-8],
        whole[0][1] + bytes(8),
        whole[0][1][:12] + b"\xff" * 4 + whole[0][1][16:],
    ):
        whole[216] = (whole[216][0], wrong)
        content = ros_bytes.mcap(whole) if is_cdr else ros_bytes.bag_of_ros1(whole)
        path = put("r.mcap" if is_cdr else "r.bag", content)(tmp_path)
        said = refusal(opened(path))
        assert f"{path.name}, message 217 of /imu: this is not a message of the type sensor_msgs/" in said


def test_a_time_that_does_not_increase_is_named(tmp_path: Path) -> None:
    whole = [*CDR[:40], CDR[39], *CDR[40:]]
    said = refusal(opened(put("r.mcap", ros_bytes.mcap(whole))(tmp_path)))
    assert "r.mcap, message 41 of /imu: time does not increase: 1700000000.39 s after 1700000000.39 s" in said


def test_other_encodings_and_versions_are_named(tmp_path: Path) -> None:
    content = ros_bytes.mcap(CDR, encoding="json", schema="jsonschema")
    said = refusal(opened(put("r.mcap", content)(tmp_path)))
    assert "the messages of /imu cannot be read: its messages are encoded as 'json', not as in ROS" in said
    said = refusal(opened(put("r.bag", b"#ROSBAG V1.2\n" + bytes(99))(tmp_path)))
    assert (
        "r.bag is a bag of the version 1.2; planrunner reads version 2.0: convert it with `rosbag migrate r.bag NEW.bag`"
        in said
    )
    said = refusal(opened(put("r.mcap", b"\x28\xb5\x2f\xfd" + bytes(99))(tmp_path)))
    assert "r.mcap is compressed as a whole: unpack it first, for example with `zstd -d r.mcap`" in said
    said = refusal(opened(put("r.db3", b"t,x\n1,2\n")(tmp_path)))
    assert "r.db3 is not a ROS bag: it is neither a bag of ROS 1, an MCAP file nor a database of rosbag2" in said
    data = b"\0\x07\0\0" + CDR[0][1][4:]  # XCDR2
    said = refusal(opened(put("r.mcap", ros_bytes.mcap([(1, data)]))(tmp_path)))
    assert "it does not begin as a message in CDR: 00 07 00 00" in said


def test_files_that_are_compressed_as_a_whole(tmp_path: Path) -> None:
    path = of_ros2(StoragePlugin.SQLITE3, CompressionMode.FILE)(tmp_path)
    assert "bag.db3.zstd is compressed as a whole: unpack it first" in refusal(opened(path))


def test_two_types_on_one_topic(tmp_path: Path) -> None:
    path = ros_bytes.database(tmp_path / "r.db3", CDR)
    with sqlite3.connect(path) as base:
        base.execute("INSERT INTO topics VALUES (2, '/imu', 'std_msgs/msg/Float64', 'cdr', '')")
    base.close()
    assert "its messages have two types, sensor_msgs/msg/Imu and std_msgs/msg/Float64" in refusal(opened(path))


def test_definitions_that_differ_only_in_comments(tmp_path: Path) -> None:
    """Two publishers of a topic, one of which has comments and line ends of Windows in its definition."""
    other = ros_bytes.IMU_1.replace("\n", " # in SI units\r\n", 5).replace(
        "orientation\n", "orientation  # x, y, z, w\n", 1
    )
    for definition, is_fine in ((other, True), (ros_bytes.IMU_1.replace("float64[9]", "float64[3]", 1), False)):
        whole = ros_bytes.bag_of_ros1(ROS1[:200], definition=definition, closed=False)
        second = ros_bytes.connection(1, "/imu", "sensor_msgs/Imu", ros_bytes.IMU_1)
        rest = b"".join(ros_bytes.message(1, *one) for one in ROS1[200:])
        file = opened(put("r.bag", whole + ros_bytes.chunk(second + rest))(tmp_path))
        if is_fine:
            np.testing.assert_array_equal(read(file)[1][CHANNELS[0]], ros_bytes.truth(COUNT)[:, 0])
        else:
            assert "the bag contains two definitions of its type sensor_msgs/Imu" in refusal(file)


def test_the_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    said = refusal(opened(FORMS["ros 1, by hand"](tmp_path)))
    assert "reading ROS bags needs the package rosbags" in said and "pip install 'planrunner[recordings]'" in said


# -- damaged bags ------------------------------------------------------------------------------------------------------

WHOLE = {
    "r.bag": ros_bytes.bag_of_ros1(ROS1),
    "r.mcap": ros_bytes.mcap(CDR),
    "s.mcap": ros_bytes.mcap(CDR, chunked=False),
}


@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.05, 0.32, 0.5, 0.8, 0.95, 0.999])
def test_a_bag_that_is_cut_is_read_up_to_there_or_refused(tmp_path: Path, name: str, share: float) -> None:
    content = WHOLE[name][: int(share * len(WHOLE[name]))]
    file = opened(put(name, content)(tmp_path))
    if share < (0.04 if name == "s.mcap" else 0.1):  # a chunk has 100 messages
        assert refusal(file).startswith(name)
        return
    _, found = read(file)
    kept = len(found[CHANNELS[0]])
    np.testing.assert_array_equal(found[CHANNELS[0]], ros_bytes.truth(COUNT)[:kept, 0])
    assert kept >= 0.9 * share * COUNT - 100
    assert file.remarks and "incomplete" in file.remarks[-1]


@pytest.mark.parametrize("packed", [False, True])
def test_a_bag_whose_recorder_was_killed(tmp_path: Path, packed: bool) -> None:
    """The recorder of ROS 1 writes the size of a chunk after the chunk."""
    whole = ros_bytes.bag_of_ros1(ROS1[:200], closed=False)
    rest = b"".join(ros_bytes.message(0, *one) for one in ROS1[200:250])
    rest = lz4.frame.compress(rest) if packed else rest
    file = opened(put("r.bag", whole + ros_bytes.chunk(b"", "lz4" if packed else "none") + rest[:-20])(tmp_path))
    _, found = read(file)
    kept = 200 if packed else 249
    np.testing.assert_array_equal(found[CHANNELS[0]], ros_bytes.truth(250)[:kept, 0])
    assert file.remarks == (
        "messages that the recorder did not write to the file before it stopped (the bag was not closed)",
        "an incomplete record at the end of the file",
    )


def test_a_database_that_is_cut_is_refused(tmp_path: Path) -> None:
    path = in_database(tmp_path)
    whole = path.read_bytes()
    for share in (0.01, 0.1, 0.5, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        assert refusal(opened(path)).startswith("r.db3")


def test_a_database_whose_schema_is_damaged(tmp_path: Path) -> None:
    """The message of SQLite shows the damaged text."""
    path = in_database(tmp_path)
    whole = path.read_bytes()
    for wrong in (b"\x11", b"\xcc"):
        path.write_bytes(whole.replace(b"TABLE topics(id ", b"TABLE topics(%s%s " % (wrong, wrong)))
        said = refusal(opened(path))
        assert said.startswith("r.db3 is damaged: ") and said.isprintable()


def test_a_database_with_a_log_of_changes(tmp_path: Path) -> None:
    path = in_database(tmp_path)
    path.with_name("r.db3-wal").write_bytes(b"x")
    file = opened(path)
    read(file)
    assert file.remarks == ("the messages in r.db3-wal, because the bag was not closed",)


@pytest.mark.parametrize(
    "form", ["ros 1, by hand", "ros 1 in lz4", "ros 1 in bz2", "mcap, by hand", "mcap in zstd", "db3 folder"]
)
def test_changed_bytes_lead_to_a_message_or_to_numbers(tmp_path: Path, form: str) -> None:
    path = FORMS[form](tmp_path)
    draw = np.random.default_rng(4)
    target = next(one for one in path.iterdir() if one.suffix != ".yaml") if path.is_dir() else path
    whole = target.read_bytes()
    for _ in range(60):
        content = bytearray(whole)
        edge = draw.integers(0, 2) * (len(content) - 700)
        for at in draw.integers(edge, len(content), draw.integers(1, 6)).tolist():
            content[at] = draw.integers(0, 256)
        target.write_bytes(bytes(content))
        with contextlib.suppress(InstrumentError):
            read(opened(path))


# -- bags that mean harm -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("how", "pack"), [("bz2", bz2.compress), ("lz4", lz4.frame.compress)])
def test_a_chunk_that_unpacks_to_more_than_it_states(tmp_path: Path, how: str, pack: Callable[[bytes], bytes]) -> None:
    packed = pack(bytes(200_000_000))
    start = ros_bytes.bag_of_ros1([], closed=False)
    path = put("r.bag", start + ros_bytes.chunk(packed, how, size=1000))(tmp_path)
    tracemalloc.start()
    said = refusal(opened(path))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (
        "r.bag is damaged: the chunk at byte 4109: it should have 1000 bytes after unpacking, but has 1001 or more"
        in said
    )
    assert peak < 20_000_000


def test_a_chunk_or_a_message_beyond_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag_files, "MAX_CHUNK", 20_000)
    said = refusal(opened(put("r.bag", WHOLE["r.bag"])(tmp_path)))
    assert (
        "r.bag has a chunk or message of 3.74e-05 GB, more than 2e-05 GB; record it again with smaller chunks" in said
    )
    chunk = ros_bytes.chunk(bz2.compress(b""), "bz2", size=30_000)
    path = put("r.bag", ros_bytes.bag_of_ros1([], closed=False) + chunk)(tmp_path)
    assert "the chunk at byte 4109: it has 3e-05 GB, more than 2e-05 GB" in refusal(opened(path))
    path = of_ros2(StoragePlugin.SQLITE3, CompressionMode.MESSAGE)(tmp_path)
    monkeypatch.setattr(bag_files, "MAX_CHUNK", 100)
    assert "a compressed message of /imu has more than 1e-07 GB" in refusal(opened(path))


def test_sizes_beyond_the_file_need_no_memory(tmp_path: Path) -> None:
    """A record states 8 EB."""
    content = ros_bytes.mcap(CDR[:9], summary=False)[:-50] + struct.pack("<BQ", 6, 1 << 63)
    file = opened(put("r.mcap", content)(tmp_path))
    time, _ = read(file)
    assert len(time) == 9 and file.remarks


def listed(folder: Path, *names: object) -> Path:
    (folder / "bag").mkdir(exist_ok=True)
    listing = f"rosbag2_bagfile_information: {{version: 5, relative_file_paths: {list(names)}}}\n"
    (folder / "bag" / "metadata.yaml").write_text(listing)
    return folder / "bag"


@pytest.mark.parametrize(
    "name",
    [
        "../secret.db3",
        "/etc/passwd",
        "bag/../../secret.db3",
        "a/b/secret.db3",
        "..",
        "C:/secret.db3",
        "..\\\\secret.db3",
        "",
    ],
)
def test_a_folder_names_files_outside(tmp_path: Path, name: str) -> None:
    ros_bytes.database(tmp_path / "secret.db3", CDR)
    said = refusal(opened(listed(tmp_path, name)))
    assert "bag/metadata.yaml names the file" in said
    assert "not in the folder" in said or "does not exist" in said


def test_a_folder_with_links_and_other_files(tmp_path: Path) -> None:
    ros_bytes.database(tmp_path / "secret.db3", CDR)
    path = listed(tmp_path, "bag.db3")
    assert "names the file 'bag.db3', which does not exist" in refusal(opened(path))
    if os.name != "nt":
        (path / "bag.db3").symlink_to(tmp_path / "secret.db3")
        assert "'bag/bag.db3' is a link that leads outside the folder" in refusal(opened(path))
        (path / "bag.db3").unlink()
        os.mkfifo(path / "bag.db3")
        assert "bag/bag.db3: this is a pipe, not a regular file" in refusal(opened(path))
        (path / "bag.db3").unlink()
    (path / "bag.db3").mkdir()
    assert "bag/bag.db3 is a folder, not a file of a bag" in refusal(opened(path))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[",
        "a: 1",
        "rosbag2_bagfile_information: {relative_file_paths: []}",
        "rosbag2_bagfile_information: {relative_file_paths: [1]}",
        "rosbag2_bagfile_information: {relative_file_paths: x.db3}",
        "rosbag2_bagfile_information: !!python/object/apply:os.getcwd []",
        "[" * 2000,
        "\0",
    ],
)
def test_metadata_that_list_no_files(tmp_path: Path, text: str) -> None:
    path = listed(tmp_path)
    (path / "metadata.yaml").write_text(text)
    assert "bag/metadata.yaml does not list the files of a bag; name a file of the bag instead" in refusal(opened(path))


def test_a_folder_without_metadata(tmp_path: Path) -> None:
    path = FORMS["db3 folder"](tmp_path)
    (path / "metadata.yaml").unlink()
    with pytest.raises(InstrumentError, match="bag: this is a folder, not a file"):
        opened(path)
    said = refusal(opened(path, given=Format(type="rosbag", parameters=NoKeys())))
    assert "bag/metadata.yaml: there is no such file; check the path, or name a file of the bag (.db3 or .mcap)" in said


def test_a_database_with_views_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "r.db3") as base:
        base.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        base.execute("CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(9) AS data")
    base.close()
    assert "r.db3 is not a bag: it has no tables `topics` and `messages`" in refusal(opened(tmp_path / "r.db3"))


def test_names_that_cannot_be_displayed(tmp_path: Path) -> None:
    """A line feed in the name of a topic could add a line to a bench file."""
    content = ros_bytes.mcap(CDR, topic="/imu\n\x1b[2Jdriver: other")
    file = opened(put("r.mcap", content)(tmp_path), time=None)
    assert file.contents() == ("topic /imu??[2Jdriver: other: 350 messages of the type sensor_msgs/msg/Imu",)
    assert all(one.isprintable() for one in file.columns())


# -- long bags ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["r.bag", "r.mcap", "r.db3"])
def test_a_long_bag_needs_no_more_memory_than_a_short_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    monkeypatch.setattr(rosbag, "BATCH", 500)
    peaks = []
    for count in (2_000, 20_000):
        if form == "r.bag":
            path = put(form, ros_bytes.bag_of_ros1(ros_bytes.samples(count, ros_bytes.imu_of_ros1)))(tmp_path)
        elif form == "r.mcap":
            path = put(form, ros_bytes.mcap(ros_bytes.samples(count, ros_bytes.imu_in_cdr)))(tmp_path)
        else:
            shutil.rmtree(tmp_path / form, ignore_errors=True)
            path = ros_bytes.database(tmp_path / f"{count}.db3", ros_bytes.samples(count, ros_bytes.imu_in_cdr))
        file = opened(path)
        file.look()
        tracemalloc.start()
        assert sum(len(time) for time, _ in file.rows()) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0] + 100_000
