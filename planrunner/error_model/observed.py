"""Defines the input of effects: the samples of a recording or schedule, with the stimulus of the sensor at each sample.

All values are in SI units with radians, except temperatures, which are in degC. The samples of all segments are concatenated;
`bounds` gives the index of the first sample of each segment. The nominal stimulus at every sample follows from attitude, table
angle and site. An `Observed` contains no effects, but it may contain the output of the nominal model after its parameters have been
fitted (`with_model`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.earth import Site
from planrunner.physics.moved_body import BodyMotion
from planrunner.physics.sampled_motion import AngleFrom, angle_from, once_per_turn
from planrunner.plan.schedule import Motion, RecordedMotion, Rock, Segment, Spin
from planrunner.plan.units import unit

KINDS = {unit("rad/s").dimension: "gyro", unit("m/s^2").dimension: "accel"}
"""Kinds of channels, by the dimension of their unit."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A measured channel of the sensor.

    `kind`: 'gyro' or 'accel'. `axis`: index (0, 1 or 2) of the sensor axis along which the channel measures. `factor`: SI value of
    the channel's `unit`. `white`: declared one-sided noise density, SI·√s, so that a sample at the sampling rate f has the standard
    deviation white·√f. `flicker`: declared bias instability, SI. `resolution`: SI value of one count.
    """

    name: str
    kind: str
    axis: int
    unit: str
    factor: float
    white: float
    flicker: float = 0.0
    resolution: float = 0.0

    def sample_variance(self, rate: float, count: float | None = None) -> float:
        """Returns the declared variance, SI, of samples at the sampling rate `rate` [Hz]: white noise and the rounding to counts.
        `count`: size of one count, SI, if it differs from the declared size."""
        return self.white**2 * rate + (self.resolution if count is None else count) ** 2 / 12


def axis_of(name: str) -> int | None:
    """Returns the sensor axis along which a channel measures. The axis is the first x, y or z among the words of the channel's
    name, in small or capital letters, such as gyro_x, x_rate or accel_z_filtered. The result is None if the name contains no axis.
    Recordings, schedules and simulations all use this function."""
    return next(("xyz".index(word) for word in name.lower().split("_") if word in ("x", "y", "z")), None)


def channel_of(name: str, text: str, white: float, flicker: float, resolution: float) -> Channel | None:
    """Returns the channel of an output. Returns None if the output measures neither angular rate (a gyro) nor acceleration, or if
    its name contains no axis. `text`: unit of the output and of its noise, as text. `white`, `flicker`, `resolution`: the declared
    noise, as in `Channel`, but in this unit."""
    kind, axis = KINDS.get(unit(text).dimension), axis_of(name)
    if kind is None or axis is None:
        return None
    factor = unit(text).factor
    return Channel(name, kind, axis, text, factor, white * factor, flicker * factor, resolution * factor)


@dataclass(frozen=True, slots=True)
class TemperatureCourse:
    """Describes the temperature over a segment or over a part of a segment.

    `time`: array of shape (n,), s since power-on, ascending. `temperature`: array of shape (n,) in degC. `rate`: slope of the
    temperature at the end, K/s.
    """

    time: Array
    temperature: Array
    rate: float


@dataclass(frozen=True, slots=True)
class ObservedSegment:
    """Contains one segment of an `Observed`, with n samples.

    `motion`, `attitude`, `last_change`: one value each for the whole segment; the attitude has the shape (3, 3). `time`, `angle`, `rate`,
    `acceleration`, `temperature`, `temperature_rate`: arrays of shape (n,). `values`: array of shape (n, K), the recorded outputs.
    `course`: the motion of the sensor, if it does not follow from attitude and table angle. `overvoltage`, `overpressure`: arrays of
    shape (n,); None means that all values are zero.
    """

    label: str
    motion: Motion
    attitude: Array
    time: Array
    angle: Array
    rate: Array
    acceleration: Array
    temperature: Array
    temperature_rate: Array
    values: Array
    last_change: float = 0.0
    course: BodyMotion | None = None
    overvoltage: Array | None = None
    overpressure: Array | None = None


def joined(
    site: Site,
    channels: Sequence[Channel],
    segments: Sequence[ObservedSegment],
    *,
    magnetic: Sequence[float] | None = None,
    rejected: int = 0,
    along: Array | None = None,
    bins: Bins | None = None,
    encoder: bool = True,
) -> Observed:
    """Makes an `Observed` by joining segments in the given order. `magnetic`, `rejected`, `along`, `bins`, `encoder`: values of the
    fields of `Observed` with these names."""

    def stacked(parts: Iterable[Array]) -> Array:
        return np.concatenate([np.zeros(0), *parts])

    return Observed(
        site,
        tuple(channels),
        tuple(one.label for one in segments),
        tuple(one.motion for one in segments),
        np.array([one.attitude for one in segments], dtype=float).reshape(-1, 3, 3),
        np.concatenate(([0], np.cumsum([len(one.time) for one in segments]))).astype(np.int64),
        stacked(one.time for one in segments),
        stacked(one.angle for one in segments),
        stacked(one.rate for one in segments),
        stacked(one.acceleration for one in segments),
        stacked(one.temperature for one in segments),
        stacked(one.temperature_rate for one in segments),
        np.array([one.last_change for one in segments], dtype=float),
        np.concatenate([np.zeros((0, len(channels))), *(one.values for one in segments)]),
        None if magnetic is None else np.asarray(magnetic, dtype=float),
        rejected,
        along=along,
        bins=bins,
        excess_voltage=_excess([one.overvoltage for one in segments], segments),
        excess_pressure=_excess([one.overpressure for one in segments], segments),
        courses=tuple(one.course for one in segments) if any(one.course is not None for one in segments) else (),
        encoder=encoder,
    )


def _excess(parts: Sequence[Array | None], segments: Sequence[ObservedSegment]) -> Array | None:
    if all(one is None for one in parts):
        return None
    return np.concatenate(
        [np.zeros(len(of.time)) if one is None else one for one, of in zip(parts, segments, strict=True)]
    )


_STEADY = 1e-6  # fraction of the square of the rate; a rate whose variance is smaller counts as constant
_OF_MOTION = ("owner", "_turned", "earth_rate", "table_axis", "omega", "force", "turn", "swing", "pulsation")
"""Attributes of `Observed` that contain the motion at every sample, once they have been computed."""


@dataclass(frozen=True)
class Observed:
    """Contains a recording together with its plan: S segments, N samples and K channels.

    `labels`, `motions`: label and planned motion of each segment.
    `attitude`: array of shape (S, 3, 3); its rows are the sensor's axes in East-North-Up at table angle 0.
    `bounds`: array of shape (S + 1,), index of the first sample of each segment, followed by N.
    `time`: array of shape (N,), time of each sample, s since power-on.
    `angle`: array of shape (N,), table angle, rad.
    `rate`, `acceleration`: arrays of shape (N,), angular rate [rad/s] and angular acceleration [rad/s²] of the table.
    `temperature`, `temperature_rate`: arrays of shape (N,), smoothed temperature [degC] and its rate of change [K/s].
    `last_change`: array of shape (S,), sign of the last change of temperature, 0 before the first change.
    `values`: array of shape (N, K), the recorded outputs in SI units.
    `magnetic`: Earth's magnetic field in East-North-Up, in any unit; None if the field is not declared.
    `rejected`: number of rows that were omitted because of a NaN.
    `along`: for a sensor in unknown orientations, an array of shape (S, 3), the direction of gravity in the sensor's axes, estimated from
        the readings. The accelerometers of such a sensor are observed only along gravity, as one channel: perpendicular to gravity, errors
        cannot be distinguished from the unknown orientation.
    `bins`: the bins of a long recording; the "samples" are then means over consecutive samples. None for single samples.
    `felt`: angular rate (N, 3) and specific force (N, 3), if they do not follow from site, attitude and table.
    `fitted`: array of shape (N, K), output of the fitted nominal model.
    `response`: array of shape (K, 3), change of each output per rate about each sensor axis in the fitted nominal model; None for an ideal
        sensor.
    `courses`: one entry for each segment: the motion if it is known only from the recording, or None if attitude and angle determine
        it. The tuple is empty if all entries would be None.
    `excess_voltage`, `excess_pressure`: arrays of shape (N,), the values that `overvoltage` and `overpressure` return; None means zero
        everywhere.
    `past`: used if the samples are one block of a simulation; maps the value of an effect's shape to the temperatures before the first
        sample.
    `reach`: largest distance of a sensor from the axis of a table, m.
    `encoder`: True if the angle of a turning table is known, from an encoder or from a simulation.
    `scatter`: array of shape (K, Q), quantiles of the noise of a sample, SI, for effects that act on an output together with its noise;
        if `scatter` is None, such effects neglect the noise.
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
    response: Array | None = None
    along: Array | None = None
    bins: Bins | None = None
    felt: tuple[Array, Array] | None = None
    courses: tuple[BodyMotion | None, ...] = ()
    excess_voltage: Array | None = None
    excess_pressure: Array | None = None
    past: Mapping[float, tuple[TemperatureCourse, ...]] = field(default_factory=dict)
    reach: float = 1.0
    encoder: bool = True
    scatter: Array | None = None

    def __len__(self) -> int:
        return len(self.labels)

    def with_model(
        self, *, fitted: Array | None = None, response: Array | None = None, scatter: Array | None = None
    ) -> Observed:
        """Returns a copy with another nominal model; arguments that are None leave an attribute unchanged. The copy shares the
        motion at every sample with this recording, so the motion is neither computed nor stored again. Each argument replaces the
        attribute of the same name."""
        made = replace(
            self,
            fitted=self.fitted if fitted is None else fitted,
            response=self.response if response is None else response,
            scatter=self.scatter if scatter is None else scatter,
        )
        made.__dict__.update({name: self.__dict__[name] for name in _OF_MOTION if name in self.__dict__})
        return made

    def at_samples(self, kept: NDArray[np.bool_]) -> Observed:
        """Returns a copy that contains only some samples of each segment. `kept`: array of shape (N,), True for these samples. Each
        segment keeps at least one sample, and a segment with an entry in `courses` keeps all its samples."""
        made = replace(
            self,
            bounds=np.concatenate(([0], np.cumsum(np.add.reduceat(kept.astype(np.int64), self.bounds[:-1])))),
            values=self.values[kept],
            fitted=None if self.fitted is None else self.fitted[kept],
            felt=None if self.felt is None else (self.felt[0][kept], self.felt[1][kept]),
            time=self.time[kept],
            angle=self.angle[kept],
            rate=self.rate[kept],
            acceleration=self.acceleration[kept],
            temperature=self.temperature[kept],
            temperature_rate=self.temperature_rate[kept],
            excess_voltage=None if self.excess_voltage is None else self.excess_voltage[kept],
            excess_pressure=None if self.excess_pressure is None else self.excess_pressure[kept],
        )
        made.__dict__.update({name: self.__dict__[name][kept] for name in _OF_MOTION if name in self.__dict__})
        return made

    def segments(self) -> list[slice]:
        """Returns one slice per segment, which selects the samples of the segment."""
        return self._slices

    @cached_property
    def _slices(self) -> list[slice]:
        return [slice(int(a), int(b)) for a, b in zip(self.bounds[:-1], self.bounds[1:], strict=True)]

    @cached_property
    def unsteady(self) -> NDArray[np.bool_]:
        """Returns a mask of shape (S,), which is True for the segments in which the rate of rotation changes."""
        changing = [bool(self.acceleration[part].any()) for part in self.segments()]
        return np.array(
            [change or isinstance(m, RecordedMotion) for change, m in zip(changing, self.motions, strict=True)]
        )

    @cached_property
    def moved(self) -> NDArray[np.bool_]:
        """Returns a mask of shape (S,), which is True for the segments whose motion is known only from the recording."""
        return np.array([isinstance(motion, RecordedMotion) for motion in self.motions], dtype=bool)

    @cached_property
    def angle_from(self) -> tuple[AngleFrom, ...]:
        """Returns, for each of the S segments, how the angle of the table is known: from the plan, from gravity or not at all."""
        if self.encoder:
            return (AngleFrom.PLAN,) * len(self)
        axes = [self.channels[index].axis for index in self.of_kind("accel")]
        each = zip(self.motions, self.attitude, strict=True)
        return tuple(angle_from(motion, attitude, self.site, axes) for motion, attitude in each)

    @cached_property
    def unknown_phase(self) -> Array:
        """Returns a complex amplitude for each segment and channel, SI, shape (S, K). The amplitude describes the part of the
        channel's nominal input that varies once per turn. If the angle θ of the table were known, this part would be the real part
        of the amplitude times exp(iθ). If the angle is known, or if gravity shows it, the amplitude is zero."""
        out = np.zeros((len(self), len(self.channels)), dtype=complex)
        for index, (motion, source) in enumerate(zip(self.motions, self.angle_from, strict=True)):
            if source is AngleFrom.NOTHING and isinstance(motion, Spin):
                site = {"gyro": self.site.earth_rate_enu, "accel": self.site.specific_force_enu}
                seen = {kind: once_per_turn(motion, self.attitude[index], vector) for kind, vector in site.items()}
                out[index] = [seen[channel.kind][channel.axis] for channel in self.channels]
        return out

    @cached_property
    def turn(self) -> Array:
        """Returns the angular rate of the sensor in its axes [rad/s], shape (N, 3). The rate is relative to the Earth if the
        attitude is known."""
        return self._by_course(self.rate[:, None] * self.table_axis, lambda course: course.turn)

    @cached_property
    def swing(self) -> Array:
        """Returns the angular acceleration of the sensor in its axes [rad/s²], shape (N, 3)."""
        return self._by_course(self.acceleration[:, None] * self.table_axis, lambda course: course.swing)

    def response_in(self, outputs: Array) -> Array:
        """Returns the change of each output per rate about each sensor axis, shape (K, 3), from a regression of the errors of the
        outputs on the rate. Directions in which the rate hardly changes get the response of an ideal sensor. `outputs`: array of
        shape (N, K), outputs without noise, SI."""
        axes = np.eye(3)[[channel.axis for channel in self.channels]]
        rate, error = self.omega - self.omega.mean(axis=0), outputs - replace(self, fitted=None).nominal_output
        energy, directions = np.linalg.eigh(rate.T @ rate)
        changing = directions[:, energy > _STEADY * (self.omega**2).sum()]
        gains, *_ = np.linalg.lstsq(rate @ changing, error, rcond=None)
        return np.asarray(axes + (changing @ gains).T)

    def turn_before(self, seconds: float) -> Array:
        """Returns the value of `turn` at the time `seconds` earlier, minus the present value of `turn`, shape (N, 3). While the
        table rocks with angular frequency p, the motion is harmonic: with d = `seconds`, ω(t − d) = ω·cos pd − (dω/dt)/p·sin pd. If
        only the recording shows the motion, the rate is assumed to be constant before the first and after the last sample of a
        segment."""
        from scipy.interpolate import CubicSpline

        change = np.zeros((len(self.time), 3))
        for rows in self.rocked:
            phase = self.pulsation[rows] * seconds
            earlier = seconds * np.sinc(phase / np.pi)  # sin(pd)/p
            further = self.rate[rows] * (np.cos(phase) - 1) - self.acceleration[rows] * earlier
            change[rows] = further[:, None] * self.table_axis[rows]
        for rows, moved in zip(self.segments(), self.moved, strict=True):
            if moved:
                time = self.time[rows]
                course = CubicSpline(time, self.turn[rows])
                change[rows] = course(np.clip(time - seconds, time[0], time[-1])) - self.turn[rows]
        return change

    def turn_lagged(self, tau: float) -> Array:
        """Returns the rate `turn` after a first-order lag, minus `turn` itself, shape (N, 3). The lag is in steady state at the start of
        each segment. The rate x is assumed to be linear between samples. For a step of length h, the lagged rate y is y₁ = q·y₀ + (1 −
        g·(1 − q))·x₁ + (g·(1 − q) − q)·x₀ with q = exp(−h/τ) and g = τ/h."""
        from scipy.signal import lfilter

        change = np.zeros((len(self.time), 3))
        for rows, moved in zip(self.segments(), self.moved, strict=True):
            if moved and tau > 0:
                step = float(np.median(np.diff(self.time[rows])))
                q, g = float(np.exp(-step / tau)), tau / step
                ahead, behind = 1 - g * (1 - q), g * (1 - q) - q
                rate = self.turn[rows] - self.turn[rows.start]
                change[rows] = lfilter([ahead, behind], [1.0, -q], rate, axis=0) - rate
        return change

    @cached_property
    def mean_square_rate(self) -> Array:
        """Returns the mean square of the angular rate of a rocking table [rad²/s²], shape (N,); 0 in other segments. For harmonic
        motion with the angular frequency p, the mean square is (ω² + (α/p)²)/2, where ω and α are the rate and the angular
        acceleration at any moment."""
        return np.asarray(self.mean_square_acceleration / np.where(self.pulsation > 0, self.pulsation, 1.0) ** 2)

    @cached_property
    def mean_square_acceleration(self) -> Array:
        """Returns the mean square of the angular acceleration of a rocking table [rad²/s⁴], shape (N,); 0 in other segments. The mean
        square is (α² + (p·ω)²)/2, with the symbols explained at `mean_square_rate`."""
        return np.where(self.pulsation > 0, (self.acceleration**2 + (self.pulsation * self.rate) ** 2) / 2, 0.0)

    def _by_course(self, values: Array, part: Callable[[BodyMotion], Array]) -> Array:
        """Returns the given values (N, …), which follow from attitude and table angle. In segments with a recorded motion, they are
        replaced by the values of this motion. `part`: returns the values of a motion."""
        for rows, course in zip(self.segments(), self.courses, strict=False):
            if course is not None:
                values[rows] = part(course)
        return values

    @cached_property
    def pulsation(self) -> Array:
        """Returns the angular frequency (2π times the frequency) of a rocking table [rad/s], shape (N,). The result is 0 in other
        segments and while the table is at rest."""
        each = np.array([2 * np.pi * m.frequency if isinstance(m, Rock) else 0.0 for m in self.motions])[self.owner]
        return np.where((self.rate != 0) | (self.acceleration != 0), each, 0.0)

    @cached_property
    def rocked(self) -> list[slice]:
        """Returns one slice per segment in which the table rocks."""
        return [
            part
            for part, motion in zip(self.segments(), self.motions, strict=True)
            if isinstance(motion, Rock) and self.acceleration[part].any()
        ]

    @cached_property
    def owner(self) -> NDArray[np.int64]:
        """Returns the index of the segment to which each sample belongs, shape (N,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.bounds))

    @cached_property
    def bin_size(self) -> NDArray[np.int64]:
        """Returns the number of samples that are averaged in each value of a segment, shape (S,)."""
        return np.ones(len(self), dtype=np.int64) if self.bins is None else self.bins.size

    @cached_property
    def counts(self) -> NDArray[np.int64]:
        """Returns the number of recorded samples in each segment, shape (S,). All samples that are averaged in a bin are counted."""
        return np.diff(self.bounds) * self.bin_size

    @cached_property
    def turning(self) -> Array:
        """Returns the direction about which the table turns in each segment, in site axes, shape (S, 3)."""
        return np.array(
            [m.about if isinstance(m, Spin | RecordedMotion) else (0.0, 0.0, 1.0) for m in self.motions], dtype=float
        )

    @cached_property
    def sample_rate(self) -> float:
        """Returns the number of samples per second, computed from the median interval of the run."""
        if self.bins is not None:
            return self.bins.rate
        return 1.0 / float(np.median(np.diff(self.time[: min(len(self.time), 100_000)])))

    def in_sensor_axes(self, site_vector: Array) -> Array:
        """Transforms a vector (3,) in site axes to sensor axes at every sample, shape (N, 3). The result is attitude · R(−θ) · vector,
        where R is the rotation about the segment's axis (Rodrigues' formula). The result is zero if the attitude is unknown."""
        vector = np.asarray(site_vector, dtype=float)
        along = (self.turning @ vector)[:, None] * self.turning
        axes = np.stack([along, vector - along, -np.cross(self.turning, vector)], axis=1) @ self.attitude.swapaxes(1, 2)
        seen = np.empty((len(self.time), 3))
        for part, here in zip(self.segments(), axes, strict=True):
            np.matmul(self._turned[part], here, out=seen[part])
        return self._by_course(seen, lambda course: course.attitude @ vector)

    @cached_property
    def _turned(self) -> Array:
        """Returns a matrix with the columns 1, cosine of the table's angle, and sine of the table's angle, shape (N, 3). For bins,
        cosine and sine are means over each bin, correct to second order in the length of the bin."""
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
        """Returns the Earth's rotation in sensor axes [rad/s], shape (N, 3)."""
        return self.in_sensor_axes(self.site.earth_rate_enu)

    @cached_property
    def table_axis(self) -> Array:
        """Returns the axis about which the table turns, in sensor axes, shape (N, 3); it is constant within a segment."""
        felt: Array = np.einsum("sij,sj->si", self.attitude, self.turning)[self.owner]
        return felt

    @cached_property
    def omega(self) -> Array:
        """Returns the nominal angular rate relative to inertial space, in sensor axes [rad/s], shape (N, 3)."""
        if self.felt is not None:
            return self.felt[0]
        return self._by_course(self.earth_rate + self.rate[:, None] * self.table_axis, lambda course: course.omega)

    @cached_property
    def force(self) -> Array:
        """Returns the nominal specific force in sensor axes [m/s²], shape (N, 3), for a sensor on the axis of rotation."""
        if self.felt is not None:
            return self.felt[1]
        return self._by_course(self.in_sensor_axes(self.site.specific_force_enu), lambda course: course.force)

    @cached_property
    def nominal_output(self) -> Array:
        """Returns the output of the channels without any effect, SI, shape (N, K). This output comes from the fitted nominal model,
        or from an ideal sensor before the fit."""
        if self.fitted is not None:
            return self.fitted
        felt = {"gyro": self.omega, "accel": self.force}
        return np.column_stack([self.seen(index, felt[channel.kind]) for index, channel in enumerate(self.channels)])

    @cached_property
    def gyro_output(self) -> Array:
        """Returns the columns of `nominal_output` that belong to gyros, shape (N, G)."""
        return np.ascontiguousarray(self.nominal_output[:, self.of_kind("gyro")])

    @cached_property
    def gyro_range(self) -> Array:
        """Returns the smallest and the largest `gyro_output` of any gyro in each segment, shape (S, 2). The range always contains
        0: a smallest value that is positive, and a largest value that is negative, are replaced by 0."""
        parts = [self.gyro_output[part] for part in self.segments()]
        return np.array([(part.min(initial=0.0), part.max(initial=0.0)) for part in parts]).reshape(-1, 2)

    @cached_property
    def largest_gyro_output(self) -> Array:
        """Returns the largest magnitude of `gyro_output` of any gyro in each segment, shape (S,)."""
        return np.asarray(np.abs(self.gyro_range).max(axis=1))

    def seen(self, index: int, vector: Array) -> Array:
        """Returns the component of a vector along a channel's input axis, shape (N,). The vector, shape (N, 3), is given in sensor
        axes."""
        if self.along is None:
            return np.asarray(vector[:, self.channels[index].axis])
        component = np.einsum("ni,ni->n", self.along[self.owner], vector)
        rounding = 1e-12 * np.linalg.norm(vector, axis=1).max(initial=0.0)
        return np.where(np.abs(component) > rounding, component, 0.0)

    def inputs(self, kind: str) -> list[tuple[int, int, Array | float]]:
        """Returns the input axes of a triad as tuples (axis, channel, cosine). These are the index of the axis, the index of a
        channel that shows the input of this axis, and the cosine of the angle between the axis and the direction of the channel.
        The cosine is 1 or an array of shape (N,)."""
        if self.along is None:
            return [(self.channels[index].axis, index, 1.0) for index in self.of_kind(kind)]
        return [(axis, index, self.along[self.owner, axis]) for index in self.of_kind(kind) for axis in range(3)]

    @cached_property
    def warmth(self) -> Array:
        """Returns the temperature minus the reference temperature [K], shape (N,)."""
        return self.temperature - REFERENCE_TEMPERATURE

    @cached_property
    def overvoltage(self) -> Array:
        """Returns the supply voltage minus the nominal supply voltage of the sensor [V], shape (N,)."""
        return np.zeros(len(self.time)) if self.excess_voltage is None else self.excess_voltage

    @cached_property
    def overpressure(self) -> Array:
        """Returns the ambient pressure minus the standard atmosphere [Pa], shape (N,)."""
        return np.zeros(len(self.time)) if self.excess_pressure is None else self.excess_pressure

    @property
    def sampled(self) -> dict[str, Array]:
        """Returns a dictionary of all attributes that have one value per sample, shape (N,), except `values`. The keys are the names of
        the attributes."""
        names = ("time", "angle", "rate", "acceleration", "temperature", "temperature_rate")
        found = {name: getattr(self, name) for name in (*names, "excess_voltage", "excess_pressure")}
        return {name: own for name, own in found.items() if own is not None}

    def of_kind(self, kind: str) -> list[int]:
        """Returns the indices of the channels of one kind, `gyro` or `accel`."""
        return [index for index, channel in enumerate(self.channels) if channel.kind == kind]


