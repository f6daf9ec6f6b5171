"""From a bench file to what stands behind its addresses: the virtual instruments of its `simulation`, each behind the protocol that the
bench's driver of the same role speaks.

Drivers are only known by name, and their settings only as the keys of the bench file: no code is shared with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from planrunner.base.findings import InputError, closest
from planrunner.bench.model import Bench, InstrumentEntry, driver_of, read_bench, site_of
from planrunner.bench.simulation import SimulationSpec
from planrunner.instruments.interfaces import Addressed, Surroundings
from planrunner.instruments.virtual.world import World
from planrunner.simulators import sensor_units as units
from planrunner.simulators.acutrol import Acutrol
from planrunner.simulators.aerosmith import Aerosmith
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.conversation import Controller
from planrunner.simulators.declared_frame import (
    CHECKS,
    Alarms,
    DeclaredFrame,
    DeclaredUnit,
    FieldPlace,
    FrameCheck,
    Running,
)
from planrunner.simulators.espec_p300 import EspecP300
from planrunner.simulators.kvh1775 import Kvh1775
from planrunner.simulators.live_world import LiveWorld, RunsFreely, SensorFeed
from planrunner.simulators.message_port import Manner
from planrunner.simulators.navigation_units import VectorNavUnit, XsensUnit
from planrunner.simulators.ports import Address
from planrunner.simulators.scpi_table import ScpiTable
from planrunner.simulators.stim300 import Stim300
from planrunner.simulators.table_plant import TablePlant
from planrunner.simulators.thermotron_8800 import Thermotron8800
from planrunner.simulators.vectornav import VectorNav
from planrunner.simulators.watlow_f4t import WatlowF4t
from planrunner.simulators.xsens import Xsens


class PlantController(Controller, Protocol):
    """A controller of a table or a chamber."""

    @property
    def plant(self) -> TablePlant | ChamberPlant: ...


CRLF = Manner(b"\r\n", b"\r\n")
TABLES: Mapping[str, tuple[Callable[[TablePlant], PlantController], Manner]] = {
    "acutrol": (Acutrol, Manner()),
    "scpi_table": (ScpiTable, Manner()),
    "aerosmith": (Aerosmith, Manner(b"\r\n", b"\r", "prompt")),
}
CHAMBERS: Mapping[str, tuple[Callable[[ChamberPlant], PlantController], Manner]] = {
    "watlow_f4t": (WatlowF4t, Manner()),
    "espec_p300": (EspecP300, CRLF),
    "thermotron_8800": (Thermotron8800, Manner(b"\r", b"\r")),
}
_WORD_BYTES = {"u8": 1, "u16": 2, "u24": 3, "u32": 4}


@dataclass(frozen=True, slots=True)
class Spoken:
    """A table or chamber: its controller, its manner, where."""

    name: str
    role: str
    controller: PlantController
    manner: Manner
    address: Address


@dataclass(frozen=True, slots=True)
class Streamed:
    """A sensor: its unit, its feed of samples, where, and the line's bits a second."""

    name: str
    unit: units.SensorUnit
    feed: SensorFeed
    address: Address
    baud: float


@dataclass(frozen=True, slots=True)
class Simulated:
    """Everything served at a bench's addresses."""

    live: LiveWorld
    spoken: tuple[Spoken, ...]
    sensor: Streamed | None
    roles: Mapping[str, str]


def simulation_of(bench: Bench) -> SimulationSpec:
    """The simulation key of the bench. Raises `InputError` if it is missing."""
    if bench.simulation is None:
        message = "the bench does not name the virtual bench that is served at its addresses"
        hint = "add for example `simulation: {bench: virtual, control: 127.0.0.1:9870}`"
        raise InputError.at(bench.origin.mark, "form-missing-key", message, hint)
    found: SimulationSpec = bench.simulation
    return found


