"""A link on a bus that marks the end of a message, as GPIB does; PyVISA's resource is played, since no bus is at hand."""

from __future__ import annotations

import time
from typing import Any

import pytest
from pyvisa import constants, errors

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire import links
from planrunner.instruments.wire.links import LinkSettings, MessageLink


class Bus:
    """A resource manager and its one resource."""

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.answers: list[bytes] = []

    timeout = 0.0

    def open_resource(self, address: str, open_timeout: int) -> Bus:
        self.told.append(("open", address))
        return self

    def write_raw(self, message: bytes) -> None:
        self.told.append(message)

    def read_raw(self) -> bytes:
        if not self.answers:
            raise errors.VisaIOError(constants.StatusCode.error_timeout)
        return self.answers.pop(0)

    def clear(self) -> None:
        self.told.append("clear")

    def close(self) -> None:
        self.told.append("close")


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Bus:
    made = Bus()
    monkeypatch.setattr(links, "_manager", lambda: made)
    return made


def test_messages_go_one_by_one_at_the_pace_that_the_instrument_needs(bus: Bus) -> None:
    link = MessageLink(LinkSettings("GPIB0::1::INSTR", pace=0.04))
    bus.answers = [b"0\r\n"]
    start = time.monotonic()
    assert link.query(":status:stb?", after=[":dem:rate 1,0", ":mode:rate 1"]) == "0"
    assert time.monotonic() - start >= 0.08
    assert bus.told == [("open", "GPIB0::1::INSTR"), b":dem:rate 1,0\n", b":mode:rate 1\n", b":status:stb?\n"]


def test_after_silence_the_device_is_cleared_so_that_no_late_answer_waits_in_it(bus: Bus) -> None:
    link = MessageLink(LinkSettings("GPIB0::1::INSTR", timeout=0.1, tries=1))
    with pytest.raises(InstrumentError, match=r"GPIB0::1::INSTR, when asked '\*IDN\?', did not answer within 0.1 s"):
        link.query("*IDN?")
    assert bus.told[-2:] == ["clear", "close"]
    bus.answers = [b"ACUTRONIC\n"]
    assert link.query("*IDN?") == "ACUTRONIC"
    assert bus.told[-2] == ("open", "GPIB0::1::INSTR")
