"""Tables that refuse, trip, stray or are the wrong ones: told in words, left safe."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from scripted import Listener, answering, parameters, silent_at_first, surroundings, turned

from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import InstrumentError, OwnLimits
from planrunner.instruments.tables.acutrol import Acutrol, AcutrolParameters, kind_of
from planrunner.instruments.wire.links import LinkFailure
from planrunner.physics.kinematics import rotation_about
from planrunner.plan.schedule import Cycle, Move, Rock, Segment, Spin

ONE = "axes: [{name: table, direction: up, max_rate: 100 deg/s, max_acceleration: 200 deg/s^2}]"
TWO = """axes:
  - {name: outer, direction: up, max_rate: 100 deg/s, max_acceleration: 200 deg/s^2, number: 2, zero: 30 deg, sense: clockwise}
  - {name: inner, direction: east, max_rate: 50 deg/s, max_acceleration: 100 deg/s^2, number: 1, lowest: -90 deg, highest: 90 deg}
"""


class Controller:
    """Answers as an ACUTROL whose axes are at once where they are told to be; `say` changes single answers, `heard` keeps the commands."""

    def __init__(self) -> None:
        self.position, self.rate, self.mode = {1: 0.0, 2: 30.0}, {1: 0.0, 2: 0.0}, {1: "Off", 2: "Off"}
        self.limits: dict[str, str] = {}
        self.say: dict[str, str] = {}
        self.heard: list[str] = []
        self.stops = True
        self.lock = threading.Lock()

    def __call__(self, message: str) -> bytes:
        with self.lock:
            reply = self._reply(message.casefold())
        return b"" if reply is None else f"{reply}\n".encode()

    def wait_for(self, command: str, times: int = 1) -> None:
        """What is not answered may still be on its way."""
        end = time.monotonic() + 60
        while self.heard.count(command) < times and time.monotonic() < end:
            time.sleep(0.005)
        assert self.heard.count(command) == times

    def _reply(self, text: str) -> str | None:
        if text in self.say:
            return self.say[text]
        if not text.endswith("?") and "?" not in text:
            self.heard.append(text)
            for command in text[1:].split(":", 1)[1].split(";"):
                self._obey(text[1:].split(":", 1)[0], command)
            return None
        if text.startswith(":read:pos?"):
            axis = int(re.findall(r"\d", text)[0])
            return f"{self.position[axis]};{self.rate[axis]}"
        if text.startswith(":mode?"):
            return self.mode[int(text[-1])]
        if text.startswith(":limit:absolute?"):
            return "1000,4200,40000,-400,400,1100"
        if text.startswith((":limit:rate?", ":limit:acc?")):
            return self.limits[f"{text[7:].split('?')[0]} {text[-1]}"]
        return {"*idn?": "ACUTRONIC,ACT2000,17,2.1", ":status:stb?": "0", "*stb?": "0"}.get(text, "Closed")

    def _obey(self, main: str, command: str) -> None:
        sub, _, rest = command.partition(" ")
        values = rest.split(",")
        if main == "lim" and sub in ("rate", "acc") and values[0] == "rate":
            self.limits[f"{sub} {values[1]}"] = values[2]
        if main == "mode":
            for axis in (1, 2) if values[0] == "all" else (int(values[0]),):
                self.mode[axis] = {"pos": "P", "rate": "Rate", "synt": "Synthesis", "off": "Off"}[sub]
                if sub == "off" and self.stops:
                    self.rate[axis] = 0.0
        if main == "dem" and sub == "pos":
            self.position[int(values[0])], self.rate[int(values[0])] = float(values[1]), 0.0
        if main == "dem" and sub == "rate":
            self.rate[int(values[0])] = float(values[1])


@contextmanager
def bench(axes: str = ONE) -> Iterator[tuple[Controller, Any, Listener]]:
    """A table whose time passes only by its waits and by the test's, `table.clock.sleep`."""
    controller = Controller()
    with answering(controller) as server:
        table = Acutrol.connect(parameters(AcutrolParameters, server.address, axes), surroundings(VirtualClock()))
        try:
            yield controller, table, server
        finally:
            table.close()


def segment(motion: Any) -> Segment:
    return Segment(0, "S1", None, "", motion, 60.0)


