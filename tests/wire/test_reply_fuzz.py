"""Whatever a table or chamber answers, its driver understands it or says what is wrong with it."""

from __future__ import annotations

import contextlib
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import TRANSCRIPTS, Transcript, parameters

from planrunner.instruments.chambers.espec_p300 import EspecP300Commands, EspecP300Parameters
from planrunner.instruments.chambers.thermotron_8800 import Thermotron8800Commands, Thermotron8800Parameters
from planrunner.instruments.chambers.watlow_f4t import WatlowF4tCommands, WatlowF4tParameters
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.tables.acutrol import KINDS, AcutrolCommands, AcutrolParameters, kind_of
from planrunner.instruments.tables.aerosmith import AerosmithCommands, AerosmithParameters
from planrunner.instruments.tables.axis_commands import AxisBounds
from planrunner.instruments.wire.links import LinkFailure, MessageLink
from planrunner.plan.kinds import Record

ADDRESS = "TCPIP::127.0.0.1::9::SOCKET"
AXIS = "axes: [{name: table, direction: up, max_rate: 100 deg/s, max_acceleration: 200 deg/s^2}]"
RANGE = ("lowest: -40 degC", "highest: 85 degC", "ramp: 3 K/min")
PIECES = ("0", "1", "65", "72", "-40.0", "1e9", "1e999", "nan", "Rate", "P", "Fault", "NONE", "C", "OK:TEMP,S60.0", "NA:CMD ERR", "8800",
          "ACUT", "F4T", "T,T,S2,160.0", "25.0,,CONSTANT,1", "1_0", "0x1", "+", "٣")  # fmt: skip


class Answering(MessageLink):
    """A link whose answers are given."""

    def __init__(self, link: MessageLink, answers: list[str]):
        super().__init__(link.settings, link.framing)
        self.answers = answers

    def query(self, text: str, **how: Any) -> str:
        return self.answers.pop() if self.answers else ""

    def write(self, *texts: str) -> None:
        """Nothing hears it."""


def _keys(record: type[Record], *more: str) -> Any:
    return parameters(record, ADDRESS, *more)


TABLES = [(AcutrolCommands, _keys(AcutrolParameters, AXIS)), (AerosmithCommands, _keys(AerosmithParameters, AXIS))]
CHAMBERS = [
    (EspecP300Commands, _keys(EspecP300Parameters, *RANGE)),
    (Thermotron8800Commands, _keys(Thermotron8800Parameters, *RANGE)),
    (WatlowF4tCommands, _keys(WatlowF4tParameters, *RANGE)),
]
BOUNDS = AxisBounds(100.0, 200.0, 1.0)
ANSWERS = st.lists(
    st.one_of(
        st.sampled_from(PIECES), st.text(max_size=30), st.lists(st.sampled_from(PIECES), max_size=6).map(",".join)
    ),
    max_size=8,
)


def _asks_of_table(table: Any) -> tuple[Any, ...]:
    return (
        table.identify, lambda: table.limit(1, BOUNDS), table.energise, lambda: table.go_to({1: 5.0}, {1: 0.0}),
        lambda: table.turn(1, 3.0), lambda: table.state(1), table.faults, table.stop,
    )  # fmt: skip


def _asks_of_chamber(chamber: Any) -> tuple[Any, ...]:
    return (
        chamber.identify, lambda: chamber.prepare(3.0), lambda: chamber.limit(-45.0, 90.0), lambda: chamber.head_for(60.0),
        chamber.air, chamber.faults,
    )  # fmt: skip


def _try(answers: list[str]) -> None:
    for kinds, asks_of in ((TABLES, _asks_of_table), (CHAMBERS, _asks_of_chamber)):
        for commands, keys in kinds:
            made = commands(keys)
            _ask_all(made, asks_of(made), answers)


def _ask_all(commands: Any, asks: Any, answers: list[str]) -> None:
    for ask in asks:
        commands.link = Answering(commands.link, list(answers))
        with contextlib.suppress(InstrumentError):
            ask()


@settings(max_examples=150, deadline=None)
@given(ANSWERS)
def test_any_answers_are_understood_or_refused_in_words(answers: list[str]) -> None:
    _try(answers)


@pytest.mark.slow
def test_a_million_mutated_replies() -> None:
    draw = random.Random(20261121)
    replies = sorted(
        {
            reply.encode()
            for path in TRANSCRIPTS.glob("*.txt")
            for _, reply in Transcript.read(path.stem).exchanges
            if reply
        }
    )
    asks: list[tuple[Answering, Any]] = []
    for kinds, asks_of in ((TABLES, _asks_of_table), (CHAMBERS, _asks_of_chamber)):
        for commands, keys in kinds:
            made = commands(keys)
            made.link = Answering(made.link, [])
            asks += [(made.link, ask) for ask in asks_of(made)]
    understood = 0
    for _ in range(1_000_000):
        reply = bytearray(draw.choice(replies))
        for _ in range(draw.randrange(4)):
            place = draw.randrange(len(reply) + 1)
            reply[place : place + draw.randrange(3)] = draw.randbytes(draw.randrange(3))
        link, ask = draw.choice(asks)
        link.answers = [reply.decode("ascii", "ignore")] * 4
        with contextlib.suppress(InstrumentError):
            ask()
            understood += 1
        with contextlib.suppress(LinkFailure):
            kind_of(bytes(reply))
    assert 10_000 < understood < 1_000_000


@settings(max_examples=500, deadline=None)
@given(st.one_of(st.binary(max_size=60), st.binary(max_size=20).map(lambda body: b"0000%04d" % len(body) + body)))
def test_any_first_reply_is_framed_a_line_or_refused(reply: bytes) -> None:
    try:
        kind = kind_of(reply)
    except LinkFailure:
        return
    assert kind in KINDS or reply.endswith(b"\n")