def planned_excess(segment: Segment, nominal_supply: float) -> tuple[float, float]:
    """Returns the planned supply voltage minus the nominal voltage [V], and the planned pressure minus the standard atmosphere
    [Pa]; 0 for a quantity that the plan does not state."""
    voltage, pressure = segment.supply_voltage, segment.ambient_pressure
    return (
        0.0 if voltage is None else voltage - nominal_supply,
        0.0 if pressure is None else pressure - STANDARD_PRESSURE,
    )


def orientation_key(attitude: Array) -> tuple[float, ...]:
    """Turns an attitude (3, 3) into a dictionary key. Attitudes that differ only by rounding have equal keys."""
    return tuple((np.round(attitude, 6) + 0.0).ravel().tolist())


REFERENCE_TEMPERATURE = 25.0  # degC
STANDARD_PRESSURE = 101325.0  # Pa


@dataclass(frozen=True)
class Bins:
    """Describes how a long recording was averaged in bins, and contains quantities that were computed from the single samples
    before averaging.

    `size`: array of shape (S,), number of samples per bin in each segment. `rate`: sampling rate, Hz. `energy`: array of shape (S, K, K)
    in SI², sums of products of the DCT-II coefficients of two channels. The sums include only the upper three quarters of the orders.
    `count`: array of shape (S,), number of coefficients of a channel in these sums. `spikes`: array of shape (K,), number of samples that
    were replaced. `levels`: for each channel, the distinct values that occur, expressed in counts.
    """

    size: NDArray[np.int64]
    rate: float
    energy: Array
    count: Array
    spikes: NDArray[np.int64]
    levels: tuple[Array, ...]

    def followed(self, further: int) -> Bins:
        """Returns these bins, followed by `further` segments whose values are single samples."""
        return replace(self, size=np.concatenate([self.size, np.ones(further, dtype=np.int64)]))
