"""Astronomic and geodetic latitude: which one the Earth's rate and which one positions are taken from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import models, parse_bench, site_of
from planrunner.instruments.interfaces import Surroundings
from planrunner.instruments.virtual.carrier import VirtualCarrier, VirtualCarrierParameters
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.uncertainty.stated_inputs import check_vertical, stated_inputs

ARCSEC = math.radians(1 / 3600)
BENCH = """planrunner_bench: 1
name: played
clock: virtual
site: {{{site}, gravity: 9.80665 m/s^2}}
instruments:
  imu:
    driver: recording
    file: r.csv
    kind: imu
    time: {{column: t, unit: s}}
    sample_rate: 100 Hz
    channels: {{gx: {{column: gx, unit: deg/s}}}}
"""
DEVIATION = "deviation_of_vertical: {north: 20 arcsec ± 3 arcsec, east: -8 arcsec}"


def bench(site: str):
    made, log = parse_bench(source.parse(BENCH.format(site=site), "bench.yaml"))
    assert made is not None, list(log)
    return made


def test_the_earths_rate_follows_the_plumb_line_and_positions_the_ellipsoid() -> None:
    """By hand: Φ = φ + ξ; a level gyro along up sees Ω·sin Φ."""
    stated = bench(f"latitude: 45 deg ± 4 arcsec, latitude_kind: geodetic, {DEVIATION}")
    site = site_of(stated)
    up = math.radians(15.041067) / 3600 * math.sin(math.radians(45) + 20 * ARCSEC)
    assert site.earth_rate_enu[2] == pytest.approx(up, rel=1e-12)
    assert site.on_ellipsoid.latitude == pytest.approx(math.radians(45), rel=1e-15)
    latitude = stated_inputs(stated, models(stated), {}).get("latitude")
    assert latitude is not None
    assert latitude.standard_uncertainty == pytest.approx(5 * ARCSEC)
    assert latitude.value == pytest.approx(site.latitude)


def test_an_astronomic_latitude_is_the_earths_rates_own() -> None:
    site = site_of(bench(f"latitude: 45 deg, latitude_kind: astronomic, {DEVIATION}"))
    assert site.latitude == pytest.approx(math.radians(45), rel=1e-15)
    assert site.on_ellipsoid.latitude == pytest.approx(math.radians(45) - 20 * ARCSEC, rel=1e-12)
    alone = site_of(bench("latitude: 45 deg"))
    assert np.array_equal(alone.earth_rate_enu, alone.on_ellipsoid.earth_rate_enu)


@pytest.mark.parametrize(
    ("site", "warned"),
    [
        ("latitude: 45 deg ± 1 arcsec", True),
        ("latitude: 45 deg ± 10 arcsec", False),
        ("latitude: 45 deg", False),
        ("latitude: 45 deg ± 1 arcsec, latitude_kind: astronomic", False),
        (f"latitude: 45 deg ± 1 arcsec, {DEVIATION}", False),
    ],
)
def test_a_close_latitude_says_which_it_is(site: str, warned: bool) -> None:
    log, made = Findings(), bench(site)
    check_vertical(made, models(made), log)
    assert [finding.code for finding in log] == (["bench-vertical"] if warned else [])


@pytest.mark.parametrize("speed", ["0 m/s", "5 m/s"])
def test_a_simulated_carrier_starts_at_the_latitude_of_the_ellipsoid(speed: str) -> None:
    """Navigation compares with it, and navigated positions are geodetic."""
    site = site_of(bench(f"latitude: 45 deg, latitude_kind: astronomic, {DEVIATION}"))
    surroundings = Surroundings(VirtualClock(), site)
    log = Findings()
    parameters = RecordOf(VirtualCarrierParameters).read(source.parse(f"speed: {speed}", "bench.yaml"), log)
    assert parameters is not None, list(log)
    carrier = VirtualCarrier.connect(parameters, surroundings)
    assert carrier.read()["latitude_deg"] == pytest.approx(45 - 20 / 3600, abs=1e-9)