def test_the_wrong_instrument_is_reported_before_anything_is_set() -> None:
    heard = []

    def watlow(message: str) -> bytes:
        heard.append(message)
        return b"WATLOW,F4T,1,4.0\n"

    with answering(watlow) as server:
        with pytest.raises(
            InstrumentError,
            match=r"identifies itself as .WATLOW,F4T,1,4.0., which does not contain .ACUT.",
        ):
            Acutrol.connect(parameters(AcutrolParameters, server.address, ONE), surroundings())
        assert heard == ["*IDN?"]
        keys = parameters(AcutrolParameters, server.address, ONE, "model_contains: f4t")
        Acutrol.connect(keys, surroundings()).close()


def test_two_axes_move_in_one_message_each_as_its_controller_counts() -> None:
    with bench(TWO) as (controller, table, _):
        east_up = rotation_about((0.0, 0.0, 1.0), math.radians(40)) @ rotation_about((1.0, 0.0, 0.0), math.radians(-20))
        table.orient(east_up.T)
        assert controller.heard[-1] == ":dem:pos 2,-10;pos 1,-20"  # 30 deg − 40 deg clockwise; −20 deg
        assert ":mode:pos 2;pos 1" in controller.heard
        assert table.holding()
        assert table.read() == pytest.approx({"outer_deg": 40.0, "inner_deg": -20.0})
        assert ":limit:global 1,-90,90,55,1" in controller.heard
        assert ":limit:global 2,-400,400,110,1" in controller.heard
        assert next(command for command in controller.heard if "lim" not in command) == ":interlock:reset"


def test_limits_of_the_bench_narrow_those_of_the_axes() -> None:
    with bench() as (controller, table, _):
        told = table.limit(OwnLimits(rate=math.radians(60), position_error=math.radians(0.25)))
        assert told == ["axis 1: at most 60 deg/s and 200 deg/s^2; it trips at 66 deg/s, 0.25 deg of tracking error"]
        table.orient(turned(10.0))
        assert controller.heard.count(":lim:rate pos,1,60") == 1  # not set again with the first move
        assert ":lim:rate pos,1,100" not in controller.heard
        assert table.orient(turned(130.0)) == pytest.approx(120 / 60 + 60 / 200)  # at the rate that it is limited to


def test_a_table_that_reaches_less_than_the_bench_file_says() -> None:
    with bench() as (controller, table, _):
        controller.say[":limit:absolute? 1"] = "80,4200,40000,-400,400,90"
        with pytest.raises(InstrumentError, match=r"axis 1 of the ACUTROL reaches 80 deg/s .* correct max_rate"):
            table.orient(turned(10.0))
        assert not [command for command in controller.heard if command.startswith((":dem", ":int:close"))]


def test_a_limit_that_is_not_kept() -> None:
    with bench() as (controller, table, _):
        controller.say[":limit:rate? rate,1"] = "1000"
        with pytest.raises(InstrumentError, match=r"keeps 1000 as its rate limit instead of the commanded 100"):
            table.limit(OwnLimits())


def test_a_command_that_is_not_taken() -> None:
    with bench() as (controller, table, _):
        table.orient(turned(0.0))
        controller.say[":status:stb?"] = "72"
        with pytest.raises(
            InstrumentError, match=r"rejects one of these commands: :dem:rate 1,0, :mode:rate 1, :dem:rate 1,10"
        ):
            table.begin_motion(Spin(math.radians(10)), 1.0)


def test_an_interlock_that_does_not_close() -> None:
    with bench() as (controller, table, _):
        controller.say[":interlock? 1"] = "Fault"
        with pytest.raises(InstrumentError, match=r"the interlock of axis 1 does not close: check doors"):
            table.orient(turned(10.0))
        assert not [command for command in controller.heard if command.startswith(":dem")]


def test_a_trip_while_it_spins() -> None:
    with bench() as (controller, table, _):
        table.begin_motion(Spin(math.radians(10)), 60.0)
        assert table.watch().faults == ()
        controller.say[":status:stb?"] = "65"
        controller.mode[1], controller.rate[1] = "Off", 0.0
        faults = table.watch().faults
        assert faults[0].startswith("an interlock is open or a trip has opened it")
        assert faults[1] == "axis 1 went into the mode 'Off' by itself"
        with pytest.raises(InstrumentError, match="the table: an interlock is open"):
            table.holding()


