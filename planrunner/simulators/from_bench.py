"""Makes simulated instruments at the addresses of a bench file. The bench file names a virtual bench in the key `simulation`. Each
instrument of this virtual bench uses the protocol of the driver that has the same role in the bench file.

A simulation uses only the name of a driver and its keys in the bench file. The simulation has no code in common with the driver.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from planrunner.base import plugins
from planrunner.base.findings import InputError, closest
from planrunner.bench.model import SINGLE_ROLES, Bench, InstrumentEntry, driver_of, read_bench, site_of
from planrunner.bench.simulation import SimulationSpec
from planrunner.instruments.interfaces import Addressed, Clock, Instrument, Surroundings
from planrunner.instruments.virtual.chamber import VirtualChamber
from planrunner.instruments.virtual.table import VirtualTable
from planrunner.instruments.virtual.world import World
from planrunner.plan.quantity import Quantity
from planrunner.simulators.interface import ConversationSimulator, PlantController, SensorSimulator
from planrunner.simulators.live_world import LiveWorld, RunsFreely, SensorFeed
from planrunner.simulators.message_port import Manner
from planrunner.simulators.ports import Address
from planrunner.simulators.sensor_units import SensorUnit


@runtime_checkable
class DeclaresAxes(Protocol):
    """Lists the driver keys that are needed to simulate a table."""

    axes: Sequence[object]


@runtime_checkable
class DeclaresLine(Protocol):
    """Lists the driver keys that are needed to simulate a sensor on a serial line."""

    sample_rate: Quantity
    baud: int


@dataclass(frozen=True, slots=True)
class Spoken:
    """Describes a simulated table or chamber: its controller, the form of its messages, and its address."""

    name: str
    role: str
    controller: PlantController
    manner: Manner
    address: Address


@dataclass(frozen=True, slots=True)
class Streamed:
    """Describes a simulated sensor: its electronics, its feed of samples, its address, and the bit rate of its line."""

    name: str
    unit: SensorUnit
    feed: SensorFeed
    address: Address
    baud: float


@dataclass(frozen=True, slots=True)
class Simulated:
    """Contains all simulated instruments at the addresses of a bench."""

    live: LiveWorld
    spoken: tuple[Spoken, ...]
    sensor: Streamed | None
    roles: Mapping[str, str]


def simulation_of(bench: Bench) -> SimulationSpec:
    """Returns the value of the key `simulation` of a bench. Raises `InputError` if the bench does not have this key."""
    if bench.simulation is None:
        message = "the bench does not name the virtual bench that is served at its addresses"
        hint = "add for example `simulation: {bench: virtual, control: 127.0.0.1:9870}`"
        raise InputError.at(bench.origin.mark, "form-missing-key", message, hint)
    return bench.simulation


def simulated(bench: Bench, path: str, clock: Clock, seed: int | None = None) -> Simulated:
    """Makes the simulated instruments for `bench`, which was read from `path`. Raises `InputError` if the bench cannot be
    simulated, and `PortError` for an address that cannot be served."""
    simulation = simulation_of(bench)
    truth, _, _ = read_bench(simulation.bench, beside=Path(path).parent)
    live, virtual = _alive(truth, clock, truth.seed if seed is None else seed)
    spoken: list[Spoken] = []
    sensor = None
    for name, entry in bench.instruments.items():
        driver = driver_of(entry)
        role = driver.role
        if not issubclass(driver, Addressed):
            continue  # simulated within the run itself
        if role not in virtual:
            message = f"the bench '{simulation.bench}' has no {role} that could simulate '{name}'"
            raise InputError.at(entry.origin.mark, "meaning-simulation", message, "name another virtual bench")
        address = Address.of(driver.address(entry.parameters))
        if role == "sensor":
            sensor = _streamed(name, entry, live, virtual[role], address)
        else:
            spoken.append(_spoken(name, role, entry, live, address, simulation.framing))
    roles = {item.name: item.role for item in spoken} | ({sensor.name: "sensor"} if sensor else {})
    return Simulated(live, tuple(spoken), sensor, roles)


def _alive(truth: Bench, clock: Clock, seed: int) -> tuple[LiveWorld, dict[str, Instrument]]:
    """Connects the virtual instruments of a bench, with a running clock; returns the live world, and the instruments by role."""
    site = site_of(truth)
    world = World(clock, site, seed, real_time=True)
    live = LiveWorld(world, clock)
    surroundings = Surroundings(clock, site, seed=seed, real_time=True, world=world)
    for entry in truth.instruments.values():
        driver = driver_of(entry)
        instrument = driver.connect(entry.parameters, surroundings)
        surroundings.instruments[driver.role] = instrument
        if isinstance(instrument, VirtualTable):
            live.table = instrument
        elif isinstance(instrument, VirtualChamber):
            live.chamber = instrument
    return live, {role: item for role, item in surroundings.instruments.items() if role in SINGLE_ROLES}


def _spoken(name: str, role: str, entry: InstrumentEntry, live: LiveWorld, address: Address, framing: str) -> Spoken:
    simulator: ConversationSimulator = plugins.load(plugins.SIMULATORS, _simulated(entry))
    if live.table is not None and isinstance(entry.parameters, DeclaresAxes):
        axes, own = len(live.table.axes), len(entry.parameters.axes)
        if axes != own:
            message = f"'{name}' has {own} axes, but the virtual table behind it has {axes}"
            hint = "declare the axes of the virtual table"
            raise InputError.at(entry.origin.mark, "meaning-simulation", message, hint)
    made = simulator(entry.parameters, live)
    manner = made.manner
    if made.framed and address.link is None:
        manner = replace(manner, framing=framing)
    return Spoken(name, role, made.controller, manner, address)


def _streamed(name: str, entry: InstrumentEntry, live: LiveWorld, virtual: Instrument, address: Address) -> Streamed:
    simulator: SensorSimulator = plugins.load(plugins.SIMULATORS, _simulated(entry))
    if not isinstance(virtual, RunsFreely):
        message = f"the virtual sensor '{type(virtual).__name__}' cannot run freely"
        raise InputError.at(entry.origin.mark, "meaning-simulation", message, "use a virtual gyro or inertial sensor")
    keys = entry.parameters
    if not isinstance(keys, DeclaresLine):
        message = f"the driver '{entry.driver}' has no keys sample_rate and baud, which its simulation needs"
        raise InputError.at(entry.origin.mark, "meaning-simulation", message, "declare both in its Parameters")
    rate, fastest = keys.sample_rate.value, virtual.parameters.sample_rate.value
    if rate > fastest * (1 + 1e-9):
        message = f"the bench file declares that '{name}' gives {rate:g} Hz; the virtual sensor behind it gives {fastest:g} Hz at most"
        raise InputError.at(entry.parameters.at("sample_rate"), "meaning-simulation", message, "declare a lower rate")
    feed = SensorFeed(live, virtual, rate)
    return Streamed(name, simulator(entry.parameters, live, feed), feed, address, float(keys.baud))


def _simulated(entry: InstrumentEntry) -> str:
    """Returns the name of an entry's driver, which is also the name of an installed simulator. Raises `InputError` if there is no
    such simulator."""
    known = plugins.names(plugins.SIMULATORS)
    if entry.driver not in known:
        message = f"there is no simulated instrument for the driver '{entry.driver}'"
        raise InputError.at(entry.origin.mark, "meaning-simulation", message, closest(entry.driver, known))
    return entry.driver
