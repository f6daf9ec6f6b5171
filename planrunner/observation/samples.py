"""Makes the input of a diagnosis: an `Observed` with all samples of a run and their planned states."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.base.arrays import Array
from planrunner.base.findings import closest
from planrunner.error_model.observed import KINDS, Channel, Observed, ObservedSegment, channel_of, joined
from planrunner.instruments.models import NoiseModel, SensorModel
from planrunner.observation.bins import SQUARED, Averaged, bins_of, sizes
from planrunner.observation.bins import averaged as in_bins
from planrunner.observation.moved import recorded_course, supposed_course
from planrunner.observation.refusals import ObservationError
from planrunner.observation.surroundings import Monitors, changes, settled, temperature_of
from planrunner.physics.earth import Site
from planrunner.physics.moved_body import BodyMotion, averaged
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

_REACHED = 0.99  # of full scale


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
) -> Observed:
    """Makes the input of a diagnosis from the recorded segments of a run. The segments are put in order of time, because slow noise
    and hysteresis require it.

    `only`: names of the channels to use, by default all. `measured`: channels that are used as measurements, whatever their names
    and units. By default, the name of a channel gives its axis (`axis_of`), and its unit makes it a gyro (angular rate) or an
    accelerometer (acceleration). `angle_channel`: channel of the table's encoder. `temperature_channel`: channel of the
    thermometer. `supply_channel`: channel of the voltmeter for the supply. `pressure_channel`: channel of the barometer. If the
    channel of a quantity is not given, the values of this quantity in the plan are used. `power_on`: time of power-on, in the time
    of the recording, s. `free_angle`: determines the angle of a table without encoder. If it is True, the angle that agrees best
    with the Earth's rate is used. An input that varies once per turn with an unknown phase then counts as noise, as in a diagnosis
    (`Observed.unknown_phase`). If False, the angle is zero at the first sample, unless gravity shows the angle. Raises
    `ObservationError` if the recording cannot be diagnosed.
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
) -> tuple[dict[str, Array], Averaged, float, BodyMotion | None]:
    """Reads one segment, without the rows that contain a NaN.

    Returns four values: the planned states of the segment with its samples or, if `size` is given, with means over `size` samples;
    the rows as they were read; the uncertainty of the temperature, NaN if the temperature changes; and the motion, None if attitude
    and angle describe it. `limits`: full scale of each output."""
    motion = item.segment.motion
    if isinstance(motion, RecordedMotion):
        return _moved_part(item, motion, site, limits, channels, monitors, power_on, size)
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
    accelerometers. Otherwise, the angle is found from all channels if `free_angle` is True, and is zero if `free_angle` is
    False."""
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
) -> tuple[dict[str, Array], Averaged, float, BodyMotion | None]:
    """Does the same as `_part` for a segment whose motion is recorded. Samples at full scale are left out, because the motion is
    not known there."""
    own = [channel.name for channel in channels if channel.name in motion.channels]
    if own:
        message = f"'{own[0]}' shows the motion of segment '{item.label}', so it cannot be compared with this motion"
        raise ObservationError(message, "leave it out of the outputs, or give the motion by other channels")
    extra = [*motion.channels, *monitors.channels]
    rows = rows_of(item, channels, extra, size, motion.angle or None)
    time, table = rows.time, rows.table
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
            f"segment '{item.label}' holds {len(rows.time)} usable samples: leave it out or record it again"
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
