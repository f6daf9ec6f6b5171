"""Reads the files of ROS bags: topics, and the messages of a topic as bytes. The files are bags of ROS 1 (format 2.0), MCAP files, and
databases of rosbag2. A bag of ROS 2 may be a folder with several files.

Messages are read in the order of the file, one chunk at a time. The index of a bag is used only to find its topics, so a bag that
was not closed can also be read. Sources: ROS wiki, Bags/Format/2.0; MCAP Format Specification.
"""

from __future__ import annotations

import bz2
import contextlib
import struct
import sys
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, BinaryIO, Protocol

from planrunner.base.dataclass import dataclass
from planrunner.base.regular_files import RefusedFileError, read_regular
from planrunner.instruments.formats.file import open_samples
from planrunner.instruments.formats.ros_messages import MessageBytes
from planrunner.instruments.interfaces import InstrumentError

if TYPE_CHECKING:
    import sqlite3

MAX_CHUNK = 1_000_000_000
"""Maximum size in bytes of a chunk or message, packed and unpacked. Chunks usually have about 1 MB."""
MAX_METADATA = 10_000_000
"""Maximum size in bytes of the file metadata.yaml."""
MAX_FILES = 10_000
"""Maximum number of files of a bag."""
MAX_TOPICS = 10_000
MAX_NAME = 200
"""Maximum number of characters in the name of a topic or of a type. Longer names are shortened."""
METADATA = "metadata.yaml"
ROS1_MAGIC = b"#ROSBAG V"
MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\x00"
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_NOT_CLOSED = "messages that the recorder did not write to the file before it stopped (the bag was not closed)"

_MALFORMED = (struct.error, UnicodeDecodeError, IndexError, KeyError)
"""Exceptions that are raised if a record has a wrong form."""

Message = tuple[int, MessageBytes]
"""The time at which the recorder received a message, ns, and the bytes of the message."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag. `type`: name of the type of its messages. `definition`: the definition of the type; empty if the bag does
    not contain it. `is_cdr`: True if the messages are in CDR, as in ROS 2. `count`: number of messages. `problem`: the reason why
    the messages cannot be read, otherwise empty."""

    name: str
    type: str
    definition: str
    is_cdr: bool
    count: int = 0
    problem: str = ""

    @classmethod
    def of(cls, name: str, kind: str, definition: str, *, is_cdr: bool, count: int = 0, problem: str = "") -> Topic:
        """Makes a topic from the texts in a bag. Characters that cannot be displayed are replaced. `kind`: name of the type.
        `is_cdr`: True if the messages are in CDR."""
        return cls(_shown(name, MAX_NAME), _shown(kind, MAX_NAME), definition, is_cdr, count, problem)

    def joined(self, other: Topic) -> Topic:
        """Combines the topic with `other`, which describes the messages of another publisher or of another file on the same
        topic."""
        problem = self.problem or other.problem
        if not problem and self.type != other.type:
            problem = f"its messages have two types, {self.type} and {other.type}"
        if not problem and self.definition and other.definition and not _alike(self.definition, other.definition):
            problem = f"the bag contains two definitions of its type {self.type}"
        definition = self.definition or other.definition
        return replace(self, definition=definition, count=self.count + other.count, problem=problem)


def _alike(one: str, other: str) -> bool:
    """Returns True if two definitions differ only in comments and blanks, as the definitions of two versions of ROS may do."""
    words = [[line.partition("#")[0].split() for line in text.splitlines()] for text in (one, other)]
    return one == other or list(filter(None, words[0])) == list(filter(None, words[1]))


def _shown(text: str, most: int) -> str:
    """Returns the first `most` characters of a text, with `?` instead of characters that cannot be displayed."""
    return "".join(one if one.isprintable() else "?" for one in text[:most])


def _text(data: bytes) -> str:
    return data.decode(errors="replace")


class _CutError(Exception):
    """Reports that a file ends within a record."""


