"""Exchanges data with other processes in two small files in the run folder: the live state of a run, and the answers to its
prompts.

The process that executes a run replaces `.live` about once a second and removes it at the end. A process that watches the run reads
this file, and writes `.answer` when a person has confirmed a prompt. The two files are not part of the record of the run: they are
not flushed to the disk and not sealed, and a run does not depend on them. The files may come from other processes, so they are
checked against a schema and a maximum size before they are used.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from pathlib import Path

from planrunner.archive import formats
from planrunner.archive.formats import IntegrityError
from planrunner.archive.storage import Storage
from planrunner.base.documents import Json, JsonObject
from planrunner.base.guarded_folder import GuardedFolder

NAME = ".live"
ANSWER = ".answer"
FORMAT = 1
MOST_BYTES = 2**20
"""Maximum size in bytes of each of the two files."""
LONGEST_NAME = 100
"""Maximum length of the name of the person who answers."""
LONGEST_TEXT = 1000

_STORAGE = Storage("flushed")


@dataclass(frozen=True, slots=True)
class Question:
    """Describes a prompt that waits for an answer. `id`: identifier of the question. Each question has a new identifier, so that an
    answer cannot apply to another question."""

    id: str
    text: str


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer to a prompt. `question`: id of the prompt. `by`: name of the person who confirmed the prompt."""

    question: str
    by: str


@dataclass(frozen=True, slots=True)
class Strip:
    """Contains a strip chart of a channel. For each of many short consecutive intervals, it contains the smallest value, the mean
    and the largest value; NaN for an interval without samples."""

    least: tuple[float, ...] = ()
    mean: tuple[float, ...] = ()
    greatest: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class LiveChannel:
    """Describes a channel of the sensor: the statistics of its samples in the present segment so far, and its strip chart."""

    name: str
    unit: str
    count: int
    mean: float
    standard_deviation: float
    least: float
    greatest: float
    strip: Strip


@dataclass(frozen=True, slots=True)
class LiveNotice:
    """Describes a notice of something unusual in the run. `at`: time of the notice, UTC, ISO 8601."""

    at: str
    text: str


@dataclass(frozen=True, slots=True)
class LiveState:
    """The present state of a run.

    `at`: time of this state, UTC, ISO 8601. `index`: index of the present segment, counted from 0. `fraction`: completed part of
    the planned time, 0 to 1. `time_left`: remaining real time, s; None if it is not yet known. `strip_time`: end of each interval
    of the strip charts, s, on the sensor's clock. `hidden_channels`: number of channels that are not listed.
    """

    at: str
    index: int
    label: str
    segments: int
    fraction: float
    time_left: float | None
    activity: str
    paused: bool
    question: Question | None
    channels: tuple[LiveChannel, ...]
    strip_time: tuple[float, ...]
    hidden_channels: int
    notices: tuple[LiveNotice, ...]

    def to_json(self) -> JsonObject:
        question = self.question
        return {
            "planrunner_live": FORMAT,
            "at": self.at,
            "segment": {"index": self.index, "label": _short(self.label), "of": self.segments},
            "fraction": self.fraction,
            "time_left_s": None if self.time_left is None else _number(self.time_left),
            "activity": _short(self.activity),
            "paused": self.paused,
            "question": None if question is None else {"id": question.id, "text": _short(question.text)},
            "channels": [_channel_json(channel) for channel in self.channels],
            "strip_time_s": [_number(value) for value in self.strip_time],
            "hidden_channels": self.hidden_channels,
            "notices": [{"at": notice.at, "text": _short(notice.text)} for notice in self.notices],
        }

    @classmethod
    def from_json(cls, data: JsonObject) -> LiveState:
        """Reads a live state from data that match the schema."""
        segment, question = data["segment"], data["question"]
        return cls(
            data["at"],
            segment["index"],
            segment["label"],
            segment["of"],
            data["fraction"],
            data["time_left_s"],
            data["activity"],
            data["paused"],
            None if question is None else Question(question["id"], question["text"]),
            tuple(_channel(channel) for channel in data["channels"]),
            tuple(_value(value) for value in data["strip_time_s"]),
            data["hidden_channels"],
            tuple(LiveNotice(notice["at"], notice["text"]) for notice in data["notices"]),
        )


def _channel_json(channel: LiveChannel) -> JsonObject:
    strip = channel.strip
    return {
        "name": _short(channel.name),
        "unit": _short(channel.unit),
        "count": channel.count,
        "mean": _number(channel.mean),
        "standard_deviation": _number(channel.standard_deviation),
        "least": _number(channel.least),
        "greatest": _number(channel.greatest),
        "strip": {
            "least": [_number(value) for value in strip.least],
            "mean": [_number(value) for value in strip.mean],
            "greatest": [_number(value) for value in strip.greatest],
        },
    }


def _channel(data: JsonObject) -> LiveChannel:
    strip = data["strip"]
    return LiveChannel(
        data["name"],
        data["unit"],
        data["count"],
        _value(data["mean"]),
        _value(data["standard_deviation"]),
        _value(data["least"]),
        _value(data["greatest"]),
        Strip(
            tuple(_value(value) for value in strip["least"]),
            tuple(_value(value) for value in strip["mean"]),
            tuple(_value(value) for value in strip["greatest"]),
        ),
    )


def _short(text: str) -> str:
    """Shortens a text to the length that the schema permits, because a plan or a driver may give a text of any length."""
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "…"


def _number(value: float) -> float | None:
    """Returns a number for display. The number has ten significant digits, because a bias can be a millionth of the reading of a
    channel. NaN and infinities become null."""
    return float(f"{value:.10g}") if math.isfinite(value) else None


def _value(value: Json) -> float:
    return math.nan if value is None else float(value)


def publish(run: GuardedFolder, state: LiveState) -> None:
    """Replaces the live state in the run folder. Raises `OSError` if the file cannot be written."""
    _STORAGE.write_whole(run, NAME, formats.to_bytes(state.to_json()))


def withdraw(run: GuardedFolder) -> None:
    """Removes the live state and an unused answer, because the run has ended. Failures to remove them are ignored."""
    for name in (NAME, ANSWER):
        with contextlib.suppress(OSError):
            run.remove(name)


def read_live(run: GuardedFolder) -> LiveState | None:
    """Returns the live state of a run; None if there is none, or if its file does not have the expected form."""
    data = _read(run, NAME, "live", "planrunner_live")
    return None if data is None else LiveState.from_json(data)


def write_answer(run: GuardedFolder, answer: Answer) -> None:
    """Writes the answer to a prompt. Raises `OSError` if the file cannot be written."""
    data = {"planrunner_answer": FORMAT, "question": answer.question, "by": answer.by}
    _STORAGE.write_whole(run, ANSWER, formats.to_bytes(data))


def take_answer(run: GuardedFolder, question: str) -> Answer | None:
    """Returns the answer to a question in the run folder; None if there is none. An answer to another question is discarded."""
    try:
        if run.entry(ANSWER) is None:
            return None
        data = _read(run, ANSWER, "answer", "planrunner_answer")
        run.remove(ANSWER)
    except OSError:
        return None
    return Answer(question, data["by"]) if data is not None and data["question"] == question else None


def _read(run: GuardedFolder, name: str, schema: str, version: str) -> JsonObject | None:
    path: Path = run.path / name
    try:
        return formats.parse_json(run.read(name, MOST_BYTES), path, schema, version, FORMAT)
    except (OSError, IntegrityError):
        return None
