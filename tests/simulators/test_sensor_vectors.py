"""Every published vector of a sensor's frames, encoded from its decoded values, gives the same bytes."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planrunner.simulators import kvh1775, stim300, vectornav, xsens
from planrunner.simulators.declared_frame import CHECKS, DeclaredFrame, FieldPlace, FrameCheck, Running
from planrunner.simulators.frames import CRC_8, CRC_16, CRC_32, exclusive_or

Vectors = dict[str, Any]


@pytest.fixture
def vectors(data_root: Path) -> Vectors:
    """Frames of real sensors and their decoded values, which lie beside the real recordings and are not part of the project."""
    path = data_root.parent / "wire" / "vectors.json"
    if not path.is_file():
        pytest.skip(f"no published frames in {path}; set PLANRUNNER_DATA")
    found: Vectors = json.loads(path.read_text(encoding="utf-8"))
    return found


def one(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)


def columns(**triads: list[float]) -> dict[str, np.ndarray]:
    return {
        f"{name}_{axis}": one(value)
        for name, values in triads.items()
        for axis, value in zip("xyz", values, strict=True)
    }


def test_stim300_datagram_of_a_real_unit(vectors: Vectors) -> None:
    vector = vectors["stim300_0xAF_real_unit"]
    values = columns(
        gyro=vector["gyro_dps"],
        acc=vector["acc_g_10g"],
        incl=vector["incl_g"],
        gyro_T=vector["gyro_T"],
        acc_T=vector["acc_T"],
        incl_T=vector["incl_T"],
    )
    raw = bytes.fromhex(vector["aux_raw"])
    values["aux"] = one(int.from_bytes(raw, "big", signed=True))
    unit = stim300.Stim300(0xAF, 10, crlf=True)
    sent = unit.frames(values, one(vector["counter"]), one(vector["latency_us"]))
    assert sent.tobytes().hex() == vector["hex"]
    assert unit.length() == len(bytes.fromhex(vector["hex"]))


@pytest.mark.parametrize("identifier", sorted(stim300.DATAGRAMS))
def test_every_datagram_is_as_long_as_its_clusters(identifier: int) -> None:
    clusters, warm, extra = stim300.DATAGRAMS[identifier]
    unit = stim300.Stim300(identifier)
    values = columns(**{name: [1.0, -1.0, 0.5] for name in ("gyro", "acc", "incl", "gyro_T", "acc_T", "incl_T")})
    sent = unit.frames(values, one(7), one(500))
    lengths = {1: 18, 2: 28, 3: 38}  # identifier, clusters of ten bytes, counter, latency, CRC
    assert sent.shape == (1, lengths[len(clusters)] + 7 * len(clusters) * warm + 4 * bool(extra))
    assert unit.length() == sent.shape[1]


def test_a_rate_beyond_24_bits_stays_at_the_end_of_the_range() -> None:
    values = columns(gyro=[1e6, -1e6, 0.0])
    sent = stim300.Stim300(0x90).frames(values, one(0), one(0)).tobytes()
    assert sent[1:7].hex() == "7fffff800000"


def test_stim300_utility_mode_check(vectors: Vectors) -> None:
    for text, check in vectors["stim300_crc8"]:
        assert CRC_8.of_text(text) == check


def test_kvh_format_a(vectors: Vectors) -> None:
    vector = vectors["kvh_format_A"]
    values = columns(gyro=vector["rot"], acc=vector["acc_g"])
    values |= {"temperature": one(vector["temp"]), "status": one(int(vector["status"], 16))}
    unit = kvh1775.Kvh1775("A")
    assert unit.frames(values, one(vector["seq"])).tobytes().hex() == vector["hex"]


@pytest.mark.parametrize(("form", "length"), [("A", 36), ("B", 40), ("C", 38)])
def test_kvh_formats_have_their_lengths(form: str, length: int) -> None:
    values = columns(gyro=[0.0, 0.0, 0.0], acc=[0.0, 0.0, 1.0]) | {"temperature": one(25.0)}
    unit = kvh1775.Kvh1775(form)
    assert unit.frames(values, one(130)).shape == (1, length)
    assert unit.length() == length


def test_kvh_built_in_test(vectors: Vectors) -> None:
    assert kvh1775.built_in_test(bytes.fromhex("7f7f7e7b7f7f")).hex() == vectors["kvh_bit"]["hex"]


def test_xsens_packet(vectors: Vectors) -> None:
    vector = vectors["xsens_f32"]
    raw = bytes.fromhex(vector["hex"])
    # The vector states no velocity and angle increments; they are read where the packet has them.
    place = {item: raw.index(bytes.fromhex(item)) + 3 for item in ("40100c", "803010", "10100c")}
    values = {
        0x1020: one(vector["packet_counter"]),
        0x1060: one(vector["sample_time_fine"]),
        0x1010: np.array([struct.unpack_from(">IH6B", raw, place["10100c"])], dtype=float),
        0x4010: np.array([struct.unpack_from(">3f", raw, place["40100c"])]),
        0xE020: one(int(vector["status_word"], 16)),
        0x4020: np.array([vector["acc"]]),
        0x8020: np.array([vector["gyr"]]),
        0x8030: np.array([struct.unpack_from(">4f", raw, place["803010"])]),
    }
    unit = xsens.Xsens((0x1020, 0x1060, 0x1010, 0xE020, 0x4020, 0x4010, 0x8020, 0x8030))
    sent = unit.frames(values).tobytes()
    assert len(sent) == unit.length()
    assert sent.hex() == vector["hex"]


def test_xsens_short_messages(vectors: Vectors) -> None:
    assert xsens.short_message(0x30).hex() == vectors["xsens_gotoconfig"]
    assert xsens.short_message(0x42, b"\x04").hex() == vectors["xsens_error4"]


def test_xsens_fixed_point_by_hand() -> None:
    # -1.5 in 12.20 is -1572864 = FFE80000; in 16.32 the fraction 0.5 goes before the whole part -2.
    values = {0x4020: np.full((1, 3), -1.5)}
    assert xsens.Xsens((0x4021,)).frames(values).tobytes()[7:11].hex() == "ffe80000"
    assert xsens.Xsens((0x4022,)).frames(values).tobytes()[7:13].hex() == "80000000fffe"


def test_xsens_long_message_has_a_length_of_two_bytes() -> None:
    sent = xsens.short_message(0x36, bytes(300))
    assert sent[:6].hex() == "faff36ff012c"
    assert sum(sent[1:]) % 256 == 0


def test_vectornav_binary(vectors: Vectors) -> None:
    vector = vectors["vn_ypr"]
    unit = vectornav.VectorNav(("yaw_pitch_roll",))
    sent = unit.frames({"yaw_pitch_roll": np.array([vector["ypr_deg"]])})
    assert sent.tobytes().hex() == vector["hex"]
    assert unit.length() == sent.shape[1]


def test_vectornav_lines(vectors: Vectors) -> None:
    for text in vectors["vn_ascii"]:
        body, _, _ = text[1:].partition("*")
        assert vectornav.line(body) == text.encode() + b"\r\n"
        if body.startswith("VNYMR"):
            numbers = [float(word) for word in body.split(",")[1:]]
            ypr, magnetic, accel, rate = (numbers[i : i + 3] for i in (0, 3, 6, 9))
            assert vectornav.measurement(magnetic, accel, rate, ypr) == text.encode() + b"\r\n"


def test_check_values_of_the_standard_message() -> None:
    """The published checks of "123456789": CRC-32/MPEG-2, CRC-16/XMODEM, CRC-8/ROHC without reflection is CRC-8 with its start FF."""
    frames = np.frombuffer(b"123456789", dtype=np.uint8)[None, :]
    assert int(CRC_32.of(frames)[0]) == 0x0376E6E7
    assert int(CRC_16.of(frames)[0]) == 0x31C3
    assert int(CRC_8.of(frames)[0]) == 0xFB
    assert int(exclusive_or(frames)[0]) == 0x31


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("crc32", 0xCBF43926),
        ("crc32_mpeg2", 0x0376E6E7),
        ("crc16_modbus", 0x4B37),
        ("crc16_xmodem", 0x31C3),
        ("crc16_ccitt_false", 0x29B1),
        ("crc8", 0xF4),
        ("sum8", 0xDD),
        ("zero_sum8", 0x23),
        ("xor8", 0x31),
    ],
)
def test_declared_checks_of_the_standard_message(name: str, check: int) -> None:
    """Williams, A painless guide to CRC error detection algorithms (1993): the checks of "123456789"; sums by hand (477 is 1DD)."""
    frames = np.frombuffer(b"123456789", dtype=np.uint8)[None, :]
    assert int(CHECKS[name][0](frames)[0]) == check


def test_declared_frame_by_hand() -> None:
    """-1.5 deg/s in steps of 0.5 is -3; 26 degC from 25 in steps of 0.25 is 4; the sum of the six bytes before is 2A5."""
    fields = {
        "rate": FieldPlace(2, "i16", "big", 0.5, 0.0, "deg/s"),
        "temperature": FieldPlace(4, "u8", "big", 0.25, 25.0, "degC"),
    }
    form = DeclaredFrame(
        b"\xa5\x5a", 7, fields, Running(FieldPlace(5, "u8"), 2, 256), FrameCheck(*CHECKS["sum8"], 0, "big")
    )
    sent = form.frames({"rate": one(-1.5), "temperature": one(26.0)}, one(129.0))
    assert sent.tobytes().hex() == "a55a" + "fffd" + "04" + "02" + f"{(0xA5 + 0x5A + 0xFF + 0xFD + 4 + 2) & 0xFF:02x}"
