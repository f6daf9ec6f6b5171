"""What simulated sensors answer on their lines, and what the words change."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.instruments.interfaces import Block
from planrunner.simulators.declared_frame import DeclaredFrame, DeclaredUnit, FieldPlace, Running
from planrunner.simulators.kvh1775 import Kvh1775
from planrunner.simulators.navigation_units import VectorNavUnit, XsensUnit
from planrunner.simulators.sensor_units import KvhUnit, Outputs, Stim300Unit
from planrunner.simulators.stim300 import Stim300
from planrunner.simulators.vectornav import VectorNav, line
from planrunner.simulators.xsens import Xsens, short_message

UNITS = {"gyro_z": "deg/s", "accel_z": "m/s^2", "sensor_temperature": "degC"}


def block(count: int) -> Block:
    values = {
        "gyro_z": np.full(count, 90.0),
        "accel_z": np.full(count, 9.80665),
        "sensor_temperature": np.full(count, 25.0),
    }
    return Block(np.arange(1, count + 1, dtype=float) * 0.01, values)


def test_stim300_counts_internal_samples_and_carries_its_units() -> None:
    """At 500 Hz the counter steps by 4; 90 deg/s is 1474560 counts of 2^-14, 1 g 524288 of 2^-19."""
    unit = Stim300Unit(Outputs(UNITS), Stim300(0x91), 500.0)
    sent = unit.frames(block(70))
    assert sent[:3, -7].tolist() == [0, 4, 8]
    assert sent[64:66, -7].tolist() == [0, 4]
    assert int.from_bytes(sent[0, 7:10].tobytes(), "big") == 1474560
    assert int.from_bytes(sent[0, 17:20].tobytes(), "big") == 524288


def test_stim300_in_utility_mode_is_silent_and_gives_its_number() -> None:
    unit = Stim300Unit(Outputs(UNITS), Stim300(0x90), 500.0, "N2558184602002")
    assert unit.hear(b"UTILITY") == b""
    assert unit.hear(b"MODE\r") == b"#UTILITYMODE,234\r"
    assert len(unit.frames(block(5))) == 0
    assert unit.hear(b"$isn,28\r") == b"#isn,0,N2558184602002,32\r"
    unit.hear(b"R\r")
    assert len(unit.frames(block(5))) == 5


def test_kvh_sends_two_doubtful_frames_after_a_change() -> None:
    unit = KvhUnit(Outputs(UNITS), Kvh1775("A"), 100.0)
    assert unit.hear(b"?bit\n")[:4].hex() == "fe8100aa"
    assert unit.frames(block(4))[:, 28].tolist() == [0x77] * 4
    unit.hear(b"=rotfmt,delta\r\n=tempunits,C_100\r\n")
    sent = unit.frames(block(4))
    assert sent[:, 28].tolist() == [0, 0, 0x77, 0x77]
    assert sent[:, 29].tolist() == [4, 5, 6, 7]
    assert np.frombuffer(sent[0, 12:16].tobytes(), ">f4")[0] == pytest.approx(np.pi / 2 / 100)
    assert int.from_bytes(sent[0, 30:32].tobytes(), "big") == 2500


def test_xsens_is_configured_and_measures_again() -> None:
    unit = XsensUnit(Outputs(UNITS), Xsens((0x1020, 0x8020)), 100.0)
    outputs = bytes.fromhex("1020ffff" + "80230064" + "80300064")
    assert unit.hear(short_message(0xC0, outputs)) == short_message(0x42, b"\x04")
    assert unit.hear(short_message(0x30)[:3]) == b""
    assert unit.hear(short_message(0x30)[3:]) == short_message(0x31)
    assert len(unit.frames(block(3))) == 0
    assert unit.hear(short_message(0xC0, outputs)) == short_message(0xC1, outputs)
    assert unit.hear(short_message(0xC0, b"\x99\x99\0\0")) == short_message(0x42, b"\x04")
    assert unit.hear(short_message(0x10)) == short_message(0x11)
    sent = unit.frames(block(3))
    assert sent.shape == (3, unit.form.length())
    assert np.all(sent[:, 1:].sum(axis=1) % 256 == 0)
    assert np.frombuffer(sent[0, 12:36].tobytes(), ">f8")[2] == pytest.approx(np.pi / 2)
    turn = np.frombuffer(sent[0, 39:55].tobytes(), ">f4")
    assert turn == pytest.approx([np.cos(np.pi / 400), 0, 0, np.sin(np.pi / 400)])


def test_xsens_does_not_take_a_broken_message() -> None:
    unit = XsensUnit(Outputs(UNITS), Xsens((0x1020,)), 100.0)
    assert unit.hear(b"\xfa\xff\x30\x00\x00") == b""
    assert not unit.silent


def test_vectornav_registers() -> None:
    unit = VectorNavUnit(Outputs(UNITS), VectorNav())
    assert unit.hear(line("VNRRG,3")) == line("VNRRG,03,0100000000")
    assert unit.hear(line("VNRRG,99")) == line("VNERR,08")
    assert unit.hear(line("VNWRG,75,1,8,01,0601")) == line("VNWRG,75,1,8,01,0601")
    unit.text = "VNGYR"
    assert unit.frames(block(1)).tobytes() == line("VNGYR,+00.000000,+00.000000,+01.570796")


def test_a_declared_sensor_switches_modes_and_converts_units() -> None:
    told: list[str] = []
    form = DeclaredFrame(
        b"\xa5", 7, {"gyro_z": FieldPlace(1, "f32", unit="rad/s")}, Running(FieldPlace(5, "u16"), 1, 65536.0)
    )
    unit = DeclaredUnit(UNITS, form, {b"POWER OFF\r": "unpowered"}, told.append)
    assert unit.hear(b"POWER") == b"" and unit.hear(b" OFF\r") == b""
    assert told == ["unpowered"]
    unit.hear(b"POWER ON\r")
    assert told == ["unpowered"]
    assert np.frombuffer(unit.frames(block(1))[0, 1:5].tobytes(), ">f4")[0] == pytest.approx(np.pi / 2)
