"""The drivers of tables say what the transcripts say, word for word, and understand what is answered."""

from __future__ import annotations

import math
from typing import Any

import pytest
from scripted import Player, SerialPlayer, answering, parameters, surroundings, turned

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.tables.acutrol import Acutrol, AcutrolParameters
from planrunner.instruments.tables.aerosmith import Aerosmith, AerosmithParameters
from planrunner.instruments.tables.scpi_table import ScpiTable, ScpiTableParameters
from planrunner.plan.schedule import Rock, Segment, Spin

AXIS = "axes: [{name: table, direction: up, max_rate: 100 deg/s, max_acceleration: 200 deg/s^2}]"


def acutrol(address: str, *more: str) -> Any:
    return Acutrol.connect(parameters(AcutrolParameters, address, AXIS, *more), surroundings())


def degrees(values: dict[str, float]) -> dict[str, float]:
    return {name: math.degrees(value) for name, value in values.items()}


@pytest.mark.parametrize("name", ["acutrol_position", "acutrol_tcp_words", "acutrol_tcp_ascii"])
def test_acutrol_takes_a_position(name: str) -> None:
    with Player(name) as player:
        table = acutrol(player.address)
        seconds = table.orient(turned(90.0))
        assert seconds == pytest.approx(0.9 + 0.5)  # 90 deg at 100 deg/s and 200 deg/s^2
        assert table.holding()
        table.make_safe()
        table.close()
        player.check()
        assert table.remarks() == []


def test_acutrol_spins_both_ways_and_comes_to_rest() -> None:
    with Player("acutrol_rate") as player:
        table = acutrol(player.address)
        assert table.begin_motion(Spin(math.radians(10)), 60.0) == pytest.approx(0.05)
        assert table.holding()
        # about down, the table turns the other way about its axis, which points up
        assert table.begin_motion(Spin(math.radians(20), (0.0, 0.0, -1.0)), 60.0) == pytest.approx(0.15)
        assert table.holding()
        assert table.end_motion() == pytest.approx(0.1)
        assert table.holding()
        table.make_safe()
        table.close()
        player.check()


def test_acutrol_rocks() -> None:
    with Player("acutrol_rock") as player:
        table = acutrol(player.address)
        table.orient(turned(0.0))
        rock = Rock(math.radians(3), 0.2, (0.0,), math.inf)
        table.foresee([segment(rock)])
        assert table.begin_motion(rock, 60.0) == pytest.approx(5.0)
        assert table.holding()
        table.end_motion()
        assert table.holding()
        table.make_safe()
        table.close()
        player.check()


SCPI = """commands:
  limit: ["AXIS{axis}:LIM:RATE {rate}", "AXIS{axis}:LIM:ACC {acceleration}"]
  energise: ["AXIS{axis}:DRIVE ON"]
  go_to: "AXIS{axis}:POS {position}"
  turn: "AXIS{axis}:RATE {rate}"
  stop: "AXIS{axis}:STOP"
  switch_off: ["AXIS{axis}:DRIVE OFF"]
  position: "AXIS{axis}:POS?"
  rate: "AXIS{axis}:RATE?"
"""


def test_a_table_whose_commands_stand_in_the_bench_file() -> None:
    with Player("scpi_table_position_rate") as player:
        keys = parameters(ScpiTableParameters, player.address, AXIS, SCPI)
        table = ScpiTable.connect(keys, surroundings())
        table.orient(turned(90.0))
        assert table.holding()
        table.begin_motion(Spin(math.radians(10)), 60.0)
        assert table.holding()
        table.end_motion()
        assert table.holding()
        with pytest.raises(InstrumentError, match=r"'S1': the table has no rocking motion"):
            table.foresee([segment(Rock(0.1, 1.0, (0.0,), 10.0))])
        table.make_safe()
        table.close()
        player.check()


def test_aerosmith_positions_jogs_and_rocks_over_a_serial_line() -> None:
    with SerialPlayer("aerosmith_position_rate") as player:
        table = Aerosmith.connect(parameters(AerosmithParameters, player.address, AXIS), surroundings())
        table.orient(turned(90.0))
        assert table.holding()
        table.begin_motion(Spin(math.radians(10)), 60.0)
        assert table.holding()
        table.end_motion()
        assert table.holding()
        table.begin_motion(Rock(math.radians(3), 0.2, (0.0,), math.inf), 60.0)
        assert table.holding()
        table.end_motion()
        assert table.holding()
        table.make_safe()
        table.close()
        player.check()
        assert table.remarks() == []


def test_the_late_answer_of_an_aerosmith_motion_is_not_that_of_a_question() -> None:
    """A jog is answered, with an empty line, when it ends, which may be after the next question was put."""
    replies = {"STA": b"0\r>\r", "PPO": b"\r>\r14.16\r>\r", "PVE": b"\r>\r0\r>\r"}
    with answering(lambda message: replies.get(message, b"\r>\r"), b"\r\n") as server:
        table = Aerosmith.connect(parameters(AerosmithParameters, server.address, AXIS), surroundings())
        assert table.read() == {"table_deg": pytest.approx(14.16)}
        assert table.remarks() == []
        table.close()


def segment(motion: Any) -> Segment:
    return Segment(0, "S1", None, "", motion, 60.0)
