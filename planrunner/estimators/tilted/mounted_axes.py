"""Describes input axes in a tilted fixture: the output that belongs to each axis of `mounting`, and the directions of the axes in
the fixture.

The fixture's frame is the frame to which the orientations in the plan refer; the plan calls it the sensor's frame. The z axis of
the fixture's frame lies along the rotation axis of the table. Angles of the axes are measured from z; azimuths are measured from x,
right-handed about z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.estimators.interface import EstimationError
from planrunner.plan.model import MountedAxis
from planrunner.plan.schedule import Segment, Spin

BLIND = 1e-3  # cosine (89.94 deg) below which a response cannot be distinguished from an error of the mounting
ALONG = 1e-5  # rad, largest planned angle between the fixture's z axis and the rotation axis


@dataclass(frozen=True, slots=True)
class MountedAxes:
    """The m input axes in a fixture. `names`: names of the axes in `mounting`. `outputs`: names of the channels of the axes.

    `angles`: array of shape (m,) in rad. `azimuths`: array of shape (m,) in rad, NaN for an azimuth that is not stated. `tilt`:
    array of shape (2,) in rad, a small rotation of all axes about the fixture's x and y axes, which is used to compute
    sensitivities.
    """

    names: tuple[str, ...]
    outputs: tuple[str, ...]
    angles: Array
    azimuths: Array
    tilt: tuple[float, float] = (0.0, 0.0)

    @property
    def directions(self) -> Array:
        """Returns the unit vectors along the axes in the fixture's frame, shape (m, 3). An azimuth that is not stated is treated as
        zero."""
        azimuths = np.nan_to_num(self.azimuths)
        across = np.sin(self.angles)
        x, y, z = across * np.cos(azimuths), across * np.sin(azimuths), np.cos(self.angles)
        about_x, about_y = self.tilt
        return np.column_stack([x + about_y * z, y - about_x * z, z + about_x * y - about_y * x])

    def require_azimuths(self) -> None:
        """Raises `EstimationError` if an azimuth that `earth_rate: corrected` needs is not stated."""
        for name, azimuth in zip(self.names, self.azimuths, strict=True):
            if math.isnan(azimuth):
                needs = "`earth_rate: corrected` needs: state it, or write `earth_rate: averaged`"
                raise EstimationError(f"mounting.{name} states no azimuth, which {needs}")


def mounted_axes(mounting: Mapping[str, MountedAxis], available: Sequence[str], chosen: Sequence[str]) -> MountedAxes:
    """Returns the axes of the outputs `chosen`. If no output is chosen, these are all axes of `mounting`. An output belongs to an
    axis if the name of the output ends with the name of the axis.

    `mounting`: maps the name of an axis to its `planrunner.plan.model.MountedAxis`. `available`: names of the existing channels.
    Raises `EstimationError` for an axis without an output, and for an output without an axis.
    """
    if not mounting:
        raise EstimationError(
            "the plan has no `mounting`: give the direction of each input axis, such as `x: {angle: 54.7356 deg, "
            "azimuth: 0 deg}`"
        )
    pairs = [_axis_of(output, available, mounting) for output in chosen] if chosen else _outputs_of(mounting, available)
    names, outputs = tuple(axis for axis, _ in pairs), tuple(output for _, output in pairs)
    for axis in names:
        if names.count(axis) > 1:
            twins = " and ".join(output for one, output in pairs if one == axis)
            raise EstimationError(f"{twins} all belong to mounting.{axis}: give each axis one output in `outputs`")
    return MountedAxes(
        names,
        outputs,
        np.array([mounting[axis].angle.value for axis in names]),
        np.array([math.nan if (about := mounting[axis].azimuth) is None else about.value for axis in names]),
    )


def seeing(axes: MountedAxes) -> MountedAxes:
    """Checks that each axis senses the rate, and returns the axes unchanged. Raises `EstimationError` for an axis perpendicular to
    the rotation axis."""
    for name, angle in zip(axes.names, axes.angles, strict=True):
        if abs(math.cos(angle)) < BLIND:
            raise EstimationError(
                f"mounting.{name}: at {math.degrees(angle):.6g} deg the axis is perpendicular to the rotation axis "
                "and does not respond to its rate: mount it closer to the rotation axis"
            )
    return axes


def rotation_axis(segments: Sequence[Segment], along_z: bool = True) -> Array:
    """Returns the direction about which each segment spins, in the fixture's frame, shape (n, 3); zero for a segment that does not
    spin.

    If the orientation of a segment is unknown, z is assumed to lie along the rotation axis. `along_z`: True to raise an
    `EstimationError` if z does not lie along the rotation axis, because the angles of the mounting are measured from z.
    """
    found = np.zeros((len(segments), 3))
    for row, segment in enumerate(segments):
        if not isinstance(segment.motion, Spin):
            continue
        about = np.asarray(segment.motion.about, dtype=float)
        seen = (
            np.array([0.0, 0.0, 1.0])
            if segment.attitude is None
            else segment.attitude @ (about / np.linalg.norm(about))
        )
        off = math.atan2(math.hypot(seen[0], seen[1]), abs(seen[2]))
        if along_z and off > ALONG:
            raise EstimationError(
                f"in segment '{segment.label}' the fixture's z axis is {math.degrees(off):.4g} deg from the "
                "rotation axis; the angles of `mounting` are measured from z: "
                "choose an orientation whose z axis is along the rotation axis"
            )
        found[row] = seen
    return found


def _belongs(output: str, axis: str) -> bool:
    return output == axis or output.endswith(f"_{axis}")


def _axis_of(output: str, available: Sequence[str], mounting: Mapping[str, MountedAxis]) -> tuple[str, str]:
    if output not in available:
        raise EstimationError(f"there is no output '{output}': {closest(output, available)}")
    found = [axis for axis in mounting if _belongs(output, axis)]
    if not found:
        held = ", ".join(mounting)
        raise EstimationError(
            f"output '{output}' has no axis in `mounting` ({held}): the end of an output's name gives "
            "its axis: gyro_x belongs to x"
        )
    return max(found, key=len), output


def _outputs_of(mounting: Mapping[str, MountedAxis], available: Sequence[str]) -> list[tuple[str, str]]:
    pairs = []
    for axis in mounting:
        found = [output for output in available if _belongs(output, axis)]
        if not found:
            raise EstimationError(
                f"mounting.{axis} has no output: none of {', '.join(available)} ends with '_{axis}'; name `outputs` "
                "or correct `mounting`"
            )
        if len(found) > 1:
            raise EstimationError(f"mounting.{axis} fits {' and '.join(found)}: name the one to use in `outputs`")
        pairs.append((axis, found[0]))
    return pairs
