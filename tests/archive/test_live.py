"""The live state and the answers in a run folder: what is written can be read, and nothing else is."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

from planrunner.archive.live import (
    ANSWER,
    NAME,
    Answer,
    LiveChannel,
    LiveNotice,
    LiveState,
    Question,
    Strip,
    publish,
    read_live,
    take_answer,
    withdraw,
    write_answer,
)
from planrunner.base.guarded_folder import GuardedFolder

SCHEMAS = Path(__file__).resolve().parents[2] / "schemas"
QUESTION = Question("0123456789abcdef", "Mount face B\nand <b>tighten</b>")
STATE = LiveState(
    "2026-03-01T12:00:00.000000+00:00",
    1,
    "P2",
    8,
    0.25,
    90.0,
    "recording",
    False,
    QUESTION,
    (LiveChannel("x", "deg/s", 3, 1.5, 0.5, 1.0, 2.0, Strip((1.0, 1.25), (1.5, 1.5), (2.0, 1.75))),),
    (1.0, 2.0),
    0,
    (LiveNotice("2026-03-01T12:00:00.000000+00:00", "table: retried"),),
)


@pytest.fixture
def run(tmp_path: Path) -> GuardedFolder:
    return GuardedFolder.open(tmp_path)


def schema(name: str) -> dict[str, object]:
    found: dict[str, object] = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
    return found


def test_what_is_published_is_read_and_matches_its_schema(run: GuardedFolder) -> None:
    publish(run, STATE)
    assert read_live(run) == STATE
    jsonschema.validate(json.loads((run.path / NAME).read_bytes()), schema("live"))
    withdraw(run)
    assert read_live(run) is None and not list(run.path.iterdir())


def test_what_json_lacks_and_what_is_too_long_can_be_published(run: GuardedFolder) -> None:
    nothing = math.nan
    channel = LiveChannel("x" * 5000, "V", 0, nothing, nothing, math.inf, -math.inf, Strip())
    publish(run, replace(STATE, label="L" * 5000, time_left=math.inf, channels=(channel,), strip_time=()))
    read = read_live(run)
    assert read is not None and read.time_left is None and len(read.label) == len(read.channels[0].name) == 1000
    assert math.isnan(read.channels[0].mean) and math.isnan(read.channels[0].greatest)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[]",
        b'{"planrunner_live": 2}',
        b'{"planrunner_live": 1}',
        b"[" * 100_000,
        b" " * (2**20 + 1),
        json.dumps({**STATE.to_json(), "fraction": 2}).encode(),
        json.dumps({**STATE.to_json(), "more": 1}).encode(),
        json.dumps({**STATE.to_json(), "question": {"id": "../../x", "text": ""}}).encode(),
    ],
)
def test_what_does_not_match_the_schema_is_no_live_state(run: GuardedFolder, text: bytes) -> None:
    (run.path / NAME).write_bytes(text)
    assert read_live(run) is None


def test_a_link_is_no_live_state_and_is_not_followed(
    run: GuardedFolder, tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "state"
    publish(run, STATE)
    (run.path / NAME).rename(elsewhere)
    (run.path / NAME).symlink_to(elsewhere)
    assert read_live(run) is None
    publish(run, STATE)
    assert not (run.path / NAME).is_symlink() and read_live(run) == STATE


def test_an_answer_confirms_its_own_question_once(run: GuardedFolder) -> None:
    assert take_answer(run, QUESTION.id) is None
    write_answer(run, Answer(QUESTION.id, "Li Wei"))
    jsonschema.validate(json.loads((run.path / ANSWER).read_bytes()), schema("answer"))
    assert take_answer(run, QUESTION.id) == Answer(QUESTION.id, "Li Wei")
    assert take_answer(run, QUESTION.id) is None


def test_an_answer_to_another_question_is_discarded(run: GuardedFolder) -> None:
    write_answer(run, Answer("f" * 16, "Li Wei"))
    assert take_answer(run, QUESTION.id) is None and not (run.path / ANSWER).exists()


@pytest.mark.parametrize("by", ["", "x" * 101])
def test_an_answer_without_a_usable_name_confirms_nothing(run: GuardedFolder, by: str) -> None:
    write_answer(run, Answer(QUESTION.id, by))
    assert take_answer(run, QUESTION.id) is None
