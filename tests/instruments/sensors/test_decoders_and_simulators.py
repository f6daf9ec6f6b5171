"""Decoders against the simulated sensors, which were written apart from them, from the protocols alone."""

from __future__ import annotations

import numpy as np
import pytest
from bench_entries import parameters_of
from published_vectors import decoded

from planrunner.instruments.sensors import kvh1775, stim300, vectornav, xsens
from planrunner.simulators import kvh1775 as kvh_unit
from planrunner.simulators import stim300 as stim_unit
from planrunner.simulators import vectornav as vectornav_unit
from planrunner.simulators import xsens as xsens_unit
from planrunner.simulators.frames import Values

COUNT = 300
CLUSTERS = {"gyro": "gyro", "acc": "accel", "incl": "inclination"}


def random_columns(seed: int) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(seed)
    spread = {"gyro": 300.0, "acc": 4.0, "incl": 1.5, "gyro_T": 80.0, "acc_T": 80.0, "incl_T": 80.0}
    columns = {f"{name}_{axis}": draw.uniform(-width, width, COUNT) for name, width in spread.items() for axis in "xyz"}
    return columns | {"aux": draw.integers(-(2**23), 2**23, COUNT), "pps": draw.integers(0, 2**23, COUNT)}


@pytest.mark.parametrize("datagram", sorted(stim300.DATAGRAMS))
@pytest.mark.parametrize("crlf", [False, True])
def test_every_datagram_of_stim300(datagram: int, crlf: bool) -> None:
    columns, counter = random_columns(datagram), np.arange(COUNT) * 4 % 256
    latency = np.arange(COUNT) + 300
    unit = stim_unit.Stim300(datagram, acceleration_range=5, crlf=crlf)
    keys = f"driver: stim300; sample_rate: 500 Hz; datagram: 0x{datagram:X}; acceleration_range: 5 g"
    decoder = stim300.Stim300.decoder_of(parameters_of(keys))
    samples, framer = decoded(decoder, unit.frames(columns, counter, latency).tobytes())
    assert (framer.good, framer.corrupt, framer.skipped) == (COUNT, 0, 0)
    assert samples.counter.tolist() == counter.tolist()
    assert samples.latency == pytest.approx(latency * 1e-6)
    for theirs, ours in CLUSTERS.items():
        for axis in "xyz":
            if f"{ours}_{axis}" in samples.channels:
                step = decoder.fields[f"{ours}_{axis}"].scale
                assert samples.channels[f"{ours}_{axis}"] == pytest.approx(columns[f"{theirs}_{axis}"], abs=0.51 * step)
            if f"{ours}_temperature_{axis}" in samples.channels:
                found = samples.channels[f"{ours}_temperature_{axis}"]
                assert found == pytest.approx(columns[f"{theirs}_T_{axis}"], abs=0.51 / 256)
    if "aux" in samples.channels:
        assert samples.channels["aux"] == pytest.approx(columns["aux"] * 5 / 2**24, abs=1e-12)
    assert not samples.doubtful.any()


@pytest.mark.parametrize(
    ("range_", "step"), [("5 g", 2.0**-20), ("10 g", 2.0**-19), ("30 g", 2.0**-18), ("80 g", 2.0**-16)]
)
def test_ranges_of_stim300(range_: str, step: float) -> None:
    columns = random_columns(3)
    unit = stim_unit.Stim300(0x91, acceleration_range=int(range_.split()[0]))
    keys = f"driver: stim300; sample_rate: 500 Hz; datagram: 0x91; acceleration_range: {range_}"
    decoder = stim300.Stim300.decoder_of(parameters_of(keys))
    samples, _ = decoded(decoder, unit.frames(columns, np.arange(COUNT) % 256, np.zeros(COUNT)).tobytes())
    assert samples.channels["accel_x"] == pytest.approx(columns["acc_x"], abs=0.51 * step)


def test_increments_of_stim300_are_recorded_as_rates() -> None:
    columns = random_columns(4)
    increments = columns | {f"gyro_{axis}": columns[f"gyro_{axis}"] / 500 for axis in "xyz"}
    unit = stim_unit.Stim300(0x90, increments=True)
    decoder = stim300.Stim300.decoder_of(
        parameters_of("driver: stim300; sample_rate: 500 Hz; datagram: 0x90; gyro_output: increment")
    )
    samples, _ = decoded(decoder, unit.frames(increments, np.arange(COUNT) % 256, np.zeros(COUNT)).tobytes())
    assert samples.channels["gyro_y"] == pytest.approx(columns["gyro_y"], abs=0.51 * 500 / 2**21)


