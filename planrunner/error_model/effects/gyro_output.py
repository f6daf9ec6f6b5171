"""Effects at a gyro's output. The effects of bandwidth, dead zone and limits are computed exactly for every value of their shape
(the time constant, the dead zone, the limit) that a diagnosis tries. Other effects of this module change only the noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import (
    About,
    Actor,
    Column,
    Shaped,
    Variant,
    WithoutColumns,
    on_rate,
    single,
    whole,
)
from planrunner.error_model.observed import Observed

DEG = np.pi / 180
_LINEAR = 0.02  # fraction of the largest output; below it, a soft limit changes an output by less than 1e-5 of its largest change
_FRACTIONS = 1 - np.concatenate([np.linspace(0.95, 0.65, 7), np.geomspace(0.6, 1e-7, 32)])
"""Limits that a diagnosis tries first, as fractions of the largest output."""
_LARGEST = 100  # number of largest readings among which a limit is searched
_REPEATED = 10  # smallest number of equal readings that stand at a limit
_ROUNDING = 1e-9  # relative difference up to which readings are equal
_SHORT = 1e-6  # s, a delay so short that the secant equals the tangent


def _frequencies(tau: float) -> Mapping[str, str]:
    """Returns the bandwidth 1/(2πτ) of a first-order lag, and the frequency at which the phase of its output lags by one degree."""
    bandwidth = 1 / (2 * np.pi * max(abs(tau), 1e-9))
    return {"bandwidth": f"{bandwidth:.3g} Hz", "frequency": f"{bandwidth * np.tan(DEG):.2g} Hz"}


class GyroBandwidth(Shaped):
    """Passes the output through a first-order lag 1/(τs + 1). The lag is in steady state when a segment begins, so it changes the
    output only where the rate changes."""

    id, stage, shape_name, shape_unit = "gyro_bandwidth", "output", "tau", "s"
    about = About(
        "gyro output lags behind the rate",
        "A low-pass filter of first order attenuates and delays the output of the gyros when the rate changes.",
        Actor.SENSOR,
        "Raise the bandwidth of the gyros (now {bandwidth}), or rock at {frequency} or slower, so that the phase lag is "
        "below 1 deg: {found}.",
        _frequencies,
    )
    shown_by, acts_on = "rocking segments", "rate"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(5e-4, 0.2, 14) if observed.unsteady.any() else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        return Variant((whole(on_rate(observed, lagging(observed, value)), observed.unsteady),), value)


def lagging(observed: Observed, tau: float) -> Array:
    """Computes how a first-order lag changes the nominal rate, shape (N, 3). The change is zero in segments with a constant rate. While
    the table rocks with the angular frequency p, its motion is assumed to be harmonic and in steady state: the lagged rate is (ω −
    τ·dω/dt)/(1 + (pτ)²)."""
    change = observed.turn_lagged(tau)
    for rows in observed.rocked:
        squared = (observed.pulsation[rows] * tau) ** 2
        slower = -(tau * observed.acceleration[rows] + squared * observed.rate[rows]) / (1 + squared)
        change[rows] += slower[:, None] * observed.table_axis[rows]
    return change


class GyroAxisDelay:
    """Each gyro has its own delay: at any moment, its output shows the rate at an earlier moment. A negative delay means that the
    output shows the rate at a later moment."""

    id, stage = "gyro_axis_delay", "acquisition"
    about = About(
        "gyro axes are delayed differently",
        "The channels of the gyros are sampled or filtered with different delays, so that each shows the motion at a different moment.",
        Actor.SENSOR,
        "Align the channels in time by their delays, or sample them simultaneously: {found}.",
    )
    shown_by = "rocking segments about each axis, or a recorded motion whose rate changes"

    def variants(self, observed: Observed) -> list[Variant]:
        return self.around(observed, np.zeros(3))

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        """Returns one column per gyro: the change of the gyro's output due to a delay, divided by the delay. `amplitudes`: the
        delays [s] for which the columns are exact."""
        gyros = [index for index in observed.of_kind("gyro") if observed.along is None]
        if not observed.unsteady.any() or not gyros:
            return []
        columns = []
        for index, amplitude in zip(gyros, amplitudes, strict=False):
            delay = float(amplitude) or _SHORT
            parts = {index: on_rate(observed, observed.turn_before(delay))[index] / delay}
            axis = observed.channels[index].axis
            columns.append(Column(f"d_{'xyz'[axis]}", "ms", 1e-3, 1e-3, parts, observed.unsteady, axis=axis))
        return single(columns)


class GyroDeadZone(Shaped):
    """Lock-in: an output y becomes 0 if |y| is below the threshold d, otherwise sign(y)·√(y² − d²)."""

    id, stage, shape_name, shape_unit = "gyro_dead_zone", "output", "d", "deg/s"
    about = About(
        "gyro does not respond to small rates",
        "Below a threshold the output of the gyros stays at zero, as in the lock-in of ring lasers without dither.",
        Actor.SENSOR,
        "Dither the sensor, or record at rates well above the threshold: {found}.",
    )
    shown_by, acts_on = "slow rates about the axis, or rocking, with rates above and below the threshold", "output"

    def grid(self, observed: Observed) -> Array:
        return np.geomspace(1e-3, 2.0, 18) if observed.of_kind("gyro") else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        squares = (value * DEG) ** 2
        return _changed(observed, lambda y: np.copysign(np.sqrt(np.maximum(y**2 - squares, 0.0)), y), value, None)


class GyroSaturation(Shaped):
    """Clips the output at the same limit in both directions."""

    id, stage, shape_name, shape_unit = "gyro_saturation", "output", "limit", "deg/s"
    about = About(
        "gyro output is clipped",
        "The output of the gyros is clipped at a limit that is smaller than the largest rate of the plan.",
        Actor.PLAN,
        "Keep the rates of the plan below the limit, or set a larger measurement range in the sensor: {found}.",
    )
    shown_by, acts_on = "rates about the axis above the limit and below it", "output"

    def grid(self, observed: Observed) -> Array:
        if not observed.of_kind("gyro") or not observed.turn.any():
            return np.empty(0)
        return float(observed.largest_gyro_output.max()) / DEG * _FRACTIONS

    def at(self, observed: Observed, value: float) -> Variant:
        return _clipped(observed, value, (-value * DEG, value * DEG))


class _OneSided(Shaped):
    """Clips the output at one of its two limits. `sign`: 1 for the upper limit, −1 for the lower limit. The shape parameter is the
    magnitude of this limit. `other`: magnitude of the limit in the other direction, rad/s; infinite if there is none. A diagnosis
    tries only limits whose magnitude the unclipped output exceeds in both directions. For other limits, the effect cannot be
    distinguished from `gyro_saturation`."""

    stage, shape_unit, acts_on = "output", "deg/s", "output"
    sign: int

    def __init__(self, effect: str, other: float = np.inf):
        self.id, self.other = effect, other

    def grid(self, observed: Observed) -> Array:
        if not observed.of_kind("gyro") or not observed.turn.any():
            return np.empty(0)
        reached = float(np.abs(observed.gyro_range).max(axis=0).min())
        return reached / DEG * _FRACTIONS if reached > 0 else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        limit = value * DEG
        return _clipped(observed, value, (-self.other, limit) if self.sign > 0 else (-limit, self.other))

    def opposite(self, value: float) -> _OneSided | None:
        """Returns the effect with the limit of the other direction as its shape parameter, if there is such a limit. `value`: the
        limit of this direction, deg/s."""
        if not np.isfinite(self.other):
            return None
        return (_Below if self.sign > 0 else _Above)(self.id, value * DEG)


class _Above(_OneSided):
    """Clips the output at an upper limit."""

    shape_name, sign = "upper", 1


class _Below(_OneSided):
    """Clips the output at a lower limit; the shape parameter is the magnitude of this limit."""

    shape_name, sign = "lower", -1


class GyroSaturationAsymmetric:
    """Clips the output at +upper and at −lower. The limits differ, for example because an offset is added to the output before
    clipping. It is a hypothesis only if many readings are equal to a limit, and other readings exceed this limit in the other
    direction."""

    id, stage, hypothesis = "gyro_saturation_asymmetric", "output", False
    about = About(
        "gyro output is clipped in one direction",
        "The output of the gyros is clipped at a limit that is smaller in one direction of rotation than in the other.",
        Actor.PLAN,
        "Keep the rates of the plan below the smaller limit, or remove the offset before the output is clipped: {found}.",
    )

    def __init__(self) -> None:
        self.alternatives = (_Above(self.id), _Below(self.id))

    def variants(self, observed: Observed) -> list[Variant]:
        return [variant for one in self.alternatives for variant in one.variants(observed)]

    def shown_in(self, observed: Observed) -> bool:
        return bool(self.ways_shown(observed))

    def ways_shown(self, observed: Observed) -> list[Shaped]:
        """Returns the ways in which the readings may be clipped: at one limit, or at different limits in both directions. The
        result is empty if the readings of the gyros do not stand at a limit, or if they do not exceed it in the other direction
        either."""
        readings = observed.values[:, observed.of_kind("gyro")].ravel()
        upper, lower = _repeated_maximum(readings), _repeated_maximum(-readings)
        if not observed.turn.any() or max(_count_beyond(-readings, upper), _count_beyond(readings, lower)) < _REPEATED:
            return []
        if np.isfinite(lower) and np.isfinite(upper):
            return [_Above(self.id, lower)]
        return [_Above(self.id) if np.isfinite(upper) else _Below(self.id)]


class GyroSoftSaturation(Shaped):
    """Turns an output y into L·tanh(y/L), which approaches the limit L gradually."""

    id, stage, shape_name, shape_unit = "gyro_soft_saturation", "output", "limit", "deg/s"
    about = About(
        "gyro output saturates gradually",
        "The output of the gyros increases less and less with the rate as it approaches a limit, as in an amplifier that overloads.",
        Actor.SENSOR,
        "Keep the rates well below the limit, or linearise the output: {found}.",
    )
    shown_by, acts_on = "three rates about the axis, in both directions", "output"

    def grid(self, observed: Observed) -> Array:
        if not observed.of_kind("gyro") or not observed.turn.any():
            return np.empty(0)
        return float(observed.largest_gyro_output.max()) / DEG * np.geomspace(0.7, 300.0, 14)

    def at(self, observed: Observed, value: float) -> Variant:
        limit, largest = value * DEG, observed.largest_gyro_output
        acting = largest > _LINEAR * largest.max(initial=0.0)
        return _changed(observed, lambda y: limit * np.tanh(y / limit), value, acting)


class GyroFoldOver(Shaped):
    """Turns an output y into y − 2L·floor((y + L)/2L): an output beyond ±L continues from the other end of the range, as if a
    counter overflowed."""

    id, stage, hypothesis, shape_name, shape_unit = "gyro_fold_over", "output", False, "limit", "deg/s"
    about = About(
        "gyro output folds over at its limit",
        "If the rate exceeds a limit, the output of the gyros continues from the opposite limit, like a counter that overflows.",
        Actor.PLAN,
        "Keep the rates of the plan below the limit, or set a larger measurement range in the sensor: {found}.",
    )

    not_fitted = (
        "The parameters of the simulation are fitted first, and a fit to folded readings no longer shows the limit."
    )

    def grid(self, observed: Observed) -> Array:
        return GyroSaturation().grid(observed)

    def at(self, observed: Observed, value: float) -> Variant:
        limit = value * DEG
        beyond = observed.largest_gyro_output > limit
        return _changed(observed, lambda y: y - 2 * limit * np.floor((y + limit) / (2 * limit)), value, beyond)


def _repeated_maximum(readings: Array) -> float:
    """Returns the limit at which the largest of the readings (n,) stand. Readings stand at a limit if at least `_REPEATED` readings
    are equal, and if this limit occurs more often than larger readings and than the next smaller reading. A few errors of single
    samples may be larger. The result is infinite if the readings do not stand at a limit."""
    if len(readings) < _LARGEST:
        return np.inf
    largest = np.sort(np.partition(readings, -_LARGEST)[-_LARGEST:])
    same = _ROUNDING * float(np.abs(largest).max())
    first = np.flatnonzero(np.concatenate([[True], np.diff(largest) > same]))
    repeated = np.diff([*first.tolist(), len(largest)])
    most = int(np.argmax(repeated))
    limit, larger = float(largest[first[most]]), int(repeated[most + 1 :].sum())
    smaller = readings[readings < limit - same]
    number = len(readings) - larger - len(smaller)
    next_number = int((smaller >= smaller.max() - same).sum()) if len(smaller) else 0
    return limit if limit > 0 and number >= _REPEATED and number > max(larger, next_number) else np.inf


def _count_beyond(readings: Array, limit: float) -> int:
    """Returns the number of readings (n,) that are larger than a limit."""
    return int((readings > limit + _ROUNDING * abs(limit)).sum()) if np.isfinite(limit) else 0


def _clipped(observed: Observed, shape: float, limits: tuple[float, float]) -> Variant:
    """Returns the variant of an effect that clips the output at a lower and an upper limit [rad/s]. A sample is clipped together
    with its noise. Therefore, an output near a limit is already reduced on average: for a noise n, the mean of min(y + n, L) is y +
    E[min(n, L − y)]. If the recording states no noise (`Observed.scatter`), the noise is neglected. `shape`: value of the shape of
    the variant."""
    gyros, reach = observed.of_kind("gyro"), 0.0
    noise = np.zeros((len(gyros), 1))
    if observed.scatter is not None:
        noise = np.sort(observed.scatter[gyros], axis=1)
        noise -= noise.mean(axis=1, keepdims=True)
        reach = float(np.abs(noise).max(initial=0.0))
    lower, upper = limits
    at_upper = [_mean_of_smaller(own) for own in noise]
    at_lower = [_mean_of_smaller(-own[::-1]) for own in noise]

    def output(nominal: Array) -> Array:
        out = nominal.copy()
        for place, own in enumerate(nominal.T):
            if own.max(initial=0.0) > upper - reach:
                out[:, place] += at_upper[place](upper - own)
            if own.min(initial=0.0) < lower + reach:
                out[:, place] -= at_lower[place](own - lower)
        return out

    acting = (observed.gyro_range[:, 1] > upper - reach) | (observed.gyro_range[:, 0] < lower + reach)
    return _changed(observed, output, shape, acting)


def _mean_of_smaller(noise: Array) -> Callable[[Array], Array]:
    """Returns a function of distances d (N,). For each distance, the function computes the mean of min(n, d) over all noise values
    n. `noise`: array of shape (Q,), sorted noise values with the mean 0."""
    below = np.arange(1, len(noise) + 1)
    means = (np.cumsum(noise) + (len(noise) - below) * noise) / len(noise)

    def mean(distance: Array) -> Array:
        found = np.minimum(distance, 0.0)
        near = np.flatnonzero((distance > noise[0]) & (distance < noise[-1]))
        if len(near):
            found[near] = np.interp(distance[near], noise, means)
        return np.asarray(found)

    return mean


def _changed(
    observed: Observed, output: Callable[[Array], Array], shape: float, acting: NDArray[np.bool_] | None
) -> Variant:
    """Returns the variant of an effect that replaces the nominal output of the gyros by a function of this output. `acting`: array
    of shape (S,), True for the segments in which the function changes the output; None for all segments."""
    nominal = observed.gyro_output
    change = np.zeros_like(nominal)
    for part in [part for index, part in enumerate(observed.segments()) if acting is None or acting[index]]:
        np.subtract(output(nominal[part]), nominal[part], out=change[part])
    parts = {index: change[:, place] for place, index in enumerate(observed.of_kind("gyro"))}
    return Variant((whole(parts, acting),), shape)


class GyroNoiseExcess(WithoutColumns):
    """Raises the white noise density of the gyros above the declared density."""

    id, outside = "gyro_noise_excess", "white"
    about = About(
        "gyro noise is larger than declared",
        "The white noise of the gyros is stronger than the bench file declares.",
        Actor.BOOKKEEPING,
        "Correct the noise in the bench file, or look for vibration and electrical interference: {found}.",
    )


class GyroQuantization(WithoutColumns):
    """Makes the resolution of the gyros coarser than declared: every output is a multiple of a larger count."""

    id, outside = "gyro_quantization", "resolution"
    about = About(
        "gyro counts are coarser than declared",
        "The output of the gyros is rounded to multiples of a count that is larger than the bench file declares.",
        Actor.BOOKKEEPING,
        "Correct the resolution in the bench file, or set a finer resolution in the sensor: {found}.",
    )
