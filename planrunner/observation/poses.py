"""Makes observations of poses in unknown orientations. While a sensor that is turned by hand is at rest, only the magnitude |f| = g
of the specific force is known.

The readings in a pose are a = M·f + b + noise. The two components of the readings that are perpendicular to f determine only the
unknown orientation. One observation per sample remains: the component along u = f/g,

    u·a = g + u·b + g·uᵀ(M − 1)u + noise.

Errors that rotate f (a tilt, an azimuth, a rotation of the whole triad) can therefore not be observed. Only three sums of two
misalignments can be observed, for example the sum of x toward y and y toward x. These sums are the non-orthogonalities. The
direction u is found from the mean of the pose and the fitted nominal model by Gauss-Newton steps. If an effect of relative size δ
is not in the nominal model, it rotates u by at most δ, which changes u·a only by g·δ²/2.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.base.arrays import Array
from planrunner.error_model.observed import Channel, Observed, ObservedSegment, joined
from planrunner.instruments.models import SensorModel
from planrunner.observation.bins import bins_of, seen_along, sizes
from planrunner.observation.refusals import ObservationError
from planrunner.observation.samples import channels_of, rows_of
from planrunner.observation.surroundings import temperature_of
from planrunner.physics.earth import Site
from planrunner.plan.schedule import RecordedMotion, Rest

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
    """Finds the directions of the specific force in the sensor's axes while the nominal model is fitted to the mean readings. The
    readings [m/s²] and the directions have the shape (S, 3).

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
        "the readings of the poses are not close to a sphere of radius g: check the unit of the channels, and whether "
        "the sensor was still"
    )


def _columns(unit: Array, gravity: float, nominal: Sequence[str]) -> Array:
    """Returns one column for each parameter of the terms in `nominal`: bias, scale factors and non-orthogonalities. A column
    contains the changes of the reading along `unit` (S, 3) per unit of the parameter."""
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
    """Returns an attitude (3, 3) whose vertical has the direction `up` in sensor axes; its azimuth is arbitrary."""
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    east = np.cross(helper, up)
    east /= np.linalg.norm(east)
    return np.column_stack([east, np.cross(up, east), up])