def test_status_bits_of_stim300_become_doubts() -> None:
    columns = random_columns(5) | {"gyro_status": np.zeros(COUNT, int), "acc_status": np.zeros(COUNT, int)}
    columns["gyro_status"][10:20] = 0b0001_0100  # overload of z
    columns["acc_status"][200] = 0b1000_0000
    unit = stim_unit.Stim300(0x91)
    decoder = stim300.Stim300.decoder_of(parameters_of("driver: stim300; sample_rate: 500 Hz; datagram: 0x91"))
    samples, _ = decoded(decoder, unit.frames(columns, np.arange(COUNT) % 256, np.zeros(COUNT)).tobytes())
    assert np.flatnonzero(samples.doubtful).tolist() == [*range(10, 20), 200]
    assert samples.doubts == ("gyro: overload", "gyro: z axis", "accel: system integrity error")


@pytest.mark.parametrize("letter", ["A", "B", "C"])
def test_formats_of_kvh(letter: str) -> None:
    draw = np.random.default_rng(ord(letter))
    columns = {
        f"{name}_{axis}": draw.uniform(-5, 5, COUNT).astype(np.float32) for name in ("gyro", "acc") for axis in "xyz"
    }
    columns["temperature"] = np.repeat(draw.integers(-20, 70, COUNT // 4), 4).astype(float)
    sent = columns
    if letter == "C":  # every fourth frame holds the temperature, the others the magnetic field
        sent = columns | {"temperature": np.where(np.arange(COUNT) % 4 == 0, columns["temperature"], 0.5)}
    frames = kvh_unit.Kvh1775(letter).frames(sent, np.arange(COUNT)).tobytes()
    keys = f"driver: kvh_1775; sample_rate: 1000 Hz; format: {letter}"
    samples, framer = decoded(kvh1775.Kvh1775.decoder_of(parameters_of(keys)), frames)
    assert (framer.good, framer.corrupt) == (COUNT, 0)
    assert samples.counter.tolist() == (np.arange(COUNT) % 128).tolist()
    for axis in "xyz":
        assert samples.channels[f"gyro_{axis}"].tolist() == columns[f"gyro_{axis}"].tolist()
        assert samples.channels[f"accel_{axis}"].tolist() == columns[f"acc_{axis}"].tolist()
    assert samples.channels["sensor_temperature"].tolist() == columns["temperature"].tolist()


def test_validity_bits_of_kvh_become_doubts() -> None:
    columns = {f"{name}_{axis}": np.zeros(8) for name in ("gyro", "acc") for axis in "xyz"} | {
        "temperature": np.zeros(8)
    }
    columns["status"] = np.array([0x77, 0x77, 0x75, 0x77, 0x37, 0x77, 0x77, 0x77])
    frames = kvh_unit.Kvh1775("A").frames(columns, np.arange(8)).tobytes()
    samples, _ = decoded(kvh1775.Kvh1775.decoder_of(parameters_of("driver: kvh_1775; sample_rate: 1000 Hz")), frames)
    assert np.flatnonzero(samples.doubtful).tolist() == [2, 4]
    assert samples.doubts == ("gyro: y invalid", "accel: z invalid")


def test_numbers_that_are_none_are_refused() -> None:
    columns = {f"{name}_{axis}": np.zeros(6) for name in ("gyro", "acc") for axis in "xyz"} | {
        "temperature": np.zeros(6)
    }
    columns["gyro_y"][2], columns["acc_z"][4] = np.nan, np.inf
    frames = kvh_unit.Kvh1775("A").frames(columns, np.arange(6)).tobytes()
    samples, framer = decoded(
        kvh1775.Kvh1775.decoder_of(parameters_of("driver: kvh_1775; sample_rate: 1000 Hz")), frames
    )
    assert framer.good == 6
    assert samples.counter.tolist() == [0, 1, 3, 5]
    assert samples.refused == 2


@pytest.mark.parametrize("precision", range(4))
def test_outputs_of_xsens_in_every_way_to_write_numbers(precision: int) -> None:
    draw = np.random.default_rng(precision)
    columns: dict[int, Values] = {
        0x4020: draw.uniform(-20, 20, (COUNT, 3)),
        0x8020: draw.uniform(-5, 5, (COUNT, 3)),
        0x0810: draw.uniform(-20, 60, COUNT),
    }
    columns |= {0x1020: np.arange(COUNT) + 65400, 0xE020: np.ones(COUNT)}
    items = [0x1020, 0x0810 | precision, 0x4020 | precision, 0x8020 | precision, 0xE020]
    frames = xsens_unit.Xsens(items).frames(columns).tobytes()
    keys = "driver: xsens_mti; sample_rate: 400 Hz; outputs: [rate, acceleration, temperature]"
    samples, framer = decoded(xsens.XsensMti.decoder_of(parameters_of(keys)), frames)
    assert (framer.good, samples.refused) == (COUNT, 0)
    exact = (1e-6, 2.0**-20, 2.0**-31, 1e-15)[precision]
    for place, axis in enumerate("xyz"):
        assert samples.channels[f"accel_{axis}"] == pytest.approx(columns[0x4020][:, place], rel=exact, abs=exact)
        assert samples.channels[f"gyro_{axis}"] == pytest.approx(columns[0x8020][:, place], rel=exact, abs=exact)
    assert samples.channels["sensor_temperature"] == pytest.approx(columns[0x0810], rel=exact, abs=exact)
    assert samples.counter.tolist() == ((np.arange(COUNT) + 65400) % 65536).tolist()


def test_frames_of_xsens_whose_packets_differ_keep_their_order() -> None:
    columns: dict[int, Values] = {0x4020: np.arange(3 * COUNT).reshape(COUNT, 3), 0x8020: np.zeros((COUNT, 3))}
    columns |= {0x0810: np.zeros(COUNT)}
    columns |= {0x1020: np.arange(COUNT), 0xE020: np.where(np.arange(COUNT) == 7, 1 | 1 << 12, 1)}
    shapes = ([0x1020, 0x4020, 0x8020, 0xE020], [0x1020, 0x0810, 0x8020, 0x4023], [0x1020, 0x4020])
    rows = [xsens_unit.Xsens(items).frames(columns) for items in shapes]
    chosen = np.random.default_rng(9).integers(0, 3, COUNT)
    chosen[7] = 0
    stream = b"".join(rows[shape][row].tobytes() for row, shape in enumerate(chosen))
    samples, framer = decoded(
        xsens.XsensMti.decoder_of(parameters_of("driver: xsens_mti; sample_rate: 400 Hz")), stream
    )
    complete = np.flatnonzero(chosen < 2)
    assert framer.good == COUNT
    assert samples.refused == COUNT - complete.size
    assert samples.counter.tolist() == complete.tolist()
    assert samples.channels["accel_z"].tolist() == columns[0x4020][complete, 2].tolist()
    assert samples.doubts == ("MTi: gyro y clipped",)


def test_binary_messages_of_vectornav() -> None:
    draw = np.random.default_rng(11)
    columns: dict[str, np.ndarray] = {
        "time_startup": np.arange(COUNT) * 2_500_000 + 10**12,
        "imu": draw.uniform(-9, 9, (COUNT, 6)).astype(np.float32),
    }
    columns["mag_pres"] = draw.uniform(-1, 1, (COUNT, 5)).astype(np.float32)
    frames = vectornav_unit.VectorNav().frames(columns).tobytes()
    decoder = vectornav.VectorNav.decoder_of(parameters_of("driver: vectornav; sample_rate: 400 Hz"))
    samples, framer = decoded(decoder, frames)
    assert (framer.good, framer.skipped) == (COUNT, 0)
    assert samples.counter.tolist() == columns["time_startup"].tolist()
    assert decoder.counter.step == 2_500_000
    names = ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"]
    np.testing.assert_array_equal(np.array([samples.channels[name] for name in names]).T, columns["imu"])
    np.testing.assert_array_equal(samples.channels["sensor_temperature"], columns["mag_pres"][:, 3])


def test_lines_of_vectornav() -> None:
    draw = np.random.default_rng(12)
    rows = [[np.round(draw.uniform(-90, 90, 3), 3), np.round(draw.uniform(-1, 1, 3), 4)] for _ in range(COUNT)]
    lines = b"".join(vectornav_unit.measurement(field, angle / 10, angle / 100, angle) for angle, field in rows)
    decoder = vectornav.VectorNav.decoder_of(parameters_of("driver: vectornav; sample_rate: 40 Hz; output: VNYMR"))
    samples, framer = decoded(decoder, lines)
    assert (framer.good, samples.refused) == (COUNT, 0)
    assert samples.channels["pitch"].tolist() == [float(angle[1]) for angle, _ in rows]
    assert samples.channels["magnetometer_z"].tolist() == [float(field[2]) for _, field in rows]
    assert samples.channels["gyro_x"] == pytest.approx([angle[0] / 100 for angle, _ in rows], abs=6e-7)
