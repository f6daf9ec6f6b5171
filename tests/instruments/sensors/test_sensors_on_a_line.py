"""Whole drivers on a pseudo-terminal, in real time: connecting, streaming, commands, and lines that fail."""

from __future__ import annotations

import threading
import time
from functools import partial

import numpy as np
import pytest
from bench_entries import parameters_of

pytest.importorskip("tty", reason="this system has no pseudo-terminals")

from sending_unit import SendingUnit

from planrunner.bench.clock import VirtualClock, WallClock
from planrunner.instruments.interfaces import Counting, InstrumentError, Surroundings, Watched
from planrunner.instruments.sensors import kvh1775 as kvh1775_driver
from planrunner.instruments.sensors import vectornav as vectornav_driver
from planrunner.instruments.sensors import xsens as xsens_driver
from planrunner.instruments.sensors.kvh1775 import Kvh1775
from planrunner.instruments.sensors.serial_sensor import FirstFrames, SerialSensor
from planrunner.instruments.sensors.stim300 import Stim300
from planrunner.instruments.sensors.vectornav import VectorNav
from planrunner.instruments.sensors.xsens import XsensMti
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Rest, Segment
from planrunner.simulators import kvh1775, stim300, vectornav, xsens
from planrunner.simulators.frames import Values

KEYS = "driver: stim300; sample_rate: 500 Hz; datagram: 0x91; silence: 60 s"
IMPATIENT = KEYS.replace("60 s", "1 s")  # where silence is what is expected: a busy machine can be silent that long


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands are answered, however late a busy machine lets the unit do it."""
    monkeypatch.setattr(kvh1775_driver, "PATIENCE", 60.0)
    monkeypatch.setattr(xsens_driver, "PATIENCE", 60.0)
    monkeypatch.setattr(vectornav_driver, "ask", partial(vectornav_driver.ask, patience=60.0))


def surroundings() -> Surroundings:
    return Surroundings(WallClock(), Site(0.7, 9.8), real_time=True)


def segment(dwell: float) -> Segment:
    return Segment(0, "S", np.eye(3), "", Rest(), dwell)


def triads(first: int, end: int) -> dict[str, np.ndarray]:
    """Columns of frames whose gyro_x is their number, and the rest zero."""
    columns = {f"{name}_{axis}": np.zeros(end - first) for name in ("gyro", "acc") for axis in "xyz"}
    return columns | {"gyro_x": np.arange(first, end, dtype=float) % 256, "temperature": np.zeros(end - first)}


def stim_frames(first: int, end: int) -> bytes:
    index = np.arange(first, end)
    return (
        stim300.Stim300(0x91, crlf=True)
        .frames(triads(first, end), index * 4 % 256, np.full(end - first, 300))
        .tobytes()
    )


def test_a_segment_is_streamed() -> None:
    with SendingUnit(stim_frames, 500) as unit:
        around = surroundings()
        sensor = Stim300.connect(parameters_of(KEYS, unit.port), around)
        assert isinstance(sensor, Watched) and isinstance(sensor, Counting)
        assert sensor.identify()["model"] == "STIM300"
        assert Stim300.address(parameters_of(KEYS, unit.port)) == unit.port
        begun = around.clock.now()
        blocks = list(sensor.stream(segment(1.0)))
        times = np.concatenate([block.time for block in blocks])
        numbers = np.concatenate([block.channels["gyro_x"] for block in blocks])
        assert begun < times[0] and np.all(np.diff(times) > 0)
        assert times[-1] - times[0] == pytest.approx(
            499 / 500, abs=0.02
        )  # by the counter, however late the frames were read
        counts = sensor.counts()
        if unit.dropped == 0:  # a machine that is too busy drops on the line, and the counts tell
            assert counts.lost == 0
            assert set(np.mod(np.diff(numbers), 256)) == {1.0}
        assert times.size + counts.lost == 500
        assert sensor.watch().faults == ()
        sensor.make_safe()
        sensor.close()


def test_a_line_that_falls_silent_or_goes_away_is_reported() -> None:
    with SendingUnit(stim_frames, 500) as unit:
        sensor = Stim300.connect(parameters_of(KEYS, unit.port), surroundings())
        rows = 0
        stream = sensor.stream(segment(3600.0))
        while rows < 150:
            rows += next(stream).time.size
        unit.silent = True
        sensor.parameters = parameters_of(IMPATIENT, unit.port)
        with pytest.raises(InstrumentError, match=r"no good frame for \d+\.\d s: check its power"):
            list(stream)
        assert "no good frame" in sensor.watch().faults[0]
        unit.silent = False
        unit.unplug()
        with pytest.raises(InstrumentError, match=r"is no longer available .*unplugged"):
            list(sensor.stream(segment(3600.0)))
        sensor.close()


def test_a_counter_that_stands_still_ends_the_segment() -> None:
    """Good frames come for ever, and none is another sample."""

    def same(first: int, end: int) -> bytes:
        columns = {"time_startup": np.full(end - first, 5e9), "imu": np.zeros((end - first, 6))}
        return vectornav.VectorNav(("time_startup", "imu")).frames(columns).tobytes()

    with SendingUnit(same, 200) as unit:
        keys = "driver: vectornav; sample_rate: 200 Hz; fields: [time_startup, imu]; silence: 60 s"
        sensor = VectorNav.connect(parameters_of(keys, unit.port), surroundings())
        sensor.parameters = parameters_of(keys.replace("60 s", "0.5 s"), unit.port)
        with pytest.raises(InstrumentError, match=r"have a constant counter: the sensor's counter is stuck"):
            list(sensor.stream(segment(20.0)))
        sensor.close()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            KEYS.replace(
                "500 Hz", "125 Hz"
            ),  # far enough off for a machine so busy that half of the frames are dropped
            "good frames per second arrive from .*, but the bench file says 125 Hz",
        ),
        (KEYS.replace("0x91", "0xA7").replace("60 s", "3 s"), "no frame that begins with A7 .*: check `baud`"),
    ],
)
def test_what_does_not_fit_is_reported_when_connecting(keys: str, words: str) -> None:
    with SendingUnit(stim_frames, 500) as unit, pytest.raises(InstrumentError, match=words):
        Stim300.connect(parameters_of(keys, unit.port), surroundings())


def test_a_silent_line_and_a_simulated_clock_are_refused() -> None:
    unit = SendingUnit(stim_frames, 500)
    unit.silent = True
    with unit:
        with pytest.raises(InstrumentError, match=r"no data arrive from .* switched on"):
            Stim300.connect(parameters_of(IMPATIENT, unit.port), surroundings())
        with pytest.raises(InstrumentError, match="clock: wall"):
            Stim300.connect(parameters_of(IMPATIENT, unit.port), Surroundings(VirtualClock(), Site(0.7, 9.8)))


def test_a_line_that_falls_silent_while_connecting_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few frames, too few to judge the rate by, and then nothing more."""
    left, listening = [stim_frames(0, 5)], threading.Event()
    heard_first = SerialSensor._heard_first

    def after_the_few(sensor: SerialSensor) -> FirstFrames:
        listening.set()
        while sensor.link.ring.held < 5 * stim_length:
            time.sleep(0.005)
        return heard_first(sensor)

    stim_length = len(left[0]) // 5
    monkeypatch.setattr(SerialSensor, "_heard_first", after_the_few)
    unit = SendingUnit(lambda first, end: left.pop() if left and listening.is_set() else b"", 500)
    with unit, pytest.raises(InstrumentError, match=r"no good frame for \d+\.\d s"):
        Stim300.connect(parameters_of(IMPATIENT, unit.port), surroundings())


