"""What the sensor feels: direction cosine matrices stepped in time, rates and accelerations as their differences.

Site axes East-North-Up. The matrix C takes sensor axes to site axes:
C = tilt · wobble · Rz(table angle + azimuth) · placing error · orientation. Angular rate is read off C(u − h)ᵀ·C(u + h), the acceleration
of a point off the rotation axis off three positions. Faults of the stimulus stage act here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tests.blind.plans import Axes, Axis, Segment

Array = np.ndarray

WORDS = {
    "east": (1, 0, 0), "west": (-1, 0, 0), "north": (0, 1, 0), "south": (0, -1, 0), "up": (0, 0, 1), "down": (0, 0, -1),
}  # fmt: skip
RATE_STEP = 2e-5  # s; of the difference that gives the angular rate
PLACE_STEP = 5e-4  # s; of the second difference that gives the acceleration
HEAT_STEP = 0.5  # s; of the integration of a body that follows the chamber
RAMP_TIME = 90.0  # s; time constant of the chamber
ACTS_ON_STIMULUS = {
    *(
        "table_rate_ripple",
        "ripple_three_per_turn",
        "backlash",
        "table_position_error",
        "table_azimuth",
        "table_wobble",
    ),
    *("table_tilt", "table_rate_error", "site_latitude", "lever_arm", "mount_shift"),
}


def vector(axis: Axis) -> tuple[float, float, float]:
    """East, north, up."""
    return WORDS[axis] if isinstance(axis, str) else axis


@dataclass(frozen=True)
class Site:
    """Latitude deg, gravity m/s², Earth rate deg/h and direction of the magnetic field (east, north, up)."""

    latitude: float = 39.98
    gravity: float = 9.80154
    earth_rate: float = 15.041067
    field: tuple[float, float, float] = (0.0, 0.55, -0.83)


@dataclass(frozen=True)
class Fault:
    """One effect with its numbers: `theta` scales with the amplitude, `shape` does not (time constants, harmonics, seeds)."""

    effect: str
    theta: Array
    shape: tuple[float, ...] = ()


Faults = Mapping[str, Fault]


@dataclass(frozen=True)
class Stimulus:
    """Per sample, in sensor axes: rate deg/s with and without that of the Earth, specific force in site g, field; temperature degC."""

    time: Array
    angle: Array
    rate: Array
    table_rate: Array
    force: Array
    field: Array
    temperature: Array
    temperature_rate: Array
    last_change: Array


@dataclass(frozen=True)
class Schedule:
    """A plan sampled at `sampling` Hz: per sample the segment's number and the time since it began."""

    segments: tuple[Segment, ...]
    sampling: float
    site: Site = Site()

    @cached_property
    def index(self) -> Array:
        counts = [round(s.duration * self.sampling) for s in self.segments]
        return np.repeat(np.arange(len(counts)), counts)

    @cached_property
    def local(self) -> Array:
        return np.concatenate([np.arange(round(s.duration * self.sampling)) / self.sampling for s in self.segments])

    @cached_property
    def time(self) -> Array:
        return self.each("start") + self.local

    @cached_property
    def _numbers(self) -> dict[str, Array]:
        names = ("start", "rate", "amplitude", "frequency", "chamber", "ramp")
        return {name: np.array([float(getattr(s, name)) for s in self.segments])[self.index] for name in names}

    def each(self, name: str) -> Array:
        """A number of the segments, per sample."""
        return self._numbers[name]

    @cached_property
    def nominal(self) -> Stimulus:
        """What an ideal table in an ideal place gives."""
        return _felt(self, {}, 0.0)

    @cached_property
    def turning(self) -> Array:
        return np.array([s.kind != "static" for s in self.segments])[self.index]

    @cached_property
    def places(self) -> tuple[Axes, ...]:
        return tuple(dict.fromkeys(s.axes for s in self.segments))

    @cached_property
    def before(self) -> Array:
        """Chamber setpoint before each segment, degC, per sample."""
        chamber = [s.chamber for s in self.segments]
        return np.array([25.0, *chamber[:-1]])[self.index]

    @cached_property
    def last_change(self) -> Array:
        """Sign of the last change of temperature, per sample; 0 before the first."""
        sign, found, now = 0.0, [], 25.0
        for s in self.segments:
            sign = float(np.sign(s.chamber - now)) or sign
            now = s.chamber
            found.append(sign)
        return np.array(found)[self.index]


