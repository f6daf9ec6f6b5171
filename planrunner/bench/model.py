"""Describes a bench as data: its site and its instruments. Each key has a description and an example.

The code that reads bench files, the JSON Schema in `schemas/` and the key reference in `docs/` are all derived from these records.
The keys of one instrument are declared by its driver.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from functools import cache, lru_cache
from pathlib import Path

from planrunner.base import plugins
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, InputError, Mark, closest, nearest
from planrunner.base.shipped import shipped
from planrunner.bench.calibration import LINE, Calibration, Laboratory, check_dates
from planrunner.bench.check_standard import CHECK_STANDARD, CheckStandardRule
from planrunner.bench.protection import PROTECTION, Protection, kept_chamber, kept_table
from planrunner.bench.signatures import APPROVALS, ApprovalRule, SigningSpec, TimeStampsSpec, check_stamps
from planrunner.bench.simulation import SimulationSpec
from planrunner.bench.specification import Specification
from planrunner.instruments.interfaces import Counting, Driver, PlaysBack, Resumable, Watched
from planrunner.instruments.models import ChamberModel, DataOrigin, SensorModel, TableModel
from planrunner.physics.earth import Site
from planrunner.plan import source
from planrunner.plan.kinds import (
    Choice,
    Kind,
    ListOf,
    MapOf,
    Number,
    Plugged,
    QuantityOf,
    Record,
    RecordOf,
    Text,
    key,
    optional,
)
from planrunner.plan.quantity import Quantity, parse_quantity

NAME = r"[A-Za-z][A-Za-z0-9_-]{0,39}"
SINGLE_ROLES = ("table", "chamber", "sensor")  # roles that drivers have a model for


class MagneticFieldSpec(Record):
    """States the true components of the Earth's magnetic field at the site. The unit of the components matters only if
    sensitivities to the field are stated in a unit; otherwise, only the ratios of the components matter."""

    east: float = key(Number(-1e6, 1e6), "Component towards east.", 0.0, default=0.0)
    north: float = key(Number(-1e6, 1e6), "Component towards north.", 22.0)
    up: float = key(Number(-1e6, 1e6), "Component upwards; negative on the northern hemisphere.", -44.0)


class DeviationOfVertical(Record):
    """States the deviation of the plumb line from the normal of the ellipsoid at the site."""

    north: Quantity = key(
        QuantityOf("angle", uncertain=True),
        "ξ: astronomic latitude minus geodetic latitude; north positive.",
        "3.2 arcsec",
    )
    east: Quantity = key(
        QuantityOf("angle"),
        "η, towards east: astronomic azimuth minus geodetic azimuth is η·tan φ.",
        "-1.5 arcsec",
        default=parse_quantity("0 arcsec"),
    )


class SiteSpec(Record):
    """Site of the bench."""

    latitude: Quantity = key(
        QuantityOf("angle", uncertain=True), "Latitude, north positive; `latitude_kind` gives its kind.", "39.98 deg"
    )
    latitude_kind: str | None = optional(
        Choice(("astronomic", "geodetic")),
        "Kind of the latitude: astronomic (of the plumb line, as measured with stars or gyros) or geodetic (of the "
        "ellipsoid, as in satellite positions and maps); without it, the value counts as both.",
        "geodetic",
    )
    deviation_of_vertical: DeviationOfVertical | None = optional(
        RecordOf(DeviationOfVertical),
        "Converts the stated latitude to the other kind; take it from a geoid model or a survey.",
        {"north": "3.2 arcsec ± 0.5 arcsec", "east": "-1.5 arcsec"},
    )
    gravity: Quantity = key(QuantityOf("acceleration", "positive", uncertain=True), "Local gravity.", "9.80154 m/s^2")
    azimuth: Quantity = key(
        QuantityOf("angle", uncertain=True),
        "Azimuth of the table's reference direction from true north, positive towards east.",
        "0 deg",
        default=parse_quantity("0 deg"),
    )
    longitude: Quantity = key(
        QuantityOf("angle"),
        "Geodetic longitude, east positive; for navigation.",
        "116.34 deg",
        default=parse_quantity("0 deg"),
    )
    height: Quantity = key(
        QuantityOf("length"), "Height above the ellipsoid; for navigation.", "50 m", default=parse_quantity("0 m")
    )
    magnetic_field: MagneticFieldSpec | None = optional(
        RecordOf(MagneticFieldSpec),
        "The Earth's magnetic field, all components in one unit; for sensors that respond to it.",
        {"north": 22.0, "up": -44.0},
    )
    survey: Calibration | None = optional(
        RecordOf(Calibration),
        "Survey that gives latitude, gravity and azimuth.",
        {"certificate": "site survey 2026-1", "date": "2026-02-10"},
    )


def astronomic_latitude(site: SiteSpec) -> Quantity:
    """Returns the latitude of the plumb line [rad], which determines the direction of the Earth's rotation relative to gravity. If
    the bench states the geodetic latitude φ and the northward deviation of the vertical ξ, then Φ = φ + ξ."""
    stated, deviation = site.latitude, site.deviation_of_vertical
    if deviation is None or site.latitude_kind == "astronomic":
        return stated
    u = math.hypot(stated.standard_uncertainty, deviation.north.standard_uncertainty)
    return replace(stated, value=stated.value + deviation.north.value, standard_uncertainty=u)


def geodetic_latitude(site: SiteSpec) -> float:
    """Returns the latitude φ on the ellipsoid [rad], which is used for navigated positions. If the bench states the astronomic
    latitude Φ and the northward deviation of the vertical ξ, then φ = Φ − ξ."""
    deviation = site.deviation_of_vertical
    known = site.latitude_kind == "astronomic" and deviation is not None
    return site.latitude.value - (deviation.north.value if known and deviation is not None else 0.0)


class AmbientSpec(Record):
    """The room of the bench."""

    temperature: Quantity | None = optional(QuantityOf("temperature"), "Air temperature of the room.", "23 degC")
    pressure: Quantity | None = optional(QuantityOf("pressure", "positive"), "Air pressure.", "101.3 kPa")
    humidity: Quantity | None = optional(QuantityOf("ratio", "not negative"), "Relative humidity.", "45 %")


class InstrumentEntry(Record):
    """One instrument of the bench. The driver has additional keys."""

    driver: str = key(Text(NAME, "a driver's name"), "Driver of the instrument.", "virtual_table")
    asset: str | None = optional(
        Text(LINE, "an asset number"), "Your own number for the instrument; stored in the run folder.", "RT-0042"
    )
    calibration: Calibration | None = optional(
        RecordOf(Calibration),
        "Calibration that the instrument's stated uncertainties come from.",
        {"certificate": "RT-0042 / 2026-117", "date": "2026-03-01", "due": "2027-03-01"},
    )
    parameters: Record = field(default_factory=Record)


class FixtureSpec(Record):
    """Describes the fixture in which the sensor is mounted. A plan states the angles of the fixture under `mounting`."""

    asset: str | None = optional(Text(LINE, "an asset number"), "Your own number for the fixture.", "FX-0007")
    reach: Quantity | None = optional(
        QuantityOf("length", "positive"),
        "Largest distance of a sensor from the axis of the table; a diagnosis accepts no longer lever arm (default: 1 m).",
        "0.2 m",
    )
    calibration: Calibration | None = optional(
        RecordOf(Calibration),
        "Calibration that the stated uncertainties of the fixture's angles come from.",
        {"certificate": "FX-0007 / 2026-31", "date": "2026-02-20", "due": "2028-02-20"},
    )


INSTRUMENT: Kind = Plugged(
    InstrumentEntry,
    "driver",
    lambda: plugins.names(plugins.INSTRUMENTS),
    lambda name: plugins.load(plugins.INSTRUMENTS, name),
    "form-unknown-driver",
)


class Bench(Record):
    """A bench: site, instruments and how they are made safe."""

    planrunner_bench: int = key(Number(1, 1, integer=True), "Version of the bench language.", 1)
    name: str = key(Text(LINE, "a name"), "Name of the bench.", "virtual")
    description: str = key(
        Text(), "Description of the bench, for reviewers.", "Three-axis table with chamber.", default=""
    )
    clock: str | None = optional(
        Choice(("virtual", "wall")),
        "virtual: time is simulated and runs as fast as possible; wall: real time. The default is virtual if the "
        "sensor plays back a recording, otherwise wall.",
        "virtual",
    )
    laboratory: Laboratory | None = optional(
        RecordOf(Laboratory),
        "The laboratory that the bench belongs to; needed for certificates.",
        {"name": "Inertial calibration laboratory", "address": "1 Example Street, 00000 Example Town"},
    )
    simulation: SimulationSpec | None = optional(
        RecordOf(SimulationSpec),
        "Simulated instruments at the addresses of this bench, for `planrunner simulate-bench`; a run then uses the "
        "clock of the simulation. A bench with real instruments does not have this key.",
        {"bench": "virtual", "control": "127.0.0.1:9870"},
    )
    site: SiteSpec = key(
        RecordOf(SiteSpec), "Site of the bench.", {"latitude": "39.98 deg", "gravity": "9.80154 m/s^2"}
    )
    seed: int = key(
        Number(0, 2**63 - 1, integer=True), "Seed of all random numbers of a simulated bench.", 20, default=0
    )
    ambient: AmbientSpec | None = optional(RecordOf(AmbientSpec), "The room of the bench.", {"temperature": "23 degC"})
    instruments: dict[str, InstrumentEntry] = key(
        MapOf(INSTRUMENT, pattern=NAME),
        "The instruments by name: at most one table, one chamber and one sensor, and any number of monitors.",
        {"chamber": {"driver": "virtual_chamber", "lowest": "-55 degC", "highest": "85 degC", "ramp": "3 K/min"}},
    )
    fixture: FixtureSpec | None = optional(
        RecordOf(FixtureSpec),
        "The fixture that the sensor is mounted in.",
        {"asset": "FX-0007", "calibration": {"certificate": "FX-0007 / 2026-31", "date": "2026-02-20"}},
    )
    protection: Protection = key(
        PROTECTION,
        "Limits of the bench. Instruments that support such limits enforce them; plans must not exceed them.",
        {"rate": "320 deg/s", "hottest": "75 degC"},
        default_factory=Protection,
    )
    time_stamps: TimeStampsSpec | None = optional(
        RecordOf(TimeStampsSpec),
        "Time stamps of the journal and the seal of every run, from an authority.",
        {"url": "https://tsa.example.org/tsr", "every": "10 min", "certificate": "-----BEGIN CERTIFICATE----- …"},
    )
    approvals: ApprovalRule | None = optional(
        APPROVALS,
        "Approvals that a plan needs before it may run on this bench; without this key, plans need none.",
        {"keys": "lab-keys.yaml", "required": 2, "roles": ["reviewer"]},
    )
    signing: SigningSpec | None = optional(
        RecordOf(SigningSpec),
        "The bench's own key, which signs the seal and the analyses of every run.",
        {"key": "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIGLkQmCXDi/PQZJZziZo7k97osN1kINhk5QiG1kpfDFm"},
    )
    check_standard: CheckStandardRule | None = optional(
        CHECK_STANDARD,
        "The check standard of the bench: other plans run only while it is in control.",
        {
            "device": "CS-01",
            "plan": "check_standard.yaml",
            "coefficients": {"drift.D_X_F": {"reference": "0.30 deg/h ± 0.02 deg/h"}},
            "max_age": "24 h",
        },
    )
    specification: Specification | None = optional(
        RecordOf(Specification),
        "Limits of the constant errors of the sensor; a diagnosis warns of values outside them.",
        {"accel_bias": "±50 mg", "gyro_scale_factor": "±1 %"},
    )
    safe_order: tuple[str, ...] = key(
        ListOf(Text(NAME, "an instrument's name"), minimum=1),
        "Order in which the instruments are made safe; without it the table, then the chamber, then the others.",
        ["table", "chamber", "gyro"],
        default_factory=tuple,
    )

    def calibrations(self) -> tuple[tuple[str, Calibration], ...]:
        """Returns the name and the calibration of each calibrated object."""
        fixed = self.fixture.calibration if self.fixture else None
        found = [("the site's survey", self.site.survey), ("the fixture", fixed)]
        found += [(f"'{name}'", entry.calibration) for name, entry in self.instruments.items()]
        return tuple((what, calibration) for what, calibration in found if calibration)


@dataclass(frozen=True, slots=True)
class BenchModels:
    """Properties of a bench that are known without connecting to its instruments.

    `replays`: True if the sensor plays back a recording. Orientations, rates and temperatures then come from the recording and need
    no table or chamber. `measures`: True if at least one instrument has live readings. `counts`: True if the sensor counts its lost
    and corrupt frames. On a bench with simulated time, `measures` and `counts` are always True. `origin`: whether the samples are
    simulated, played back or measured.
    """

    site: Site
    table: TableModel | None
    chamber: ChamberModel | None
    sensor: SensorModel | None
    replays: bool = False
    measures: bool = True
    counts: bool = True
    origin: DataOrigin = "measured"


def driver_of(entry: InstrumentEntry) -> type[Driver[Record]]:
    """Returns the driver class of an instrument. Raises `InputError` if the driver is not installed."""
    driver: type[Driver[Record]] = plugins.load(plugins.INSTRUMENTS, entry.driver)
    return driver


def site_of(bench: Bench) -> Site:
    """Returns the site of a bench, with its astronomic and its geodetic latitude."""
    site = bench.site
    magnetic = site.magnetic_field
    return Site(
        astronomic_latitude(site).value,
        site.gravity.value,
        site.azimuth.value,
        geodetic_latitude=geodetic_latitude(site),
        longitude=site.longitude.value,
        height=site.height.value,
        magnetic_field=None if magnetic is None else (magnetic.east, magnetic.north, magnetic.up),
    )


def models(bench: Bench) -> BenchModels:
    """Returns the models that the drivers declare for the bench's instruments, restricted by the limits of `protection`."""
    drivers = {name: driver_of(entry) for name, entry in bench.instruments.items()}
    table, chamber, sensor = None, None, None
    for name, driver in drivers.items():
        if driver.role not in SINGLE_ROLES:
            continue
        found = driver.model(bench.instruments[name].parameters)
        if isinstance(found, TableModel):
            table = kept_table(found, bench.protection)
        elif isinstance(found, ChamberModel):
            chamber = kept_chamber(found, bench.protection)
        else:
            sensor = found
    replays = any(issubclass(driver, PlaysBack) for driver in drivers.values())
    simulated = _virtual(bench, replays)
    measures = simulated or any(issubclass(driver, Watched) for driver in drivers.values())
    counts = simulated or any(driver.role == "sensor" and issubclass(driver, Counting) for driver in drivers.values())
    origin = _origin(bench, drivers.values(), replays)
    return BenchModels(site_of(bench), table, chamber, sensor, replays, measures, counts, origin)