def simulated(bench: Bench, path: str, clock: Any, seed: int | None = None) -> Simulated:
    """The simulated instruments for `bench`, read from `path`. Raises `InputError` if it cannot be simulated, and `PortError` for an
    address that cannot be served."""
    simulation = simulation_of(bench)
    truth, _, _ = read_bench(simulation.bench, beside=Path(path).parent)
    live = _alive(truth, clock, truth.seed if seed is None else seed)
    spoken: list[Spoken] = []
    sensor = None
    for name, entry in bench.instruments.items():
        driver = driver_of(entry)
        role = driver.role
        if not issubclass(driver, Addressed):
            continue  # simulated within the run itself
        if getattr(live, role, None) is None:
            message = f"the bench '{simulation.bench}' has no {role} to stand behind '{name}'"
            raise InputError.at(entry.origin.mark, "meaning-simulation", message, "name another virtual bench")
        address = Address.of(driver.address(entry.parameters))
        if role == "sensor":
            sensor = _streamed(name, entry, live, address)
        else:
            spoken.append(_spoken(name, role, entry, live, address, simulation.framing))
    roles = {item.name: item.role for item in spoken} | ({sensor.name: "sensor"} if sensor else {})
    return Simulated(live, tuple(spoken), sensor, roles)


def _alive(truth: Bench, clock: Any, seed: int) -> LiveWorld:
    """The virtual instruments of a bench, in running time."""
    site = site_of(truth)
    world = World(clock, site, seed, real_time=True)
    live = LiveWorld(world, clock)
    surroundings = Surroundings(clock, site, seed=seed, real_time=True, world=world)
    for entry in truth.instruments.values():
        driver = driver_of(entry)
        instrument = driver.connect(entry.parameters, surroundings)
        surroundings.instruments[driver.role] = instrument
        if driver.role in ("table", "chamber", "sensor"):
            setattr(live, driver.role, instrument)
    return live


def _spoken(name: str, role: str, entry: InstrumentEntry, live: LiveWorld, address: Address, framing: str) -> Spoken:
    known: Mapping[str, Any] = TABLES if role == "table" else CHAMBERS
    if entry.driver not in known:
        raise _not_simulated(entry, known)
    make, manner = known[entry.driver]
    if entry.driver == "espec_p300":
        return Spoken(name, role, EspecP300(ChamberPlant(live), address=entry.parameters.station), manner, address)
    if role == "chamber":
        return Spoken(name, role, make(ChamberPlant(live)), manner, address)
    axes, own = len(live.table.axes), len(entry.parameters.axes)
    if axes != own:
        message = f"'{name}' has {own} axes, the virtual table behind it {axes}"
        raise InputError.at(entry.origin.mark, "meaning-simulation", message, "declare the axes of the virtual table")
    if entry.driver == "acutrol" and address.link is None:
        manner = Manner(manner.sent_ends, manner.reply_ends, framing)
    return Spoken(name, role, make(TablePlant(live)), manner, address)


def _streamed(name: str, entry: InstrumentEntry, live: LiveWorld, address: Address) -> Streamed:
    if entry.driver not in SENSORS:
        raise _not_simulated(entry, SENSORS)
    if not isinstance(live.sensor, RunsFreely):
        message = f"the virtual sensor '{type(live.sensor).__name__}' cannot run freely"
        raise InputError.at(entry.origin.mark, "meaning-simulation", message, "use a virtual gyro or inertial sensor")
    rate, fastest = entry.parameters.sample_rate.value, live.sensor.parameters.sample_rate.value
    if rate > fastest * (1 + 1e-9):
        message = f"'{name}' is said to give {rate:g} Hz; the virtual sensor behind it gives {fastest:g} Hz at most"
        raise InputError.at(entry.parameters.at("sample_rate"), "meaning-simulation", message, "make it slower")
    feed = SensorFeed(live, rate)
    made = SENSORS[entry.driver](entry, live, feed)
    return Streamed(name, made, feed, address, float(entry.parameters.baud))