class BagFile(ABC):
    """A file of a bag, or all files of a bag. `name`: name of the file, used in messages. `remarks`: descriptions of data that were
    left out."""

    def __init__(self, path: Path, name: str):
        self.path, self.name = path, name
        self.remarks: list[str] = []

    @abstractmethod
    def topics(self) -> dict[str, Topic]:
        """Returns the topics by name. Raises `InstrumentError` if the file cannot be read."""

    @abstractmethod
    def messages(self, topic: str) -> Iterator[Message]:
        """Yields the messages of a topic in the order of the file. Raises `InstrumentError` if the file cannot be read."""

    def _damaged(self, reason: str) -> InstrumentError:
        return InstrumentError(f"{self.name} is damaged: {reason}; record it again, or restore it from a copy")

    def _remark(self, text: str) -> None:
        if text not in self.remarks:
            self.remarks.append(text)


def open_bag(path: Path, name: str) -> BagFile:
    """Opens a bag: a file, or a folder with the file metadata.yaml. The first bytes of a file determine its format. Raises
    `InstrumentError` if the file is not a bag."""
    if path.is_dir():
        return _Folder(path, name)
    with open_samples(path, name) as file:
        start = file.read(len(SQLITE_MAGIC))
    for magic, kind in ((ROS1_MAGIC, _Ros1Bag), (MCAP_MAGIC, _Mcap), (SQLITE_MAGIC, _Database)):
        if start.startswith(magic):
            return kind(path, name)
    if start.startswith(_ZSTD_MAGIC):
        raise InstrumentError(
            f"{name} is compressed as a whole: unpack it first, for example with `zstd -d {path.name}`"
        )
    raise InstrumentError(
        f"{name} is not a ROS bag: it is neither a bag of ROS 1, an MCAP file nor a database of rosbag2"
    )


# -- records in bytes --------------------------------------------------------------------------------------------------


class _Source(Protocol):
    """A source of bytes that can be read at any position. `size`: number of bytes."""

    size: int

    def read(self, position: int, count: int) -> MessageBytes:
        """Returns `count` bytes, beginning at `position`. Raises `_CutError` if the source ends before the last of these bytes."""


class _FileSource:
    def __init__(self, file: BinaryIO, name: str):
        self._file, self._name, self.size = file, name, file.seek(0, 2)

    def read(self, position: int, count: int) -> bytes:
        if position + count > self.size:
            raise _CutError
        if count > MAX_CHUNK:
            message = f"{self._name} has a chunk or message of {count / 1e9:.3g} GB, more than {MAX_CHUNK / 1e9:g} GB"
            raise InstrumentError(f"{message}; record it again with smaller chunks")
        self._file.seek(position)
        return self._file.read(count)


class _HeldSource:
    def __init__(self, data: MessageBytes):
        self._data, self.size = memoryview(data), len(data)

    def read(self, position: int, count: int) -> memoryview:
        if position + count > self.size:
            raise _CutError
        return self._data[position : position + count]


def _u32(data: MessageBytes, position: int = 0) -> int:
    return int.from_bytes(data[position : position + 4], "little")


def _u64(data: MessageBytes, position: int = 0) -> int:
    return int.from_bytes(data[position : position + 8], "little")


def _unpacked(packed: MessageBytes, how: str, size: int) -> MessageBytes:
    """Unpacks a chunk. `how`: name of the compression method. `size`: the stated number of bytes after unpacking. At most one byte
    more than this number is unpacked. Raises `ValueError` if the chunk is damaged or has another size."""
    if size > MAX_CHUNK:
        raise ValueError(f"it has {size / 1e9:.3g} GB, more than {MAX_CHUNK / 1e9:g} GB")
    if how in ("", "none"):
        made = packed
    elif how == "bz2":
        made = _limited(bz2.BZ2Decompressor(), packed, size)
    elif how == "lz4":
        import lz4.frame

        made = _limited(lz4.frame.LZ4FrameDecompressor(), packed, size)
    elif how == "zstd":
        made = _limited(_zstd(), packed, size)
    else:
        raise ValueError(f"its compression '{_shown(how, 20)}' is not known")
    if len(made) != size:
        raise ValueError(f"it should have {size} bytes after unpacking, but has {len(made)} or more")
    return made


class _Decompressor(Protocol):
    def decompress(self, data: bytes, max_length: int = ...) -> bytes: ...