def _origin(bench: Bench, drivers: Iterable[type[Driver[Record]]], replays: bool) -> DataOrigin:
    """Returns the origin of the bench's samples. The origin is simulated if at least one instrument is simulated. The simulation is
    part of this program, or a separate process at the address of the instrument. A driver whose simulation is part of this program
    is `Resumable`, because the program can restore the state of the simulation after a crash. `replays`: True if the sensor plays
    back a recording."""
    inside = any(issubclass(driver, Resumable) and not issubclass(driver, PlaysBack) for driver in drivers)
    if inside or bench.simulation is not None or (_virtual(bench, replays) and not replays):
        return "simulated"
    return "replayed" if replays else "measured"


def real_instruments(bench: Bench) -> tuple[str, ...]:
    """Returns the names of the instruments that are not simulated within this program, in the order in which they are made safe."""
    return tuple(name for name in safe_order(bench) if not issubclass(driver_of(bench.instruments[name]), Resumable))


def runs_on_virtual_clock(bench: Bench) -> bool:
    """Returns True if the bench uses simulated time. If the bench file does not state this, only played-back recordings use
    simulated time."""
    return _virtual(bench, any(issubclass(driver_of(entry), PlaysBack) for entry in bench.instruments.values()))


def _virtual(bench: Bench, replays: bool) -> bool:
    return bench.clock == "virtual" if bench.clock is not None else replays


