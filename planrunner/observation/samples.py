"""Makes the input of a diagnosis: an `Observed` with all samples of a run and the states of the sensor during the run.

The motion of a segment has one of three sources. `observed` takes the motion from the plan. If no plan commands the motion,
`observed` computes it from channels of the recording, which the plan names (`recorded_course`). If the sensor is turned by hand and
is at rest in unknown orientations (poses), `poses` uses only the magnitude |f| = g of the specific force.

The readings in a pose are a = M·f + b + noise. The two components of the readings that are perpendicular to f determine only the
unknown orientation. One observation per sample remains: the component along u = f/g,

    u·a = g + u·b + g·uᵀ(M − 1)u + noise.

Errors that rotate f (a tilt, an azimuth, a rotation of the whole triad) can therefore not be observed. Only three sums of two
misalignments can be observed, for example the sum of x toward y and y toward x. These sums are the non-orthogonalities. The
direction u is found from the mean of the pose and the fitted nominal model by Gauss-Newton steps. If an effect of relative size δ
is not in the nominal model, it rotates u by at most δ, which changes u·a only by g·δ²/2.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.error_model.observed import KINDS, Channel, Observed, ObservedSegment, channel_of, joined
from planrunner.instruments.models import NoiseModel, SensorModel
from planrunner.observation.bins import SQUARED, Averaged, bins_of, seen_along, sizes
from planrunner.observation.bins import averaged as in_bins
from planrunner.observation.refusals import ObservationError
from planrunner.observation.surroundings import Monitors, changes, settled, temperature_of
from planrunner.physics.earth import Site
from planrunner.physics.moved_body import BodyMotion, averaged, by_attitude, by_force, by_rates, slope
from planrunner.physics.sampled_motion import (
    OFFSET,
    AngleFrom,
    along_axis,
    angle_from,
    fading,
    motion_at,
    once_per_turn,
    start_angle,
)
from planrunner.physics.table_motion import about_one_axis
from planrunner.plan.schedule import RecordedMotion, Rest, Rock, Spin
from planrunner.plan.units import unit

_REACHED = 0.99  # fraction of full scale from which a sample counts as clipped


def observed(
    recording: Sequence[RecordedSegment],
    site: Site,
    sensor: SensorModel,
    *,
    only: Collection[str] | None = None,
    measured: Sequence[Channel] | None = None,
    angle_channel: str | None = None,
    temperature_channel: str | None = None,
    supply_channel: str | None = None,
    pressure_channel: str | None = None,
    magnetic: Sequence[float] | None = None,
    power_on: float = 0.0,
    free_angle: bool = False,
    late: Mapping[str, float] | None = None,
) -> Observed:
    """Makes the input of a diagnosis from the recorded segments of a run. The segments are sorted by time, because slow noise and
    hysteresis require it.

    `only`: names of the channels to use, by default all. `measured`: channels that are used as measurements, regardless of their
    names and units. By default, the name of a channel gives its axis (`axis_of`), and its unit makes it a gyro (angular rate) or an
    accelerometer (acceleration). `angle_channel`: channel of the table's encoder. `temperature_channel`: channel of the
    thermometer. `supply_channel`: channel of the voltmeter for the supply. `pressure_channel`: channel of the barometer. If the
    channel of a quantity is not given, the values of this quantity in the plan are used. `power_on`: time of power-on, in the time
    of the recording, s. `free_angle`: selects how the angle of a table without encoder is determined. If True, the angle that
    agrees best with the Earth's rate is used. An input that varies once per turn with an unknown phase then counts as noise, as in
    a diagnosis (`Observed.unknown_phase`). If False, the angle is zero at the first sample, unless gravity shows the angle. Raises
    `ObservationError` if the recording cannot be diagnosed. `magnetic`: array of shape (3,), the Earth's magnetic field in
    East-North-Up, in any unit; None if it is not declared. `late`: maps the label of a segment to the time [s] by which its outputs
    are late relative to the recorded motion; the outputs are shifted by this time.
    """
    if not recording:
        raise ObservationError("no recorded segments are given: a diagnosis needs at least two")
    recording = in_time_order(recording)
    channels = channels_of(recording[0], sensor, only) if measured is None else tuple(measured)
    if not channels:
        units = ", ".join(f"'{name}' [{text}]" for name, text in recording[0].units.items())
        raise ObservationError(
            f"no channel has a unit of angular rate or acceleration and an axis x, y or z in its name: {units}",
            "only outputs in such units can be simulated; state the nominal scale factor of other outputs by `per_unit` of a played "
            "recording",
        )
    size = sizes(recording)
    limits = {output.name: output.full_scale for output in sensor.outputs}
    monitors = Monitors(temperature_channel, supply_channel, pressure_channel, sensor.nominal_supply)
    made = [
        _part(
            item,
            site,
            limits,
            channels,
            angle_channel,
            monitors,
            power_on,
            None if size is None else int(size[index]),
            free_angle,
            (late or {}).get(item.label, 0.0),
        )
        for index, item in enumerate(recording)
    ]
    parts = [part for part, *_ in made]
    settled(recording, parts, [uncertainty for _, _, uncertainty, _ in made])
    means = [float(np.mean(part["temperature"])) for part in parts]
    return joined(
        site,
        channels,
        [
            ObservedSegment(
                item.label,
                item.segment.motion,
                np.eye(3) if item.segment.attitude is None else np.array(item.segment.attitude),
                last_change=float(change),
                course=course,
                **part,
            )
            for item, (part, _, _, course), change in zip(recording, made, changes(recording, means), strict=True)
        ],
        magnetic=magnetic,
        rejected=sum(rows.rejected for _, rows, *_ in made),
        bins=None if size is None else bins_of(size, [rows for _, rows, *_ in made]),
        encoder=angle_channel is not None,
    )


def channels_of(first: RecordedSegment, sensor: SensorModel, only: Collection[str] | None) -> tuple[Channel, ...]:
    """Returns the recorded channels of angular rate and acceleration that have an axis."""
    found = []
    for name, text in first.units.items():
        output = sensor.output(name)
        noise = output.noise if output else NoiseModel()
        made = channel_of(name, text, noise.white, noise.bias_instability, noise.resolution)
        if made is not None and (only is None or name in only):
            found.append(made)
    return tuple(found)


def measures_motion(text: str) -> bool:
    """Returns True if a channel with this unit measures angular rate or acceleration, so that it is diagnosed."""
    return unit(text).dimension in KINDS


def _part(
    item: RecordedSegment,
    site: Site,
    limits: Mapping[str, float],
    channels: tuple[Channel, ...],
    angle: str | None,
    monitors: Monitors,
    power_on: float,
    size: int | None,
    free_angle: bool,
    late: float = 0.0,
) -> tuple[dict[str, Array], Averaged, float, BodyMotion | None]:
    """Reads one segment, without the rows that contain a NaN.

    Returns four values: the planned states of the segment with its samples or, if `size` is given, with means over `size` samples;
    the rows that were read; the uncertainty of the temperature, NaN if the temperature changes; and the motion, None if attitude
    and angle describe the motion. `limits`: full scale of each output. `power_on`, `free_angle`: the same as in `observed`. `late`:
    time [s] by which the outputs are late relative to the recorded motion."""
    motion = item.segment.motion
    if isinstance(motion, RecordedMotion):
        return _moved_part(item, motion, site, limits, channels, monitors, power_on, size, late)
    if item.segment.attitude is None:
        raise ObservationError(f"the orientation of segment '{item.label}' is unknown: leave it out of the diagnosis")
    if not isinstance(motion, Rest | Spin | Rock):
        raise ObservationError(f"segment '{item.label}' is a cycle of turns and stops: leave it out of the diagnosis")
    if not about_one_axis(motion):
        raise ObservationError(f"segment '{item.label}' rocks several rings at once: leave it out of the diagnosis")
    extra = [*([] if angle is None else [angle]), *monitors.channels]
    rows = rows_of(item, channels, extra, size, angle)
    time, table = rows.time, rows.table
    left = 1.0 if size is None else fading(motion, size, 1 / rows.step)
    encoder = None if angle is None or item.expected else _in_si(item, angle, table)
    values = np.column_stack([table[channel.name] * channel.factor for channel in channels])
    start = 0.0
    if isinstance(motion, Spin) and encoder is None and not item.expected:
        attitude = np.array(item.segment.attitude)
        start = _start_angle(motion, attitude, site, channels, time - rows.begin, values, free_angle)
    part = motion_at(motion, time - rows.begin, encoder, left, start)
    warm = None if monitors.thermometer is None else _in_si(item, monitors.thermometer, table)
    temperature = temperature_of(item, time, warm)
    part["temperature"], part["temperature_rate"] = temperature.celsius, temperature.rate
    part |= monitors.excess_of(item, time, table)
    part["values"] = values
    part["time"] = time - power_on
    return part, rows, temperature.uncertainty, None


def _start_angle(
    motion: Spin,
    attitude: Array,
    site: Site,
    channels: Sequence[Channel],
    since: Array,
    values: Array,
    free_angle: bool,
) -> float:
    """Returns the angle [rad] of a table without encoder at the first sample. If gravity shows the angle, it is found from the
    accelerometers. Otherwise, the angle is found from all channels if `free_angle` is True, and is zero if `free_angle` is False.
    `since`: array of shape (n,), time since the first sample, s. `values`: array of shape (n, K), outputs in SI units."""
    accelerometers = [channel.axis for channel in channels if channel.kind == "accel"]
    by_gravity = angle_from(motion, attitude, site, accelerometers) is AngleFrom.GRAVITY
    if not by_gravity and not free_angle:
        return 0.0
    vectors = {"gyro": site.earth_rate_enu, "accel": site.specific_force_enu}
    seen = {kind: once_per_turn(motion, attitude, vector) for kind, vector in vectors.items()}
    used = [k for k, channel in enumerate(channels) if channel.kind == "accel" or not by_gravity]
    expected = np.array([seen[channels[k].kind][channels[k].axis] for k in used])
    if not by_gravity:
        return start_angle(motion, since, values[:, used], expected, np.inf)
    steady = along_axis(motion, attitude, site.specific_force_enu)[[channels[k].axis for k in used]]
    return start_angle(motion, since, values[:, used] - steady, expected, OFFSET)


def _moved_part(
    item: RecordedSegment,
    motion: RecordedMotion,
    site: Site,
    limits: Mapping[str, float],
    channels: tuple[Channel, ...],
    monitors: Monitors,
    power_on: float,
    size: int | None,
    late: float,
) -> tuple[dict[str, Array], Averaged, float, BodyMotion | None]:
    """Does the same as `_part` for a segment whose motion is recorded. Samples at full scale are left out, because the motion is
    not known there. `late`: time [s] by which the channels are late relative to the motion."""
    own = [channel.name for channel in channels if channel.name in motion.channels]
    if own:
        message = f"'{own[0]}' shows the motion of segment '{item.label}', so it cannot be compared with this motion"
        raise ObservationError(message, "leave it out of the outputs, or give the motion by other channels")
    extra = [*motion.channels, *monitors.channels]
    rows = rows_of(item, channels, extra, size, motion.angle or None)
    time, table = rows.time, dict(rows.table)
    shift = round(late / float(np.median(np.diff(time)))) if late else 0
    for channel in channels:
        table[channel.name] = np.roll(table[channel.name], -shift)
    if item.expected:
        moved = supposed_course(time, site)
    else:
        shown = {name: _in_si(item, name, table) for name in motion.channels}
        moved = recorded_course(motion, item.segment.attitude, site, time, shown)
    warm = None if monitors.thermometer is None else _in_si(item, monitors.thermometer, table)
    temperature = temperature_of(item, time, warm)
    values = moved.as_shown(np.column_stack([table[channel.name] * channel.factor for channel in channels]))
    part = {**moved.table, "temperature": temperature.celsius, "temperature_rate": temperature.rate, "values": values}
    part |= monitors.excess_of(item, time, table)
    part["time"] = time - power_on
    over, usable = moved.averaging if size is None else 1, moved.usable
    usable[len(time) - max(shift, 0) :] = False
    usable[: max(-shift, 0)] = False
    for name in (*motion.channels, *(channel.name for channel in channels)):
        reached = np.abs(table[name]) >= _REACHED * limits.get(name, np.inf)
        usable &= ~(reached | np.append(reached[1:], False) | np.append(False, reached[:-1]))
    part = {name: averaged(one[usable], over) for name, one in part.items()}
    if len(part["time"]) < 8:
        message = f"segment '{item.label}' holds {len(part['time'])} averages of {over} samples"
        raise ObservationError(message, "record for longer, or shorten `averaging` of its motion")
    course = None if moved.course is None else moved.course.at(usable).averaged(over)
    return part, rows, temperature.uncertainty, course


def rows_of(
    item: RecordedSegment,
    channels: Sequence[Channel],
    extra: Sequence[str] = (),
    size: int | None = None,
    encoder: str | None = None,
) -> Averaged:
    """Reads the rows of a segment that contain no NaN; if `size` is given, returns means over `size` rows. `extra`: names of
    further channels; one of them may be the channel `encoder`, whose values wrap. Raises `ObservationError` if a channel is missing
    or there are too few usable rows."""
    names = [*(channel.name for channel in channels), *extra]
    missing = [name for name in names if name not in item.units]
    if missing:
        raise ObservationError(
            f"segment '{item.label}' has no channel '{missing[0]}'; {closest(missing[0], item.units)}"
        )
    if item.expected:
        rows = _expected(item, channels, names, 1 if size is None else size)
    else:
        rows = _held(item, names) if size is None else _averaged(item, channels, names, size, encoder)
    if len(rows.time) < 8:
        raise ObservationError(
            f"segment '{item.label}' has {len(rows.time)} usable samples, but at least 8 are necessary: leave it out or record it again"
        )
    return rows


def _expected(item: RecordedSegment, channels: Sequence[Channel], names: Sequence[str], size: int) -> Averaged:
    """Makes the planned samples of a schedule: their times, and the expected mean as the value of every sample."""
    known = item.statistics
    time: Array = known.start + known.period * (
        np.arange(known.count // size, dtype=np.float64) * size + (size - 1) / 2
    )
    table = {name: np.full(len(time), known.mean[known.of(name)]) for name in names}
    k = len(channels)
    return Averaged(
        known.start,
        known.period,
        time,
        table,
        energy=np.zeros((k, k)),
        spikes=np.zeros(k, dtype=np.int64),
        levels=[np.empty(0)] * k,
    )


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
    return in_bins(item, names, factors, counts, smallest, size, wraps)


def _in_si(item: RecordedSegment, name: str, table: Mapping[str, Array]) -> Array:
    scale = unit(item.units[name])
    return np.asarray(table[name] * scale.factor + scale.offset)


_AVERAGED = 10  # samples of an angle or an attitude, by default
_GAP = 3.0  # times the median interval: a longer interval is a gap; samples next to it have no differences
_SUPPOSED = 100.0  # deg/s
_UNIT = 0.05  # largest deviation of the norm of a quaternion from 1


@dataclass(frozen=True, slots=True, eq=False)
class MotionShown:
    """The motion of a segment, computed from recorded channels.

    `table`: angle, rate and acceleration of an axis with an encoder, an array of shape (n,) each; zero without an encoder.
    `course`: the motion if it is computed from channels other than an encoder; otherwise None. `averaging`: number of consecutive
    samples that are averaged. `usable`: array of shape (n,), True for samples with neighbours on both sides. `differences`: True if
    the rate at a sample is computed from the difference between its two neighbours.
    """

    table: Mapping[str, Array]
    course: BodyMotion | None
    averaging: int
    usable: NDArray[np.bool_]
    differences: bool = False

    def as_shown(self, values: Array) -> Array:
        """Averages outputs (n, k) in the same way as the motion. If rates are computed from differences, the outputs are averaged
        by Simpson's rule over the interval of each difference. A fast motion is then attenuated equally in the outputs and in the
        reference."""
        if not self.differences:
            return values
        found = values.copy()
        found[1:-1] = (values[:-2] + 4 * values[1:-1] + values[2:]) / 6
        return found


def recorded_course(
    motion: RecordedMotion, attitude: Array | None, site: Site, time: Array, shown: Mapping[str, Array]
) -> MotionShown:
    """Computes the motion at n samples from recorded channels.

    `attitude`: attitude of the sensor at the first sample of the segment. `time`: array of shape (n,) in s. `shown`: the values
    (n,) of each channel, SI.

    Raises `ObservationError` if the motion cannot be computed from these channels.
    """
    step = float(np.median(np.diff(time)))
    size = max(1, round(motion.averaging / step)) if motion.averaging else 1
    if not motion.averaging and (motion.angle or motion.attitude):
        size = _AVERAGED
    near = np.diff(time) < _GAP * step
    usable = np.append(near, True) & np.append(True, near)
    zero = np.zeros(len(time))
    still = {"angle": zero, "rate": zero, "acceleration": zero}
    force = _stacked(motion.forces, shown)
    if motion.angle or motion.attitude:
        usable[[0, -1]] = False
    if motion.angle:
        if attitude is None:
            message = (
                "the orientation at angle zero is unknown, so the input of the sensor cannot be computed from the angle"
            )
            raise ObservationError(message, "state the `orientation` of the segment, or give `rates`")
        angle = np.unwrap(shown[motion.angle])
        rate = slope(time, angle)
        return MotionShown({"angle": angle, "rate": rate, "acceleration": slope(time, rate)}, None, size, usable, True)
    quaternions, rates = _stacked(motion.attitude, shown), _stacked(motion.rates, shown)
    if quaternions is not None:
        norm = np.linalg.norm(quaternions, axis=1)
        if np.abs(norm - 1).max() > _UNIT:
            message = f"the norm of the attitude quaternion goes from {norm.min():.3g} to {norm.max():.3g}, not 1"
            raise ObservationError(message, "check the channels of `attitude` in the plan, and their columns")
        course = by_attitude(time, quaternions, site, force)
    elif rates is not None:
        course = by_rates(time, rates, attitude, site, force)
    else:
        assert force is not None
        course = by_force(force)
    return MotionShown(still, course, size, usable, bool(motion.attitude))


def supposed_course(time: Array, site: Site) -> MotionShown:
    """Returns an assumed motion about all axes, for a segment that has not been recorded yet. The motion is chosen so that every
    effect can act. Numbers that are reported must not depend on this motion. `time`: array of shape (n,), s."""
    since = time - time[0]
    rates = np.radians(_SUPPOSED) * np.sin(2 * np.pi * np.outer(since, np.array([0.3, 0.5, 0.7])))
    zero = np.zeros(len(time))
    course = by_rates(time, rates, np.eye(3), site)
    return MotionShown({"angle": zero, "rate": zero, "acceleration": zero}, course, 1, zero == 0)


def _stacked(names: tuple[str, ...], shown: Mapping[str, Array]) -> Array | None:
    """Returns the named channels as columns (n, k); None if no channels are named. `shown`: the values (n,) of each channel."""
    return np.column_stack([shown[name] for name in names]) if names else None


_STEPS = 20
_ONE_DIRECTION = 0.9998  # cosine of 1.1 deg
_PAIRS = ((0, 1), (0, 2), (1, 2))


def unknown_orientations(recording: Sequence[RecordedSegment]) -> bool:
    """Returns True if all segments are at rest in unknown orientations. Segments whose motion is recorded need no orientation.

    Raises `ObservationError` if only some of the segments are in unknown orientations, or if a segment in an unknown orientation
    moves."""
    unknown = [
        item.label
        for item in recording
        if item.segment.attitude is None and not isinstance(item.segment.motion, RecordedMotion)
    ]
    if not unknown:
        return False
    if len(unknown) < len(recording):
        message = f"the orientation of segment '{unknown[0]}' is unknown, but other segments have known orientations"
        raise ObservationError(f"{message}: choose segments of one kind with `segments` under `diagnosis` in the plan")
    moving = [item.label for item in recording if not isinstance(item.segment.motion, Rest)]
    if moving:
        raise ObservationError(
            f"segment '{moving[0]}' moves in an unknown orientation: give the orientation of the sensor"
        )
    return True


def poses(
    recording: Sequence[RecordedSegment],
    site: Site,
    sensor: SensorModel,
    nominal: Sequence[str],
    *,
    only: Collection[str] | None = None,
) -> Observed:
    """Makes the input of a diagnosis from recorded poses. There is one channel `accel`, the reading of the accelerometers along
    gravity.

    `nominal`: terms that the nominal simulation fits; they are used to find the directions of gravity. Gyros are left out, because
    at rest in an unknown orientation they show only a bias. Raises `ObservationError` if there is no complete triad of
    accelerometers, or if the readings are not near a sphere.
    """
    recording = in_time_order(recording)
    found = [channel for channel in channels_of(recording[0], sensor, only) if channel.kind == "accel"]
    triad = {channel.axis: channel for channel in found}
    if len(found) != 3 or len(triad) != 3:
        message = f"orientations are unknown, and only {len(found)} accelerometers are recorded"
        raise ObservationError(
            f"{message}: a pose gives information only through |f| = g, which needs all of x, y and z"
        )
    names = [triad[axis].name for axis in range(3)]
    factors = np.array([triad[axis].factor for axis in range(3)])
    size = sizes(recording)
    rows = [
        rows_of(item, [triad[axis] for axis in range(3)], size=None if size is None else int(size[index]))
        for index, item in enumerate(recording)
    ]
    time = [part.time for part in rows]
    samples = [np.column_stack([part.table[name] for name in names]) * factors for part in rows]
    warm = [temperature_of(item, part.time, None) for item, part in zip(recording, rows, strict=True)]
    directions = directions_of(np.array([part.mean(axis=0) for part in samples]), site.gravity, nominal)
    white = np.array([triad[axis].white for axis in range(3)])
    noise = np.sqrt(directions**2 @ white**2)
    level = float(noise.mean())
    # Noise differs between axes and hence between poses: each pose is scaled to the mean level.
    along = directions * (level / noise if level > 0 else np.ones(len(noise)))[:, None]
    segments = []
    for item, now, taken, felt, direction, weight in zip(
        recording, time, samples, warm, directions, along, strict=True
    ):
        still = np.zeros(len(now))
        segments.append(
            ObservedSegment(
                item.label, item.segment.motion, _attitude(direction), now, still, still, still, felt.celsius, felt.rate,
                (taken @ weight)[:, None],
            )
        )  # fmt: skip
    return joined(
        site,
        (Channel("accel", "accel", 0, triad[0].unit, triad[0].factor, level),),
        segments,
        rejected=sum(part.rejected for part in rows),
        along=along,
        bins=None if size is None else seen_along(bins_of(size, rows), along),
    )


def directions_of(means: Array, gravity: float, nominal: Sequence[str]) -> Array:
    """Fits the nominal model to the mean readings [m/s²], and returns the directions of the specific force in the sensor's axes.
    The readings and the directions have the shape (S, 3). `gravity`: magnitude of gravity, m/s².

    Raises `ObservationError` if the fit does not converge.
    """
    bias, matrix = np.zeros(3), np.eye(3)
    for _ in range(_STEPS):
        force = np.linalg.solve(matrix, (means - bias).T).T
        size = np.linalg.norm(force, axis=1)
        if not np.isfinite(size).all() or size.min() < 0.1 * gravity:
            break
        unit: Array = force / size[:, None]
        columns = _columns(unit, gravity, nominal)
        if not columns.shape[1]:
            return unit
        left = np.einsum("si,si->s", unit, means - bias - gravity * unit @ matrix.T)
        step = np.linalg.lstsq(columns, left, rcond=1e-9)[0]
        more_bias, more_matrix = _changed(step, nominal)
        bias, matrix = bias + more_bias, matrix + more_matrix
        if np.abs(columns @ step).max() < 1e-9 * gravity:
            return unit
    lengths = np.linalg.norm(means, axis=1, keepdims=True)
    if (
        np.isfinite(means).all()
        and lengths.min() > 0
        and (means @ means[0] > _ONE_DIRECTION * (lengths * lengths[0]).ravel()).all()
    ):
        raise ObservationError(
            "the sensor has the same direction to gravity in all segments, and their orientations are unknown: state the "
            "orientation and the rate of each segment, or record poses in other directions"
        )
    raise ObservationError(
        "the readings of the poses are not close to a sphere of radius g (the median of their lengths is "
        f"{float(np.median(lengths)) / gravity:.3g} g): check the unit of the channels, and whether the sensor was still"
    )


def _columns(unit: Array, gravity: float, nominal: Sequence[str]) -> Array:
    """Returns one column of length S for each parameter of the terms in `nominal`: bias, scale factors and non-orthogonalities. A
    column contains the changes of the reading along `unit` (S, 3) per unit of the parameter."""
    parts = [np.empty((len(unit), 0))]
    if "accel_bias" in nominal:
        parts.append(unit)
    if "accel_scale_factor" in nominal:
        parts.append(gravity * unit**2)
    if "accel_misalignment" in nominal:
        parts.append(np.column_stack([2 * gravity * unit[:, i] * unit[:, j] for i, j in _PAIRS]))
    return np.hstack(parts)


def _changed(step: Array, nominal: Sequence[str]) -> tuple[Array, Array]:
    """Converts a step in the parameters of `_columns` to changes of the bias (3,) and of the matrix (3, 3)."""
    bias, matrix, left = np.zeros(3), np.zeros((3, 3)), list(step)
    if "accel_bias" in nominal:
        bias, left = np.array(left[:3]), left[3:]
    if "accel_scale_factor" in nominal:
        matrix, left = np.diag(left[:3]), left[3:]
    if "accel_misalignment" in nominal:
        for (i, j), value in zip(_PAIRS, left, strict=True):
            matrix[i, j] = matrix[j, i] = value
    return bias, matrix


def _attitude(up: Array) -> Array:
    """Returns an attitude (3, 3) whose vertical has the direction `up` in sensor axes. The azimuth is arbitrary."""
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    east = np.cross(helper, up)
    east /= np.linalg.norm(east)
    return np.column_stack([east, np.cross(up, east), up])
