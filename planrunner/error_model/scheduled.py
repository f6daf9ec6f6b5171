"""A schedule as a recording without values: the segments and channels on which effects will act."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.error_model.observed import REFERENCE_TEMPERATURE, Channel, Observed
from planrunner.instruments.models import SensorModel
from planrunner.physics.earth import Site
from planrunner.physics.sampled_motion import motion_at
from planrunner.plan.schedule import Motion, Rest, Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS, unit

_SAMPLES = 8  # of each segment
_KINDS = {unit("rad/s").dimension: "gyro", unit("m/s^2").dimension: "accel"}


def channel(name: str, text: str, white: float, flicker: float, step: float) -> Channel | None:
    """The channel of an output of angular rate or acceleration whose name gives an axis, such as gyro_x; None for other outputs. text:
    unit of noise and count."""
    kind = _KINDS.get(unit(text).dimension)
    axis = name.rpartition("_")[2]
    if kind is None or axis not in ("x", "y", "z"):
        return None
    factor = unit(text).factor
    return Channel(name, kind, "xyz".index(axis), text, factor, white * factor, flicker * factor, step * factor)


def sensor_channels(sensor: SensorModel) -> tuple[Channel, ...]:
    """The outputs that effects can act on."""
    listed = ((o.name, o.unit, o.noise.white, o.noise.bias_instability, o.noise.resolution) for o in sensor.outputs)
    return tuple(made for one in listed if (made := channel(*one)) is not None)


def everything(site: Site, channels: Sequence[Channel], rate: float) -> Observed:
    """A schedule with everything that any effect may need: orientations, a rate, rocking, changes of temperature."""
    places = [np.eye(3), np.roll(np.eye(3), 1, 0), np.roll(np.eye(3), 2, 0), np.diag([1.0, -1.0, -1.0])]
    spin, rock = Spin(np.radians(100.0)), Rock(np.radians(5.0), 1.0, (0.0,), 10.0)
    motions: list[Motion] = [Rest(), Rest(), Rest(), Rest(), spin, rock]
    warm = [298.15, 298.15, 318.15, 278.15, 298.15, 298.15]
    segments = [
        Segment(i, f"S{i}", places[i % 4], "", motion, 10.0, temperature=kelvin, start=20.0 * i)
        for i, (motion, kelvin) in enumerate(zip(motions, warm, strict=True))
    ]
    return scheduled(segments, site, channels, rate)


def scheduled(segments: Sequence[Segment], site: Site, channels: Sequence[Channel], rate: float) -> Observed:
    """A few samples of every segment that turns about one axis or rests; such segments only. rate: Hz."""
    usable = [s for s in segments if s.attitude is not None and isinstance(s.motion, Rest | Spin | Rock)]
    since = np.arange(_SAMPLES) / rate
    parts = [motion_at(segment.motion, since, None) for segment in usable]
    warm = [_celsius(segment.temperature) for segment in usable]
    end = [w if s.ramp_to is None else _celsius(s.ramp_to) for w, s in zip(warm, usable, strict=True)]
    slope = [(e - w) / (s.dwell or 1.0) for w, e, s in zip(warm, end, usable, strict=True)]
    samples = _SAMPLES * len(usable)
    turning = {
        name: np.concatenate([part[name] for part in parts]) if parts else np.zeros(0)
        for name in ("angle", "rate", "acceleration")
    }
    return Observed(
        site,
        tuple(channels),
        tuple(segment.label for segment in usable),
        tuple(segment.motion for segment in usable),
        np.array([segment.attitude for segment in usable], dtype=float).reshape(-1, 3, 3),
        _SAMPLES * np.arange(len(usable) + 1),
        time=np.concatenate([segment.start + since for segment in usable]) if usable else np.zeros(0),
        angle=turning["angle"],
        rate=turning["rate"],
        acceleration=turning["acceleration"],
        temperature=np.repeat(warm, _SAMPLES) + np.tile(since, len(usable)) * np.repeat(slope, _SAMPLES),
        temperature_rate=np.repeat(slope, _SAMPLES),
        last_change=np.sign(np.diff([*warm[:1], *end])) if usable else np.zeros(0),
        values=np.zeros((samples, len(channels))),
        magnetic=None if site.magnetic_field is None else np.array(site.magnetic_field),
    )


def _celsius(kelvin: float | None) -> float:
    return REFERENCE_TEMPERATURE if kelvin is None else kelvin - ZERO_CELSIUS
