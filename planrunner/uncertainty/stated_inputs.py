"""Collects the uncertainties that the bench and the plan state: the type B inputs of budgets, each with its source and calibration
date."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from planrunner.base.findings import Findings
from planrunner.bench.calibration import Calibration
from planrunner.bench.model import (
    Bench,
    BenchModels,
    InstrumentEntry,
    astronomic_latitude,
    driver_of,
    runs_on_virtual_clock,
)
from planrunner.instruments.models import ChamberModel, SensorModel, TableModel
from planrunner.plan.model import MountedAxis
from planrunner.plan.quantity import Quantity
from planrunner.plan.units import unit
from planrunner.uncertainty.influences import Aspect, InputQuantity, Inputs

ARCSEC = unit("arcsec").factor
TYPICAL_DEVIATION = 5 * ARCSEC
"""Typical deviation of the vertical. The deviation is a few arcseconds in flat country, and tens of arcseconds in mountains."""


def stated_inputs(bench: Bench, models: BenchModels, mounting: Mapping[str, MountedAxis]) -> Inputs:
    """Returns the quantities for which the bench or the plan states an uncertainty; `Inputs` lists their names."""
    found = [*_site(bench), *_mounting(bench, mounting)]
    for name, entry in bench.instruments.items():
        role, source, day = driver_of(entry).role, _source(name, entry), _day(entry.calibration)
        if role == "table" and models.table is not None:
            found += _table(models.table, source, day)
        elif role == "chamber" and models.chamber is not None:
            found += _chamber(models.chamber, source, day)
        elif role == "sensor" and models.sensor is not None:
            found += _outputs(models.sensor, source, day)
    outputs = () if models.sensor is None else models.sensor.outputs
    silent = frozenset(output.name for output in outputs if not (output.constant or output.noise.states_flicker))
    return Inputs({item.name: item for item in found if item.standard_uncertainty > 0}, silent)


def check_backed(bench: Bench, models: BenchModels, log: Findings) -> None:
    """Adds a note for each instrument of a real bench that has stated uncertainties but no calibration."""
    if runs_on_virtual_clock(bench):
        return
    table, chamber = models.table, models.chamber
    stated = {
        "table": table is not None and any((table.position_uncertainty, table.orthogonality, table.rate_stability)),
        "chamber": chamber is not None and chamber.temperature_uncertainty > 0,
    }
    for name, entry in bench.instruments.items():
        if entry.calibration is None and stated.get(driver_of(entry).role):
            message = f"'{name}' states uncertainties without a calibration, so budgets cannot name their source"
            hint = "add calibration: {certificate: …, date: …}"
            log.note("bench-no-calibration", entry.origin.mark, message, hint)


def check_vertical(bench: Bench, models: BenchModels, log: Findings) -> None:
    """Adds a warning if the stated uncertainty of the latitude is smaller than usual deviations of the vertical, but the bench does
    not state whether the latitude is astronomic or geodetic."""
    site, simulated = bench.site, bench.simulation is not None or (runs_on_virtual_clock(bench) and not models.replays)
    u = site.latitude.standard_uncertainty
    if simulated or site.latitude_kind is not None or site.deviation_of_vertical is not None:
        return
    if 0 < u < TYPICAL_DEVIATION:
        message = (
            f"latitude has an uncertainty of {u / ARCSEC:.3g} arcsec, but its kind (astronomic or geodetic) is not given; the two "
            f"differ by the deviation of the vertical, typically {TYPICAL_DEVIATION / ARCSEC:.0f} arcsec, in mountains up to 60 arcsec"
        )
        hint = "write `latitude_kind: astronomic`, or `latitude_kind: geodetic` and `deviation_of_vertical: {north: …}`, or widen the ±"
        log.warning("bench-vertical", site.at("latitude"), message, hint)


def input_quantity(name: str, stated: Quantity, si: str, source: str, calibrated: str = "") -> InputQuantity:
    """Makes an input quantity from a quantity in a file. `si`: SI-coherent unit in which the value is given."""
    return InputQuantity(
        name,
        stated.value,
        si,
        stated.standard_uncertainty,
        stated.degrees_of_freedom,
        stated.shape,
        source,
        calibrated,
        "" if stated.unit.offset else stated.unit.text,
        stated.unit.factor,
    )


def _site(bench: Bench) -> Iterator[InputQuantity]:
    survey = bench.site.survey
    source = f"bench site, {survey.words}" if survey else "bench site"
    site = bench.site
    for name, stated, si in (
        ("latitude", astronomic_latitude(site), "rad"),
        ("gravity", site.gravity, "m/s^2"),
        ("azimuth", site.azimuth, "rad"),
    ):
        yield input_quantity(name, stated, si, source, _day(survey))


def _mounting(bench: Bench, mounting: Mapping[str, MountedAxis]) -> Iterator[InputQuantity]:
    fixture = bench.fixture
    calibration = fixture.calibration if fixture else None
    known = [f"asset {fixture.asset}"] if fixture and fixture.asset else []
    known += [calibration.words] if calibration else []
    for axis, mounted in mounting.items():
        source = ", ".join([f"plan mounting.{axis}", *known])
        yield input_quantity(f"fixture angle {axis}", mounted.angle, "rad", source, _day(calibration))
        if mounted.azimuth is not None:
            yield input_quantity(f"fixture azimuth {axis}", mounted.azimuth, "rad", source, _day(calibration))


def _table(table: TableModel, source: str, day: str) -> Iterator[InputQuantity]:
    arcsec = unit("arcsec").factor
    for name, width in (("position", table.position_uncertainty), ("orthogonality", table.orthogonality)):
        yield InputQuantity(
            f"table {name}", 0.0, "rad", width, source=source, calibrated=day, shown="arcsec", shown_factor=arcsec
        )
    yield InputQuantity(
        "table rate", 0.0, "1", table.rate_stability, source=source, calibrated=day, shown="ppm", shown_factor=1e-6
    )


def _chamber(chamber: ChamberModel, source: str, day: str) -> Iterator[InputQuantity]:
    """Yields the uncertainty of the temperature in the chamber. The uncertainty combines the tolerance, within which the
    temperature of the air can have any value, and the declared uncertainty of the air temperature."""
    width = math.hypot(chamber.tolerance / math.sqrt(3), chamber.temperature_uncertainty)
    shape = "normal" if chamber.temperature_uncertainty else "rectangular"
    yield InputQuantity("temperature", 0.0, "K", width, distribution=shape, source=source, calibrated=day)


def _outputs(sensor: SensorModel, source: str, day: str) -> Iterator[InputQuantity]:
    """Yields the uncertainties of the outputs, in the unit of the output. The uncertainty of the resolution is that of a
    rectangular distribution of half a count on either side (JCGM 100:2008, F.2.2.1). The uncertainty of flicker is the coefficient
    of the bias instability."""
    for output in sensor.outputs:
        yield InputQuantity(
            Aspect.BIAS_INSTABILITY.of(output.name),
            0.0,
            output.unit,
            output.noise.bias_instability,
            source=source,
            calibrated=day,
        )
        yield InputQuantity(
            Aspect.RESOLUTION.of(output.name),
            0.0,
            output.unit,
            output.noise.resolution / math.sqrt(12),
            distribution="rectangular",
            source=source,
            calibrated=day,
        )


def _source(name: str, entry: InstrumentEntry) -> str:
    parts = [f"bench '{name}'"]
    parts += [f"asset {entry.asset}"] if entry.asset else []
    parts += [entry.calibration.words] if entry.calibration else []
    return ", ".join(parts)


def _day(calibration: Calibration | None) -> str:
    return calibration.date if calibration else ""
