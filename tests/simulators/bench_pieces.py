"""Live worlds for tests: a virtual table and chamber on a clock that the test moves."""

from __future__ import annotations

from planrunner.instruments.interfaces import Surroundings
from planrunner.instruments.table_keys import AxisSpec
from planrunner.instruments.virtual.chamber import VirtualChamber, VirtualChamberParameters
from planrunner.instruments.virtual.table import VirtualTable, VirtualTableParameters
from planrunner.instruments.virtual.world import World
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity
from planrunner.simulators.live_world import LiveWorld

SITE = Site(0.698, 9.80154)


class SteppedClock:
    """Time that somebody moves by hand, in place of a running clock."""

    speed = 1.0

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


def axis(name: str, direction: str, rate: float, acceleration: float, **limits: str) -> AxisSpec:
    return AxisSpec(
        name=name,
        direction=direction,
        max_rate=parse_quantity(f"{rate:.17g} deg/s"),
        max_acceleration=parse_quantity(f"{acceleration:.17g} deg/s^2"),
        **{key: parse_quantity(value) for key, value in limits.items()},
    )


def live_world() -> LiveWorld:
    clock = SteppedClock()
    return LiveWorld(World(clock, SITE, 1), clock)


def clock_of(live: LiveWorld) -> SteppedClock:
    """The clock that `live_world` gave it."""
    assert isinstance(live.clock, SteppedClock)
    return live.clock


def with_table(*axes: AxisSpec) -> LiveWorld:
    live = live_world()
    surroundings = Surroundings(live.clock, SITE, world=live.world)
    live.table = VirtualTable.connect(VirtualTableParameters(axes=axes), surroundings)
    return live


def with_chamber(lowest: float, highest: float, ramp: float, ambient: float = 25.0) -> LiveWorld:
    live = live_world()
    surroundings = Surroundings(live.clock, SITE, world=live.world)
    parameters = VirtualChamberParameters(
        lowest=parse_quantity(f"{lowest} degC"),
        highest=parse_quantity(f"{highest} degC"),
        ramp=parse_quantity(f"{ramp} K/min"),
        ambient=parse_quantity(f"{ambient} degC"),
    )
    live.chamber = VirtualChamber.connect(parameters, surroundings)
    return live
