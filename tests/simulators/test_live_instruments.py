"""What stands behind the controllers, and what they are on a line: plants, feed, serial line, faulty replies."""

from __future__ import annotations

import asyncio
import math

import bench_pieces
import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.instruments.interfaces import Surroundings
from planrunner.instruments.virtual.imu import VirtualImu
from planrunner.instruments.virtual.imu_keys import VirtualImuParameters
from planrunner.plan.kinds import RecordOf
from planrunner.plan.source import parse
from planrunner.plan.units import ZERO_CELSIUS
from planrunner.simulators.acutrol import Acutrol
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.espec_p300 import EspecP300
from planrunner.simulators.faults import FaultBoard, read_fault
from planrunner.simulators.live_world import SensorFeed
from planrunner.simulators.message_port import Manner, MessagePort
from planrunner.simulators.ports import Port, SerialLine
from planrunner.simulators.table_plant import TablePlant

EARTH_RATE = math.degrees(7.292115e-5)  # deg/s
SINE = math.sin(bench_pieces.SITE.latitude)


def table(**limits: str) -> tuple[Acutrol, TablePlant]:
    live = bench_pieces.with_table(bench_pieces.axis("only", "up", 400, 200, **limits))
    plant = TablePlant(live)
    unit = Acutrol(plant)
    for message in (":int:reset", ":int:close all", ":lim:rate rate,1,400", ":mode:rate 1"):
        unit.answer(message)
    return unit, plant


# -- tables ------------------------------------------------------------------------------------------------------------


def test_a_rate_beyond_the_limit_is_held_to_it_and_said() -> None:
    unit, plant = table()
    unit.answer(":lim:rate rate,1,50;:dem:rate 1,80")
    bench_pieces.clock_of(plant.live).time = 10.0
    assert unit.answer(":read:rate? 1") == "50"
    assert int(unit.answer(":status:a1dyn?") or "none") & 16


def test_an_axis_that_turns_faster_than_its_trip_switches_itself_off() -> None:
    unit, plant = table()
    unit.answer(":limit:global 1,-1000,1000,30,1;:dem:rate 1,60")
    bench_pieces.clock_of(plant.live).time = 1.0
    unit.watch()
    bench_pieces.clock_of(plant.live).time = 5.0
    assert unit.answer(":read:rate? 1") == "0"
    assert unit.answer(":mode? 1") == "Abort"
    assert int(unit.answer("*STB?") or "none") & 64
    unit.answer(":mode:rate 1")
    assert unit.answer(":read:rate? 1") == "0"


def test_a_limited_axis_does_not_go_beyond_its_end() -> None:
    unit, plant = table(lowest="-30 deg", highest="30 deg")
    unit.answer(":dem:pos 1,90;:mode:pos 1")
    bench_pieces.clock_of(plant.live).time = 60.0
    assert unit.answer(":read:pos? 1") == "30"


def test_a_continuous_axis_takes_the_shorter_way_and_reads_within_a_turn() -> None:
    unit, plant = table()
    unit.answer(":dem:pos 1,350;:mode:pos 1")
    bench_pieces.clock_of(plant.live).time = 60.0
    assert unit.answer(":read:pos? 1") == "350"
    assert math.degrees(plant.state(0)[0]) == pytest.approx(-10)


def test_an_interlock_that_stays_open_is_not_reset_away() -> None:
    unit, plant = table()
    plant.open_interlock()
    unit.answer(":int:reset;close 1")
    assert unit.answer(":interlock? 1") == "Fault"
    plant.open_interlock(False)
    unit.answer(":int:reset;close 1")
    assert unit.answer(":interlock? 1") == "Closed"


# -- chambers ----------------------------------------------------------------------------------------------------------


def celsius(plant: ChamberPlant) -> float:
    return plant.air() - ZERO_CELSIUS


