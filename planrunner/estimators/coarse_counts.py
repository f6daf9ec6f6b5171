"""Warnings about outputs whose counts are too coarse for their noise, so that rounding errors do not average out."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from planrunner.archive.recording import RecordedSegment
from planrunner.base.said import Said, said
from planrunner.instruments.models import SensorModel
from planrunner.observation.observations import dithered
from planrunner.observation.screening import varies


def coarse_counts(
    segments: Sequence[RecordedSegment], channels: Collection[str], sensor: SensorModel
) -> tuple[Said, ...]:
    """A warning for each of these channels (by default each output of the sensor) whose noise does not dither the counts in some segment.

    Equal inputs then have equal rounding errors, so neither the noise within the segments nor the scatter of repeats shows them.
    """
    found = []
    for output in sensor.outputs:
        if not output.noise.resolution or not varies(output) or (channels and output.name not in channels):
            continue
        coarse = [one.label for one in segments if _coarse(one, output.name, sensor)]
        if coarse:
            found.append(
                said(
                    "{output}: the noise in '{segment}' is too small for counts of {resolution:.4g} {unit}, so rounding errors do "
                    "not average out. They are the same whenever the sensor senses the same input: repeats do not reduce them, "
                    "and scatter may not show them. The uncertainties may be too small, and noise coefficients "
                    "describe the rounding instead of the noise. Record with a finer resolution.",
                    output=output.name,
                    segment=coarse[0],
                    resolution=output.noise.resolution,
                    unit=output.unit,
                )
            )
    return tuple(found)


def _coarse(recorded: RecordedSegment, channel: str, sensor: SensorModel) -> bool:
    statistics = recorded.statistics
    if channel not in statistics.channels or statistics.count < 2:
        return False
    place = statistics.of(channel)
    return not dithered(sensor, channel, float(statistics.covariance[place, place]))