def _not_simulated(entry: InstrumentEntry, known: Mapping[str, Any]) -> InputError:
    message = f"there is no simulated instrument for the driver '{entry.driver}'"
    return InputError.at(entry.origin.mark, "meaning-simulation", message, closest(entry.driver, known))


# -- sensors by driver -------------------------------------------------------------------------------------------------


def _stim300(entry: InstrumentEntry, live: LiveWorld, feed: SensorFeed) -> units.SensorUnit:
    keys = entry.parameters
    form = Stim300(keys.datagram, int(keys.acceleration_range.split()[0]), keys.gyro_output == "increment")
    return units.Stim300Unit(_outputs(live), form, feed.rate)


def _kvh1775(entry: InstrumentEntry, live: LiveWorld, feed: SensorFeed) -> units.SensorUnit:
    keys = entry.parameters
    form, degrees, increments = Kvh1775(keys.format), keys.angle_unit == "deg", keys.rotation == "delta"
    return units.KvhUnit(_outputs(live), form, feed.rate, degrees, increments, keys.temperature_unit == "C_100")


def _xsens(entry: InstrumentEntry, live: LiveWorld, feed: SensorFeed) -> units.SensorUnit:
    names = {"acceleration": 0x4020, "delta_v": 0x4010, "rate": 0x8020, "delta_q": 0x8030, "temperature": 0x0810}
    items = (0x1020, *(names[name] for name in entry.parameters.outputs), 0xE020)
    return XsensUnit(_outputs(live), Xsens(items), feed.rate)


def _vectornav(entry: InstrumentEntry, live: LiveWorld, feed: SensorFeed) -> units.SensorUnit:
    keys = entry.parameters
    return VectorNavUnit(_outputs(live), VectorNav(keys.fields), "" if keys.output == "binary" else keys.output)


def _outputs(live: LiveWorld) -> units.Outputs:
    return units.Outputs(live.sensor.channels())


def _declared(entry: InstrumentEntry, live: LiveWorld, feed: SensorFeed) -> units.SensorUnit:
    """The frame that the bench file declares, filled with the virtual sensor's outputs of the same names."""
    keys, own = entry.parameters, live.sensor.channels()
    missing = [name for name in keys.fields if name not in own]
    if missing:
        message = f"the virtual sensor has no output '{missing[0]}', only {', '.join(own)}"
        raise InputError.at(entry.origin.mark, "meaning-simulation", message, closest(missing[0], own))
    fields = {
        name: FieldPlace(item.place, item.type, _order(item), item.scale, item.zero, item.unit)
        for name, item in keys.fields.items()
    }
    running = check = None
    alarms = None
    if (counter := keys.counter) is not None:
        modulus = float(counter.modulus or 2 ** (8 * _WORD_BYTES[counter.type]))
        running = Running(FieldPlace(counter.place, counter.type, _order(counter)), counter.step, modulus)
    if (declared := keys.checksum) is not None:
        check = FrameCheck(*CHECKS[declared.type], declared.start, _order(declared))
    if (status := keys.status) is not None:
        alarms = Alarms(status.place, _WORD_BYTES[status.type], _order(status), status.bits, status.set_is_good)
    form = DeclaredFrame(bytes.fromhex(keys.sync), keys.length, fields, running, check)
    words = {text.encode("ascii") + b"\r": mode for mode, text in keys.modes.items()}
    return DeclaredUnit(own, form, words, feed.set_mode, alarms)


def _order(item: Any) -> Any:
    return "little" if item.little_endian else "big"


SENSORS: Mapping[str, Callable[[InstrumentEntry, LiveWorld, SensorFeed], units.SensorUnit]] = {
    "stim300": _stim300,
    "kvh_1775": _kvh1775,
    "xsens_mti": _xsens,
    "vectornav": _vectornav,
    "declared_frame": _declared,
}