def test_a_chamber_follows_its_ramp() -> None:
    """A lag of 2 min behind 3 K/min is 6 K behind on the ramp, and nothing an hour later."""
    plant = ChamberPlant(bench_pieces.with_chamber(-55, 85, 3))
    plant.regulate(60 + ZERO_CELSIUS)
    bench_pieces.clock_of(plant.live).time = 600.0
    assert celsius(plant) == pytest.approx(25 + 30 - 6 * (1 - math.exp(-5)), abs=1e-6)
    bench_pieces.clock_of(plant.live).time = 4200.0
    assert celsius(plant) == pytest.approx(60, abs=1e-3)


def test_a_chamber_that_overshoots_trips_on_its_own_limit() -> None:
    live = bench_pieces.with_chamber(-55, 85, 3)
    plant = ChamberPlant(live)
    unit = EspecP300(plant)
    unit.answer("TEMP,H70.0")
    unit.answer("TEMP,S60.0")
    unit.answer("MODE,CONSTANT")
    plant.disturb(overshoot=30.0)
    for minute in range(90):
        bench_pieces.clock_of(live).time = 60.0 * minute
        unit.watch()
    assert plant.alarms
    assert unit.answer("MODE,CONSTANT") == "NA:CHB NOT READY"
    bench_pieces.clock_of(live).time += 7200
    assert celsius(plant) == pytest.approx(25, abs=0.1)


def test_a_chamber_that_sticks_stays_where_it_is() -> None:
    plant = ChamberPlant(bench_pieces.with_chamber(-55, 85, 3))
    plant.regulate(60 + ZERO_CELSIUS)
    bench_pieces.clock_of(plant.live).time = 300.0
    stuck = celsius(plant)
    plant.disturb(stuck=True)
    bench_pieces.clock_of(plant.live).time = 3000.0
    assert celsius(plant) == pytest.approx(stuck, abs=1e-6)
    plant.disturb(stuck=False)
    bench_pieces.clock_of(plant.live).time = 9000.0
    assert celsius(plant) == pytest.approx(60, abs=0.01)


# -- the sensor --------------------------------------------------------------------------------------------------------


def test_the_sensor_feels_the_table_turn_from_the_moment_of_the_command() -> None:
    unit, plant = table()
    live = plant.live
    keys = parse("{sample_rate: 100 Hz, gyros: {axes: {z: {}}}}", "sensor")
    parameters = RecordOf(VirtualImuParameters).read(keys, Findings())
    sensor = VirtualImu.connect(parameters, Surroundings(live.clock, bench_pieces.SITE, world=live.world))
    feed = SensorFeed(live, sensor, 100.0)
    bench_pieces.clock_of(live).time = 10.0
    unit.answer(":lim:acc rate,1,200;:dem:rate 1,100")
    bench_pieces.clock_of(live).time = 20.0
    blocks = feed.take()
    time = np.concatenate([block.time for block in blocks])
    rate = np.concatenate([block.channels["gyro_z"] for block in blocks])
    assert time.size == 2000
    np.testing.assert_allclose(np.diff(time), 0.01, atol=1e-9)
    assert rate[time <= 10.0] == pytest.approx(EARTH_RATE * SINE, abs=1e-6)
    assert rate[time > 10.52] == pytest.approx(100 + EARTH_RATE * SINE, abs=1e-6)
    turned = np.sum(rate) * 0.01 - 20 * EARTH_RATE * SINE
    assert turned == pytest.approx(0.5 * 0.5 * 100 + 9.5 * 100, abs=1e-3)


class Gate(Port):
    """A port that takes as much as `room`."""

    def __init__(self) -> None:
        self.room, self.got = 10**9, bytearray()

    def write(self, data: bytes) -> int:
        taken = data[: self.room]
        self.got += taken
        return len(taken)

    def attend(self) -> None:
        """Nothing comes in."""

    def unplug(self) -> None:
        """Its other end stays."""

    def plug(self) -> None:
        """It was never out."""

    def close(self) -> None:
        """Nothing is open."""


def test_a_line_sends_no_faster_than_its_baud_rate() -> None:
    gate = Gate()
    line = SerialLine(gate, 9600, 1.0, 0.0)  # 960 bytes a second
    line.offer(np.zeros((100, 40), dtype=np.uint8))
    for step in range(1, 101):
        line.pump(step / 100)
    assert 959 <= len(gate.got) <= 960
    for step in range(101, 600):
        line.pump(step / 100)
    assert len(gate.got) == 4000


