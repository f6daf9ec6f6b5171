"""The driver of a chamber that docs/writing-a-driver.md builds, against a scripted chamber that speaks ASCII-2."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from scripted import answering, parameters, surroundings

from planrunner.instruments.interfaces import (
    HoldsTemperature,
    Instrument,
    InstrumentError,
    Readable,
    SelfLimiting,
    Watched,
)
from planrunner.plan.units import ZERO_CELSIUS

MODULE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "votsch_chamber" / "votsch_chamber.py"
RANGE = ("lowest: -40 degC", "highest: 85 degC", "ramp: 3 K/min", "tolerance: 0.5 K")


@pytest.fixture(scope="module")
def votsch() -> Any:
    spec = importlib.util.spec_from_file_location("votsch_chamber", MODULE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Chamber:
    """Temperature and humidity; its air is at once where its set point is."""

    def __init__(self) -> None:
        self.points, self.air, self.bits, self.obeys = [23.0, 50.0], 23.1, "0000", True
        self.heard: list[str] = []

    def __call__(self, message: str) -> bytes:
        self.heard.append(message)
        if message == "$01I":
            said = f"{self.points[0]:06.1f} {self.air:06.1f} {self.points[1]:06.1f} 0048.0 {self.bits}\r\n"
            return said.encode()
        if message.startswith("$01E ") and self.obeys:
            *points, self.bits = message.split()[1:]
            self.points = [float(point) for point in points]
            self.air = self.points[0]
        return b""


@contextmanager
def connected(votsch: Any) -> Iterator[tuple[Chamber, Any]]:
    chamber = Chamber()
    with answering(chamber, b"\r\n") as server:
        driver = votsch.Votsch.connect(parameters(votsch.VotschParameters, server.address, *RANGE), surroundings())
        yield chamber, driver
        driver.close()


def test_it_reaches_temperatures_and_is_left_at_ambient(votsch: Any) -> None:
    with connected(votsch) as (chamber, driver):
        assert all(isinstance(driver, able) for able in (Instrument, HoldsTemperature, Readable, Watched, SelfLimiting))
        assert not driver.at_temperature()
        driver.set_temperature(-40 + ZERO_CELSIUS)
        assert "$01E -040.0 0050.0 0100" in chamber.heard  # the other channel keeps its set point
        assert driver.at_temperature()
        assert driver.read() == {"air_degC": -40.0}
        driver.make_safe()
        assert chamber.points == [25.0, 50.0]
        assert driver.remarks() == []


def test_what_it_does_not_do_is_noticed(votsch: Any) -> None:
    with connected(votsch) as (chamber, driver):
        chamber.obeys = False
        with pytest.raises(InstrumentError, match=r"stays at set point 23 degC: is it in remote operation\?"):
            driver.set_temperature(60 + ZERO_CELSIUS)


@pytest.mark.parametrize(
    "said", [b"hello\r\n", b"\r\n", b"0023.0 0023.1 0x\r\n", b"0023.0 0100\r\n", b"1 2 3 4 5 0100\r\n"]
)
def test_another_instrument_is_reported(votsch: Any, said: bytes) -> None:
    with (
        answering(lambda message: said, b"\r\n") as server,
        pytest.raises(InstrumentError, match="not an ASCII-2 reply"),
    ):
        votsch.Votsch.connect(parameters(votsch.VotschParameters, server.address, *RANGE), surroundings())
