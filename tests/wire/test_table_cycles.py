"""Cycles of turns and stops on a real table: each turn in its sense and at its time, each stop where it belongs, and what ends them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from planrunner.base.findings import Findings
from planrunner.instruments.interfaces import InstrumentError, OwnLimits
from planrunner.instruments.tables import timed_motion
from planrunner.instruments.tables.acutrol import AcutrolParameters
from planrunner.instruments.tables.axis_commands import AxisBounds, AxisState, Sine
from planrunner.instruments.tables.axis_table import AxisTable
from planrunner.instruments.tables.timed_motion import turns_of
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Cycle, Move, Segment

TICK = 0.01
"""s by which the clock goes on whenever it is looked at."""
AXIS = "axes: [{name: table, direction: up, max_rate: 100 deg/s, max_acceleration: 50 deg/s^2MORE}]"


class TickingClock:
    speed = 1.0

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        self.time += TICK
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


class Axis:
    """One axis that reads 0 to 360 deg and knows how far it truly turned. A rate is reached at 50 deg/s^2; a position at once, and only
    from near by, since a controller would choose its own way there. lazy: it turns at 99 % of a rate and does not go to positions."""

    rocks = False

    def __init__(self, clock: TickingClock, reads_whole_turns: bool = False):
        self.clock, self.reads_whole_turns = clock, reads_whole_turns
        self.since, self.angle, self.rate, self.wanted = 0.0, 0.0, 0.0, 0.0
        self.told: list[tuple[float, str, float, float]] = []  # s, what, value, true angle
        self.lazy = False

    def _now(self) -> tuple[float, float]:
        """True angle [deg] and rate."""
        elapsed, change = self.clock.time - self.since, self.wanted - self.rate
        ramp = min(elapsed, abs(change) / 50)
        turned = self.rate * ramp + math.copysign(25 * ramp**2, change) + self.wanted * (elapsed - ramp)
        rate = self.wanted if ramp < elapsed else self.rate + math.copysign(50 * ramp, change)
        return self.angle + turned, rate

    def _begin(self, what: str, value: float) -> None:
        self.angle, self.rate = self._now()
        self.since = self.clock.time
        self.told.append((self.clock.time, what, value, self.angle))

    def identify(self) -> Mapping[str, str]:
        return {}

    def limit(self, axis: int, bounds: AxisBounds) -> Sequence[str]:
        return []

    def energise(self) -> None:
        """It is ready."""

    def go_to(self, positions: Mapping[int, float], here: Mapping[int, float]) -> None:
        self._begin("go", positions[1])
        away = math.remainder(positions[1] - self.angle, 360)
        assert abs(away) < 3 and abs(self.rate) < 0.5
        if not self.lazy:
            self.angle, self.rate, self.wanted = self.angle + away, 0.0, 0.0

    def turn(self, axis: int, rate: float) -> None:
        self._begin("turn", rate)
        self.wanted = rate * (0.99 if self.lazy else 1.0)

    def rock(self, sines: Mapping[int, Sine]) -> None:
        raise AssertionError

    def state(self, axis: int) -> AxisState:
        angle, rate = self._now()
        return AxisState(angle if self.reads_whole_turns else angle % 360, rate)

    def faults(self) -> Sequence[str]:
        return []

    def stop(self) -> None:
        self._begin("stop", 0.0)
        self.wanted = 0.0

    def switch_off(self) -> None:
        self.told.append((self.clock.time, "off", 0.0, self.angle))

    def remarks(self) -> Sequence[str]:
        return []

    def close(self) -> None:
        """Nothing is held open."""

    def turns(self) -> list[tuple[float, str, float, float]]:
        """Beginnings of turns."""
        return [told for told in self.told if told[1] == "turn" and told[2] != 0.0]


@contextmanager
def table(
    monkeypatch: pytest.MonkeyPatch, more: str = "", **axis: bool
) -> Iterator[tuple[AxisTable, Axis, TickingClock]]:
    monkeypatch.setattr(timed_motion, "SHORTEST", 0.0)
    monkeypatch.setattr(timed_motion, "LONGEST", 0.0)
    log = Findings()
    text = f"address: TCPIP::127.0.0.1::1::SOCKET\n{AXIS.replace('MORE', more)}"
    keys: Any = RecordOf(AcutrolParameters).read(source.parse(text, "bench.yaml"), log)
    assert list(log) == []
    clock = TickingClock()
    commands = Axis(clock, **axis)
    made = AxisTable(commands, keys, clock, 0.0)
    try:
        yield made, commands, clock
    finally:
        made.close()


def cycle(stop: float, *degrees: float, rate: float = 20.0) -> Cycle:
    moves = tuple(Move(str(place), math.radians(turn), str(place + 1)) for place, turn in enumerate(degrees))
    return Cycle({}, moves, math.radians(rate), stop)


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_when_turns_begin_brake_and_end() -> None:
    """180 deg at 20 deg/s and 10 deg/s^2: 2 s of ramp, 7 s level, 2 s of ramp. 10 deg: sqrt(10·10) = 10 deg/s after 1 s, and 1 s down."""
    found = turns_of(cycle(5.0, 180.0, -180.0, -10.0, 10.0), math.radians(10))
    expected = [
        (5, 14, 16, 20, 180),
        (21, 30, 32, -20, 0),
        (37, 38, 39, -10, -10),
        (44, 45, 46, 10, 0),
        (51, 60, 62, 20, 180),
    ]
    for turn, (begins, brakes, ends, rate, target) in zip(found, expected, strict=False):
        assert (turn.begins, turn.brakes, turn.ends) == pytest.approx((begins, brakes, ends))
        assert (math.degrees(turn.rate), math.degrees(turn.target)) == pytest.approx((rate, target))


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
@pytest.mark.parametrize("whole", [False, True])
def test_every_turn_has_its_sense_and_every_stop_its_place(
    sense: str, whole: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half turns and more, whose shorter way is the other one; after two cycles nothing has added up."""
    degrees = (180.0, 90.0, -270.0, -180.0, 180.0)
    with table(monkeypatch, f", sense: {sense}", reads_whole_turns=whole) as (made, axis, _):
        assert made.begin_motion(cycle(2.0, *degrees), 1000.0) == 0.0
        begun = axis.told[0][0]
        until(lambda: len(axis.turns()) > 2 * len(degrees))
        made.end_motion()
        assert made._timed.broken == ""
        sign = 1 if sense == "counterclockwise" else -1
        place, planned = 0.0, begun
        for number, (when, _, rate, angle) in enumerate(axis.turns()[: 2 * len(degrees)]):
            turn = degrees[number % len(degrees)]
            planned += 2.0
            assert when == pytest.approx(planned, abs=0.1)
            assert rate == pytest.approx(sign * math.copysign(20.0, turn))
            assert angle == pytest.approx(sign * place, abs=0.01)  # it stood where it belongs until then
            place += turn
            planned += abs(turn) / 20 + 20 / 50


