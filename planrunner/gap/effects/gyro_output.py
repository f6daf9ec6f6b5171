"""Effects at a gyro's output: its bandwidth, its dead zone and its limits, exact at every value of a grid; and those on its noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planrunner.gap.effects.interface import Array, Column, Shaped, Variant, on_stimulus
from planrunner.gap.observed import Observed

DEG = np.pi / 180
_FORGOTTEN = 1e-18  # of a sample: less is below rounding


class GyroBandwidth(Shaped):
    """First-order lag 1/(τs + 1) of the output, steady when a segment begins; visible where the rate changes."""

    id, stage, shape_name, shape_unit = "gyro_bandwidth", "output", "tau", "s"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(5e-4, 0.2, 14) if observed.acceleration.any() else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        change = lagged(observed, value) - observed.omega
        return Variant((Column("share", "1", 1.0, 1.0, on_stimulus(observed, change, None)),), value)


def lagged(observed: Observed, tau: float) -> Array:
    """The nominal rate (N, 3) behind a first-order lag: the exact response to a ramp from sample to sample, in all moving segments at
    once. What is remembered of earlier samples, decay^k of the k-th before, is summed in doublings of the reach."""
    out = observed.omega.copy()
    which = [index for index, part in enumerate(observed.segments()) if observed.acceleration[part].any()]
    moving = [observed.segments()[index] for index in which]
    step = (observed.bin_size[which] / observed.sample_rate)[:, None]
    decay = np.exp(-step / tau)
    share = tau / step * (1 - decay)
    longest = max(part.stop - part.start for part in moving)
    rate = np.zeros((longest, len(moving), 3))
    for place, part in enumerate(moving):
        rate[: part.stop - part.start, place] = observed.omega[part]
    driven = (1 - share) * rate
    driven[1:] += (share - decay) * rate[:-1]
    driven[0] = rate[0]
    late, reach = driven, 1
    while reach < longest and (decay > _FORGOTTEN).any():
        late[reach:] += decay * late[:-reach]
        decay, reach = decay**2, 2 * reach
    for place, part in enumerate(moving):
        out[part] = late[: part.stop - part.start, place]
    return out


class GyroDeadZone(Shaped):
    """Lock-in: 0 for |y| < d, else sign(y)·√(y² − d²)."""

    id, stage, shape_name, shape_unit = "gyro_dead_zone", "output", "d", "deg/s"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(1e-3, 2.0, 18) if observed.of_kind("gyro") else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        squares = (value * DEG) ** 2
        return _changed(observed, lambda y: np.sign(y) * np.sqrt(np.maximum(y**2 - squares, 0.0)), value)


class GyroSaturation(Shaped):
    """Output clipped at ±limit."""

    id, stage, shape_name, shape_unit = "gyro_saturation", "output", "limit", "deg/s"

    def grid(self, observed: Observed) -> Array:
        if not observed.of_kind("gyro") or not observed.rate.any():
            return np.empty(0)
        largest = float(np.abs(observed.nominal_output[:, observed.of_kind("gyro")]).max())
        return largest / DEG * (1 - np.geomspace(0.6, 1e-7, 32))

    def at(self, observed: Observed, value: float) -> Variant:
        return _changed(observed, lambda y: np.clip(y, -value * DEG, value * DEG), value)


def _changed(observed: Observed, output: Callable[[Array], Array], shape: float) -> Variant:
    """A function of the gyros' nominal output, as what it adds."""
    nominal = observed.nominal_output
    parts = {index: output(nominal[:, index]) - nominal[:, index] for index in observed.of_kind("gyro")}
    return Variant((Column("share", "1", 1.0, 1.0, parts),), shape)


class GyroBiasRandomWalk:
    """A bias that walks at random beyond the declared noise: covariance q²·min(t, t') between moments."""

    id, stage, noise = "gyro_bias_random_walk", "covariance", "random walk"

    def variants(self, observed: Observed) -> list[Variant]:
        return []


class GyroNoiseExcess:
    """White noise density larger than declared."""

    id, stage, noise = "gyro_noise_excess", "covariance", "white"

    def variants(self, observed: Observed) -> list[Variant]:
        return []


class GyroQuantization:
    """Resolution coarser than declared: every output is a multiple of a larger count."""

    id, stage, noise = "gyro_quantization", "covariance", "resolution"

    def variants(self, observed: Observed) -> list[Variant]:
        return []