def _limited(unpack: _Decompressor, packed: MessageBytes, size: int) -> bytes:
    try:
        return unpack.decompress(bytes(packed), size + 1)
    except (OSError, ValueError, RuntimeError, EOFError, MemoryError) as error:
        raise ValueError(f"it cannot be unpacked ({type(error).__name__})") from None
    except Exception as error:  # ZstdError is derived from Exception
        raise ValueError(f"it cannot be unpacked ({str(error)[:80]})") from None


def _zstd() -> _Decompressor:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    made: _Decompressor = zstd.ZstdDecompressor()
    return made


# -- files of records --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Record:
    """A record of a file. `kind`: number of its kind. `header`: the named fields before its data. `at`, `size`: position and size of
    its data."""

    kind: int
    header: Mapping[bytes, bytes]
    at: int
    size: int


class _RecordsFile(BagFile):
    """A file of records, some of which are chunks that contain further records. `MESSAGE`: kind of the records that contain a
    message. `CHUNK`: kind of the records that contain further records. `END`: kind of the record that ends the file; −1 if there is
    none."""

    MESSAGE: int
    CHUNK: int
    END = -1

    def __init__(self, path: Path, name: str):
        super().__init__(path, name)
        self._topics: dict[str, Topic] | None = None

    def topics(self) -> dict[str, Topic]:
        if self._topics is None:
            with self._opened() as source:
                first = self._first(source)
                indexed = self._indexed(source)
                self._topics = self._counted(source, first) if indexed is None else indexed
        return self._topics

    def messages(self, topic: str) -> Iterator[Message]:
        with self._opened() as source:
            for _, time, data in self._walk(source, self._first(source), {}, topic):
                yield time, data

    @abstractmethod
    def _first(self, source: _Source) -> int:
        """Returns the position of the first record. Raises `InstrumentError` if the file cannot be read."""

    @abstractmethod
    def _indexed(self, source: _Source) -> dict[str, Topic] | None:
        """Returns the topics that the index of the file lists; None if it has no complete index."""

    @abstractmethod
    def _record(self, source: _Source, position: int) -> _Record:
        """Returns the record at a position. Raises `_CutError` if the file ends before its data."""

    @abstractmethod
    def _declared(self, record: _Record, source: _Source) -> tuple[int, Topic] | None:
        """Returns the number and the topic of the connection that the record declares; None if it does not declare a connection."""

    @abstractmethod
    def _of_message(self, record: _Record, source: _Source) -> tuple[int, int, int]:
        """Returns the number of the connection, the time [ns] and the position of the bytes of a message."""

    @abstractmethod
    def _chunk(self, record: _Record, source: _Source) -> MessageBytes:
        """Returns the records in a chunk. Raises `ValueError` if the chunk is damaged."""

    @contextlib.contextmanager
    def _opened(self) -> Iterator[_FileSource]:
        with open_samples(self.path, self.name) as file:
            try:
                yield _FileSource(file, self.name)
            except _MALFORMED:
                raise self._damaged("a record has an unexpected form") from None
            except _CutError:
                raise self._damaged("it ends within its first record") from None

    def _counted(self, source: _FileSource, first: int) -> dict[str, Topic]:
        """Finds the topics of a bag without an index, and counts their messages. `first`: position of the first record."""
        connections: dict[int, Topic] = {}
        counts: dict[int, int] = {}
        for number, _, _ in self._walk(source, first, connections, None):
            counts[number] = counts.get(number, 0) + 1
        return self._merged(connections, counts)

    def _merged(self, connections: Mapping[int, Topic], counts: Mapping[int, int]) -> dict[str, Topic]:
        """Returns the topics of a file, each with the messages of all its publishers. `connections`: maps the number of each
        connection (one publisher of a topic) to its topic. `counts`: number of messages of each connection."""
        found: dict[str, Topic] = {}
        for number, one in connections.items():
            topic = replace(one, count=counts.get(number, 0))
            found[topic.name] = found[topic.name].joined(topic) if topic.name in found else topic
        return found

    def _add(self, connections: dict[int, Topic], declared: tuple[int, Topic]) -> None:
        if len(connections) >= MAX_TOPICS:
            raise InstrumentError(f"{self.name} contains more than {MAX_TOPICS} topics")
        connections.setdefault(*declared)

    def _walk(
        self, source: _FileSource, position: int, connections: dict[int, Topic], topic: str | None
    ) -> Iterator[tuple[int, int, MessageBytes]]:
        """Yields the messages of a topic. If `topic` is None, yields the messages of all topics, without their bytes. Each message
        consists of the number of the connection, the time [ns] and the bytes. The connections of the file are added to
        `connections`."""
        while position < source.size:
            begin = position
            try:
                record = self._record(source, position)
                position = record.at + record.size
                if position > source.size:
                    raise _CutError
            except (_CutError, *_MALFORMED) as error:
                # the recorder was stopped while it wrote this record, so its size, or the size of its chunk, is missing
                if not isinstance(error, _CutError) and _NOT_CLOSED not in self.remarks:
                    raise
                self._remark("an incomplete record at the end of the file")
                return
            if record.kind == self.END:
                return
            if record.kind != self.CHUNK:
                yield from self._of_record(record, source, connections, topic)
                continue
            try:
                chunk = _HeldSource(self._chunk(record, source))
            except ValueError as error:
                raise self._damaged(f"the chunk at byte {begin}: {error}") from None
            at = 0
            while at < chunk.size:
                try:
                    record = self._record(chunk, at)
                    at = record.at + record.size
                    yield from self._of_record(record, chunk, connections, topic)
                except _CutError:
                    raise self._damaged(f"the chunk at byte {begin} ends within a record") from None

    def _of_record(
        self, record: _Record, source: _Source, connections: dict[int, Topic], topic: str | None
    ) -> Iterator[tuple[int, int, MessageBytes]]:
        """Yields the message of a record if it belongs to the topic. If the record declares a connection, adds it to
        `connections`."""
        if record.kind == self.MESSAGE:
            number, time, at = self._of_message(record, source)
            if number not in connections:
                raise self._damaged(f"a message belongs to the connection {number}, which the file does not declare")
            if topic is None:
                yield number, time, b""
            elif connections[number].name == topic:
                yield number, time, source.read(at, record.at + record.size - at)
        elif (declared := self._declared(record, source)) is not None:
            self._add(connections, declared)


