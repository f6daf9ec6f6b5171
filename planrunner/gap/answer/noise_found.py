"""The noise of each channel in the recording, compared with its declaration. Noise is reported, but is not a rival of the effects
as an explanation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.open_set import Line


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """Noise of a channel, in the channel's unit.

    `white`, `declared`: standard deviation of a single sample, as found in the recording and as declared. `declared` includes the
    rounding to `declared_count`; it is 0 if no noise is declared. `count`, `declared_count`: size of one count, as found in the
    recording and as declared; 0 if the values are not rounded to counts. `slow`: amplitude density at the lowest measured
    frequency, divided by the amplitude density of the white noise; 1 if there is only white noise. `quietest`, `loudest`: standard
    deviation of the noise in the quietest and in the loudest segment, divided by the standard deviation of the white noise. `line`:
    the strongest tone, None if there is none.
    """

    channel: str
    unit: str
    white: float
    declared: float
    count: float
    declared_count: float
    slow: float
    quietest: float
    loudest: float
    line: Line | None


def noise_found(weighing: Weighing, lines: Sequence[Line]) -> tuple[NoiseFound, ...]:
    """The noise of every channel. `lines`: tones in the recording, at most one per channel."""
    declared, noise = weighing.declared, weighing.noise
    by_channel = {line.channel: line for line in lines}
    found = []
    for index, channel in enumerate(declared.channels):
        sample = np.sqrt(channel.white**2 * declared.sample_rate + channel.resolution**2 / 12) if channel.white else 0.0
        level = np.sqrt(noise.level[:, index])
        still = noise.spectrum[int(noise.moving.min()), 0, index]
        found.append(
            NoiseFound(
                channel.name,
                channel.unit,
                float(weighing.white[index] / channel.factor),
                float(sample / channel.factor),
                float(weighing.steps[index] / channel.factor),
                float(channel.resolution / channel.factor),
                float(np.sqrt(still)),
                float(level.min()),
                float(level.max()),
                by_channel.get(channel.name),
            )
        )
    return tuple(found)