def test_what_it_sees_of_itself_is_reported_when_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    with table(monkeypatch) as (made, axis, clock):
        monkeypatch.setattr(timed_motion, "LONGEST", 0.0005)  # slowly enough to be looked at meanwhile
        monkeypatch.setattr(timed_motion, "SHORTEST", 0.0005)
        made.begin_motion(cycle(1.0, 20.0, -20.0), 1000.0)
        errors: list[float] = []
        while len(axis.turns()) < 4 or not errors:  # a busy machine may look away from one stop to the next
            condition = made.watch()
            assert condition.faults == ()
            errors += [value for name, value in condition.values.items() if name == "position_error"]
            time.sleep(0.002)
        assert errors and max(errors) < math.radians(0.01)
        until(lambda: abs(axis.state(1).rate) > 19)
        seconds = made.end_motion()
        assert seconds == pytest.approx(20 / 50, rel=0.1)
        clock.sleep(seconds + 0.1)
        assert made.holding() and axis.state(1).rate == 0.0
        told = len(axis.told)
        clock.sleep(100.0)
        time.sleep(0.02)
        assert len(axis.told) == told  # nobody goes on with it


def test_an_axis_that_does_not_come_to_its_position_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    with table(monkeypatch) as (made, axis, _):
        axis.lazy = True
        made.begin_motion(cycle(2.0, 90.0, -90.0), 1000.0)
        until(lambda: made._timed.broken)
        assert len(axis.turns()) == 1
        (fault,) = made.watch().faults
        assert fault.startswith("the cycle could not continue: the axis 'table' is not at its position when the stop")
        with pytest.raises(InstrumentError, match="make the stop longer"):
            made.holding()
        made.make_safe()
        assert axis.told[-1][1] == "off"


def test_nothing_moves_when_the_run_looks_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when a driver hangs: the watchdog has made the table safe by then, and the cycle must not set it going again."""
    with table(monkeypatch) as (made, axis, clock):
        made.limit(OwnLimits(silence=0.2))
        made.begin_motion(cycle(2.0, 90.0, -90.0), 1000.0)
        time.sleep(0.4)
        until(lambda: made._timed.broken)
        told = len(axis.told)
        clock.sleep(1000.0)
        time.sleep(0.05)
        assert len(axis.told) == told
        assert made.watch().faults == ("the cycle could not continue: the run has not polled the table for 0.2 s",)


def test_cycles_that_the_axis_cannot_make_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with table(monkeypatch, ", lowest: -100 deg, highest: 100 deg") as (made, axis, _):
        with pytest.raises(
            InstrumentError, match="'C': turning needs 120 deg/s; the table axis reaches at most 100 deg/s"
        ):
            made.foresee([Segment(0, "C", None, "", cycle(2.0, 90.0, -90.0, rate=120.0), 60.0)])
        made.foresee([Segment(0, "C", None, "", cycle(2.0, 90.0, -90.0), 60.0)])
        with pytest.raises(
            InstrumentError, match="the cycle turns the table axis from 0 to 180 deg; the axis can turn only from -100"
        ):
            made.begin_motion(cycle(2.0, 90.0, 90.0, -180.0), 60.0)
        assert axis.told == []
