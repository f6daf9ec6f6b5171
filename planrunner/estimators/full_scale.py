"""Checks that the planned rates act on the fitted outputs and do not exceed the full scale of these outputs.

If an output saturates, its readings no longer lie on the straight line that gives the scale factor. If the input axis of an output
is perpendicular to the rotation axis, the output senses the rotation only through its misalignment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.observed import axis_of
from planrunner.estimators.interface import DesignRequest, Remark
from planrunner.plan.model import MountedAxis
from planrunner.plan.schedule import Cycle, Motion, Segment, Spin
from planrunner.plan.units import unit

_ROUNDING = 1e-9  # relative: a larger excess over the full scale is not rounding
_AXES = "xyz"
_FELT = 0.05  # fraction of the rate below which an output's axis counts as perpendicular to the rotation axis
UP = (0.0, 0.0, 1.0)  # axis of cycles


def beyond_full_scale(request: DesignRequest[object], outputs: Sequence[str], shares: Array) -> list[Remark]:
    """Returns an error for each output whose reading at the fastest planned rate exceeds its declared full scale.

    `shares`: array of shape (n, m), for each of n segments and m outputs, the fraction of the rate that acts along the output's
    axis. An output of specific force is not checked. An output whose unit is not an angular rate is checked only if a scale factor
    K_… is declared for it.
    """
    found = []
    rates = np.array([_rate(segment.motion) for segment in request.segments], dtype=float)
    for k, name in enumerate(outputs):
        model = request.sensor.output(name)
        if model is None or not math.isfinite(model.full_scale) or not rates.size:
            continue
        own = unit(model.unit)
        if own.dimension == unit("m/s^2").dimension:
            continue
        plain = 1.0 if own.dimension == unit("rad/s").dimension else math.nan
        gain = abs(request.sensor.nominal.get(f"K_{name}", plain)) / own.factor
        shown = gain * np.abs(rates * shares[:, k])
        most = int(np.nan_to_num(shown).argmax())
        if shown[most] > model.full_scale * (1 + _ROUNDING):
            message = (
                f"'{name}' would show {shown[most]:.4g} {model.unit} in '{request.segments[most].label}', beyond its "
                "full scale of "
                f"{model.full_scale:.4g} {model.unit}"
            )
            hint = f"turn at {math.degrees(model.full_scale / shown[most] * abs(rates[most])):.4g} deg/s at most"
            found.append(Remark("physics-full-scale", message, hint, error=True))
    return found


def not_turned(request: DesignRequest[object], outputs: Sequence[str], shares: Array) -> list[Remark]:
    """Returns a warning if the planned rates do not act on any output, for example because the table rotates about an axis other
    than the fitted axis.

    `shares`: array of shape (n, m), for each of n segments and m outputs, the fraction of the rate that acts along the output's
    axis. Segments in unknown orientations and outputs of specific force are not checked.
    """
    moving = [row for row, segment in enumerate(request.segments) if isinstance(segment.motion, Spin)]
    if not moving or any(request.segments[row].attitude is None for row in moving):
        return []
    sensing = [k for k, name in enumerate(outputs) if _turns(request, name)]
    felt = np.abs(shares[moving]).max(axis=0) if outputs else np.zeros(0)
    if not sensing or max(felt[k] for k in sensing) >= _FELT:
        return []
    nearest = max(sensing, key=lambda k: float(felt[k]))
    off = math.degrees(math.acos(min(1.0, float(felt[nearest]))))
    message = (
        f"'{outputs[nearest]}' does not respond to the planned rates: its input axis is {off:.3g} deg from the "
        "rotation axis, so that the "
        "slope is its misalignment, not its scale factor"
    )
    turned = _nearest_axis(request, moving[0])
    hint = f"align its input axis with the rotation axis, or fit an output along {turned}, about which the table turns"
    return [Remark("physics-input-axis", message, hint, "outputs")]


def _turns(request: DesignRequest[object], name: str) -> bool:
    """Returns True if an output measures rotation about a known axis, judged from its unit and its name."""
    model = request.sensor.output(name)
    rotation = (unit("rad/s").dimension, unit("pulse/s").dimension)
    return (
        model is not None
        and input_direction(request.setup.mounting, name) is not None
        and unit(model.unit).dimension in rotation
    )


def _nearest_axis(request: DesignRequest[object], row: int) -> str:
    segment = request.segments[row]
    assert segment.attitude is not None and isinstance(segment.motion, Spin)
    return _AXES[int(np.abs(np.asarray(segment.attitude) @ np.asarray(segment.motion.about)).argmax())]


def _rate(motion: Motion) -> float:
    return motion.rate if isinstance(motion, Spin | Cycle) else 0.0


def _axis(motion: Motion) -> tuple[float, float, float] | None:
    """Returns the rotation axis in site axes; None for a motion without a single axis."""
    if isinstance(motion, Cycle):
        return UP
    return motion.about if isinstance(motion, Spin) else None


def shares_by_name(segments: Sequence[Segment], mounting: Mapping[str, MountedAxis], outputs: Sequence[str]) -> Array:
    """Computes which fraction of the rate acts along the input axis of each output. Returns an array of shape (n, m) for n segments
    and m outputs. The input axis is the sensor axis in the output's name (gyro_x: x), or the direction that the plan's `mounting`
    gives for this axis. The fraction is one if the name contains no axis, and zero if the orientation is unknown."""
    return shares_along(segments, [input_direction(mounting, name) for name in outputs])


def shares_along(segments: Sequence[Segment], directions: Sequence[Array | None]) -> Array:
    """Computes which fraction of the rate acts along each input axis. Returns an array of shape (n, m) for n segments and m axes.
    `directions`: each input axis as a vector (3,) in the sensor's frame, or None; for None, the fraction is one."""
    shares = np.zeros((len(segments), len(directions)))
    for row, segment in enumerate(segments):
        about = _axis(segment.motion)
        if about is None or segment.attitude is None:
            continue
        seen = np.asarray(segment.attitude) @ (np.asarray(about, dtype=float) / np.linalg.norm(about))
        for column, direction in enumerate(directions):
            shares[row, column] = 1.0 if direction is None else direction @ seen
    return shares


def input_direction(mounting: Mapping[str, MountedAxis], output: str) -> Array | None:
    """Returns the input axis of an output as a vector (3,) in the sensor's frame; None if the name of the output contains no axis.
    If `mounting` contains the axis in the output's name, the direction comes from `mounting`; otherwise, the direction is that of
    the sensor axis. If the azimuth of the axis is not given, only its z component is known, and the other two components are set to
    zero, so that no valid rate is rejected."""
    axis = axis_of(output)
    if axis is None:
        return None
    mounted = mounting.get(_AXES[axis])
    if mounted is not None:
        across = 0.0 if mounted.azimuth is None else math.sin(mounted.angle.value)
        azimuth = 0.0 if mounted.azimuth is None else mounted.azimuth.value
        return np.array([across * math.cos(azimuth), across * math.sin(azimuth), math.cos(mounted.angle.value)])
    return np.array(np.eye(3)[axis])
