"""Reads ROS bags: bags of ROS 1 (.bag), and bags of ROS 2 (.mcap, .db3, or the folder that contains them).

A column is named after its topic and its field, with a point between them (`/imu/data.angular_velocity.x`). Each topic has its own
times, so a recording takes all its columns from one topic. The column `header.stamp` contains the time of the measurement, and
`receive_time` the time at which the recorder received the message. Both are in s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.instruments.formats.bag_files import BagFile, Topic, open_bag
from planrunner.instruments.formats.file import FormatFile, HeldRows, NoKeys, SampleRows, TimeStamps
from planrunner.instruments.formats.ros_messages import (
    MessageReader,
    MessageType,
    UnreadableTypeError,
    WrongMessageError,
    message_type,
    usual_name,
)
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.span import Span

RECEIVE_TIME = "receive_time"
BATCH = 8_192  # messages
_STAMP = "header.stamp"
_IMU = "sensor_msgs/msg/Imu"
_COVARIANCE = "covariance["
_SECOND = 1_000_000_000  # ns
_SHOWN = 12  # topics in a message


@dataclass(frozen=True, slots=True)
class _Fields:
    """The fields of the messages of a topic, with their units. `type`: the type of the messages; None if they cannot be read.
    `problem`: the reason why they cannot be read; otherwise empty."""

    type: MessageType | None
    units: Mapping[str, str]
    problem: str = ""


class _Contents:
    """The contents of a bag. `topics`: all topics by name. The definitions of the messages of a topic are parsed when they are needed,
    because a bag may contain hundreds of topics."""

    def __init__(self, bag: BagFile):
        self.bag, self.topics = bag, bag.topics()
        self._fields: dict[str, _Fields] = {}

    def topic_of(self, column: str) -> str:
        """Returns the topic of a column; empty if there is none."""
        fits = [name for name in self.topics if column.startswith(f"{name}.")]
        return max(fits, key=len, default="")

    def fields(self, topic: str) -> _Fields:
        """Returns the fields of the messages of a topic."""
        if topic not in self._fields:
            self._fields[topic] = _fields_of(self.topics[topic])
        return self._fields[topic]


class RosbagFile(FormatFile[NoKeys]):
    """A ROS bag. Its messages are read in batches, in the order of the bag."""

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: NoKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._known: _Contents | None = None

    def columns(self) -> list[str]:
        return list(self._units(self._needed()))

    def examined(self) -> list[str]:
        """Returns the columns of the topic that most probably contains the samples of an IMU. Topics with messages of the type Imu
        are preferred, then topics with many messages. Covariances are left out, because they are statements of the driver and not
        samples. Raises `InstrumentError` if no messages can be read."""
        contents = self._contents()
        ranked = sorted(
            (one for one in contents.topics.values() if one.count),
            key=lambda one: (usual_name(one.type) == _IMU, one.count),
            reverse=True,
        )
        for topic in ranked:
            found = contents.fields(topic.name).units
            if found:
                return [f"{topic.name}.{field}" for field in found if _COVARIANCE not in field]
        reasons = [f"; {one.name}: {contents.fields(one.name).problem}" for one in ranked[:3]]
        raise InstrumentError(f"{self.name} has no topic with messages that can be read{''.join(reasons)}")

    def contents(self) -> tuple[str, ...]:
        topics = self._contents().topics.values()
        return tuple(f"topic {one.name}: {one.count} messages of the type {one.type}" for one in topics)

    def units(self) -> Mapping[str, str]:
        contents = self._contents()
        topics = self._needed() if self.wanted else [contents.topic_of(self.examined()[0])]
        return {column: unit for column, unit in self._units(topics).items() if unit}

    def rows_about(self) -> int:
        return self._contents().topics[self._topic()].count

    def place(self, row: int) -> str:
        return f"message {row} of {self._topic()}"

    @property
    def remarks(self) -> tuple[str, ...]:
        return () if self._known is None else tuple(self._known.bag.remarks)

    def hint(self, column: str, known: list[str]) -> str:
        contents = self._contents()
        topic = contents.topic_of(column)
        if topic:
            own = contents.fields(topic)
            if own.problem:
                return f"the messages of {topic} cannot be read: {own.problem}"
            return closest(column, [f"{topic}.{field}" for field in own.units])
        named = [f"{one.name} ({one.type})" for one in contents.topics.values()]
        shown = f"{', '.join(named[:_SHOWN])}{' …' if len(named) > _SHOWN else ''}"
        return f"its topics are {shown}; the name of the topic comes first, then a point and the name of the field"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        topic, contents = self._topic(), self._contents()
        kind = contents.fields(topic).type
        if kind is None:
            raise InstrumentError(
                f"{self.name}: the messages of {topic} cannot be read: {contents.fields(topic).problem}"
            )
        fields = [column.removeprefix(f"{topic}.") for column in self.wanted]
        decoder = MessageReader(
            kind, [field for field in fields if field != RECEIVE_TIME or RECEIVE_TIME in kind.fields()]
        )
        first = 1
        times: list[int] = []
        rows: list[list[float]] = []
        for time, message in contents.bag.messages(topic):
            try:
                rows.append(decoder.numbers(message))
            except WrongMessageError as error:
                raise self._wrong(topic, first + len(rows), error) from None
            times.append(time)
            if len(rows) == BATCH:
                yield first, self._rows(topic, decoder, times, rows)
                first, times, rows = first + len(rows), [], []
        if rows:
            yield first, self._rows(topic, decoder, times, rows)

    def _rows(self, topic: str, decoder: MessageReader, times: list[int], rows: list[list[float]]) -> HeldRows:
        values = {f"{topic}.{field}": numbers for field, numbers in decoder.values(rows).items()}
        received = np.array([time // _SECOND + 1e-9 * (time % _SECOND) for time in times])  # rounded only once
        return HeldRows(len(rows), {f"{topic}.{RECEIVE_TIME}": received, **values})

    def _wrong(self, topic: str, number: int, error: WrongMessageError) -> InstrumentError:
        kind = self._contents().topics[topic].type
        return InstrumentError(
            f"{self.name}, message {number} of {topic}: this is not a message of the type {kind}: {error}; the bag is damaged, or "
            "was recorded with another definition of the type"
        )

    def _topic(self) -> str:
        """Returns the topic of all columns. Raises `InstrumentError` if they belong to several topics."""
        topics = self._needed()
        if len(topics) > 1:
            message = (
                f"its columns belong to the topics {' and '.join(topics[:4])}, whose messages have different times"
            )
            raise InstrumentError(f"{self.name}: {message}; take all columns, and the time, from one topic")
        return topics[0]

    def _needed(self) -> list[str]:
        """Returns the topics of the columns that are needed; all topics if no column is named yet."""
        contents = self._contents()
        if not self.wanted:
            return list(contents.topics)
        return list(dict.fromkeys(topic for column in self.wanted if (topic := contents.topic_of(column))))

    def _units(self, topics: Sequence[str]) -> dict[str, str]:
        """Returns the columns of some topics, with their units."""
        contents = self._contents()
        return {f"{topic}.{field}": unit for topic in topics for field, unit in contents.fields(topic).units.items()}

    def _contents(self) -> _Contents:
        """Returns the contents of the bag. Raises `InstrumentError` if it cannot be read, or if it contains no messages."""
        if self._known is None:
            made = _Contents(open_bag(self.path, self.name))
            if not any(one.count for one in made.topics.values()):
                raise InstrumentError(
                    f"{self.name} contains no messages{''.join(f'; left out: {one}' for one in made.bag.remarks)}"
                )
            try:
                import rosbags.typesys  # noqa: F401
            except ImportError:
                message = (
                    "reading ROS bags needs the package rosbags; install it with: pip install 'planrunner[recordings]'"
                )
                raise InstrumentError(f"{self.name}: {message}") from None
            self._known = made
        return self._known


def _fields_of(topic: Topic) -> _Fields:
    """Finds the fields of the messages of a topic. The stamp comes first, and the time of reception last."""
    if topic.problem:
        return _Fields(None, {}, topic.problem)
    try:
        kind = message_type(topic.type, topic.definition, is_cdr=topic.is_cdr)
        own = kind.fields()
    except UnreadableTypeError as error:
        return _Fields(None, {}, f"its type {topic.type} {error}")
    order = sorted(own, key=lambda field: field != _STAMP)
    return _Fields(kind, {**{field: own[field] for field in order}, RECEIVE_TIME: own.get(RECEIVE_TIME, "s")})