def rotation(vector: Array) -> Array:
    """Rotation matrices of rotation vectors (rad), shape (..., 3) → (..., 3, 3), by Rodrigues' formula."""
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vector.shape[:-1], 3, 3)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (cross @ cross)


def commanded(schedule: Schedule, local: Array) -> Array:
    """Table angle that the encoder shows, rad."""
    phase = 2 * np.pi * schedule.each("frequency") * local
    return np.radians(schedule.each("rate") * local + schedule.each("amplitude") * np.sin(phase))


def _play(schedule: Schedule, local: Array, gap: float) -> Array:
    """Angle lost in a drive with a backlash of `gap` rad: half of it behind the motion, held at each reversal until it is taken up."""
    amplitude = np.radians(schedule.each("amplitude"))
    phase = np.mod(2 * np.pi * schedule.each("frequency") * local, 2 * np.pi)
    drive = amplitude * np.sin(phase)
    rising = (phase < np.pi / 2) | (phase >= 1.5 * np.pi)
    half = np.minimum(gap / 2, amplitude)
    up = np.maximum(drive - half, -amplitude + half)
    down = np.minimum(drive + half, amplitude - half)
    rocked = np.where(rising, up, down) - drive
    return np.where(amplitude > 0, rocked, -np.sign(schedule.each("rate")) * gap / 2)


def true_angle(schedule: Schedule, local: Array, faults: Faults) -> Array:
    """Where the table really points, rad."""
    angle = commanded(schedule, local)
    found = angle
    for name in ("table_rate_ripple", "ripple_three_per_turn"):
        if name in faults:
            (n,), (p, q) = faults[name].shape, faults[name].theta
            found = found + (p * np.sin(n * angle) + q * (np.cos(n * angle) - 1)) / n
    if "backlash" in faults:
        found = found + _play(schedule, local, float(faults["backlash"].theta[0]))
    return found


def attitude(schedule: Schedule, local: Array, faults: Faults) -> Array:
    """Direction cosine matrices, sensor to site, shape (n, 3, 3)."""
    placed = np.array([np.array([vector(axis) for axis in axes], float).T for axes in schedule.places])
    if "table_position_error" in faults:
        placed = rotation(faults["table_position_error"].theta.reshape(-1, 3)) @ placed
    number = [schedule.places.index(s.axes) for s in schedule.segments]
    mounted = placed[number][schedule.index]
    angle = true_angle(schedule, local, faults)
    if "table_azimuth" in faults:
        angle = angle + faults["table_azimuth"].theta[0]
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    east, north, up = mounted[:, 0], mounted[:, 1], mounted[:, 2]
    matrix = np.stack([c * east - s * north, s * east + c * north, up], axis=1)
    if "table_wobble" in faults:
        p, q = faults["table_wobble"].theta
        enc = commanded(schedule, local)
        lean = np.stack([p * np.cos(enc) - q * np.sin(enc), p * np.sin(enc) + q * np.cos(enc), 0 * enc], 1)
        matrix = rotation(lean * schedule.turning[:, None]) @ matrix
    if "mount_shift" in faults:
        slipped = schedule.time >= faults["mount_shift"].shape[0]
        matrix = np.where(slipped[:, None, None], matrix @ rotation(faults["mount_shift"].theta), matrix)
    if "table_tilt" in faults:
        matrix = rotation(np.append(faults["table_tilt"].theta, 0.0)) @ matrix
    return matrix


