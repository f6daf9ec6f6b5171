"""Reads ROS bags: bags of ROS 1 (.bag), and bags of ROS 2 (.mcap, .db3, or the folder that contains them).

A column is named after its topic and its field, with a point between them (`/imu/data.angular_velocity.x`). Each topic has its own
times, so a recording takes all its columns from one topic. The column `header.stamp` contains the time of the measurement, and
`receive_time` the time at which the recorder received the message. Both are in s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
class _Contents:
    """The contents of a bag. `topics`: all topics by name. `types`: the types of those topics whose messages can be read. `fields`:
    the fields of these topics, with their units. `problems`: for the other topics, the reason why they cannot be read."""

    topics: Mapping[str, Topic]
    types: Mapping[str, MessageType]
    fields: Mapping[str, Mapping[str, str]]
    problems: Mapping[str, str]

    def topic_of(self, column: str) -> str:
        """Returns the topic of a column; empty if there is none."""
        fits = [name for name in self.topics if column.startswith(f"{name}.")]
        return max(fits, key=len, default="")


class RosbagFile(FormatFile[NoKeys]):
    """A ROS bag. Its messages are read in batches, in the order in which they lie in the bag."""

    def __init__(self, path: Path, name: str, stamps: TimeStamps, channels: Mapping[str, str], parameters: NoKeys):
        super().__init__(path, name, stamps, channels, parameters)
        self._known: tuple[BagFile, _Contents] | None = None

    def columns(self) -> list[str]:
        fields = self._contents().fields
        return [f"{topic}.{field}" for topic, own in fields.items() for field in own]

    def examined(self) -> list[str]:
        """Returns the columns of the topic that most probably contains the IMU: of the messages of the type Imu, or of any type, the
        topic with most messages. Covariances are left out: they are statements of the driver, not samples."""
        contents = self._contents()
        counts = {
            name: (one.name == _IMU, contents.topics[name].count)
            for name, one in contents.types.items()
            if contents.topics[name].count
        }
        if not counts:
            reasons = [f"{topic}: {reason}" for topic, reason in contents.problems.items()]
            raise InstrumentError(
                f"{self.name} has no topic with messages that can be read{'; '.join(['', *reasons[:3]])}"
            )
        best = max(counts, key=counts.__getitem__)
        return [f"{best}.{field}" for field in contents.fields[best] if _COVARIANCE not in field]

    def contents(self) -> tuple[str, ...]:
        topics = self._contents().topics.values()
        return tuple(f"topic {one.name}: {one.count} messages of the type {one.type}" for one in topics)

    def units(self) -> Mapping[str, str]:
        fields = self._contents().fields
        return {f"{topic}.{field}": unit for topic, own in fields.items() for field, unit in own.items() if unit}

    def rows_about(self) -> int:
        return self._contents().topics[self._topic()].count

    def place(self, row: int) -> str:
        return f"message {row} of {self._topic()}"

    @property
    def remarks(self) -> tuple[str, ...]:
        return () if self._known is None else tuple(self._known[0].remarks)

    def hint(self, column: str, known: list[str]) -> str:
        contents = self._contents()
        topic = contents.topic_of(column)
        if topic in contents.problems:
            return f"the messages of {topic} cannot be read: {contents.problems[topic]}"
        if topic:
            return closest(column, [f"{topic}.{field}" for field in contents.fields[topic]])
        named = [f"{one.name} ({one.type})" for one in contents.topics.values()]
        shown = f"{', '.join(named[:_SHOWN])}{' …' if len(named) > _SHOWN else ''}"
        return f"its topics are {shown}; the name of the topic comes first, then a point and the name of the field"

    def batches(self, span: Span) -> Iterator[tuple[int, SampleRows]]:
        topic = self._topic()
        bag, contents = self._opened()
        fields = [column.removeprefix(f"{topic}.") for column in self.wanted]
        received = self._receives(topic)
        decoded = [field for field in fields if not (received and field == RECEIVE_TIME)]
        decoder = MessageReader(contents.types[topic], decoded)
        first, times, rows = 1, [], []
        for time, message in bag.messages(topic):
            try:
                rows.append(decoder.numbers(message) if decoded else [])
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

    def _receives(self, topic: str) -> bool:
        """Returns True if the column `receive_time` of a topic is the time of the recorder, not a field of its messages."""
        return RECEIVE_TIME not in self._contents().types[topic].fields()

    def _topic(self) -> str:
        """Returns the topic of all columns. Raises `InstrumentError` if they belong to several topics."""
        contents = self._contents()
        topics = list(dict.fromkeys(contents.topic_of(column) for column in self.wanted))
        if len(topics) > 1:
            message = (
                f"its columns belong to the topics {' and '.join(topics[:4])}, whose messages have different times"
            )
            raise InstrumentError(f"{self.name}: {message}; take all columns, and the time, from one topic")
        return topics[0] if topics else next(iter(contents.fields))

    def _contents(self) -> _Contents:
        return self._opened()[1]

    def _opened(self) -> tuple[BagFile, _Contents]:
        """Returns the bag and its contents."""
        if self._known is None:
            try:
                bag = open_bag(self.path, self.name)
                self._known = bag, _contents_of(bag)
            except ImportError as missing:
                message = f"reading ROS bags needs the package {missing.name}; install it with: pip install 'planrunner[recordings]'"
                raise InstrumentError(f"{self.name}: {message}") from None
        return self._known


def _contents_of(bag: BagFile) -> _Contents:
    """Finds the topics of a bag, and the fields of their messages. Raises `InstrumentError` if the bag contains no messages."""
    topics = bag.topics()
    if not any(one.count for one in topics.values()):
        raise InstrumentError(f"{bag.name} contains no messages{''.join(f'; {remark}' for remark in bag.remarks)}")
    types: dict[str, MessageType] = {}
    fields: dict[str, Mapping[str, str]] = {}
    problems: dict[str, str] = {}
    for name, topic in topics.items():
        try:
            if topic.problem:
                raise UnreadableTypeError(topic.problem)
            types[name] = message_type(topic.type, topic.definition, is_cdr=topic.is_cdr)
            own = types[name].fields()
        except UnreadableTypeError as error:
            types.pop(name, None)
            problems[name] = topic.problem or f"its type {topic.type} {error}"
            continue
        stamped = [_STAMP] if _STAMP in own else []
        order = [*stamped, *(field for field in own if field != _STAMP)]
        fields[name] = {**{field: own[field] for field in order}, RECEIVE_TIME: own.get(RECEIVE_TIME, "s")}
    return _Contents(topics, types, fields, problems)