def _fields(header: MessageBytes) -> dict[bytes, bytes]:
    """Returns the fields of a header of a bag of ROS 1."""
    found, position, data = {}, 0, bytes(header)
    while position < len(data):
        size = _u32(data, position)
        name, _, value = data[position + 4 : position + 4 + size].partition(b"=")
        found[name] = value
        position += 4 + size
    return found


class _Ros1Bag(_RecordsFile):
    """A bag of ROS 1. A record has a header with named fields. The field `op` states the kind of the record."""

    MESSAGE, CHUNK = 2, 5
    _BAG_HEADER, _CHUNK_INFO, _CONNECTION = 3, 6, 7
    _START = b"#ROSBAG V2.0\n"

    def _first(self, source: _Source) -> int:
        start = bytes(source.read(0, len(self._START)))
        if start != self._START:
            version = _shown(start[len(ROS1_MAGIC) :].partition(b"\n")[0].decode("ascii", "replace"), 10)
            hint = f"convert it with `rosbag migrate {self.path.name} NEW.bag`"
            raise InstrumentError(
                f"{self.name} is a bag of the version {version}; planrunner reads version 2.0: {hint}"
            )
        return len(self._START)

    def _record(self, source: _Source, position: int) -> _Record:
        size = _u32(source.read(position, 4))
        header = _fields(source.read(position + 4, size))
        data = _u32(source.read(position + 4 + size, 4))
        return _Record(header[b"op"][0], header, position + 8 + size, data)

    def _of_message(self, record: _Record, source: _Source) -> tuple[int, int, int]:
        time = record.header[b"time"]
        return _u32(record.header[b"conn"]), 1_000_000_000 * _u32(time) + _u32(time, 4), record.at

    def _declared(self, record: _Record, source: _Source) -> tuple[int, Topic] | None:
        if record.kind != self._CONNECTION:
            return None
        header, own = record.header, _fields(source.read(record.at, record.size))
        name, kind, definition = header[b"topic"], own[b"type"], own[b"message_definition"]
        made = Topic.of(name.decode(), kind.decode(), definition.decode(errors="replace"), is_cdr=False)
        return _u32(header[b"conn"]), made

    def _chunk(self, record: _Record, source: _Source) -> MessageBytes:
        how, size = record.header[b"compression"].decode(), _u32(record.header[b"size"])
        return _unpacked(source.read(record.at, record.size), how, size)

    def _indexed(self, source: _Source) -> dict[str, Topic] | None:
        fields = self._record(source, self._first(source)).header
        if fields.get(b"encryptor"):
            raise InstrumentError(f"{self.name} is encrypted: write it again without encryption")
        position = _u64(fields[b"index_pos"])
        if not position:
            self._remark(_NOT_CLOSED)
            return None
        connections: dict[int, Topic] = {}
        counts: dict[int, int] = {}
        try:
            while position < source.size:
                record = self._record(source, position)
                position = record.at + record.size
                if record.kind == self._CHUNK_INFO:
                    pairs = struct.iter_unpack("<II", source.read(record.at, record.size))
                    for number, count in pairs:
                        counts[number] = counts.get(number, 0) + count
                elif (declared := self._declared(record, source)) is not None:
                    self._add(connections, declared)
        except (_CutError, KeyError, IndexError, struct.error):
            return None
        complete = len(connections) == _u32(fields[b"conn_count"]) and position == source.size
        return self._merged(connections, counts) if complete else None


