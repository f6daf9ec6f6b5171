"""An ideal virtual sensor on a moving carrier, navigated here: simulator and navigator share no formula, and must agree on where it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from inertial_bench import DEG, LEVEL, TRIAD, InertialBench

from planrunner.navigation.mechanisation import Navigator
from planrunner.navigation.wgs84 import normal_gravity, separation
from planrunner.plan.schedule import Cycle, Move, Rest

CYCLE = Cycle({"A": 0.0, "B": math.pi}, (Move("A", math.pi, "B"), Move("B", -math.pi, "A")), 20 * DEG, 31.7)


@pytest.mark.parametrize(
    ("carrier", "motion", "rate"),
    [
        (None, CYCLE, 100),
        ("{speed: 10 m/s, heading: 60 deg, speed_up: 45 s}", CYCLE, 100),
        ("{speed: 8 m/s, heading: -150 deg, period: 40 s}", CYCLE, 100),
        ("{speed: 250 m/s, heading: 100 deg, track: great-circle}", Rest(), 50),
    ],
    ids=["turning", "under way and turning", "forth and back", "great circle"],
)
def test_an_ideal_sensor_is_found_where_it_is(carrier: str | None, motion: object, rate: int) -> None:
    """Over ten minutes, position to 0.1 mm and velocity to 1 µm/s, horizontally and, with the free vertical channel, in height."""
    bench = InertialBench(TRIAD + "reference: true", latitude=48.0, carrier=carrier, rate=rate)
    bench.orient(LEVEL)
    bench.move(motion, 700.0)
    data = bench.record(600.0, motion=motion)
    values = np.array([data[f"{kind}_{axis}"] for kind in ("gyro", "accel") for axis in "xyz"])
    values *= np.array([DEG] * 3 + [1.0] * 3)[:, None] / rate
    latitude, longitude = data["reference_latitude"] * DEG, data["reference_longitude"] * DEG
    site = bench.world.site
    # Gravity of the bench at rest is the site's own; on a carrier it is normal gravity.
    factor = 1.0 if carrier else site.gravity / float(normal_gravity(site.latitude, site.height))
    velocity = np.array([data["reference_velocity_east"][0], data["reference_velocity_north"][0], 0.0])
    unit = Navigator(
        np.array([1.0, 0, 0, 0]),
        velocity,
        (latitude[0], longitude[0], site.height),
        vertical="free",
        gravity_factor=factor,
        earth_rate=site.earth_rate,
        last=values[:, 0],
        every=10**9,
    )
    unit.advance(values[:, 1:], np.diff(data["time"]))
    east, north = separation(latitude[-1], longitude[-1], *unit.position[:2])
    assert math.hypot(float(east), float(north)) < 1e-4
    assert abs(unit.position[2] - site.height) < 1e-4
    assert abs(unit.velocity[0] - data["reference_velocity_east"][-1]) < 1e-6
    assert abs(unit.velocity[1] - data["reference_velocity_north"][-1]) < 1e-6