def test_kvh_is_set_by_commands() -> None:
    def frames(first: int, end: int) -> bytes:
        stream = kvh1775.Kvh1775("A").frames(triads(first, end), np.arange(first, end)).tobytes()
        return stream + (
            kvh1775.built_in_test(b"\x7f\x7f\x7e\x7b\x7f\x7f") if unit.heard.endswith(b"?bit\r\n") else b""
        )

    unit = SendingUnit(frames, 500)
    with unit:
        keys = "driver: kvh_1775; sample_rate: 500 Hz; configure: true; rotation: delta; temperature_unit: C_100; silence: 60 s"
        sensor = Kvh1775.connect(parameters_of(keys, unit.port), surroundings())
        sensor.close()
        assert sensor.identify()["built_in_test"] == "7f 7f 7e 7b 7f 7f"
        assert sensor.watch().doubts == sensor.watch().doubts == ("its built-in test failed (byte.bit 2.0, 3.2)",)
        commands = [b"=config,1", b"=dr,500", b"=rotfmt,delta", b"=tempunits,C_100", b"=config,0", b"?bit"]
        assert unit.heard.split(b"\r\n")[:-1] == commands


class AnsweringMti(SendingUnit):
    """Acknowledges every message, or answers with an error."""

    refuses = False

    def __init__(self) -> None:
        self.answered = 0
        super().__init__(self._frames, 100)

    def _frames(self, first: int, end: int) -> bytes:
        columns: dict[int, Values] = {0x4020: np.zeros((end - first, 3)), 0x8020: np.zeros((end - first, 3))}
        columns |= {0x1020: np.arange(first, end), 0xE020: np.ones(end - first)}
        stream = xsens.Xsens([0x1020, 0x4020, 0x8020, 0xE020]).frames(columns).tobytes()
        while len(self.heard) >= self.answered + 5:
            identifier, length = self.heard[self.answered + 2], self.heard[self.answered + 3]
            self.answered += 5 + length
            said = b"\x03\x80\xab\x12" if identifier == 0 else b""
            stream += xsens.short_message(0x42, b"\x04") if self.refuses else xsens.short_message(identifier + 1, said)
        return stream