def safe_order(bench: Bench) -> tuple[str, ...]:
    """Returns the names of all instruments in the order in which they are made safe. The bench file states this order; by default,
    the table comes first, then the chamber, then all others."""
    if bench.safe_order:
        return bench.safe_order
    ranks = {"table": 0, "chamber": 1}
    names = list(bench.instruments)
    return tuple(
        sorted(names, key=lambda name: (ranks.get(driver_of(bench.instruments[name]).role, 2), names.index(name)))
    )


def read_bench(name_or_path: str, beside: Path | None = None) -> tuple[Bench, bytes, str]:
    """Reads a bench; returns the bench, the exact bytes of its file, and the file name that findings state.

    A bare word names a shipped bench. Anything else is a file, relative to the folder `beside`. Raises `InputError` with every finding in
    the file.
    """
    path, shown = locate(name_or_path, beside)
    try:
        data = source.read_bytes(path, shown)
    except InputError as error:
        if error.findings[0].code != "file-missing":
            raise
        hint = "check the path; `planrunner bench list` names the benches that come with planrunner"
        raise InputError.at(error.findings[0].mark, "file-missing", "there is no such bench file", hint) from None
    return bench_of(data, shown), data, shown


@lru_cache(maxsize=16)
def bench_of(data: bytes, shown: str) -> Bench:
    """Returns the bench that the bytes of a file describe. The result is cached, because many plans name the same bench. Raises
    `InputError` if the file contains an error."""
    bench, log = parse_bench(source.parse(source.decode(data, shown), shown))
    if bench is None or log.errors:
        raise InputError(log)
    return bench


