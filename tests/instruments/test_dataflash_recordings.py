"""Dataflash logs of ArduPilot: both forms, several sensors of one kind, and damaged logs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from planrunner.instruments.formats import dataflash
from planrunner.instruments.formats.choice import Format, open_file
from planrunner.instruments.formats.dataflash import DataflashKeys
from planrunner.instruments.formats.file import AnyFile, TimeStamps
from planrunner.instruments.interfaces import InstrumentError
from tests import dataflash_bytes

NUMBERS = np.random.default_rng(5).normal(size=(500, 6)).astype(np.float32)
SAMPLES = [(1_000_000 + 2500 * k, *row) for k, row in enumerate(NUMBERS.tolist())]
WRITERS = (dataflash_bytes.binary, dataflash_bytes.text)
Writer = Callable[[Sequence[Sequence[object]]], bytes]


def opened(folder: Path, content: bytes, *channels: str, **keys: object) -> AnyFile:
    (folder / "r.bin").write_bytes(content)
    names = dict(zip(channels, channels, strict=True))
    given = Format(type="dataflash", parameters=DataflashKeys(**keys))  # type: ignore[arg-type]
    return open_file(folder / "r.bin", "r.bin", TimeStamps("TimeUS", 1e-6), names, given)


def refusal(file: AnyFile) -> str:
    with pytest.raises(InstrumentError) as caught:
        file.look()
    assert len(str(caught.value)) < 600
    return str(caught.value)


@pytest.mark.parametrize("write", WRITERS)
def test_the_messages_of_one_sensor_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Writer) -> None:
    file = opened(tmp_path, write(SAMPLES), "GyrX", "AccZ")
    file.look()
    ((time, found),) = file.rows()
    np.testing.assert_allclose(time, 1.0 + np.arange(500) / 400, atol=1e-9)
    np.testing.assert_allclose(found["GyrX"], NUMBERS[:, 0], rtol=1e-7)
    np.testing.assert_allclose(found["AccZ"], NUMBERS[:, 5], rtol=1e-7)
    assert file.units() == {
        "TimeUS": "us",
        **{f"{kind}{x}": u for kind, u in (("Gyr", "rad/s"), ("Acc", "m/s^2")) for x in "XYZ"},
    }
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("write", WRITERS)
def test_other_sensors_and_other_messages(tmp_path: Path, write: Writer) -> None:
    file = opened(tmp_path, write(SAMPLES), "GyrX", instance=1)
    file.look()
    ((time, found),) = file.rows()
    assert time[0] == pytest.approx(1.001) and set(found["GyrX"].tolist()) == {0.5}
    file = opened(tmp_path, write(SAMPLES), "Temp", message="BARO")
    file.look()
    ((time, found),) = file.rows()
    assert len(time) == 50 and found["Temp"].tolist() == pytest.approx([23.71] * 50)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"message": "IMV"}, "r.bin has no messages IMV of instance 0; did you mean 'IMU'?"),
        (
            {"instance": 3},
            "r.bin has no messages IMU of instance 3; the log describes this message, but does not contain it",
        ),
        ({"message": "BARO"}, "r.bin has no column 'GyrX'"),
    ],
)
def test_what_the_log_does_not_contain(tmp_path: Path, write: Writer, keys: dict[str, object], said: str) -> None:
    assert said in refusal(opened(tmp_path, write(SAMPLES), "GyrX", **keys))


@pytest.mark.parametrize("write", WRITERS)
def test_a_time_that_does_not_increase_is_named(tmp_path: Path, write: Writer) -> None:
    samples = [*SAMPLES[:7], SAMPLES[6], *SAMPLES[7:]]
    said = refusal(opened(tmp_path, write(samples), "GyrX"))
    assert "r.bin, message IMU number 8: time does not increase: 1.015 s after 1.015 s" in said


def test_a_log_that_is_cut_is_read_up_to_there_or_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for write in WRITERS:
        whole = write(SAMPLES)
        for size in (0, 1, 50, 100, 399, 700, 1000, len(whole) // 2, len(whole) - 5):
            file = opened(tmp_path, whole[:size], "GyrX")
            if size < 700:
                assert refusal(file).startswith("r.bin")
                continue
            file.look()
            found = np.concatenate([values["GyrX"] for _, values in file.rows()])
            np.testing.assert_allclose(found[:-1], NUMBERS[: len(found) - 1, 0], rtol=1e-7)
    assert capsys.readouterr().out == ""


def test_bytes_that_are_no_log_are_refused(tmp_path: Path) -> None:
    draw = np.random.default_rng(1)
    assert "is not a dataflash log" in refusal(opened(tmp_path, b"t,x\n1,2\n", "GyrX"))
    for start in (
        dataflash.BINARY,
        dataflash.BINARY * 40,
        b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\nIMU, ",
    ):
        assert refusal(opened(tmp_path, start + draw.bytes(5000), "GyrX")).startswith("r.bin")


def test_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = dataflash_bytes.binary(SAMPLES)
    monkeypatch.setattr(dataflash, "MAX_HELD", 1000)
    assert "its messages IMU contain more than 0.001 million numbers" in refusal(opened(tmp_path, whole, "GyrX"))
    monkeypatch.setattr(dataflash, "MAX_LOG", 20_000)
    assert "the log has 0 MB, more than 0.02 MB; write its messages IMU as CSV" in refusal(
        opened(tmp_path, whole, "GyrX")
    )


def test_the_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    said = refusal(opened(tmp_path, dataflash_bytes.binary(SAMPLES), "GyrX"))
    assert "needs the package pymavlink; install it with: pip install 'planrunner[recordings]'" in said
