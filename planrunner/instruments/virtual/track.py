"""Computes the position and motion of a simulated carrier along its track on the Earth, and the inertial rate and specific force of
a level bench on the carrier.

The carrier does not change its height. There are two kinds of tracks, and both are computed exactly. A track of the first kind is a
line of constant heading on the ellipsoid, and its length is measured along the ellipsoid. On a track of the second kind, the normal
of the ellipsoid moves along a great circle, and the length is measured on a sphere with the Earth's mean radius. Velocity,
acceleration, Earth rate and transport rate are computed from latitude and longitude by differentiation with respect to time, in
closed form.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.virtual import ellipsoid
from planrunner.instruments.virtual.courses import Stretch, Value

Vector = tuple[Array, Array, Array]
POLAR = math.radians(85)
_ALONG_PARALLEL = 1e-12  # cosine of a heading below which the track keeps its latitude


@dataclass(frozen=True, slots=True)
class TrackProgress:
    """The distance that a carrier has covered along its track. The carrier starts at the time `start` [s] and, with constant
    acceleration, reaches `speed` [m/s] within `speed_up` [s]. If `period` [s] is given, the velocity is speed·sin(2π·t/period)
    instead, where t counts from the start."""

    speed: float
    start: float = 0.0
    speed_up: float = 60.0
    period: float | None = None

    def follow(self, times: Array) -> tuple[Array, Array, Array]:
        """Returns the distance [m], the velocity [m/s] and the acceleration [m/s^2] along the track at `times` (n,), s, as three
        arrays (n,)."""
        elapsed = np.maximum(times - self.start, 0.0)
        if self.period is not None:
            circular = 2 * math.pi / self.period
            sine, cosine = np.sin(circular * elapsed), np.cos(circular * elapsed)
            acceleration = np.where(times < self.start, 0.0, self.speed * circular * cosine)
            # 1 − cos x = 2·sin²(x/2) without cancellation
            return 2 * self.speed / circular * np.sin(circular * elapsed / 2) ** 2, self.speed * sine, acceleration
        gain = self.speed / self.speed_up
        rising = np.minimum(elapsed, self.speed_up)
        distance = 0.5 * gain * rising**2 + self.speed * (elapsed - rising)
        acceleration = np.where((times >= self.start) & (elapsed < self.speed_up), gain, 0.0)
        return distance, gain * rising, acceleration

    @property
    def breaks(self) -> tuple[float, ...]:
        """Returns the times [s] at which the acceleration jumps."""
        return (self.start,) if self.period is not None else (self.start, self.start + self.speed_up)


@dataclass(frozen=True, slots=True)
class CarrierPlace:
    """Contains the position of the carrier: latitude and longitude [rad] with their first and second time derivatives, and the
    heading of the bench [rad, clockwise from north] with its first time derivative."""

    latitude: Array
    longitude: Array
    latitude_rate: Array
    longitude_rate: Array
    latitude_acceleration: Array
    longitude_acceleration: Array
    heading: Value
    heading_rate: Value


@dataclass(frozen=True, slots=True)
class Track:
    """A track over the Earth.

    `latitude`, `longitude`, `heading`: values at the start, rad. `height`: height of the carrier above the ellipsoid, m. `aligned`:
    True if the bench turns with the heading.
    """

    latitude: float
    longitude: float
    height: float
    heading: float
    progress: TrackProgress
    great_circle: bool = False
    aligned: bool = False

    @property
    def pace(self) -> float:
        """Returns an upper limit of the angular frequencies [rad/s] at which the motion of the carrier changes the stimulus."""
        turning = 2 * math.pi / self.progress.period if self.progress.period is not None else 0.0
        return turning + 2 * self.progress.speed / (ellipsoid.MEAN_RADIUS * math.cos(POLAR))

    def stretches(self, stretch: Stretch) -> list[Stretch]:
        """Divides an interval of smooth motion of the table at the times when the acceleration of the carrier jumps."""
        times = [stretch.begin, *(t for t in self.progress.breaks if stretch.begin < t < stretch.end), stretch.end]
        return [Stretch(first, last, stretch.pace + self.pace) for first, last in pairwise(times)]

    def place(self, times: Array) -> CarrierPlace:
        """Returns the position of the carrier at `times` [s]. Raises `InstrumentError` if the carrier comes near a pole."""
        place = self._on_great_circle(times) if self.great_circle else self._on_rhumb_line(times)
        if float(np.max(np.abs(place.latitude))) > POLAR:
            limit = f"{math.degrees(POLAR):g} deg"
            raise InstrumentError(
                f"the carrier has passed the latitude of {limit}: shorten the run or change its heading"
            )
        return place

    def velocity(self, place: CarrierPlace) -> tuple[Array, Array]:
        """Returns the velocities of the carrier to the east and to the north [m/s]."""
        meridian, parallel = self._radii(place.latitude)
        return place.longitude_rate * parallel, place.latitude_rate * meridian

    def felt(self, times: Array, earth_rate: float) -> tuple[Vector, Vector]:
        """Returns the inertial rate [rad/s] and the specific force [m/s^2] of the bench. The components refer to the bench's own
        East-North-Up axes, whose north is the heading of the bench.

        In true East-North-Up axes, f = v̇ + (2·Ω + ω_en) × v − g. `times`: array of shape (n,), s. `earth_rate`: rotation rate of
        the Earth, rad/s.
        """
        place = self.place(times)
        sine, cosine = np.sin(place.latitude), np.cos(place.latitude)
        meridian, parallel = self._radii(place.latitude)
        east, north = place.longitude_rate * parallel, place.latitude_rate * meridian
        east_rate = (
            place.longitude_acceleration * parallel - place.longitude_rate * place.latitude_rate * meridian * sine
        )
        north_rate = place.latitude_acceleration * meridian + place.latitude_rate**2 * ellipsoid.meridian_radius_slope(
            place.latitude
        )
        twice = 2 * earth_rate + place.longitude_rate
        force = (
            east_rate - twice * sine * north,
            north_rate + twice * sine * east,
            ellipsoid.normal_gravity(place.latitude, self.height) - place.latitude_rate * north - twice * cosine * east,
        )
        turning = earth_rate + place.longitude_rate
        rate = (-place.latitude_rate, turning * cosine, turning * sine - place.heading_rate)
        return _in_bench(rate, place.heading), _in_bench(force, place.heading)

    def _radii(self, latitude: Array) -> tuple[Array, Array]:
        """Returns the lengths [m] of one radian of latitude and of one radian of longitude at the height of the carrier."""
        meridian: Array = ellipsoid.meridian_radius(latitude) + self.height
        parallel: Array = (ellipsoid.normal_radius(latitude) + self.height) * np.cos(latitude)
        return meridian, parallel

    def _on_rhumb_line(self, times: Array) -> CarrierPlace:
        distance, speed, acceleration = self.progress.follow(times)
        along, across = math.cos(self.heading), math.sin(self.heading)
        if abs(along) < _ALONG_PARALLEL:
            latitude = np.full(times.shape, self.latitude)
            parallel = ellipsoid.normal_radius(self.latitude) * math.cos(self.latitude)
            longitude, zero = self.longitude + distance * across / parallel, np.zeros(times.shape)
            rates = (zero, speed * across / parallel, zero, acceleration * across / parallel)
        else:
            latitude = ellipsoid.latitude_at_arc(ellipsoid.meridian_arc(self.latitude) + distance * along)
            gained = ellipsoid.isometric_latitude(latitude) - ellipsoid.isometric_latitude(self.latitude)
            longitude = self.longitude + across / along * gained
            rates = _rhumb_rates(latitude, speed, acceleration, along, across)
        return CarrierPlace(latitude, longitude, *rates, self.heading if self.aligned else 0.0, 0.0)

    def _on_great_circle(self, times: Array) -> CarrierPlace:
        """Returns the position of the carrier on a great circle. If the normal is n = n₀·cos σ + d₀·sin σ, then sin φ = n_z, and
        for a given σ̇, cos²φ·λ̇ = (n × ṅ)_z is the same at every position."""
        distance, speed, acceleration = (item / ellipsoid.MEAN_RADIUS for item in self.progress.follow(times))
        normal, forward = self._great_circle_axes()
        cosine, sine = np.cos(distance), np.sin(distance)
        x, y, z = (n * cosine + d * sine for n, d in zip(normal, forward, strict=True))
        climbing = forward[2] * cosine - normal[2] * sine  # dn_z/dσ
        level = np.hypot(x, y)
        latitude = np.arctan2(z, level)
        momentum = normal[0] * forward[1] - normal[1] * forward[0]
        latitude_rate, longitude_rate = climbing * speed / level, momentum * speed / level**2
        lifted = climbing * acceleration - z * speed**2
        latitude_acceleration = (lifted + z * latitude_rate**2) / level
        longitude_acceleration = momentum * acceleration / level**2 + 2 * z / level * latitude_rate * longitude_rate
        heading, heading_rate = (np.arctan2(momentum, climbing), longitude_rate * z) if self.aligned else (0.0, 0.0)
        return CarrierPlace(
            latitude,
            self.longitude + np.arctan2(y, x),
            latitude_rate,
            longitude_rate,
            latitude_acceleration,
            longitude_acceleration,
            heading,
            heading_rate,
        )

    def _great_circle_axes(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Returns the ellipsoid's normal n₀ at the start and the direction d₀ in which this normal moves; longitudes are measured
        from the start."""
        sine, cosine = math.sin(self.latitude), math.cos(self.latitude)
        north, east = math.cos(self.heading), math.sin(self.heading)
        return (cosine, 0.0, sine), (-sine * north, east, cosine * north)


