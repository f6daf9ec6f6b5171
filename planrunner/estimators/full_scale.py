"""Whether planned rates go beyond what an output can show: a saturated output bends the line that its scale factor comes from."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.interface import DesignRequest, Remark
from planrunner.plan.schedule import Cycle
from planrunner.plan.units import unit

Array = NDArray[np.float64]

_ROUNDING = 1e-9  # relative, of a rate that is the full scale itself
_AXES = "xyz"
UP = (0.0, 0.0, 1.0)  # about which cycles turn


def beyond_full_scale(request: DesignRequest, outputs: Sequence[str], shares: Array) -> list[Remark]:
    """An error for each output whose declared full scale is less than what the fastest planned rate would show.

    shares: (n, m), the part of each segment's rate that each output's axis feels. An output in another unit than that of a rate needs a
    declared scale factor K_… to be judged; one of specific force is not judged.
    """
    found = []
    rates = np.array([getattr(segment.motion, "rate", 0.0) for segment in request.segments], dtype=float)
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
                f"'{name}' would show {shown[most]:.4g} {model.unit} in '{request.segments[most].label}', beyond its full scale of "
                f"{model.full_scale:.4g} {model.unit}"
            )
            hint = f"turn at {math.degrees(model.full_scale / shown[most] * abs(rates[most])):.4g} deg/s at most"
            found.append(Remark("physics-full-scale", message, hint, error=True))
    return found


def shares_by_name(request: DesignRequest, outputs: Sequence[str]) -> Array:
    """What part of the rate each output feels, (n, m): its axis is that of the sensor that its name ends with (gyro_x: x), or of the
    plan's `mounting`. All of the rate where the name does not tell, none where the orientation is unknown."""
    shares = np.zeros((len(request.segments), len(outputs)))
    directions = [_direction(request, name.rpartition("_")[2]) for name in outputs]
    for row, segment in enumerate(request.segments):
        about = UP if isinstance(segment.motion, Cycle) else getattr(segment.motion, "about", None)
        if about is None or segment.attitude is None:
            continue
        seen = np.asarray(segment.attitude) @ (np.asarray(about, dtype=float) / np.linalg.norm(about))
        for column, direction in enumerate(directions):
            shares[row, column] = 1.0 if direction is None else direction @ seen
    return shares


def _direction(request: DesignRequest, axis: str) -> Array | None:
    """An input axis in the sensor's frame; without azimuth only its part along z, so that no rate is refused that may be right."""
    mounted = request.setup.mounting.get(axis)
    if mounted is not None:
        across = 0.0 if mounted.azimuth is None else math.sin(mounted.angle.value)
        azimuth = 0.0 if mounted.azimuth is None else mounted.azimuth.value
        return np.array([across * math.cos(azimuth), across * math.sin(azimuth), math.cos(mounted.angle.value)])
    return np.eye(3)[_AXES.index(axis)] if axis in tuple(_AXES) else None
