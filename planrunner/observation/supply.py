"""Supply voltage and ambient pressure at each sample, from recorded channels or from the plan, relative to their reference values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.error_model.observed import STANDARD_PRESSURE, planned_excess
from planrunner.instruments.models import NOMINAL_SUPPLY
from planrunner.observation.temperature import smoothed
from planrunner.plan.units import unit


@dataclass(frozen=True, slots=True)
class Monitors:
    """Channels that show the state of the sensor besides its motion; None for a state that comes from the plan. thermometer: of the
    sensor; voltmeter: of its supply; barometer: of the ambient air. nominal_supply: V."""

    thermometer: str | None = None
    voltmeter: str | None = None
    barometer: str | None = None
    nominal_supply: float = NOMINAL_SUPPLY

    @property
    def channels(self) -> list[str]:
        return [one for one in (self.thermometer, self.voltmeter, self.barometer) if one is not None]

    def excess_of(self, item: RecordedSegment, time: Array, table: Mapping[str, Array]) -> dict[str, Array]:
        """`overvoltage` and `overpressure` of a segment at its samples (n,), smoothed where they are recorded."""
        planned = planned_excess(item.segment, self.nominal_supply)
        found = {}
        for name, channel, reference, stated in (
            ("overvoltage", self.voltmeter, self.nominal_supply, planned[0]),
            ("overpressure", self.barometer, STANDARD_PRESSURE, planned[1]),
        ):
            if channel is None:
                found[name] = np.full(len(time), stated)
            else:
                own = unit(item.units[channel])
                found[name] = smoothed(time, table[channel] * own.factor + own.offset - reference).celsius
        return found
