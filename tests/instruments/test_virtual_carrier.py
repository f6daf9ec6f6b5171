"""The carrier's specific force and angular rate against numerical derivatives of its Earth-fixed trajectory, worked in extended precision.

The trajectories are written here once more, from the definitions: the meridian's arc by quadrature and root finding, the great circle by
rotating the ellipsoid's normal, positions in Earth-fixed coordinates; everything else by differences of eighth order in 80-bit numbers.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.instruments.interfaces import InstrumentError, Surroundings
from planrunner.instruments.virtual import ellipsoid
from planrunner.instruments.virtual.carrier import VirtualCarrier, VirtualCarrierParameters
from planrunner.instruments.virtual.track import Track, TrackProgress
from planrunner.instruments.virtual.world import World
from planrunner.physics.earth import EARTH_RATE, Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf

LONG = np.longdouble
pytestmark = pytest.mark.skipif(bool(np.finfo(LONG).eps > 1e-18), reason="needs 80-bit numbers")
A = LONG(6378137)
FLATTENING = 1 / LONG("298.257223563")
B = A * (1 - FLATTENING)
E2 = 1 - (B / A) ** 2
GRAVITY_EQUATOR, GRAVITY_POLE = LONG("9.7803253359"), LONG("9.8321849378")
PI = LONG("3.14159265358979323846264338327950288")
OMEGA = LONG(EARTH_RATE)
DEG = math.pi / 180
LATITUDE, LONGITUDE, HEIGHT = 45.78 * DEG, 126.67 * DEG, 150.0
STEP = 1.0  # s
OFFSETS = np.arange(-4, 5)
FIRST = np.array(
    [
        LONG(1) / 280,
        -LONG(4) / 105,
        LONG(1) / 5,
        -LONG(4) / 5,
        0,
        LONG(4) / 5,
        -LONG(1) / 5,
        LONG(4) / 105,
        -LONG(1) / 280,
    ]
)
HALF = [-LONG(1) / 560, LONG(8) / 315, -LONG(1) / 5, LONG(8) / 5]
SECOND = np.array([*HALF, -LONG(205) / 72, *HALF[::-1]])


def distance(progress, t):
    t = t - LONG(progress.start)
    if progress.period is not None:
        w = 2 * PI / LONG(progress.period)
        return progress.speed / w * (1 - np.cos(w * t))
    up = LONG(progress.speed_up)
    return np.where(t < up, progress.speed / up * t * t / 2, progress.speed * (t - up / 2))


def meridian(x):
    return A * (1 - E2) / (1 - E2 * np.sin(x) ** 2) ** LONG(1.5)


def over_latitudes(integrand, end):
    """The integral from the start's latitude, by Gauss-Legendre with 30 points."""
    points, weights = np.polynomial.legendre.leggauss(30)
    half = (end - LONG(LATITUDE)) / 2
    return (
        sum(LONG(w) * integrand(LONG(LATITUDE) + half * (1 + LONG(p))) for p, w in zip(points, weights, strict=True))
        * half
    )


def on_rhumb_line(heading, s):
    along, across = np.cos(LONG(heading)), np.sin(LONG(heading))
    latitude = LONG(LATITUDE) + s * along / meridian(LONG(LATITUDE))
    for _ in range(12):
        latitude = latitude - (over_latitudes(meridian, latitude) - s * along) / meridian(latitude)

    def stretched(x):
        return meridian(x) * np.sqrt(1 - E2 * np.sin(x) ** 2) / (A * np.cos(x))

    return latitude, LONG(LONGITUDE) + over_latitudes(stretched, latitude) * across / along


def on_great_circle(heading, s):
    angle = s / LONG("6371008.7714")
    east, north, up = axes(LONG(LATITUDE), LONG(LONGITUDE)).T
    forward = north * np.cos(LONG(heading)) + east * np.sin(LONG(heading))
    n = np.cos(angle)[:, None] * up + np.sin(angle)[:, None] * forward
    return np.arctan2(n[:, 2], np.hypot(n[:, 0], n[:, 1])), np.arctan2(n[:, 1], n[:, 0])


def axes(lat, lon):
    """East, north and up as columns, in Earth-fixed coordinates; shape (…, 3, 3)."""
    zero = np.zeros_like(lat)
    east = np.stack([-np.sin(lon), np.cos(lon), zero], axis=-1)
    north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    return np.stack([east, north, up], axis=-1)


def positions(lat, lon):
    n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    level = (n + LONG(HEIGHT)) * np.cos(lat)
    return np.stack([level * np.cos(lon), level * np.sin(lon), (n * (1 - E2) + LONG(HEIGHT)) * np.sin(lat)], axis=-1)


