"""What a diagnosis looks at: samples with the state that was planned for them, in arrays over the whole run.

Everything is SI with radians, temperature apart (degC). Samples of all segments stand one after the other; `bounds` says where a segment
begins. The nominal stimulus at every sample follows from attitude, table angle and site; an Observed holds no error model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.gap.bins import SQUARED, Averaged, Bins, averaged, bins_of, sizes
from planrunner.gap.motion import fading, motion_at
from planrunner.gap.temperature import REFERENCE_TEMPERATURE, changes, settled, temperature_of
from planrunner.instruments.models import NoiseModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.findings import closest
from planrunner.plan.schedule import Motion, Rest, Rock, Spin
from planrunner.plan.units import unit

Array = NDArray[np.float64]


class ObservationError(Exception):
    """The recording cannot be diagnosed. The message says why, for a quality engineer; the hint what to do, where that is known."""

    def __init__(self, message: str, hint: str = ""):
        super().__init__(message)
        self.hint = hint


@dataclass(frozen=True, slots=True)
class Channel:
    """A measured channel. kind: 'gyro' or 'accel'; axis: index 0, 1, 2 of the sensor's axis it measures along. factor: SI value of one
    `unit`. white: one-sided declared noise, SI·√s, so that a sample at rate f has the standard deviation white·√f; flicker: declared bias
    instability, SI; resolution: one count, SI."""

    name: str
    kind: str
    axis: int
    unit: str
    factor: float
    white: float
    flicker: float = 0.0
    resolution: float = 0.0


@dataclass(frozen=True)
class Observed:
    """A recording beside its plan. S segments, N samples, K channels.

    labels, attitude (S, 3, 3; rows are the sensor's axes in East-North-Up at table angle 0), motions: of the segments. bounds: (S + 1,).
    time: (N,), s since power-on. angle: (N,), table angle, rad. rate, acceleration: (N,), of the table, rad/s and rad/s². temperature,
    temperature_rate: (N,), degC and K/s, smoothed. last_change: (S,), sign of the last change of temperature, 0 before the first.
    values: (N, K), SI. magnetic: Earth's field in ENU, any unit, None where it is not declared. rejected: rows left out for a NaN.
    along: (S, 3), for a sensor in unknown orientations: the direction of gravity in its axes, found by itself. Its accelerometers are then
    seen along it alone, as one channel: across it, every error is an orientation that nobody knows.
    bins: of a long recording, whose "samples" are means over consecutive ones; None where they are the samples themselves.
    """

    site: Site
    channels: tuple[Channel, ...]
    labels: tuple[str, ...]
    motions: tuple[Motion, ...]
    attitude: Array
    bounds: NDArray[np.int64]
    time: Array
    angle: Array
    rate: Array
    acceleration: Array
    temperature: Array
    temperature_rate: Array
    last_change: Array
    values: Array
    magnetic: Array | None = None
    rejected: int = 0
    fitted: Array | None = None
    along: Array | None = None
    bins: Bins | None = None

    def __len__(self) -> int:
        return len(self.labels)

    def segments(self) -> list[slice]:
        """The samples of every segment."""
        return self._slices

    @cached_property
    def _slices(self) -> list[slice]:
        return [slice(int(a), int(b)) for a, b in zip(self.bounds[:-1], self.bounds[1:], strict=True)]

    @cached_property
    def unsteady(self) -> NDArray[np.bool_]:
        """The segments (S,) in which the table's rate changes."""
        return np.array([bool(self.acceleration[part].any()) for part in self.segments()])

    @cached_property
    def pulsation(self) -> Array:
        """Of a rocking table, 2π times its frequency, (N,), rad/s; 0 in other segments and where it has come to rest."""
        each = np.array([2 * np.pi * m.frequency if isinstance(m, Rock) else 0.0 for m in self.motions])[self.owner]
        return np.where((self.rate != 0) | (self.acceleration != 0), each, 0.0)

    @cached_property
    def owner(self) -> NDArray[np.int64]:
        """The segment of every sample, (N,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.bounds))

    @cached_property
    def bin_size(self) -> NDArray[np.int64]:
        """How many samples each of a segment's values is the mean of, (S,)."""
        return np.ones(len(self), dtype=np.int64) if self.bins is None else self.bins.size

    @cached_property
    def counts(self) -> NDArray[np.int64]:
        """Samples of every segment, (S,), those in its bins."""
        return np.diff(self.bounds) * self.bin_size

    @cached_property
    def turning(self) -> Array:
        """The site direction about which the table turns, (S, 3)."""
        return np.array([m.about if isinstance(m, Spin) else (0.0, 0.0, 1.0) for m in self.motions], dtype=float)

    @cached_property
    def sample_rate(self) -> float:
        """Samples per second, the median over the run."""
        if self.bins is not None:
            return self.bins.rate
        return 1.0 / float(np.median(np.diff(self.time[: min(len(self.time), 100_000)])))

    def in_sensor_axes(self, site_vector: Array) -> Array:
        """A vector in site axes, (3,), as the sensor's axes see it at every sample, (N, 3): attitude · R(−θ) · vector, R by Rodrigues'
        formula about the segment's axis."""
        vector = np.asarray(site_vector, dtype=float)
        along = (self.turning @ vector)[:, None] * self.turning
        axes = np.stack([along, vector - along, -np.cross(self.turning, vector)], axis=1) @ self.attitude.swapaxes(1, 2)
        seen = np.empty((len(self.time), 3))
        for part, here in zip(self.segments(), axes, strict=True):
            np.matmul(self._turned[part], here, out=seen[part])
        return seen

    @cached_property
    def _turned(self) -> Array:
        """1, cosine and sine of the table's angle, (N, 3). Over a bin they are means to the second order in its length."""
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        if self.bins is not None:
            spread = ((self.bin_size**2 - 1) / (24 * self.sample_rate**2))[self.owner]
            squared, change = self.rate**2, self.acceleration
            cosine, sine = (
                cosine - (squared * cosine + change * sine) * spread,
                sine - (squared * sine - change * cosine) * spread,
            )
        return np.column_stack([np.ones(len(cosine)), cosine, sine])

    @cached_property
    def earth_rate(self) -> Array:
        """Earth rotation in sensor axes, (N, 3), rad/s."""
        return self.in_sensor_axes(self.site.earth_rate_enu)

    @cached_property
    def table_axis(self) -> Array:
        """The axis about which the table turns in sensor axes, (N, 3): fixed within a segment."""
        felt: Array = np.einsum("sij,sj->si", self.attitude, self.turning)[self.owner]
        return felt

    @cached_property
    def omega(self) -> Array:
        """Nominal angular rate against inertial space in sensor axes, (N, 3), rad/s."""
        return self.earth_rate + self.rate[:, None] * self.table_axis

    @cached_property
    def force(self) -> Array:
        """Nominal specific force in sensor axes on the axis of rotation, (N, 3), m/s²."""
        return self.in_sensor_axes(self.site.specific_force_enu)

    @cached_property
    def nominal_output(self) -> Array:
        """What the channels give without the effect, (N, K), SI: of the fitted nominal model, before that of an ideal sensor."""
        if self.fitted is not None:
            return self.fitted
        felt = {"gyro": self.omega, "accel": self.force}
        return np.column_stack([self.seen(index, felt[channel.kind]) for index, channel in enumerate(self.channels)])

    def seen(self, index: int, vector: Array) -> Array:
        """What a channel sees, (N,), of a vector in sensor axes, (N, 3)."""
        if self.along is None:
            return np.asarray(vector[:, self.channels[index].axis])
        component = np.einsum("ni,ni->n", self.along[self.owner], vector)
        rounding = 1e-12 * np.linalg.norm(vector, axis=1).max(initial=0.0)
        return np.where(np.abs(component) > rounding, component, 0.0)

    def inputs(self, kind: str) -> list[tuple[int, int, Array | float]]:
        """Input axes of a triad: axis, channel that it is seen in, and the share of it that the channel sees, (N,) or 1."""
        if self.along is None:
            return [(self.channels[index].axis, index, 1.0) for index in self.of_kind(kind)]
        return [(axis, index, self.along[self.owner, axis]) for index in self.of_kind(kind) for axis in range(3)]

    @cached_property
    def warmth(self) -> Array:
        """Temperature above the reference, (N,), K."""
        return self.temperature - REFERENCE_TEMPERATURE

    def of_kind(self, kind: str) -> list[int]:
        """Indices of the channels of a triad."""
        return [index for index, channel in enumerate(self.channels) if channel.kind == kind]


def observed(
    recording: Sequence[RecordedSegment],
    site: Site,
    sensor: SensorModel,
    *,
    axes: Mapping[str, str] | None = None,
    angle_channel: str | None = None,
    temperature_channel: str | None = None,
    magnetic: Sequence[float] | None = None,
    power_on: float = 0.0,
) -> Observed:
    """The recorded segments of a run as a diagnosis needs them, in the order of time: slow noise and hysteresis know no other.

    axes: channel → sensor axis x, y or z; without it the last letter of names such as gyro_x and accel_z, or a part of the name between
    underscores. Angular-rate channels are gyros and acceleration channels accelerometers, whatever their names. angle_channel: the
    table's encoder; temperature_channel: thermometer; without them the plan's values. power_on: recording time of power-on, s. Raises
    `ObservationError` for whatever cannot be diagnosed.
    """
    if not recording:
        raise ObservationError("no recorded segments are given: a diagnosis needs at least two")
    recording = in_time_order(recording)
    channels = channels_of(recording[0], sensor, axes)
    if not channels:
        raise ObservationError("the recording has no channel of angular rate or acceleration with an axis x, y or z")
    size = sizes(recording)
    made = [
        _part(item, channels, angle_channel, temperature_channel, power_on, None if size is None else int(size[index]))
        for index, item in enumerate(recording)
    ]
    parts = [part for part, *_ in made]
    settled(recording, parts, [uncertainty for *_, uncertainty in made])
    means = [float(np.mean(part["temperature"])) for part in parts]
    stacked = {name: np.concatenate([part[name] for part in parts]) for name in _PER_SAMPLE}
    return Observed(
        site,
        channels,
        tuple(item.label for item in recording),
        tuple(item.segment.motion for item in recording),
        np.array([item.segment.attitude for item in recording]),
        np.concatenate(([0], np.cumsum([len(part["time"]) for part in parts]))).astype(np.int64),
        last_change=changes(recording, means),
        magnetic=None if magnetic is None else np.asarray(magnetic, dtype=float),
        rejected=sum(rows.rejected for _, rows, _ in made),
        bins=None if size is None else bins_of(size, [rows for _, rows, _ in made]),
        **stacked,
    )


_PER_SAMPLE = ("time", "angle", "rate", "acceleration", "temperature", "temperature_rate", "values")


def channels_of(first: RecordedSegment, sensor: SensorModel, axes: Mapping[str, str] | None) -> tuple[Channel, ...]:
    found = []
    for name, text in first.units.items():
        kind = {"angular rate": "gyro", "acceleration": "accel"}.get(_quantity(text))
        words = name.lower().split("_")
        letter = axes.get(name) if axes is not None else next((w for w in words if w in ("x", "y", "z")), None)
        if kind is None or letter is None:
            continue
        factor = unit(text).factor
        output = sensor.output(name)
        noise = output.noise if output else NoiseModel()
        found.append(
            Channel(
                name, kind, "xyz".index(letter), text, factor,
                noise.white * factor, noise.bias_instability * factor, noise.resolution * factor,
            )
        )  # fmt: skip
    return tuple(found)


def measures_motion(text: str) -> bool:
    """Whether a channel in this unit is one that is diagnosed."""
    return bool(_quantity(text))


def _quantity(text: str) -> str:
    dimension = unit(text).dimension
    if dimension == unit("rad/s").dimension:
        return "angular rate"
    return "acceleration" if dimension == unit("m/s^2").dimension else ""


def _part(
    item: RecordedSegment,
    channels: tuple[Channel, ...],
    angle: str | None,
    thermometer: str | None,
    power_on: float,
    size: int | None,
) -> tuple[dict[str, Array], Averaged, float]:
    """One segment's samples, or means over `size` of them, rows with a NaN left out; what they were made of; and the uncertainty of its
    temperature, NaN where it changes."""
    if item.segment.attitude is None:
        raise ObservationError(f"the orientation of segment '{item.label}' is unknown: leave it out of the diagnosis")
    if not isinstance(item.segment.motion, Rest | Spin | Rock):
        raise ObservationError(f"segment '{item.label}' is a cycle of turns and stops: leave it out of the diagnosis")
    extra = [name for name in (angle, thermometer) if name is not None]
    rows = rows_of(item, channels, extra, size, angle)
    time, table, motion = rows.time, rows.table, item.segment.motion
    left = 1.0 if size is None else fading(motion, size, 1 / rows.step)
    part = motion_at(motion, time - rows.begin, _in_si(item, angle, table) if angle is not None else None, left)
    warm = _in_si(item, thermometer, table) if thermometer is not None else None
    temperature = temperature_of(item, time, warm)
    part["temperature"], part["temperature_rate"] = temperature.celsius, temperature.rate
    part["values"] = np.column_stack([table[channel.name] * channel.factor for channel in channels])
    part["time"] = time - power_on
    return part, rows, temperature.uncertainty


def rows_of(
    item: RecordedSegment,
    channels: Sequence[Channel],
    extra: Sequence[str] = (),
    size: int | None = None,
    encoder: str | None = None,
) -> Averaged:
    """A segment's rows without a NaN, or, with `size`, means over so many. extra: further channels, of which `encoder` wraps. Raises
    `ObservationError`."""
    names = [*(channel.name for channel in channels), *extra]
    missing = [name for name in names if name not in item.units]
    if missing:
        raise ObservationError(
            f"segment '{item.label}' has no channel '{missing[0]}'; {closest(missing[0], item.units)}"
        )
    rows = _held(item, names) if size is None else _averaged(item, channels, names, size, encoder)
    if len(rows.time) < 8:
        raise ObservationError(
            f"segment '{item.label}' holds {len(rows.time)} usable samples: leave it out or record it again"
        )
    return rows


def _held(item: RecordedSegment, names: Sequence[str]) -> Averaged:
    blocks = list(item.blocks(names))
    time = np.concatenate([block.time for block in blocks]) if blocks else np.empty(0)
    table = {name: np.concatenate([np.asarray(block.channels[name]) for block in blocks]) for name in names if blocks}
    good = np.isfinite(time)
    for column in table.values():
        good &= np.abs(column) < SQUARED  # false for NaN as well
    time, table = time[good], {name: column[good] for name, column in table.items()}
    return Averaged(
        float(time[0]) if len(time) else np.nan, time=time, table=table, rejected=int(np.count_nonzero(~good))
    )


def _averaged(
    item: RecordedSegment, channels: Sequence[Channel], names: Sequence[str], size: int, encoder: str | None
) -> Averaged:
    rate = 1 / item.statistics.period
    factors = np.array([channel.factor for channel in channels])
    counts = np.array([channel.resolution for channel in channels])
    smallest = np.maximum(counts / 2, np.array([channel.white for channel in channels]) * np.sqrt(rate) / 4)
    wraps = None if encoder is None else (encoder, 2 * np.pi / unit(item.units[encoder]).factor)
    return averaged(item, names, factors, counts, smallest, size, wraps)


def _in_si(item: RecordedSegment, name: str, table: Mapping[str, Array]) -> Array:
    scale = unit(item.units[name])
    return np.asarray(table[name] * scale.factor + scale.offset)
