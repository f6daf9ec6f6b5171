"""What a simulated sensor says against its own samples is what the driver of that sensor reads, which was written apart from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.instruments.interfaces import Block
from planrunner.instruments.sensors import kvh1775, stim300, xsens
from planrunner.instruments.sensors.declared_frame import DeclaredFrame as DeclaredDriver
from planrunner.instruments.sensors.declared_frame import DeclaredFrameParameters
from planrunner.instruments.wire.framing import Framer, Piece
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.simulators.declared_frame import CHECKS, Alarms, DeclaredFrame, DeclaredUnit, FieldPlace, FrameCheck
from planrunner.simulators.faults import read_fault, struck
from planrunner.simulators.kvh1775 import Kvh1775
from planrunner.simulators.navigation_units import XsensUnit
from planrunner.simulators.sensor_units import KvhUnit, Outputs, Stim300Unit
from planrunner.simulators.stim300 import Stim300
from planrunner.simulators.xsens import Xsens

COUNT = 20
UNITS = {f"gyro_{axis}": "deg/s" for axis in "xyz"} | {f"accel_{axis}": "g" for axis in "xyz"}
DECLARED = """\
port: x
sample_rate: 100 Hz
sync: A5 5A
length: 9
fields: {gyro_x: {at: 2, type: i16, unit: deg/s}}
status: {at: 4, type: u16, bits: {overload: 4, self-test failed: 9, not ready: 0}, set_is_good: GOOD, little_endian: GOOD}
checksum: {type: crc8}
"""


def block() -> Block:
    channels = {name: np.zeros(COUNT) for name in UNITS} | {"sensor_temperature": np.full(COUNT, 25.0)}
    return Block(np.arange(COUNT) / 100.0, channels)


def declared(good: str) -> tuple[Any, Any]:
    keys: Any = RecordOf(DeclaredFrameParameters).read(source.parse(DECLARED.replace("GOOD", good), "x"), Findings())
    bits = {"overload": 4, "self-test failed": 9, "not ready": 0}
    alarms = Alarms(4, 2, "little" if good == "true" else "big", bits, good == "true")
    form = DeclaredFrame(
        b"\xa5\x5a", 9, {"gyro_x": FieldPlace(2, "i16", unit="deg/s")}, check=FrameCheck(*CHECKS["crc8"], 0, "big")
    )
    return DeclaredUnit(UNITS, form, alarms=alarms), DeclaredDriver.decoder_of(keys)


def kvh() -> tuple[Any, Any]:
    keys: Any = type("Keys", (), {"format": "A", "rotation": "rate", "angle_unit": "rad", "temperature_unit": "C"})
    keys.sample_rate = type("Rate", (), {"value": 100.0})
    return KvhUnit(Outputs(UNITS), Kvh1775("A"), 100.0), kvh1775.layout(keys)


MADE: dict[str, Callable[[], tuple[Any, Any]]] = {
    "stim300": lambda: (
        Stim300Unit(Outputs(UNITS), Stim300(0xA7), 100.0),
        stim300.layout(0xA7, 2.0**-19, 2.0**-14, 100.0),
    ),
    "kvh": kvh,
    "xsens": lambda: (
        XsensUnit(Outputs(UNITS), Xsens((0x1020, 0x8020, 0xE020)), 100.0),
        xsens.MtData2(("rate",), 100.0),
    ),
    "declared": lambda: declared("false"),
    "declared the other way": lambda: declared("true"),
}
SAYS = {
    ("stim300", "overload"): {"gyro: overload", "gyro: x axis"},
    ("stim300", "self-test"): {f"{name}: system integrity error" for name in ("gyro", "accel", "inclination")},
    ("kvh", "overload"): {"gyro: x invalid"},
    ("kvh", "self-test"): {f"{name}: {axis} invalid" for name in ("gyro", "accel") for axis in "xyz"},
    ("xsens", "overload"): {"MTi: gyro x clipped"},
    ("xsens", "self-test"): {"MTi: self-test failed"},
    ("declared", "overload"): {"status: overload"},
    ("declared", "self-test"): {"status: self-test failed"},
    ("declared the other way", "overload"): {"status: overload"},
    ("declared the other way", "self-test"): {"status: self-test failed"},
}


@pytest.mark.parametrize(("name", "ail"), SAYS)
def test_what_it_ails_from_is_read(name: str, ail: str) -> None:
    unit, decoder = MADE[name]()
    framer = Framer(decoder.framing)
    for ails, said in ((frozenset(), set()), (frozenset({ail}), SAYS[name, ail]), (frozenset(), set())):
        unit.ails = ails
        samples = decoder.decode(framer.push([Piece(0.0, unit.frames(block()).tobytes())]))
        assert len(samples) == COUNT and set(samples.doubts) == said
        assert np.all(samples.doubtful) if said else not np.any(samples.doubtful)


@pytest.mark.parametrize("name", MADE)
def test_another_instrument_on_the_line_gives_no_frame(name: str) -> None:
    unit, decoder = MADE[name]()
    fault = read_fault("{instrument: gyro, fault: wrong model}", {"gyro": "sensor"})
    lines = struck(unit.frames(block()), [fault], np.random.default_rng(0))
    assert len(lines) == COUNT
    framer = Framer(decoder.framing)
    assert len(framer.push([Piece(0.0, lines.tobytes())])) == 0 and framer.skipped > 0
