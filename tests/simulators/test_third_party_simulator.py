"""A simulator of another distribution: found under its driver's name, without a change to planrunner."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Protocol

import pytest

from planrunner.base import plugins
from planrunner.base.findings import InputError
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import read_bench
from planrunner.plan.quantity import Quantity
from planrunner.plan.units import ZERO_CELSIUS
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.from_bench import Simulated
from planrunner.simulators.from_bench import simulated as behind
from planrunner.simulators.interface import Conversation
from planrunner.simulators.live_world import LiveWorld
from planrunner.simulators.message_port import Manner

LABORATORY = Path(__file__).resolve().parents[2] / "plans" / "benches" / "lab_simulated.yaml"
DRIVER = EntryPoint("house_chamber", "planrunner.instruments.chambers.watlow_f4t:WatlowF4t", plugins.INSTRUMENTS)
SIMULATOR = EntryPoint("house_chamber", f"{__name__}:simulated", plugins.SIMULATORS)


class HouseChamberKeys(Protocol):
    lowest: Quantity
    highest: Quantity


class HouseChamber:
    """Answers every message with the temperature of its air."""

    identity = "HOUSE CHAMBER"

    def __init__(self, plant: ChamberPlant):
        self.plant = plant

    def answer(self, message: str) -> str:
        return f"{self.plant.air() - ZERO_CELSIUS:.1f}"

    def later(self) -> list[str]:
        return []

    def watch(self) -> None:
        """Has no limits."""


def simulated(keys: HouseChamberKeys, live: LiveWorld) -> Conversation:
    assert keys.lowest.value < keys.highest.value
    return Conversation(HouseChamber(ChamberPlant(live)), Manner(b"\r", b"\r"))


@pytest.fixture(autouse=True)
def _anew() -> Iterator[None]:
    for table in (plugins._table, plugins.load):
        table.cache_clear()
    yield
    for table in (plugins._table, plugins.load):
        table.cache_clear()


def made(tmp_path: Path) -> Simulated:
    path = tmp_path / "bench.yaml"
    text = LABORATORY.read_text(encoding="utf-8").replace("driver: watlow_f4t", "driver: house_chamber")
    path.write_text(text, encoding="utf-8")
    bench, _, _ = read_bench(str(path))
    return behind(bench, str(path), VirtualClock())


def test_a_simulator_of_another_distribution_stands_behind_its_driver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "_installed", lambda: EntryPoints([DRIVER, SIMULATOR]))
    found = {item.name: item for item in made(tmp_path).spoken}
    assert found["chamber"].controller.identity == "HOUSE CHAMBER"
    assert found["chamber"].controller.answer("T?") == "25.0"
    assert found["chamber"].manner.sent_ends == b"\r"
    assert found["table"].controller.identity != "HOUSE CHAMBER"


def test_a_driver_without_a_simulator_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_installed", lambda: EntryPoints([DRIVER]))
    with pytest.raises(InputError) as raised:
        made(tmp_path)
    assert [finding.code for finding in raised.value.findings] == ["meaning-simulation"]


def test_every_simulator_of_the_project_has_its_driver() -> None:
    own = plugins._own(plugins.SIMULATORS)
    assert len(own) > 10
    assert own.keys() <= plugins._own(plugins.INSTRUMENTS).keys()
    assert all(callable(plugins.load(plugins.SIMULATORS, name)) for name in own)
