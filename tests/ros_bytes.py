"""ROS bags and messages, written here byte by byte: the tests do not use the library that knows these formats.

Sources: ROS wiki, Bags/Format/2.0; MCAP Format Specification; the schema of the storage plug-in rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

Vector = Sequence[float]
Messages = Iterable[tuple[int, bytes]]
"""Times of reception, ns, and the bytes of the messages."""
Message = Callable[[int, Vector, Vector], bytes]
COVARIANCES = (1.0, 2.0, 3.0)
"""Elements of the covariances of the orientation, the angular velocity and the linear acceleration."""
IMU = """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
"""
LINE = "=" * 80 + "\n"
_VECTORS = (
    f"{LINE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    f"{LINE}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
)
IMU_1 = f"{IMU}{LINE}MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n{_VECTORS}"
IMU_2 = (
    f"{IMU}{LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{LINE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n{_VECTORS}"
)


def _numbers(order: str, rate: Vector, force: Vector) -> bytes:
    """The 37 numbers of a message after its header."""
    covariances = [struct.pack(f"{order}9d", *[one] * 9) for one in COVARIANCES]
    parts = [struct.pack(f"{order}4d", 0.0, 0.0, 0.6, 0.8), covariances[0], struct.pack(f"{order}3d", *rate)]
    return b"".join([*parts, covariances[1], struct.pack(f"{order}3d", *force), covariances[2]])


def imu_of_ros1(stamp: int, rate: Vector, force: Vector, frame: str = "imu_link") -> bytes:
    """sensor_msgs/Imu as roscpp serializes it. `stamp`: ns. All numbers follow each other without gaps."""
    name = frame.encode()
    head = struct.pack("<III", 7, stamp // 10**9, stamp % 10**9) + struct.pack("<I", len(name)) + name
    return head + _numbers("<", rate, force)


def imu_in_cdr(stamp: int, rate: Vector, force: Vector, frame: str = "imu_link", order: str = "<") -> bytes:
    """sensor_msgs/msg/Imu in CDR: four bytes before the message; numbers of 8 bytes at multiples of 8; a zero after a text."""
    name = frame.encode() + b"\0"
    head = struct.pack(f"{order}iI", stamp // 10**9, stamp % 10**9) + struct.pack(f"{order}I", len(name)) + name
    head += b"\xaa" * (-len(head) % 8)
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + head + _numbers(order, rate, force)


# -- bags of ROS 1 -----------------------------------------------------------------------------------------------------


def _record(fields: dict[str, bytes], data: bytes) -> bytes:
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _fields(fields: dict[str, bytes]) -> bytes:
    whole = _record(fields, b"")
    return whole[4:-4]


def connection(number: int, topic: str, kind: str, definition: str) -> bytes:
    own = {"topic": topic.encode(), "type": kind.encode(), "md5sum": b"*", "message_definition": definition.encode()}
    return _record({"op": b"\x07", "conn": struct.pack("<I", number), "topic": topic.encode()}, _fields(own))


def message(number: int, time: int, data: bytes) -> bytes:
    stamp = struct.pack("<II", time // 10**9, time % 10**9)
    return _record({"op": b"\x02", "conn": struct.pack("<I", number), "time": stamp}, data)


def chunk(records: bytes, how: str = "none", size: int | None = None) -> bytes:
    """A chunk record. `size`: its stated size after unpacking."""
    stated = struct.pack("<I", len(records) if size is None else size)
    return _record({"op": b"\x05", "compression": how.encode(), "size": stated}, records)


def bag_of_ros1(
    messages: Messages,
    *,
    topic: str = "/imu",
    kind: str = "sensor_msgs/Imu",
    definition: str = IMU_1,
    closed: bool = True,
) -> bytes:
    """A bag with one topic, in chunks of 100 messages. `closed`: False as the recorder leaves the file if it is killed."""
    connected = connection(0, topic, kind, definition)
    held, chunks, infos = list(messages), b"", b""
    start = b"#ROSBAG V2.0\n"
    room = 4096 + len(start)
    for first in range(0, len(held), 100):
        part = held[first : first + 100]
        at = struct.pack("<Q", room + len(chunks))
        chunks += chunk((connected if not first else b"") + b"".join(message(0, *one) for one in part))
        times = {"start_time": b"\0" * 8, "end_time": b"\0" * 8, "count": struct.pack("<I", 1)}
        info = {"op": b"\x06", "ver": struct.pack("<I", 1), "chunk_pos": at, **times}
        infos += _record(info, struct.pack("<II", 0, len(part)))
    index = struct.pack("<Q", room + len(chunks) if closed else 0)
    counts = {"conn_count": struct.pack("<I", 1), "chunk_count": struct.pack("<I", -(-len(held) // 100))}
    head = {"op": b"\x03", "index_pos": index, **counts}
    head_record = _record(head, b"")
    head_record = _record(head, b" " * (4096 - len(head_record)))
    return start + head_record + chunks + (connected + infos if closed else b"")


# -- MCAP --------------------------------------------------------------------------------------------------------------


def _mcap(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text.encode())) + text.encode()


def mcap(
    messages: Messages,
    *,
    topic: str = "/imu",
    kind: str = "sensor_msgs/msg/Imu",
    definition: str = IMU_2,
    schema: str = "ros2msg",
    encoding: str = "cdr",
    chunked: bool = True,
    summary: bool = True,
) -> bytes:
    """An MCAP file with one topic, with chunks of 100 messages or without chunks."""
    declared = _mcap(3, struct.pack("<H", 1) + _text(kind) + _text(schema) + _text(definition))
    declared += _mcap(4, struct.pack("<HH", 5, 1) + _text(topic) + _text(encoding) + struct.pack("<I", 0))
    held = [
        (time, _mcap(5, struct.pack("<HIQQ", 5, number, time, time) + data))
        for number, (time, data) in enumerate(messages)
    ]
    data = b"" if chunked else declared + b"".join(record for _, record in held)
    for first in range(0, len(held) if chunked else 0, 100):
        part = held[first : first + 100]
        records = (declared if not first else b"") + b"".join(record for _, record in part)
        head = struct.pack("<QQQI", part[0][0], part[-1][0], len(records), 0)
        data += _mcap(6, head + _text("") + struct.pack("<Q", len(records)) + records)
    magic = b"\x89MCAP0\r\n"
    start = magic + _mcap(1, _text("ros2") + _text("")) + data + _mcap(0x0F, struct.pack("<I", 0))
    end = b""
    if summary:
        counts = struct.pack("<HQ", 5, len(held))
        numbers = struct.pack("<QHIIIIQQ", len(held), 1, 1, 0, 0, -(-len(held) // 100), 0, 0)
        end = declared + _mcap(0x0B, numbers + struct.pack("<I", len(counts)) + counts)
    return start + end + _mcap(2, struct.pack("<QQI", len(start) if summary else 0, 0, 0)) + magic


# -- databases of rosbag2 ----------------------------------------------------------------------------------------------


def database(path: Path, messages: Messages, *, topic: str = "/imu", kind: str = "sensor_msgs/msg/Imu") -> Path:
    """A database as rosbag2 of ROS 2 Foxy writes it: without definitions of the types."""
    base = sqlite3.connect(path)
    with base:
        base.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,"
            " offered_qos_profiles TEXT NOT NULL)"
        )
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        base.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr', '')", (topic, kind))
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", messages)
    base.close()
    return path


# -- samples -----------------------------------------------------------------------------------------------------------


def samples(count: int, write: Message, rate: float = 100.0) -> list[tuple[int, bytes]]:
    """Messages with known numbers (see `truth`), each received 2 ms after its stamp."""
    numbers = truth(count)
    stamps = [1_700_000_000 * 10**9 + round(k * 1e9 / rate) for k in range(count)]
    return [
        (stamp + 2_000_000, write(stamp, row[:3].tolist(), row[3:].tolist()))
        for stamp, row in zip(stamps, numbers, strict=True)
    ]


def truth(count: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Angular velocity and linear acceleration, shape (count, 6)."""
    return np.random.default_rng(11).normal(0.0, 3.0, (count, 6))