@dataclass(frozen=True, slots=True)
class _Schema:
    name: str
    encoding: str
    text: str


class _Mcap(_RecordsFile):
    """An MCAP file. A record consists of its kind, its size and its data."""

    MESSAGE, CHUNK, END = 0x05, 0x06, 0x02
    _SCHEMA, _CHANNEL, _STATISTICS = 0x03, 0x04, 0x0B
    _FOOTER = 1 + 8 + 20 + len(MCAP_MAGIC)  # bytes at the end of a closed file

    def __init__(self, path: Path, name: str):
        super().__init__(path, name)
        self._schemas: dict[int, _Schema] = {}

    def _first(self, source: _Source) -> int:
        return len(MCAP_MAGIC)

    def _record(self, source: _Source, position: int) -> _Record:
        start = source.read(position, 9)
        return _Record(start[0], {}, position + 9, _u64(start, 1))

    def _of_message(self, record: _Record, source: _Source) -> tuple[int, int, int]:
        if record.size < 22:
            raise struct.error
        number, _, time, _ = struct.unpack("<HIQQ", source.read(record.at, 22))
        return number, time, record.at + 22

    def _declared(self, record: _Record, source: _Source) -> tuple[int, Topic] | None:
        if record.kind not in (self._SCHEMA, self._CHANNEL):
            return None
        data = bytes(source.read(record.at, record.size))
        if record.kind == self._SCHEMA:
            name, encoding, definition = (one.decode(errors="replace") for one in _strings(data, 2, 3))
            self._schemas.setdefault(int.from_bytes(data[:2], "little"), _Schema(name, encoding, definition))
            return None
        number, of_schema = struct.unpack_from("<HH", data)
        topic, encoding = (one.decode() for one in _strings(data, 4, 2))
        schema = self._schemas.get(of_schema, _Schema("unknown", "", ""))
        problem = (
            ""
            if encoding in ("cdr", "ros1")
            else f"its messages are encoded as '{_shown(encoding, 40)}', not as in ROS"
        )
        text = schema.text if schema.encoding in ("ros1msg", "ros2msg") else ""
        return number, Topic.of(topic, schema.name, text, is_cdr=encoding == "cdr", problem=problem)

    def _chunk(self, record: _Record, source: _Source) -> MessageBytes:
        start = bytes(source.read(record.at, min(record.size, 100)))
        _, _, size, checksum = struct.unpack_from("<QQQI", start)
        (how,) = _strings(start, 28, 1)
        at = record.at + 32 + len(how) + 8
        packed = source.read(at, record.at + record.size - at)
        if _u64(start, 32 + len(how)) != len(packed):
            raise ValueError("its size is wrong")
        made = _unpacked(packed, how.decode(errors="replace"), size)
        if checksum and zlib.crc32(made) != checksum:
            raise ValueError("its checksum is wrong")
        return made

    def _indexed(self, source: _Source) -> dict[str, Topic] | None:
        try:
            footer = bytes(source.read(max(0, source.size - self._FOOTER), self._FOOTER))
        except _CutError:
            footer = b""
        if footer[:1] != bytes([self.END]) or not footer.endswith(MCAP_MAGIC):
            self._remark(_NOT_CLOSED)
            return None
        position, end = _u64(footer, 9), source.size - self._FOOTER
        connections: dict[int, Topic] = {}
        counts: dict[int, int] | None = None
        try:
            while 0 < position < end:
                record = self._record(source, position)
                position = record.at + record.size
                if record.kind == self._STATISTICS:
                    data = source.read(record.at, record.size)
                    counts = dict(struct.iter_unpack("<HQ", data[46 : 46 + _u32(data, 42)]))
                elif (declared := self._declared(record, source)) is not None:
                    self._add(connections, declared)
        except (_CutError, IndexError, struct.error):
            return None
        if counts is None or not set(counts) <= set(connections):
            return None
        return self._merged(connections, counts)