def upward_gravity(lat):
    """Somigliana's formula in its closed form, and the upward continuation of TR8350.2."""
    sine2, cosine2 = np.sin(lat) ** 2, np.cos(lat) ** 2
    surface = (A * GRAVITY_EQUATOR * cosine2 + B * GRAVITY_POLE * sine2) / np.sqrt(A**2 * cosine2 + B**2 * sine2)
    m, h = LONG("0.00344978650684"), LONG(HEIGHT)
    return surface * (1 - 2 / A * (1 + FLATTENING + m - 2 * FLATTENING * sine2) * h + 3 / A**2 * h**2)


def by_differences(track, t):
    """Latitude, longitude, velocity, rate and force in true East-North-Up at `t`."""
    times = LONG(t) + STEP * OFFSETS
    follow = on_great_circle if track.great_circle else on_rhumb_line
    lat, lon = follow(track.heading, distance(track.progress, times))
    fixed = axes(lat, lon)
    here = positions(lat, lon)
    velocity = FIRST @ here / STEP
    acceleration = SECOND @ here / STEP**2
    coriolis = 2 * OMEGA * np.array([-velocity[1], velocity[0], 0])
    c = fixed[4]
    force = c.T @ (acceleration + coriolis) + np.array([0, 0, upward_gravity(lat[4])])
    turned = OMEGA * (times - LONG(t))  # the sky's axes as the Earth's at t
    spin = np.zeros((9, 3, 3), dtype=LONG)
    spin[:, 0, 0] = spin[:, 1, 1] = np.cos(turned)
    spin[:, 1, 0], spin[:, 0, 1], spin[:, 2, 2] = np.sin(turned), -np.sin(turned), 1
    slope = np.einsum("k,kij->ij", FIRST, np.einsum("kij,kjl->kil", spin, fixed)) / STEP
    skew = c.T @ slope
    return lat[4], lon[4], c.T @ velocity, np.array([skew[2, 1], skew[0, 2], skew[1, 0]]), force


PROGRESS = {
    "speeding-up": (TrackProgress(15.0, 100.0, 60.0), 130.0),
    "steady": (TrackProgress(15.0, 100.0, 60.0), 90_000.0),
    "sinusoidal": (TrackProgress(8.0, 0.0, 60.0, 240.0), 1234.5),
}
CASES = [
    (name, heading, great_circle)
    for name in PROGRESS
    for heading in (0.0, 60.0, -120.0, 179.0)
    for great_circle in (False, True)
]


@pytest.mark.parametrize(("progress", "heading", "great_circle"), CASES)
def test_what_a_bench_feels_follows_from_its_positions(progress, heading, great_circle):
    law, t = PROGRESS[progress]
    track = Track(LATITUDE, LONGITUDE, HEIGHT, heading * DEG, law, great_circle)
    lat, lon, velocity, rate, force = by_differences(track, t)
    times = np.array([t])
    place = track.place(times)
    assert float(place.latitude[0] - lat) == pytest.approx(0, abs=2e-13)  # 1 µm
    assert float(place.longitude[0] - lon) == pytest.approx(0, abs=4e-13)
    assert np.ravel(track.velocity(place)) == pytest.approx(velocity[:2].astype(float), abs=1e-10)
    found_rate, found_force = track.felt(times, EARTH_RATE)
    # 1e-16 rad/s is 2e-11 deg/h; the second difference of a position of 6e6 m in 80-bit numbers is good to some 1e-12 m/s².
    assert np.ravel(found_rate) == pytest.approx(rate.astype(float), abs=1e-16)
    assert np.ravel(found_force) == pytest.approx(force.astype(float), abs=2e-11)


def test_published_figures_of_the_ellipsoid():
    # NIMA TR8350.2: normal gravity at equator and pole; the quadrant of the meridian is 10 001 965.7293 m.
    assert ellipsoid.normal_gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-12)
    assert ellipsoid.normal_gravity(math.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-12)
    assert ellipsoid.meridian_arc(math.pi / 2) == pytest.approx(10_001_965.7293, abs=1e-4)
    # Hinze et al., Geophysics 70 (2005) J25: the free-air effect is (0.3087691 − 0.0004398·sin²φ)·h − 7.2125e-8·h² mGal,
    # in which what depends on latitude is rounded to some 0.007 mGal a kilometre.
    fall = ellipsoid.normal_gravity(math.pi / 4, 0.0) - ellipsoid.normal_gravity(math.pi / 4, 1000.0)
    assert fall == pytest.approx((308.7691 - 0.2199 - 0.072125) * 1e-5, abs=7e-8)
    for latitude in np.linspace(-1.4, 1.4, 15):
        assert ellipsoid.latitude_at_arc(ellipsoid.meridian_arc(latitude)) == pytest.approx(latitude, abs=5e-13)