def _temperature(schedule: Schedule, local: Array) -> Array:
    target = schedule.each("chamber")
    left = np.where(schedule.each("ramp") > 0, np.exp(-np.maximum(local, 0.0) / RAMP_TIME), 0.0)
    return target + (schedule.before - target) * left


def behind(schedule: Schedule, lag: float) -> Array:
    """By how much a body with the time constant `lag` s is warmer than the chamber, K, per sample: Euler's rule in steps of `HEAT_STEP`.
    The chamber keeps to its exponential after the recorded part of a ramp."""
    clock = np.arange(schedule.time[0], schedule.time[-1] + 2 * HEAT_STEP, HEAT_STEP)
    chamber = np.full(len(clock), schedule.segments[0].chamber if not schedule.segments[0].ramp else 25.0)
    for earlier, now in zip(schedule.segments, schedule.segments[1:], strict=False):
        if now.ramp:
            since = clock - now.start
            course = now.chamber + (earlier.chamber - now.chamber) * np.exp(-since / RAMP_TIME)
            chamber = np.where(since >= 0, course, chamber)
    body, value = np.empty_like(clock), chamber[0]
    for place, warm in enumerate(chamber):
        body[place] = value
        value += HEAT_STEP / lag * (warm - value)
    return np.interp(schedule.time, clock, body) - np.interp(schedule.time, clock, chamber)


def _spin(early: Array, late: Array) -> Array:
    """Angular rate rad/s in sensor axes, from the matrices one step before and one step after."""
    x = np.einsum("nk,nk->n", early[:, :, 2], late[:, :, 1]) - np.einsum("nk,nk->n", early[:, :, 1], late[:, :, 2])
    y = np.einsum("nk,nk->n", early[:, :, 0], late[:, :, 2]) - np.einsum("nk,nk->n", early[:, :, 2], late[:, :, 0])
    z = np.einsum("nk,nk->n", early[:, :, 1], late[:, :, 0]) - np.einsum("nk,nk->n", early[:, :, 0], late[:, :, 1])
    return np.stack([x, y, z], 1) / (4 * RATE_STEP)


def stimulus(schedule: Schedule, faults: Faults, delay: float = 0.0) -> Stimulus:
    """What the sensor felt `delay` s before each sample was taken."""
    if not delay and not ACTS_ON_STIMULUS & faults.keys():
        return schedule.nominal
    return _felt(schedule, faults, delay)


def _felt(schedule: Schedule, faults: Faults, delay: float) -> Stimulus:
    local, site = schedule.local - delay, schedule.site
    matrix = attitude(schedule, local, faults)
    early, late = (attitude(schedule, local + step, faults) for step in (-RATE_STEP, RATE_STEP))
    table = np.degrees(_spin(early, late))
    if "table_rate_error" in faults:
        table = table * (1 + faults["table_rate_error"].theta[0])
    latitude = np.radians(site.latitude)
    if "site_latitude" in faults:
        latitude += faults["site_latitude"].theta[0]
    earth = site.earth_rate / 3600 * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    force = matrix[:, 2, :].copy()
    if "lever_arm" in faults:
        early, late = (attitude(schedule, local + step, faults) for step in (-PLACE_STEP, PLACE_STEP))
        moved = (early - 2 * matrix + late) @ faults["lever_arm"].theta / PLACE_STEP**2
        force += np.einsum("nki,nk->ni", matrix, moved) / site.gravity
    step = 0.01
    return Stimulus(
        time=schedule.time - delay,
        angle=np.degrees(commanded(schedule, schedule.local)),
        rate=table + np.einsum("nki,k->ni", matrix, earth),
        table_rate=table,
        force=force,
        field=np.einsum("nki,k->ni", matrix, np.array(site.field)),
        temperature=_temperature(schedule, local),
        temperature_rate=(_temperature(schedule, local + step) - _temperature(schedule, local)) / step,
        last_change=schedule.last_change,
    )
