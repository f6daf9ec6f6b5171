"""Poses in unknown orientations as observations: of a sensor tumbled by hand only |f| = g is known while it rests.

A pose's readings are a = M·f + b + noise with |f| = g. What is across f is a matter of the orientation, which nobody knows and which
takes up two numbers a pose; what is left is one observation a sample along u = f/g:

    u·a = g + u·b + g·uᵀ(M − 1)u + noise.

So errors that turn f (a tilt, an azimuth, a rotation of the whole triad) have no signature, and of the six misalignments only the sums of
opposite ones, three non-orthogonalities, have one. u follows from the pose's own mean and the fitted nominal model, by Gauss-Newton steps;
what is not nominal turns u by its own size δ at most and changes u·a by g·δ²/2, of second order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.error_model.observed import Channel, Observed
from planrunner.instruments.models import SensorModel
from planrunner.observation.bins import bins_of, seen_along, sizes
from planrunner.observation.refusals import ObservationError
from planrunner.observation.samples import channels_of, rows_of
from planrunner.observation.temperature import temperature_of
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Rest

Array = NDArray[np.float64]
_STEPS = 20
_PAIRS = ((0, 1), (0, 2), (1, 2))


def unknown_orientations(recording: Sequence[RecordedSegment]) -> bool:
    """Whether segments rest in orientations that the plan does not know. Raises `ObservationError` where only some do, or one moves."""
    unknown = [item.label for item in recording if item.segment.attitude is None]
    if not unknown:
        return False
    if len(unknown) < len(recording):
        message = f"the orientation of segment '{unknown[0]}' is unknown, that of others is known"
        raise ObservationError(
            f"{message}: choose the ones or the others with `segments` under `diagnosis` in the plan"
        )
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
    axes: Mapping[str, str] | None = None,
    power_on: float = 0.0,
) -> Observed:
    """Recorded poses as a diagnosis needs them: one channel `accel`, what the accelerometers read along gravity.

    nominal: what the simulation fits, by which directions are found. Gyros are left out: at rest in an unknown orientation they show a bias
    and nothing beside it. Raises `ObservationError` without a whole triad of accelerometers, and where the readings lie near no sphere.
    """
    recording = in_time_order(recording)
    found = [channel for channel in channels_of(recording[0], sensor, axes) if channel.kind == "accel"]
    triad = {channel.axis: channel for channel in found}
    if len(found) != 3 or len(triad) != 3:
        message = f"orientations are unknown, and of the accelerometers {len(found)} are recorded"
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
    time = [part.time - power_on for part in rows]
    samples = [np.column_stack([part.table[name] for name in names]) * factors for part in rows]
    warm = [temperature_of(item, part.time, None) for item, part in zip(recording, rows, strict=True)]
    directions = directions_of(np.array([part.mean(axis=0) for part in samples]), site.gravity, nominal)
    white = np.array([triad[axis].white for axis in range(3)])
    noise = np.sqrt(directions**2 @ white**2)
    level = float(noise.mean())
    # Axes differ in noise, so poses do: each is scaled to the mean level.
    along = directions * (level / noise if level > 0 else np.ones(len(noise)))[:, None]
    count = sum(map(len, time))
    return Observed(
        site,
        (Channel("accel", "accel", 0, triad[0].unit, triad[0].factor, level),),
        tuple(item.label for item in recording),
        tuple(item.segment.motion for item in recording),
        np.array([_attitude(direction) for direction in directions]),
        np.concatenate(([0], np.cumsum([len(part) for part in time]))).astype(np.int64),
        np.concatenate(time),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.concatenate([part.celsius for part in warm]),
        np.concatenate([part.rate for part in warm]),
        np.zeros(len(recording)),
        np.concatenate([part @ weight for part, weight in zip(samples, along, strict=True)])[:, None],
        rejected=sum(part.rejected for part in rows),
        along=along,
        bins=None if size is None else seen_along(bins_of(size, rows), along),
    )


def directions_of(means: Array, gravity: float, nominal: Sequence[str]) -> Array:
    """The directions of specific force (S, 3) in the sensor's axes, from mean readings (S, 3), m/s², and the nominal model fitted to them.

    Raises `ObservationError` where the fit leads nowhere.
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
    raise ObservationError(
        "the readings of the poses are not close to a sphere of radius g: check the unit of the channels, and whether "
        "the sensor was still"
    )


def _columns(unit: Array, gravity: float, nominal: Sequence[str]) -> Array:
    """What bias, scale factors and non-orthogonalities change along `unit` (S, 3), those that are nominal."""
    parts = [np.empty((len(unit), 0))]
    if "accel_bias" in nominal:
        parts.append(unit)
    if "accel_scale_factor" in nominal:
        parts.append(gravity * unit**2)
    if "accel_misalignment" in nominal:
        parts.append(np.column_stack([2 * gravity * unit[:, i] * unit[:, j] for i, j in _PAIRS]))
    return np.hstack(parts)


def _changed(step: Array, nominal: Sequence[str]) -> tuple[Array, Array]:
    """A step in the parameters of `_columns` as changes of bias (3,) and matrix (3, 3)."""
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
    """An attitude (3, 3) in which the sensor sees up along `up`; its azimuth means nothing."""
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    east = np.cross(helper, up)
    east /= np.linalg.norm(east)
    return np.column_stack([east, np.cross(up, east), up])