def test_what_is_measured_decides_whether_it_holds() -> None:
    with bench() as (controller, table, _):
        table.orient(turned(90.0))
        assert table.holding()
        controller.position[1] = 90.02
        assert not table.holding()
        assert table.watch().values["position_error"] == pytest.approx(math.radians(0.02))
        controller.position[1] = 450.0  # a whole turn further on a continuous axis is the same orientation
        assert table.holding()
        controller.rate[1] = 0.5
        assert not table.holding()
        table.begin_motion(Spin(math.radians(10)), 60.0)
        controller.rate[1] = 5.0
        assert table.watch().values == {}  # on its way, there is no error to be held against limits
        controller.rate[1] = 10.0
        assert table.holding()
        controller.rate[1] = 9.9
        assert table.watch().values == pytest.approx({"rate_error": math.radians(0.1)})


def test_a_table_that_does_not_stop_is_switched_off_and_reported() -> None:
    with bench("axes: [{name: table, direction: up, max_rate: 10 deg/s, max_acceleration: 2000 deg/s^2}]") as (
        controller,
        table,
        _,
    ):
        table.begin_motion(Spin(math.radians(10)), 60.0)
        controller.stops = False
        with pytest.raises(
            InstrumentError, match=r"still turns at 10 deg/s after it was stopped: press its emergency stop"
        ):
            table.make_safe()
        controller.wait_for(":int:open all")


def test_making_safe_is_quick_and_may_be_asked_again() -> None:
    with bench() as (controller, table, _):
        table.begin_motion(Spin(math.radians(10)), 60.0)
        begun = table.clock.now()
        table.make_safe()
        table.make_safe()
        assert table.clock.now() == begun  # it waits for nothing
        controller.wait_for(":int:open all", times=2)
        assert controller.heard[-2] == ":mode:off all"
        table.orient(turned(5.0))  # goes on after a wait in the safe state
        assert controller.heard.count(":int:close 1") == 2
        assert table.holding()


def test_a_connection_that_was_lost_does_not_keep_the_table_from_being_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    with bench() as (controller, table, server):
        table.begin_motion(Spin(math.radians(10)), 60.0)
        server.hang_up()
        silent_at_first(table.commands.link, monkeypatch)
        table.make_safe()
        assert controller.rate[1] == 0.0
        controller.wait_for(":int:open all")
        assert server.connections == 2


def test_a_dead_link_is_reported_at_every_attempt_to_make_it_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    with bench() as (_, table, server):
        table.orient(turned(5.0))
        server.close()
        silent_at_first(table.commands.link, monkeypatch)
        with pytest.raises(InstrumentError, match=r"::SOCKET, when asked ':status:stb\?'"):
            table.make_safe()
        for _again in range(2):
            with pytest.raises(InstrumentError, match="refuses the connection"):
                table.make_safe()


def test_a_table_that_someone_left_turning_is_stopped() -> None:
    with bench() as (controller, table, _):
        controller.rate[1], controller.stops = 20.0, False
        with pytest.raises(InstrumentError, match="still moving"):
            table.orient(turned(5.0))
        controller.stops = True
        assert table.end_motion() == pytest.approx(0.1)
        assert controller.rate[1] == 0.0


def test_rocking_ends_by_itself_after_its_duration() -> None:
    with bench() as (controller, table, _):
        table.orient(turned(5.0))
        table.begin_motion(Rock(math.radians(0.05), 10.0, (0.0,), 0.2), 60.0)
        assert controller.heard[-1] == ":dem:osc 1,0.05,10,0"
        assert controller.mode[1] == "Synthesis"
        table.clock.sleep(0.6)
        controller.wait_for(":dem:pos 1,5", times=3)
        assert controller.heard[-4:] == [":dem:osc 1,0,10,0", ":dem:pos 1,5", ":mode:pos 1", ":dem:pos 1,5"]
        assert table.holding()
        assert table.end_motion() == 0.0


def test_rocking_begins_by_itself_within_the_record() -> None:
    with bench() as (controller, table, _):
        table.orient(turned(5.0))
        assert table.begin_motion(Rock(math.radians(0.05), 10.0, (0.0,), 0.2, delay=0.3), 60.0) == 0.0
        assert table.watch().faults == ()
        assert ":dem:osc 1,0.05,10,0" not in controller.heard
        table.clock.sleep(0.35)
        controller.wait_for(":dem:osc 1,0.05,10,0")
        table.clock.sleep(0.3)  # two periods of fading and the rocking are over then
        controller.wait_for(":dem:pos 1,5", times=3)
        assert ":dem:osc 1,0,10,0" in controller.heard
        assert table.holding()


def test_rocking_that_is_called_off_before_it_begins_never_begins() -> None:
    with bench() as (controller, table, _):
        table.orient(turned(5.0))
        table.begin_motion(Rock(math.radians(0.05), 10.0, (0.0,), 0.2, delay=3600.0), 60.0)
        table.end_motion()
        assert not any(line.startswith(":dem:osc 1,0.05") for line in controller.heard)


