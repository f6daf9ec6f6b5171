"""What the results of a bench are traceable through: its instruments and its site, with their calibrations."""

from __future__ import annotations

from planrunner.base.dataclass import dataclass
from planrunner.bench.calibration import Calibration
from planrunner.bench.model import Bench, driver_of


@dataclass(frozen=True, slots=True)
class Reference:
    """An instrument of the bench, or its site, and the calibration that stands behind it, if one is stated."""

    name: str
    role: str
    asset: str = ""
    calibration: Calibration | None = None


def references(bench: Bench) -> tuple[Reference, ...]:
    """Site and instruments in the file's order, without the sensor, which is what is calibrated."""
    instruments = [
        Reference(name, driver_of(entry).role, entry.asset or "", entry.calibration)
        for name, entry in bench.instruments.items()
        if driver_of(entry).role != "sensor"
    ]
    return (Reference("site", "site", "", bench.site.survey), *instruments)