def _strings(data: bytes, position: int, count: int) -> list[bytes]:
    """Returns `count` successive texts from `data`, beginning at `position`. The size of each text precedes the text. Raises
    `struct.error` if the data end too early."""
    found = []
    for _ in range(count):
        size = _u32(data, position)
        if position + 4 + size > len(data):
            raise struct.error
        found.append(data[position + 4 : position + 4 + size])
        position += 4 + size
    return found


# -- databases ---------------------------------------------------------------------------------------------------------


class _Database(BagFile):
    """A database that rosbag2 writes with SQLite. It is opened for reading only; views and virtual tables are refused."""

    def __init__(self, path: Path, name: str):
        super().__init__(path, name)
        self._topics: dict[str, Topic] | None = None
        self._numbers: dict[str, list[int]] = {}

    @contextlib.contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        import sqlite3

        open_samples(self.path, self.name).close()  # a regular file within the bounds
        connection = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        connection.text_factory = _text
        try:
            connection.execute("PRAGMA trusted_schema=OFF")
            yield connection
        except (sqlite3.Error, OverflowError) as error:
            raise self._damaged(_shown((str(error).splitlines() or [""])[0], 150)) from None
        except UnicodeDecodeError:  # sqlite3 shows a part of the file in its message
            raise self._damaged("a name in it is not UTF-8 text") from None
        finally:
            connection.close()

    def topics(self) -> dict[str, Topic]:
        if self._topics is None:
            with self._opened() as connection:
                self._topics = self._read(connection)
            log = self.path.with_name(f"{self.path.name}-wal")
            if log.is_file() and log.stat().st_size:
                self._remark(f"the messages in {log.name}, because the bag was not closed")
        return self._topics

    def _read(self, connection: sqlite3.Connection) -> dict[str, Topic]:
        made = connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
        tables = {str(name) for name, sql in made if not str(sql).upper().startswith("CREATE VIRTUAL")}
        if not {"topics", "messages"} <= tables:
            raise InstrumentError(f"{self.name} is not a bag: it has no tables `topics` and `messages`")
        definitions: dict[str, str] = {}
        if "message_definitions" in tables:
            named = connection.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {str(kind): str(text) for kind, encoding, text in named if encoding == "ros2msg"}
        counts = dict(connection.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        found: dict[str, Topic] = {}
        rows = connection.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        for number, name, kind, form in rows.fetchmany(MAX_TOPICS):
            problem = "" if form == "cdr" else f"its messages are encoded as '{_shown(str(form), 40)}', not as in ROS 2"
            definition, count = definitions.get(str(kind), ""), counts.get(number, 0)
            one = Topic.of(str(name), str(kind), definition, is_cdr=True, count=count, problem=problem)
            found[one.name] = found[one.name].joined(one) if one.name in found else one
            self._numbers.setdefault(one.name, []).append(number)
        return found

    def messages(self, topic: str) -> Iterator[Message]:
        self.topics()
        numbers = self._numbers.get(topic, [])
        with self._opened() as connection:
            places = ", ".join("?" * len(numbers))
            chosen = connection.execute(
                f"SELECT timestamp, data FROM messages WHERE topic_id IN ({places}) ORDER BY id", numbers
            )
            for time, data in chosen:
                if not isinstance(time, int) or not isinstance(data, bytes):
                    raise self._damaged(f"a message of {topic} is not stored as bytes with a time")
                yield time, self._message(data, topic)

    def _message(self, data: bytes, topic: str) -> bytes:
        """Returns the bytes of a message, which rosbag2 may have compressed."""
        if not data.startswith(_ZSTD_MAGIC):
            return data
        try:
            made = _limited(_zstd(), data, MAX_CHUNK)
        except ValueError as error:
            raise self._damaged(f"a compressed message of {topic}: {error}") from None
        if len(made) > MAX_CHUNK:
            raise self._damaged(f"a compressed message of {topic} has more than {MAX_CHUNK / 1e9:g} GB")
        return made


# -- folders -----------------------------------------------------------------------------------------------------------


class _Folder(BagFile):
    """A folder of a bag of ROS 2: the file metadata.yaml, and the files that it names."""

    def __init__(self, path: Path, name: str):
        super().__init__(path, name)
        self._files = [self._opened(file) for file in self._named()]

    def topics(self) -> dict[str, Topic]:
        found: dict[str, Topic] = {}
        for file in self._files:
            for name, one in file.topics().items():
                found[name] = found[name].joined(one) if name in found else one
            for remark in file.remarks:
                self._remark(f"{file.name}: {remark}")
        return found

    def messages(self, topic: str) -> Iterator[Message]:
        for file in self._files:
            yield from file.messages(topic)

    def _named(self) -> Sequence[str]:
        """Returns the names of the files that metadata.yaml lists."""
        import yaml

        where = f"{self.name}/{METADATA}"
        try:
            text = read_regular(self.path / METADATA, MAX_METADATA, links=False)
            whole = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
            names = whole["rosbag2_bagfile_information"]["relative_file_paths"]
        except RefusedFileError as refused:
            message = f"{where}: {refused}; {refused.hint}"
            raise InstrumentError(f"{message}, or name a file of the bag (.db3 or .mcap)") from None
        except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, RecursionError):
            raise InstrumentError(f"{where} does not list the files of a bag; name a file of the bag instead") from None
        if not isinstance(names, list) or not names or not all(isinstance(one, str) for one in names):
            raise InstrumentError(f"{where} does not list the files of a bag; name a file of the bag instead")
        if len(names) > MAX_FILES:
            raise InstrumentError(f"{where} lists more than {MAX_FILES} files")
        return names

    def _opened(self, listed: str) -> BagFile:
        """Opens a file of the bag. Old versions of rosbag2 write the name of the folder before the name of the file. Raises
        `InstrumentError` if the file is not directly in the folder."""
        posix, windows = PurePosixPath(listed), PureWindowsPath(listed)
        plain = len(windows.parts) == len(posix.parts) and not windows.drive and not windows.root and "\0" not in listed
        if not plain or ".." in posix.parts or not 1 <= len(posix.parts) <= 2:
            raise InstrumentError(
                f"{self.name}/{METADATA} names the file '{_shown(listed, 200)}', which is not in the folder"
            )
        try:
            path = (self.path / posix.name).resolve(strict=True)
        except (OSError, RuntimeError):
            raise InstrumentError(
                f"{self.name}/{METADATA} names the file '{posix.name}', which does not exist"
            ) from None
        if path.parent != self.path.resolve():
            raise InstrumentError(
                f"'{self.name}/{posix.name}' is a link that leads outside the folder; replace it with the file"
            )
        if path.is_dir():
            raise InstrumentError(f"{self.name}/{posix.name} is a folder, not a file of a bag")
        return open_bag(path, f"{self.name}/{posix.name}")