def test_a_mode_that_another_thread_changes_meanwhile_has_not_strayed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a cycle does: between the question for the mode and its answer the axis is sent to another."""
    with bench() as (controller, table, _):
        table.orient(turned(5.0))
        answer = controller._reply

        def late(text: str) -> str | None:
            if text == ":mode? 1":
                controller.mode[1], table.commands._modes[1] = "Rate", "rate"
            return answer(text)

        monkeypatch.setattr(controller, "_reply", late)
        assert table.watch().faults == ()
        monkeypatch.setattr(controller, "_reply", answer)
        controller.mode[1] = "Off"
        assert table.watch().faults == ("axis 1 went into the mode 'Off' by itself",)


def test_rocking_two_rings_in_phase_is_one_message() -> None:
    with bench(TWO) as (controller, table, _):
        table.begin_motion(Rock(math.radians(3), 0.2, (0.0, math.pi / 4), math.inf), 60.0)
        assert controller.heard[-1] == ":dem:osc 2,-3,0.2,0;osc 1,3,0.2,45"
        table.end_motion()


def test_what_it_cannot_do_is_foreseen() -> None:
    with bench() as (_, table, _server):
        for motion, why in (
            (
                Cycle({"A": 0.0, "C": math.pi}, (Move("A", math.pi, "C"), Move("C", -math.pi, "A")), 2.0, 1.0),
                "'S1': turning needs 114.592 deg/s; the table axis reaches at most 100 deg/s",
            ),
            (Rock(0.01, 0.2, (0.0, 0.0), 1.0), "'S1': 2 rings are planned to rock, but the table has 1"),
            (Rock(1.0, 1.0, (0.0,), 1.0), "'S1': rocking needs 360 deg/s; the table axis reaches"),
        ):
            with pytest.raises(InstrumentError, match=re.escape(why)):
                table.foresee([segment(motion)])
        table.foresee([segment(Spin(0.1)), segment(Rock(0.01, 0.2, (0.0,), 1.0))])
        with pytest.raises(
            InstrumentError, match=r"spinning needs 120 deg/s; the table axis reaches at most 100 deg/s"
        ):
            table.begin_motion(Spin(math.radians(120)), 1.0)
        with pytest.raises(InstrumentError, match="cannot spin about this direction"):
            table.begin_motion(Spin(0.1, (1.0, 0.0, 0.0)), 1.0)
        with pytest.raises(InstrumentError, match="cannot take this orientation"):
            table.orient(rotation_about((1.0, 0.0, 0.0), 1.0).T)


@pytest.mark.parametrize(
    ("reply", "kind"),
    [
        (b"\0\0\0\0\0\0\0\x0512.5\n", "words, high byte first"),
        (b"\0\0\0\0\x05\0\0\x0012.5\n", "words, low byte first"),
        (b"0000000512.5\n", "characters, decimal"),
        (b"0000001A" + b"x" * 25 + b"\n", "characters, hexadecimal"),
        (b"12.5\n", None),
        (b"ACUTRONIC,ACT2000\n", None),
    ],
)
def test_framing_is_known_by_its_length(reply: bytes, kind: str | None) -> None:
    assert kind_of(reply) == kind


@pytest.mark.parametrize("reply", [b"\0\0\0\0\0\0\0\x0512.5\n\xff", b"", b"12.5", b"\xff\xfe\n"])
def test_what_is_neither_line_nor_frame_is_refused(reply: bytes) -> None:
    with pytest.raises(LinkFailure, match="neither a line nor framed"):
        kind_of(reply)


def test_framed_replies_with_acknowledgements_and_errors() -> None:
    def framed(body: bytes, error: int = 0) -> bytes:
        return error.to_bytes(4, "big") + len(body).to_bytes(4, "big") + body

    def acknowledging(message: str) -> bytes:
        if "?" not in message:
            return framed(controller(message))  # empty
        if message == ":read:pos? 1;rate? 1":
            return framed(b"no such axis\n", error=7)
        reply = controller(message)
        return framed(reply)

    controller = Controller()
    with answering(acknowledging) as server:
        table = Acutrol.connect(parameters(AcutrolParameters, server.address, ONE), surroundings())
        table.limit(OwnLimits())
        with pytest.raises(InstrumentError, match=r"the ACUTROL reports error 7: 'no such axis\\n'"):
            table.read()
        table.close()