def parse_bench(root: source.Mapping) -> tuple[Bench | None, Findings]:
    """Reads the bench in a document as far as possible; returns the bench (None if it cannot be read) and the findings about it."""
    log = Findings()
    if root.get("planrunner_bench") is None and root.get("planrunner") is not None:
        log.error(
            "form-plan", root.mark, "this is a plan, not a bench file", "a bench file begins with `planrunner_bench: 1`"
        )
        return None, log
    bench: Bench | None = RecordOf(Bench).read(root, log)
    if bench is not None:
        _check(bench, log)
    return bench, log


@cache
def shipped_benches() -> Mapping[str, Path]:
    """Maps the names of the shipped benches to their files."""
    return {path.stem: path for path in sorted((shipped("plans") / "benches").glob("*.yaml"))}


@lru_cache(maxsize=16)
def benches_for(kind: str) -> tuple[str, ...]:
    """Returns the shipped benches with a sensor of this kind."""
    found = []
    for name in shipped_benches():
        sensor = models(read_bench(name)[0]).sensor
        if sensor is not None and sensor.kind == kind:
            found.append(name)
    return tuple(found)


def locate(name_or_path: str, beside: Path | None) -> tuple[Path, str]:
    """Returns the file of a bench, and the name of this file in messages. Raises `InputError` for an unknown shipped name."""
    if re.fullmatch(NAME, name_or_path):
        known = shipped_benches()
        if name_or_path not in known:
            near = nearest(name_or_path, known)
            first = f"did you mean '{near}'? A file" if near else "`planrunner bench list` names them; a file"
            hint = f"{first} must be given with its extension, such as my-bench.yaml"
            raise InputError.at(
                Mark(name_or_path), "meaning-unknown-bench", f"there is no shipped bench '{name_or_path}'", hint
            )
        return known[name_or_path], f"plans/benches/{name_or_path}.yaml"
    path = Path(name_or_path)
    if beside is not None and not path.is_absolute():
        path = beside / path
    return path, str(path)