def test_xsens_is_set_by_messages_that_are_answered() -> None:
    with AnsweringMti() as unit:
        keys = "driver: xsens_mti; sample_rate: 100 Hz; configure: true; silence: 60 s"
        sensor = XsensMti.connect(parameters_of(keys, unit.port), surroundings())
        sensor.close()
        assert sensor.identify()["serial"] == "0380AB12"
        settings = b"\x10\x20\xff\xff\xe0\x20\xff\xff\x80\x20\x00\x64\x40\x20\x00\x64"
        assert unit.heard == (
            xsens.short_message(0x30)
            + xsens.short_message(0x00)
            + xsens.short_message(0xC0, settings)
            + xsens.short_message(0x10)
        )
        unit.refuses = True
        with pytest.raises(InstrumentError, match="refuses message 30 with error 04"):
            XsensMti.connect(parameters_of(keys, unit.port), surroundings())


def test_vectornav_is_set_by_a_line_that_it_echoes() -> None:
    registers = ["VN-100S-CR", "0100001234"]

    def frames(first: int, end: int) -> bytes:
        columns = {"time_startup": np.arange(first, end) * 5e6, "imu": np.zeros((end - first, 6))}
        stream = vectornav.VectorNav(("time_startup", "imu")).frames(columns).tobytes()
        asked, unit.heard = unit.heard, b""
        for place, register in enumerate(registers, start=1):
            if asked.startswith(f"$VNRRG,{2 * place - 1}*".encode()):
                return stream + vectornav.line(f"VNRRG,{2 * place - 1:02d},{register}")
        return stream + asked

    unit = SendingUnit(frames, 200)
    with unit:
        keys = "driver: vectornav; sample_rate: 200 Hz; fields: [time_startup, imu]; configure: port_1; silence: 60 s"
        sensor = VectorNav.connect(parameters_of(keys, unit.port), surroundings())
        identity = sensor.identify()
        assert (identity["model"], identity["serial"]) == ("VN-100S-CR", "0100001234")
        assert identity["configured"] == "time_startup, imu"
        assert sum(block.time.size for block in sensor.stream(segment(0.4))) <= 80
        sensor.close()
        registers[0] = "OEM-7"
        with pytest.raises(InstrumentError, match="identifies itself as 'OEM-7', which is not a VectorNav"):
            VectorNav.connect(parameters_of(keys, unit.port), surroundings())
        keys = keys.replace("200 Hz", "300 Hz")
        with pytest.raises(InstrumentError, match="at 800 Hz divided by a whole number"):
            VectorNav.connect(parameters_of(keys, unit.port), surroundings())
