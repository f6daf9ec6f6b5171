"""An ideal virtual sensor, navigated by somebody else: the python-ins package must find the carrier where the reference says that it is.

The sensor turns on its table meanwhile, so that Earth rate, transport rate, Coriolis forces and increments during ramps all count. The
package takes Coriolis forces at the beginning of a step and increments as linear within two, so that its error is of first and second
order in the sampling interval h; from three intervals both are cancelled, e₀ = (e(4h) − 6·e(2h) + 8·e(h))/3.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from inertial_bench import DEG, LEVEL, TRIAD, InertialBench

from planrunner.plan.schedule import Cycle, Move, Rest

pytest.importorskip("pyins")
CYCLE = Cycle({"A": 0.0, "B": math.pi}, (Move("A", math.pi, "B"), Move("B", -math.pi, "A")), 20 * DEG, 31.7)


def missed_by(carrier, motion, rate):
    """North, east, up [m] and velocities north, east, down [m/s] that python-ins is off by after 180 s."""
    from pandas import DataFrame, Series
    from pyins import earth, strapdown

    bench = InertialBench(TRIAD + "reference: true", latitude=48.0, carrier=carrier, rate=rate)
    world = bench.world
    # The package's constants; at the ellipsoid, because it has gravity fall linearly with height.
    world.site = replace(world.site, earth_rate=earth.RATE, height=0.0, gravity=float(earth.gravity(48.0, 0.0)))
    if world.track is not None:
        world.track = replace(world.track, height=0.0)
    bench.orient(LEVEL)
    bench.move(motion)
    data = bench.record(180.0, motion=motion)
    # Forward, right and down of the package are y, x and −z here. It begins after the first sample.
    increments = {
        f"{kind}_{theirs}": sign * data[f"{kind}_{ours}"] / rate * (DEG if kind == "gyro" else 1.0)
        for kind in ("gyro", "accel")
        for theirs, ours, sign in (("x", "y", 1), ("y", "x", 1), ("z", "z", -1))
    }
    imu = DataFrame(increments, index=data["time"])
    true = {name: data[f"reference_{name}"] for name in ("latitude", "longitude", "velocity_north", "velocity_east")}
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    lat, lon, north, east = (values[0] for values in true.values())
    start = Series([lat, lon, 0.0, north, east, 0.0, 0.0, 0.0, 0.0], index=names, name=data["time"][0])
    end = strapdown.Integrator(start).integrate(strapdown.compute_increments_from_imu(imu, "increment")).iloc[-1]
    lat, lon, north, east = (values[-1] for values in true.values())
    metres = [(end.lat - lat) * DEG * 6.38e6, (end.lon - lon) * DEG * 6.39e6 * math.cos(lat * DEG), end.alt]
    return np.array([*metres, end.VN - north, end.VE - east, end.VD])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("carrier", "motion"),
    [
        (None, CYCLE),
        ("{speed: 30 m/s, heading: 60 deg, speed_up: 45 s}", CYCLE),
        ("{speed: 8 m/s, heading: -150 deg, period: 40 s}", CYCLE),
        ("{speed: 200 m/s, heading: 100 deg, track: great-circle}", Rest()),
    ],
)
def test_python_ins_finds_the_carrier_where_it_is(carrier, motion):
    coarse, middle, fine = (missed_by(carrier, motion, rate) for rate in (200, 400, 800))
    assert np.abs(fine[:3]).max() < 0.01
    left = (coarse - 6 * middle + 8 * fine) / 3
    assert left[:3] == pytest.approx(np.zeros(3), abs=5e-5)
    assert left[3:] == pytest.approx(np.zeros(3), abs=3e-7)
