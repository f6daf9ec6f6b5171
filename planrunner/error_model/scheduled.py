"""Represents a schedule as a recording without values. The recording has the segments and channels on which effects will act."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.error_model.observed import (
    REFERENCE_TEMPERATURE,
    STANDARD_PRESSURE,
    Channel,
    Observed,
    ObservedSegment,
    channel_of,
    joined,
    planned_excess,
)
from planrunner.instruments.models import NOMINAL_SUPPLY, SensorModel
from planrunner.physics.earth import Site
from planrunner.physics.sampled_motion import motion_at
from planrunner.plan.schedule import Motion, Rest, Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS

_SAMPLES = 8  # number of samples of each segment


def sensor_channels(sensor: SensorModel) -> tuple[Channel, ...]:
    """Returns the channels of a sensor on which effects can act."""
    listed = ((o.name, o.unit, o.noise.white, o.noise.bias_instability, o.noise.resolution) for o in sensor.outputs)
    return tuple(made for one in listed if (made := channel_of(*one)) is not None)


def everything(site: Site, channels: Sequence[Channel], rate: float) -> Observed:
    """Returns an example of a schedule with everything that an effect may need: several orientations, a constant rate, rocking, and
    changes of temperature, supply voltage and ambient pressure."""
    places = [np.eye(3), np.roll(np.eye(3), 1, 0), np.roll(np.eye(3), 2, 0), np.diag([1.0, -1.0, -1.0])]
    spin, rock = Spin(np.radians(100.0)), Rock(np.radians(5.0), 1.0, (0.0,), 10.0)
    motions: list[Motion] = [Rest(), Rest(), Rest(), Rest(), spin, rock]
    warm = [298.15, 298.15, 318.15, 278.15, 298.15, 298.15]
    segments = [
        Segment(
            i,
            f"S{i}",
            places[i % 4],
            "",
            motion,
            10.0,
            temperature=kelvin,
            supply_voltage=NOMINAL_SUPPLY + i % 2,
            ambient_pressure=STANDARD_PRESSURE - 1e4 * (i % 2),
            start=20.0 * i,
        )
        for i, (motion, kelvin) in enumerate(zip(motions, warm, strict=True))
    ]
    return scheduled(segments, site, channels, rate)


def scheduled(
    segments: Sequence[Segment],
    site: Site,
    channels: Sequence[Channel],
    rate: float,
    nominal_supply: float = NOMINAL_SUPPLY,
) -> Observed:
    """Makes a recording with a few samples of every segment in which the sensor rests or turns about one axis; other segments are
    omitted. `rate`: sampling rate, Hz. `nominal_supply`: nominal supply voltage of the sensor, V."""
    usable = [s for s in segments if s.attitude is not None and isinstance(s.motion, Rest | Spin | Rock)]
    since = np.arange(_SAMPLES) / rate
    warm = [_celsius(segment.begins_at) for segment in usable]
    end = [w if s.ramp_to is None else _celsius(s.ramp_to) for w, s in zip(warm, usable, strict=True)]
    changes = np.sign(np.diff([*warm[:1], *end]))
    parts = []
    for segment, begin, last, change in zip(usable, warm, end, changes, strict=True):
        slope = (last - begin) / (segment.dwell or 1.0)
        voltage, pressure = planned_excess(segment, nominal_supply)
        moving = motion_at(segment.motion, since, None)
        parts.append(
            ObservedSegment(
                segment.label,
                segment.motion,
                np.array(segment.attitude),
                segment.start + since,
                moving["angle"],
                moving["rate"],
                moving["acceleration"],
                begin + since * slope,
                np.full(_SAMPLES, slope),
                np.zeros((_SAMPLES, len(channels))),
                float(change),
                overvoltage=np.full(_SAMPLES, voltage),
                overpressure=np.full(_SAMPLES, pressure),
            )
        )
    return joined(site, channels, parts, magnetic=site.magnetic_field)


def _celsius(kelvin: float | None) -> float:
    return REFERENCE_TEMPERATURE if kelvin is None else kelvin - ZERO_CELSIUS
