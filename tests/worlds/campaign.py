"""What a campaign is: a test of one device after another, the texts that planrunner is given, and the parts that several benches have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tests.worlds.felt import GRAVITY, LATITUDE, Felt, Step

Array = NDArray[np.float64]


class Device(Protocol):
    """truth: coefficient as planrunner names it → value in the unit that it reports."""

    @property
    def truth(self) -> Mapping[str, float]: ...

    def outputs(self, felt: Felt) -> Array:
        """(n, k), without noise, in the channels' units."""
        ...


@dataclass(frozen=True)
class Campaign:
    """plan, bench: texts; the bench has blanks `{tilt}` in arcsec, `{rate}` in ppm, `{flicker}` and `{count}` by channel. channels:
    name → unit; white: (k,), of one sample; estimate: name in the plan. unsigned: channels that read nothing but their own constant error,
    so that a reversed one is a sound channel of another device. celsius: temperature of the sensor at a share of the test, where the world
    states none. causes: by world, words of a warning that names what is wrong, where this test shows more than others do."""

    plan: str
    bench: str
    steps: Sequence[Step]
    sampling: float
    channels: Mapping[str, str]
    white: Array
    estimate: str
    device: Callable[[np.random.Generator], Device]
    declared: float = 1.0  # the unit of the bench's noise, in the channels' unit
    without: Sequence[str] = ()  # worlds that say nothing of it
    unsigned: Sequence[str] = ()
    celsius: Callable[[Array], Array] | None = None
    causes: Mapping[str, str] = field(default_factory=dict)

    @property
    def signed(self) -> tuple[int, ...]:
        """The other channels, by number."""
        return tuple(k for k, name in enumerate(self.channels) if name not in self.unsigned)

    @property
    def mean(self) -> Array:
        """What white noise leaves in the mean of a step of the shortest length, (k,)."""
        return np.asarray(self.white / np.sqrt(min(step.dwell for step in self.steps) * self.sampling))


SITE = f"site: {{{{latitude: {LATITUDE} deg, gravity: {GRAVITY} m/s^2, azimuth: 0 deg}}}}"
TABLE = """\
  table:
    driver: virtual_table
    axes:
      - {{name: outer, direction: up, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}}
      - {{name: middle, direction: east, max_rate: 200 deg/s, max_acceleration: 100 deg/s^2}}
      - {{name: inner, direction: north, max_rate: 400 deg/s, max_acceleration: 200 deg/s^2}}
    position_uncertainty: {tilt} arcsec
    rate_stability: {rate} ppm
"""
