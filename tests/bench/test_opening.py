"""The connected bench: roles, the order of making safe, and what happens when an instrument fails."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from planrunner.base import plugins
from planrunner.bench import model
from planrunner.bench.clock import VirtualClock, WallClock
from planrunner.bench.model import parse_bench, read_bench
from planrunner.bench.opening import open_bench
from planrunner.bench.watchdog import Watchdog
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.virtual.chamber import VirtualChamber
from planrunner.instruments.virtual.flexure_gyro import VirtualFlexureGyro
from planrunner.instruments.virtual.table import VirtualTable
from planrunner.plan import source
from planrunner.plan.kinds import Boolean, Record, key

LOG: list[str] = []


class FakeParameters(Record):
    fails: bool = key(Boolean(), "Fails to connect.", True, default=False)
    unsafe: bool = key(Boolean(), "Fails to be made safe.", True, default=False)


def fake(kind: str):
    @dataclass
    class Fake:
        parameters: FakeParameters
        role = kind
        Parameters = FakeParameters

        @classmethod
        def model(cls, parameters):
            return None

        @classmethod
        def connect(cls, parameters, surroundings):
            if parameters.fails:
                raise OSError("no answer on the line")
            LOG.append(f"{kind} connected")
            return cls(parameters)

        def make_safe(self):
            LOG.append(f"{kind} safe")
            if self.parameters.unsafe:
                raise InstrumentError("does not stop")

        def close(self):
            LOG.append(f"{kind} closed")

    return Fake


DRIVERS = {kind: fake(kind) for kind in ("table", "chamber", "sensor", "monitor")}


@pytest.fixture(autouse=True)
def drivers(monkeypatch):
    LOG.clear()
    monkeypatch.setattr(plugins, "names", lambda group: tuple(DRIVERS))
    monkeypatch.setattr(plugins, "load", lambda group, name: DRIVERS[name])
    assert vars(model)["plugins"] is plugins


def bench(instruments: str, clock: str = "virtual"):
    text = f"planrunner_bench: 1\nname: t\nclock: {clock}\nsite: {{latitude: 40 deg, gravity: 9.8 m/s^2}}\n"
    read, log = parse_bench(source.parse(text + "instruments: {" + instruments + "}\n", "b.yaml"))
    assert list(log) == []
    return read


ALL = "s: {driver: sensor}, c: {driver: chamber}, t: {driver: table}, m: {driver: monitor}"


def test_instruments_by_role_and_made_safe_in_order_on_leaving():
    with open_bench(bench(ALL)) as opened:
        assert opened.table is opened.instruments["t"]
        assert opened.chamber is opened.instruments["c"]
        assert opened.sensor is opened.instruments["s"]
        assert isinstance(opened.clock, VirtualClock)
        opened.take_control()
        LOG.clear()
    safe = ["table safe", "chamber safe", "sensor safe", "monitor safe"]
    assert safe + [entry.replace("safe", "closed") for entry in safe] == LOG


def test_each_is_made_safe_whatever_the_others_do():
    opened = open_bench(
        bench("t: {driver: table, unsafe: true}, c: {driver: chamber, unsafe: true}, s: {driver: sensor}")
    )
    opened.take_control()
    failures = opened.make_safe()
    assert [str(failure) for failure in failures] == ["t: does not stop", "c: does not stop"]
    assert LOG[-3:] == ["table safe", "chamber safe", "sensor safe"]
    assert opened.close() == []
    assert opened.close() == []


def test_signs_of_life_come_between_the_instruments_while_each_is_made_safe():
    """Each may take its time-outs; a watchdog that is gone keeps nobody from his turn."""

    class Ending(Watchdog):
        def __init__(self): ...

        def sign_of_life(self):
            LOG.append("alive")
            if len(LOG) > 4:
                raise InstrumentError("the watchdog process has ended")

    opened = open_bench(bench("a: {driver: table}, b: {driver: chamber}, c: {driver: sensor}"))
    LOG.clear()
    opened.take_control()
    opened.watchdog = Ending()
    assert opened.make_safe() == []
    assert LOG == ["alive", "table safe", "alive", "chamber safe", "alive", "sensor safe"]


def test_leaving_says_what_could_not_be_made_safe():
    with (
        pytest.raises(InstrumentError, match="t: does not stop"),
        open_bench(bench("t: {driver: table, unsafe: true}")) as opened,
    ):
        opened.take_control()


def test_what_was_never_commanded_is_left_as_it_was_found():
    """To connect is not to command: what fails before the first command, or beside it, touches nothing else."""
    with open_bench(bench(ALL)) as opened:
        assert opened.untouched == ("s", "c", "t", "m")
        LOG.clear()
    assert LOG == ["table closed", "chamber closed", "sensor closed", "monitor closed"]
    assert opened.safe
    LOG.clear()
    opened = open_bench(bench("s: {driver: sensor}, c: {driver: chamber}, t: {driver: table, unsafe: true}"))
    LOG.clear()
    opened.take_control("t")
    assert opened.untouched == ("s", "c")
    with pytest.raises(InstrumentError, match="does not stop"):
        opened.__exit__(OSError, OSError("the chamber does not answer"), None)
    assert LOG == ["table safe", "table closed", "chamber closed", "sensor closed"]
    assert not opened.safe


def test_nothing_is_commanded_unguarded():
    """The watchdog hears of an instrument before it is commanded; when it is gone, nothing is."""
    told = []

    class Ending(Watchdog):
        def __init__(self): ...

        def sign_of_life(self): ...

        def answer_for(self, names):
            told.append(sorted(names))
            if len(told) > 2:
                raise InstrumentError("the watchdog process has ended")

    with open_bench(bench(ALL)) as opened:
        opened.watchdog = Ending()
        opened.take_control("t")
        opened.take_control("t")
        opened.take_control("t", "c")
        with pytest.raises(InstrumentError, match="watchdog process has ended"):
            opened.take_control()
        assert told == [["t"], ["c"], ["m", "s"]] and opened.untouched == ("s", "m")


def test_when_the_third_fails_the_first_two_are_let_go_as_they_were():
    text = "s: {driver: sensor}, t: {driver: table}, c: {driver: chamber, fails: true}, m: {driver: monitor}"
    with pytest.raises(InstrumentError, match=r"c \(chamber\) cannot be connected: no answer on the line"):
        open_bench(bench(text))
    assert LOG == ["sensor connected", "table connected", "table closed", "sensor closed"]


def test_clocks():
    assert isinstance(open_bench(bench(ALL, "wall")).clock, WallClock)
    clock = VirtualClock(5.0)
    assert open_bench(bench(ALL), clock=clock).clock is clock


def test_the_virtual_bench_shares_one_world(monkeypatch):
    monkeypatch.undo()
    with open_bench(read_bench("virtual")[0], seed=3) as opened:
        assert isinstance(opened.table, VirtualTable)
        assert isinstance(opened.chamber, VirtualChamber)
        assert isinstance(opened.sensor, VirtualFlexureGyro)
        assert opened.table.world is opened.chamber.world is opened.sensor.world
        assert opened.sensor.world.seed == 3
        assert not opened.sensor.world.real_time
    with open_bench(read_bench("virtual")[0]) as opened:
        assert isinstance(opened.sensor, VirtualFlexureGyro)
        assert opened.sensor.world.seed == 20
