"""Chambers that refuse, alarm, stay behind or are the wrong ones: told in words, left on their way to ambient."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from scripted import answering, parameters, silent_at_first, surroundings

from planrunner.instruments.chambers import watlow_f4t
from planrunner.instruments.chambers.espec_p300 import EspecP300
from planrunner.instruments.chambers.thermotron_8800 import Thermotron8800
from planrunner.instruments.chambers.watlow_f4t import WatlowF4t
from planrunner.instruments.interfaces import InstrumentError, OwnLimits
from planrunner.plan.units import ZERO_CELSIUS

RANGE = ("lowest: -40 degC", "highest: 85 degC", "ramp: 3 K/min", "tolerance: 0.5 K")
WARM = 60 + ZERO_CELSIUS


class Answers:
    """Answers by what is asked; a command is answered by what `commands` makes of it. `heard` keeps everything."""

    def __init__(self, end: str, says: dict[str, str], command: Any):
        self.end, self.says, self.command = end, says, command
        self.heard: list[str] = []

    def __call__(self, message: str) -> bytes:
        self.heard.append(message)
        reply = self.says.get(message, self.command(message))
        return b"" if reply is None else f"{reply}{self.end}".encode()


F4T = {
    "*IDN?": "WATLOW,F4T,12,4.07", ":SOURCE:CLOOP1:ERROR?": "NONE", ":UNIT:TEMPERATURE?": "C", ":SOURCE:CLOOP1:PVALUE?": "25.0",
    ":SOURCE:CLOOP1:SPOINT?": "60.0",
}  # fmt: skip
P300 = {"TYPE?": "T,T,S2,160.0", "MON?": "25.0,,CONSTANT,0", "TEMP?": "25.0,25.0,90.0,-45.0", "ALARM?": "0"}
T8800 = {"IDEN?": "8800", "SCOD?": "1", "ALRM1?": "0", "PVAR1?": "25.0"}


@contextmanager
def f4t() -> Iterator[tuple[Answers, Any]]:
    yield from _chamber(WatlowF4t, Answers("\n", dict(F4T), lambda message: None), b"\n")


@contextmanager
def p300(*more: str) -> Iterator[tuple[Answers, Any]]:
    says = {**P300, **{f"3,{question}": answer for question, answer in P300.items()}}
    yield from _chamber(
        EspecP300, Answers("\r\n", says, lambda message: f"OK:{message.removeprefix('3,')}"), b"\r\n", *more
    )


@contextmanager
def t8800() -> Iterator[tuple[Answers, Any]]:
    yield from _chamber(Thermotron8800, Answers("\r\n", dict(T8800), lambda message: "0"), b"\r")


def _chamber(driver: Any, answers: Answers, end: bytes, *more: str) -> Iterator[tuple[Answers, Any]]:
    with answering(answers, end) as server:
        chamber = driver.connect(parameters(driver.Parameters, server.address, *RANGE, *more), surroundings())
        try:
            yield answers, chamber
        finally:
            chamber.close()


@pytest.fixture(autouse=True)
def _no_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watlow_f4t, "PACE", 0.0)


@pytest.mark.parametrize("driver", [WatlowF4t, EspecP300, Thermotron8800])
def test_the_wrong_instrument_is_reported_when_connecting(driver: Any) -> None:
    with (
        answering(lambda message: b"ACUTRONIC ACT2000\r\n", b"\r") as server,
        pytest.raises(InstrumentError, match=r"check the address|did not answer"),
    ):
        driver.connect(parameters(driver.Parameters, server.address, *RANGE, timeout="0.5 s"), surroundings())


def test_beyond_the_range_nothing_is_sent() -> None:
    with p300() as (answers, chamber):
        with pytest.raises(InstrumentError, match=r"90 degC is outside the chamber's range of -40 to 85 degC"):
            chamber.set_temperature(90 + ZERO_CELSIUS)
        assert answers.heard == ["TYPE?"]


def test_what_is_measured_decides_whether_the_air_is_there() -> None:
    with p300() as (answers, chamber):
        assert not chamber.at_temperature()  # nothing was asked of it yet
        seconds = chamber.set_temperature(WARM)
        assert seconds > 35 / 3 * 60
        assert not chamber.at_temperature()
        answers.says["TEMP?"] = "59.6,60.0,90.0,-45.0"
        assert chamber.at_temperature()
        assert chamber.watch().values == {"temperature": pytest.approx(59.6 + ZERO_CELSIUS)}


def test_limits_of_the_bench_go_to_the_controller_that_has_them() -> None:
    with p300() as (answers, chamber):
        told = chamber.limit(OwnLimits(coldest=-20 + ZERO_CELSIUS, hottest=70 + ZERO_CELSIUS))
        assert told == ["the chamber gives an alarm below -20.0 and above 70.0 degC"]
        chamber.set_temperature(WARM)
        assert [item for item in answers.heard if item.startswith(("TEMP,H", "TEMP,L"))] == [
            "TEMP,H70.0",
            "TEMP,L-20.0",
        ]
    with f4t() as (_, chamber):
        assert chamber.limit(OwnLimits(hottest=WARM)) == []


@pytest.mark.parametrize(
    ("bench", "question", "answer", "fault"),
    [
        (f4t, ":SOURCE:CLOOP1:ERROR?", "ERROR", "control loop 1 of the F4T reports ERROR"),
        (p300, "MON?", "25.0,,CONSTANT,1", "alarms of the P300 (number, codes): 1,3"),
        (t8800, "SCOD?", "7", "the 8800 has stopped: a process alarm"),
        (t8800, "SCOD?", "10", "the 8800 has stopped: Therm-Alarm tripped"),
        (t8800, "ALRM1?", "32", "high process alarm of channel 1"),
    ],
)
def test_an_alarm_ends_waiting_and_does_not_keep_it_from_being_made_safe(
    bench: Any, question: str, answer: str, fault: str
) -> None:
    with bench() as (answers, chamber):
        chamber.foresee([])
        chamber.set_temperature(WARM)
        answers.says.update({question: answer, "ALARM?": "1,3", ":SOURCE:CLOOP1:SPOINT?": "25.0"})
        assert chamber.watch().faults == (fault,)
        for ask in (chamber.at_temperature, lambda: chamber.foresee([]), lambda: chamber.set_temperature(WARM)):
            with pytest.raises(InstrumentError, match="the chamber: "):
                ask()
        chamber.make_safe()
        asked = {"SETP1,25", "TEMP,S25.0", ":SOURCE:CLOOP1:SPOINT 25"}
        assert asked & set(answers.heard)


@pytest.mark.parametrize("driver", [WatlowF4t, EspecP300, Thermotron8800])
def test_a_connection_that_was_lost_does_not_keep_the_chamber_from_ambient(
    driver: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    says, end, command = {
        WatlowF4t: (F4T, "\n", lambda message: None),
        EspecP300: (P300, "\r\n", lambda message: f"OK:{message}"),
        Thermotron8800: (T8800, "\r", lambda message: "0"),
    }[driver]
    answers = Answers(end, {**says, ":SOURCE:CLOOP1:SPOINT?": "25.0"}, command)
    with answering(answers, end.encode()) as server:
        chamber = driver.connect(parameters(driver.Parameters, server.address, *RANGE), surroundings())
        server.hang_up()
        silent_at_first(chamber.commands.link, monkeypatch)
        chamber.make_safe()
        chamber.close()
        assert server.connections == 2
        assert {"SETP1,25", "TEMP,S25.0", ":SOURCE:CLOOP1:SPOINT 25"} & set(answers.heard)


def test_a_stop_at_the_panel_is_noticed() -> None:
    with t8800() as (answers, chamber):
        answers.says["SCOD?"] = "2"
        chamber.foresee([])  # stopped and waiting is how it is found
        answers.says["SCOD?"] = "1"
        chamber.set_temperature(WARM)
        answers.says["SCOD?"] = "2"
        assert chamber.watch().faults == ("the 8800 has stopped: its stop key was pressed",)


def test_refusals_are_reported_with_their_reason() -> None:
    with p300() as (answers, chamber):
        answers.says["TEMP,S60.0"] = "NA:DATA OUT OF RANGE"
        with pytest.raises(
            InstrumentError, match=r"refuses 'TEMP,S60.0' with 'NA:DATA OUT OF RANGE': the value is beyond its range"
        ):
            chamber.set_temperature(WARM)
        answers.says["TEMP,S60.0"] = "OK:TEMP,S20.0"
        with pytest.raises(
            InstrumentError, match=r"answers 'TEMP,S60.0' with 'OK:TEMP,S20.0' instead of OK:TEMP,S60.0"
        ):
            chamber.set_temperature(WARM)
    with t8800() as (answers, chamber):
        answers.says["SETP1,60"] = "5"
        with pytest.raises(InstrumentError, match=r"answers 'SETP1,60' with '5' instead of 0"):
            chamber.set_temperature(WARM)
    with f4t() as (answers, chamber):
        answers.says[":SOURCE:CLOOP1:SPOINT?"] = "50.0"
        with pytest.raises(
            InstrumentError, match=r"keeps the set point 50 instead of 60 degC: check its set point limits"
        ):
            chamber.set_temperature(WARM)
        answers.says[":SOURCE:CLOOP1:PVALUE?"] = "-----"
        with pytest.raises(InstrumentError, match=r"with '-----', but a number is expected"):
            chamber.read()
    with f4t() as (answers, chamber):
        answers.says[":UNIT:TEMPERATURE?"] = "F"
        with pytest.raises(InstrumentError, match=r"keeps the temperature unit 'F', although C was commanded"):
            chamber.set_temperature(WARM)


def test_a_chamber_on_a_shared_line_is_asked_by_its_address() -> None:
    with p300("station: 3") as (answers, chamber):
        chamber.set_temperature(WARM)
        assert all(message.startswith("3,") for message in answers.heard)