def _rhumb_rates(
    latitude: Array, speed: Array, acceleration: Array, along: float, across: float
) -> tuple[Array, Array, Array, Array]:
    """Returns the first and second time derivatives of latitude and longitude on a line of constant heading, as four arrays (n,).
    `latitude`, `speed`, `acceleration`: arrays of shape (n,) in rad, m/s and m/s². `along`: cosine of the heading. `across`: sine
    of the heading."""
    meridian = ellipsoid.meridian_radius(latitude)
    parallel = ellipsoid.normal_radius(latitude) * np.cos(latitude)
    north, east = speed * along, speed * across
    latitude_rate, longitude_rate = north / meridian, east / parallel
    latitude_acceleration = (
        acceleration * along - ellipsoid.meridian_radius_slope(latitude) * latitude_rate**2
    ) / meridian
    # d(N·cos φ)/dφ = −M·sin φ
    longitude_acceleration = acceleration * across / parallel + longitude_rate * north * np.sin(latitude) / parallel
    return latitude_rate, longitude_rate, latitude_acceleration, longitude_acceleration


def _in_bench(v: Vector, heading: Value) -> Vector:
    """Returns the components of a vector in axes that are rotated clockwise by `heading` about the vertical."""
    if isinstance(heading, float) and heading == 0.0:
        return v
    cosine, sine = np.cos(heading), np.sin(heading)
    return cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], v[2]