def _check(bench: Bench, log: Findings) -> None:
    """Checks requirements that concern several keys of a bench together."""
    if abs(bench.site.latitude.value) > math.pi / 2 + 1e-12:
        log.error(
            "meaning-range",
            bench.site.at("latitude"),
            f"{bench.site.latitude} is not a possible latitude",
            "give a value from -90 deg to 90 deg",
        )
    if not 9.7 < bench.site.gravity.value < 9.9:
        message = f"{bench.site.gravity} is not the gravity of any place on Earth"
        log.warning("meaning-gravity", bench.site.at("gravity"), message, "from 9.76 to 9.84 m/s^2")
    holders: dict[str, str] = {}
    for name, entry in bench.instruments.items():
        role = driver_of(entry).role
        if role in (*SINGLE_ROLES, "carrier") and holders.setdefault(role, name) != name:
            message = f"'{name}' is a second {role}, in addition to '{holders[role]}'"
            log.error("meaning-role", entry.origin.mark, message, f"a bench has at most one {role}")
        if role == "chamber":
            _check_chamber(entry, log)
    for _, calibration in bench.calibrations():
        check_dates(calibration, log)
    if bench.time_stamps is not None:
        check_stamps(bench.time_stamps, log)
    _check_safe_order(bench, log)


def _check_chamber(entry: InstrumentEntry, log: Findings) -> None:
    chamber = driver_of(entry).model(entry.parameters)
    if isinstance(chamber, ChamberModel) and chamber.lowest >= chamber.highest:
        message = "the chamber's lowest temperature is not below its highest"
        log.error("meaning-range", entry.parameters.at("lowest"), message, "exchange them")


def _check_safe_order(bench: Bench, log: Findings) -> None:
    if not bench.safe_order or "instruments" in bench.origin.broken:
        return
    at = bench.at("safe_order")
    for index, name in enumerate(bench.safe_order):
        if name not in bench.instruments:
            log.error(
                "meaning-safe-order",
                at,
                f"'{name}' is not an instrument of this bench",
                closest(name, bench.instruments),
            )
        elif name in bench.safe_order[:index]:
            log.error("meaning-safe-order", at, f"'{name}' is named twice", "name each instrument once")
    for name in bench.instruments:
        if name not in bench.safe_order:
            log.error("meaning-safe-order", at, f"'{name}' is never made safe", "name every instrument")