def test_a_heading_aligned_bench_feels_the_same_in_turned_axes():
    # On a great circle the bench keeps its direction, so that it does not turn about up relative to the Earth.
    law = TrackProgress(200.0, 0.0, 60.0)
    plain = Track(LATITUDE, LONGITUDE, HEIGHT, 60 * DEG, law, great_circle=True)
    turned = Track(LATITUDE, LONGITUDE, HEIGHT, 60 * DEG, law, great_circle=True, aligned=True)
    t = np.array([20_000.0])
    lat, _, velocity, _, force = by_differences(plain, t[0])
    heading = math.atan2(velocity[0], velocity[1])
    # Along the great circle of normals, not of positions: these headings differ by up to 0.2 deg.
    assert math.degrees(float(np.ravel(turned.place(t).heading)[0]) - heading) == pytest.approx(0.0, abs=0.2)
    h = float(np.ravel(turned.place(t).heading)[0])
    felt_rate, felt_force = (np.ravel(v) for v in turned.felt(t, EARTH_RATE))
    # Right is 90 deg clockwise of forward.
    assert felt_force[1] == pytest.approx(float(force[0]) * math.sin(h) + float(force[1]) * math.cos(h), abs=2e-11)
    assert felt_force[0] == pytest.approx(float(force[0]) * math.cos(h) - float(force[1]) * math.sin(h), abs=2e-11)
    # All that is left about up is the Earth's rate.
    assert felt_rate[2] == pytest.approx(EARTH_RATE * math.sin(lat), abs=1e-16)
    # Seen in the bench's axes the transport rate lies to its left: the bench pitches over, and does not roll.
    earth_right = EARTH_RATE * math.cos(lat) * -math.sin(h)
    assert felt_rate[0] == pytest.approx(earth_right - 200.0 / 6371008.7714, abs=1e-16)
    assert felt_rate[1] == pytest.approx(EARTH_RATE * math.cos(lat) * math.cos(h), abs=1e-16)


def carried(text, latitude=45.0):
    log = Findings()
    parameters = RecordOf(VirtualCarrierParameters).read(source.parse(text, "t"), log)
    assert list(log) == []
    surroundings = Surroundings(VirtualClock(), Site(latitude * DEG, 9.80154, longitude=LONGITUDE, height=50.0))
    return VirtualCarrier.connect(parameters, surroundings), World.of(surroundings)


def test_a_carrier_at_rest_leaves_the_declared_gravity():
    carrier, world = carried("speed: 0 m/s")
    assert world.stimulus(np.array([5.0]))[1][2] == 9.80154
    assert carrier.read()["latitude_deg"] == pytest.approx(45.0)


def test_what_a_carrier_reads_is_where_it_is():
    carrier, world = carried("{speed: 10 m/s, heading: 90 deg, start: 100 s, speed_up: 20 s}", latitude=0.0)
    world.clock.sleep(100.0)
    assert carrier.read()["velocity_east_m/s"] == 0.0
    world.clock.sleep(1000.0)
    # 10 m/s·(1000 − 10) s = 9900 m along the equator of 6378137 m radius, at 50 m height faster by 50/6378137.
    assert carrier.read()["longitude_deg"] == pytest.approx(126.67 + math.degrees(9900 / 6378137), abs=1e-12)
    assert carrier.read()["velocity_east_m/s"] == pytest.approx(10 * (1 + 50 / 6378137), rel=1e-12)


@pytest.mark.parametrize(
    ("text", "latitude", "words"),
    [
        ("{speed: 1 m/s, period: 10 s, speed_up: 5 s}", 45, "remove period or speed_up"),
        ("speed: 1 m/s", 89, "where north turns too fast"),
        ("speed: 1001 m/s", 45, "1001 m/s is not a possible speed of a carrier: at most 1000 m/s are allowed"),
    ],
)
def test_what_cannot_be_carried_is_said(text, latitude, words):
    with pytest.raises(InstrumentError, match=words):
        carried(text, latitude)


def test_nothing_goes_near_a_pole():
    _, world = carried("speed: 100 m/s", latitude=84.9)
    with pytest.raises(InstrumentError, match="passed the latitude of 85 deg"):
        world.stimulus(np.array([3600.0]))


def test_a_bench_has_one_carrier():
    carrier, _ = carried("speed: 1 m/s")
    surroundings = Surroundings(carrier.world.clock, carrier.world.site, world=carrier.world)
    log = Findings()
    parameters = RecordOf(VirtualCarrierParameters).read(source.parse("speed: 2 m/s", "t"), log)
    with pytest.raises(InstrumentError, match="already has another carrier"):
        VirtualCarrier.connect(parameters, surroundings)
