"""Every published frame decodes to its published values, bit by bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_entries import parameters_of
from published_vectors import decoded, vectors_beside

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.sensors import kvh1775, stim300, vectornav, xsens
from planrunner.instruments.wire.checksums import Checksum
from planrunner.instruments.wire.codes import CRC


@pytest.fixture
def vectors(data_root: Path) -> dict[str, Any]:
    return vectors_beside(data_root)


def triad(channels: Any, name: str) -> list[float]:
    return [float(channels[f"{name}_{axis}"][0]) for axis in "xyz"]


def test_stim300_with_everything_on(vectors: dict[str, Any]) -> None:
    told = vectors["stim300_0xAF_real_unit"]
    keys = parameters_of("driver: stim300; sample_rate: 500 Hz; datagram: 0xAF; acceleration_range: 10 g")
    samples, framer = decoded(stim300.Stim300.decoder_of(keys), bytes.fromhex(told["hex"]) * 3)
    assert (framer.good, framer.corrupt, framer.skipped) == (3, 0, 0)
    names = {"gyro": "gyro_dps", "accel": "acc_g_10g", "inclination": "incl_g"}
    names |= {"gyro_temperature": "gyro_T", "accel_temperature": "acc_T", "inclination_temperature": "incl_T"}
    for ours, theirs in names.items():
        assert triad(samples.channels, ours) == told[theirs]
    raw = int.from_bytes(bytes.fromhex(told["aux_raw"]), "big", signed=True)
    assert samples.channels["aux"][0] == raw * 5 / 2**24
    assert samples.counter.tolist() == [told["counter"]] * 3
    assert samples.latency[0] == pytest.approx(told["latency_us"] * 1e-6, abs=1e-15)
    assert samples.channels["sensor_temperature"][0] == pytest.approx(np.mean(told["gyro_T"]))
    assert samples.doubts == () and not samples.doubtful.any()


def test_stim300_lines_of_utility_mode(vectors: dict[str, Any]) -> None:
    for text, check in vectors["stim300_crc8"]:
        assert Checksum(CRC, 8, 0x07, 0xFF).of(text.encode()) == check


def test_kvh_format_a(vectors: dict[str, Any]) -> None:
    told = vectors["kvh_format_A"]
    keys = parameters_of("driver: kvh_1775; sample_rate: 1000 Hz")
    samples, framer = decoded(kvh1775.Kvh1775.decoder_of(keys), bytes.fromhex(told["hex"]))
    assert framer.good == 1
    assert triad(samples.channels, "gyro") == told["rot"]
    assert triad(samples.channels, "accel") == told["acc_g"]
    assert samples.channels["sensor_temperature"].tolist() == [told["temp"]]
    assert samples.counter.tolist() == [told["seq"]]
    assert told["status"] == "0x77" and not samples.doubtful.any()


def test_kvh_built_in_test(vectors: dict[str, Any]) -> None:
    reply = bytes.fromhex(vectors["kvh_bit"]["hex"])
    assert kvh1775.built_in_test(reply) == (0x7F, 0x7F, 0x7E, 0x7B, 0x7F, 0x7F)
    with pytest.raises(InstrumentError, match="built-in test"):
        kvh1775.built_in_test(reply[:-1] + b"\x1f")


def test_xsens_floats(vectors: dict[str, Any]) -> None:
    told = vectors["xsens_f32"]
    keys = parameters_of("driver: xsens_mti; sample_rate: 100 Hz")
    samples, framer = decoded(xsens.XsensMti.decoder_of(keys), bytes.fromhex(told["hex"]) * 2)
    assert (framer.good, framer.skipped) == (2, 0)
    assert triad(samples.channels, "accel") == told["acc"]
    assert triad(samples.channels, "gyro") == told["gyr"]
    assert samples.counter.tolist() == [told["packet_counter"]] * 2
    assert told["status_word"] == "01800007" and samples.doubts == ()


def test_xsens_increments_agree_with_the_rates_beside_them(vectors: dict[str, Any]) -> None:
    """The frame holds both, at 100 Hz: the quaternion's increment over 10 ms is the rate."""
    told = vectors["xsens_f32"]
    keys = parameters_of("driver: xsens_mti; sample_rate: 100 Hz; outputs: [delta_v, delta_q]")
    samples, _ = decoded(xsens.XsensMti.decoder_of(keys), bytes.fromhex(told["hex"]))
    assert triad(samples.channels, "gyro") == pytest.approx(told["gyr"], rel=1e-6)
    assert triad(samples.channels, "accel") == pytest.approx(told["acc"], abs=0.02)


def test_xsens_messages(vectors: dict[str, Any]) -> None:
    assert xsens.message(xsens.GO_TO_CONFIG).hex() == vectors["xsens_gotoconfig"]
    assert xsens.error_of(bytes.fromhex(vectors["xsens_error4"])) == 4
    assert xsens.error_of(bytes.fromhex(vectors["xsens_gotoconfig"])) is None


def test_vectornav_binary(vectors: dict[str, Any]) -> None:
    told = vectors["vn_ypr"]
    keys = parameters_of("driver: vectornav; sample_rate: 100 Hz; fields: [yaw_pitch_roll]")
    samples, _ = decoded(vectornav.VectorNav.decoder_of(keys), bytes.fromhex(told["hex"]))
    found = [float(samples.channels[name][0]) for name in ("yaw", "pitch", "roll")]
    assert found == pytest.approx(told["ypr_deg"], rel=1e-7)


def test_vectornav_lines(vectors: dict[str, Any]) -> None:
    measured = [text for text in vectors["vn_ascii"] if text.startswith("$VNYMR")]
    stream = "".join(f"{text}\r\n" for text in vectors["vn_ascii"]).encode()
    keys = parameters_of("driver: vectornav; sample_rate: 40 Hz; output: VNYMR")
    samples, framer = decoded(vectornav.VectorNav.decoder_of(keys), stream)
    assert (framer.good, framer.corrupt) == (len(measured), 0)
    for row, text in enumerate(measured):
        assert [float(values[row]) for values in samples.channels.values()] == [
            float(number) for number in text.partition("*")[0].split(",")[1:]
        ]
    assert vectornav.line("VNRRG,8") == b"$VNRRG,8*4B\r\n"
    assert vectornav.body_of(b"$VNRRG,8*4B\r\n") == "VNRRG,8"
    with pytest.raises(InstrumentError, match="error 03"):
        vectornav.body_of(b"$VNERR,03*72\r\n")