def test_a_sensor_drops_whole_frames_when_its_line_is_too_slow() -> None:
    gate = Gate()
    line = SerialLine(gate, 9600, 1.0, 0.0)
    for _ in range(10):
        line.offer(np.ones((100, 40), dtype=np.uint8))
    assert line.counts.frames == 1000
    assert line.counts.frames_dropped == 1000 - 4096 // 40


def test_what_nobody_fetches_is_dropped_and_counted_and_never_waited_for() -> None:
    gate = Gate()
    gate.room = 100
    line = SerialLine(gate, 1e6, 1.0, 0.0)
    line.offer(np.ones((50, 40), dtype=np.uint8))
    line.pump(1.0)
    assert (line.counts.bytes_sent, line.counts.bytes_dropped) == (100, 1900)
    assert not line.waiting


# -- replies -----------------------------------------------------------------------------------------------------------


class Parrot:
    identity = "Parrot,1"

    def answer(self, message: str) -> str | None:
        return None if message.startswith("!") else self.identity if message == "*IDN?" else message

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        """It has no limits."""


class Ear:
    """Who is connected."""

    def __init__(self, board: FaultBoard, manner: Manner | None = None):
        self.port = MessagePort("table", Parrot(), manner or Manner(), board, lambda: 0.0)
        self.got, self.held, self.hung_up = bytearray(), bytearray(), False

    def hears(self, data: bytes) -> bytes:
        start = len(self.got)
        self.port.heard(self.held, data, self.got.extend, self.hang_up)
        return bytes(self.got[start:])

    def hang_up(self) -> None:
        self.hung_up = True


def board(fault: str) -> FaultBoard:
    made = FaultBoard()
    made.declare(read_fault(fault, {"table": "table"}), 0.0)
    return made


def test_messages_are_cut_at_their_terminators() -> None:
    ear = Ear(FaultBoard())
    assert ear.hears(b"abc") == b""
    assert ear.hears(b"def\n!x\ngh\ni") == b"abcdef\ngh\n"


@pytest.mark.parametrize(
    ("framing", "reply"),
    [
        ("words", b"\0\0\0\0\0\0\0\x03ok\n"),
        ("ascii", b"00000003ok\n"),
        ("prompt", b"ok\n>\n"),
        ("none", b"ok\n"),
    ],
)
def test_replies_are_framed(framing: str, reply: bytes) -> None:
    assert Ear(FaultBoard(), Manner(framing=framing)).hears(b"ok\n") == reply


@pytest.mark.parametrize(
    ("fault", "reply"),
    [("silent", b""), ("partial", b"abc"), ("wrong model", b"abcdef\n"), ("drop link", b"")],
)
def test_faulty_replies(fault: str, reply: bytes) -> None:
    ear = Ear(board(f"{{instrument: table, fault: {fault}}}"))
    assert ear.hears(b"abcdef\n") == reply
    assert ear.hung_up == (fault == "drop link")


def test_garbage_is_as_long_as_the_reply_and_another() -> None:
    got = Ear(board("{instrument: table, fault: garbage}")).hears(b"abcdef\n")
    assert len(got) == 7 and got.endswith(b"\n") and got != b"abcdef\n"


def test_another_model_answers_when_it_is_asked_who_it_is() -> None:
    ear = Ear(board("{instrument: table, fault: wrong model}"))
    assert b"Parrot" not in ear.hears(b"*IDN?\n")
    assert ear.hears(b"abc\n") == b"abc\n"


def test_a_late_reply_comes_after_those_to_later_messages() -> None:
    async def talk() -> bytes:
        ear = Ear(board("{instrument: table, fault: late, delay: 50 ms, count: 1}"))
        assert ear.hears(b"first\n") == b""
        assert ear.hears(b"second\n") == b"second\n"
        await asyncio.gather(*ear.port.tasks)
        return bytes(ear.got)

    assert asyncio.run(talk()) == b"second\nfirst\n"
