"""The virtual carrier: moves the whole bench over the Earth, like a ship or vehicle. The carrier changes nothing on the bench."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.parameters import QuantityLike
from planrunner.instruments.virtual.track import POLAR, Track, TrackProgress
from planrunner.instruments.virtual.world import World
from planrunner.plan.kinds import Choice, QuantityOf, Record, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity

SPEED_UP = 60.0  # s
FASTEST = 1000.0  # m/s


class VirtualCarrierParameters(Record):
    """Declares the bench-file keys of a simulated carrier, which starts at the site and moves along a track at a given speed, at
    the height of the site."""

    speed: Quantity = key(
        QuantityLike("m/s", "not negative"),
        "Speed along the track, or amplitude of a sinusoidal velocity; zero means at rest, as without a carrier.",
        "10 m/s",
    )
    heading: Quantity = key(
        QuantityOf("angle"),
        "Heading at the start, clockwise from true north.",
        "45 deg",
        default=parse_quantity("0 deg"),
    )
    track: str = key(
        Choice(("constant-heading", "great-circle")),
        "What stays constant along the track: the heading (rhumb line), or the direction (great circle).",
        "great-circle",
        default="constant-heading",
    )
    period: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Period of a sinusoidal velocity back and forth; by default the speed is constant.",
        "120 s",
    )
    start: Quantity = key(
        QuantityOf("time", "not negative"),
        "Time after the beginning of the run at which the carrier starts to move.",
        "20 min",
        default=parse_quantity("0 s"),
    )
    speed_up: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Time in which the carrier reaches its constant speed, at constant acceleration; by default 1 min.",
        "1 min",
    )
    bench: str = key(
        Choice(("north-aligned", "heading-aligned")),
        "Whether the bench stays aligned with north or turns with the heading; if it turns, the directions in a "
        "plan refer to the bench.",
        "heading-aligned",
        default="north-aligned",
    )


class VirtualCarrier:
    """A simulated carrier under the virtual bench."""

    role = "carrier"
    Parameters = VirtualCarrierParameters

    def __init__(self, world: World):
        self.world = world

    @classmethod
    def connect(cls, parameters: VirtualCarrierParameters, surroundings: Surroundings) -> VirtualCarrier:
        p = parameters
        world = World.of(surroundings)
        if world.track is not None:
            raise InstrumentError("the bench already has another carrier: keep one of them")
        if p.period is not None and p.speed_up is not None:
            raise InstrumentError("a sinusoidal velocity has no time to speed up: remove period or speed_up")
        if p.speed.value > FASTEST:
            raise InstrumentError(
                f"{p.speed} is not a possible speed of a carrier: at most {FASTEST:g} m/s are allowed"
            )
        site = world.site.on_ellipsoid
        if abs(site.latitude) > POLAR:
            limit = f"{math.degrees(POLAR):g} deg"
            raise InstrumentError(f"a carrier cannot start beyond {limit} of latitude, where north turns too fast")
        if p.speed.value > 0:
            speed_up = SPEED_UP if p.speed_up is None else p.speed_up.value
            period = None if p.period is None else p.period.value
            progress = TrackProgress(p.speed.value, p.start.value, speed_up, period)
            great_circle, aligned = p.track == "great-circle", p.bench == "heading-aligned"
            world.track = Track(
                site.latitude, site.longitude, site.height, p.heading.value, progress, great_circle, aligned
            )
        return cls(world)

    def read(self) -> Mapping[str, float]:
        """Returns the true present position and velocity."""
        latitude, longitude, height, east, north = (
            float(np.ravel(value)[0]) for value in self.world.position(np.array([self.world.now()]))
        )
        return {
            "latitude_deg": math.degrees(latitude),
            "longitude_deg": math.degrees(longitude),
            "height_m": height,
            "velocity_east_m/s": east,
            "velocity_north_m/s": north,
        }

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": "virtual carrier"}

    def make_safe(self) -> None:
        """Does nothing, because a simulated carrier is always safe."""

    def close(self) -> None:
        """Does nothing, because there are no open resources."""
