"""What bench files say of sensors: models known without connecting, and mistakes told where they stand."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from bench_entries import findings_of, model_of, parameters_of
from published_vectors import decoded

from planrunner.base.findings import InputError
from planrunner.instruments.sensors.declared_frame import DeclaredFrame

DECLARED = (
    "driver: declared_frame; sample_rate: 200 Hz; sync: A5 5A; length: 14; "
    "fields: {gyro_x: {at: 2, type: i24, scale: 0.001, unit: deg/s}, t: {at: 5, type: u16, scale: 0.01, zero: -40, unit: degC, "
    "little_endian: true}, v: {at: 7, type: f32, unit: V}}; counter: {at: 11, modulus: 100, step: 2}; "
    "status: {at: 12, bits: {overload: 4}}; checksum: {type: xor8, from: 2}"
)


def test_a_model_is_known_without_connecting() -> None:
    keys = "driver: stim300; sample_rate: 2000 Hz; datagram: 0xA7; gyros: {angle_random_walk: 0.15 deg/sqrt(h), full_scale: 400 deg/s}; "
    model = model_of(keys + "accelerometers: {velocity_random_walk: 0.06 m/s/sqrt(h), full_scale: 10 g}")
    gyro, accel = model.output("gyro_x"), model.output("accel_z")
    assert gyro is not None and accel is not None
    assert gyro.unit == "deg/s" and gyro.full_scale == pytest.approx(400)
    assert gyro.noise.white == pytest.approx(0.15 / 60)
    assert gyro.noise.resolution == 2.0**-14
    assert accel.unit == "g" and accel.full_scale == pytest.approx(10)
    assert accel.noise.white == pytest.approx(0.06 / 60 / 9.80665)
    assert model.sample_rate == 2000


def test_declared_accelerometers_are_the_channels_in_units_of_acceleration_whatever_their_names() -> None:
    keys = (
        "driver: declared_frame; sample_rate: 200 Hz; sync: A5 5A; length: 10; fields: {f_north: {at: 2, type: i16, scale: 0.001, "
        "unit: g}, lift: {at: 4, type: i16, scale: 0.01, unit: m/s^2}, turn: {at: 6, type: i16, scale: 0.01, unit: deg/s}, "
        "accel_temperature: {at: 8, type: i16, scale: 0.01, unit: degC}}; "
        "accelerometers: {velocity_random_walk: 0.06 m/s/sqrt(h), full_scale: 10 g}"
    )
    model = model_of(keys)
    outputs = {item.name: item for item in model.outputs}
    assert outputs["f_north"].full_scale == pytest.approx(10)
    assert outputs["f_north"].noise.white == pytest.approx(0.06 / 60 / 9.80665)
    assert outputs["lift"].full_scale == pytest.approx(98.0665)
    assert outputs["lift"].noise.white == pytest.approx(0.06 / 60)
    for name in ("turn", "accel_temperature"):
        assert outputs[name].full_scale == math.inf and outputs[name].noise.white == 0


def test_inclinometers_have_the_unit_of_accelerometers_and_not_their_properties() -> None:
    model = model_of("driver: stim300; sample_rate: 500 Hz; datagram: 0xA7; accelerometers: {full_scale: 10 g}")
    outputs = {item.name: item for item in model.outputs}
    assert outputs["accel_x"].unit == outputs["inclination_x"].unit == "g"
    assert outputs["accel_x"].full_scale == pytest.approx(10)
    assert outputs["inclination_x"].full_scale == math.inf


def test_a_model_needs_neither_numba_nor_serial() -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from bench_entries import model_of;"
        "[model_of(f'driver: {name}; sample_rate: 400 Hz') for name in ('stim300', 'kvh_1775', 'xsens_mti', 'vectornav')];"
        "print(sorted({'numba', 'serial', 'scipy', 'pyvisa'} & set(sys.modules)))"
    )
    folder = str(__file__).rpartition("/")[0]
    run = subprocess.run(
        [sys.executable, "-c", code.replace("400 Hz", "500 Hz"), folder], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "[]"


def test_a_declared_frame_is_decoded_as_declared() -> None:
    import struct

    stream = b""
    for row in range(120):
        body = (
            (row * 1000 - 60_000).to_bytes(3, "big", signed=True)
            + struct.pack("<H", 100 * row)
            + struct.pack(">f", row / 8)
        )
        body += bytes([2 * row % 100, 16 if row == 5 else 0])
        check = 0
        for byte in body:
            check ^= byte
        stream += b"\xa5\x5a" + body + bytes([check])
    samples, framer = decoded(DeclaredFrame.decoder_of(parameters_of(DECLARED)), stream)
    assert (framer.good, framer.skipped) == (120, 0)
    assert samples.channels["gyro_x"] == pytest.approx(np.arange(120) - 60.0)
    assert samples.channels["t"] == pytest.approx(np.arange(120) - 40.0)
    assert samples.channels["v"].tolist() == (np.arange(120) / 8).tolist()
    assert samples.counter.tolist() == (2 * np.arange(120) % 100).tolist()
    assert samples.doubts == ("status: overload",)
    model = model_of(DECLARED)
    assert [(output.name, output.unit) for output in model.outputs] == [("gyro_x", "deg/s"), ("t", "degC"), ("v", "V")]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            "driver: stim300; sample_rate: 500 Hz; datagram: 90",
            r"bench.yaml:10:15: .*'90' is not an identifier of a STIM300",
        ),
        ("driver: stim300; sample_rate: 500 Hz; acceleration_range: 7 g", "7 g"),
        ("driver: stim300; sample_rate: 500 deg", "bench.yaml:9:18"),
        ("driver: stim300; sample_rate: 500 Hz; gyros: {angle_random_walk: 1 deg/s}", "is not a possible unit here"),
        ("driver: kvh_1775; sample_rate: 500 Hz; format: D", "'D' is not known here"),
        ("driver: xsens_mti; sample_rate: 500 Hz; outputs: [rates]", "'rates' is not known here"),
        ("driver: vectornav; sample_rate: 500 Hz; fields: []", "at least 1"),
        (DECLARED.replace("sync: A5 5A", "sync: A5 5"), "bytes in hexadecimal"),
        (DECLARED.replace("type: i24", "type: i12"), "'i12' is not known here"),
        (DECLARED.replace("unit: V", "unit: volts per m"), "is not a unit"),
        (DECLARED.replace("type: xor8", "type: crc"), "'crc' is not known here"),
    ],
)
def test_mistakes_are_reported_at_their_place(keys: str, words: str) -> None:
    import re

    found = findings_of(keys)
    assert any(re.search(words, text) for text in found), found


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("driver: stim300; sample_rate: 300 Hz", "does not send 300 datagrams"),
        ("driver: vectornav; sample_rate: 400 Hz; fields: [time_startup]", "contain no samples"),
        ("driver: vectornav; sample_rate: 400 Hz; fields: [imu, acceleration]", "imu already contains"),
        (DECLARED.replace("at: 2, type: i24", "at: 1, type: i24"), "'gyro_x' is not between"),
        (DECLARED.replace("at: 7, type: f32", "at: 10, type: f32"), "'v' is not between"),
        (DECLARED.replace("counter: {at: 11", "counter: {at: 13"), "'counter' is not between"),
        (DECLARED.replace("from: 2", "from: 13"), "covers no bytes"),
    ],
)
def test_what_a_sensor_cannot_do_is_reported_before_anything_runs(keys: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        model_of(keys)
    assert words in str(caught.value)
