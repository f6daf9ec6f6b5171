"""Effects that begin at one moment, for example because of a shock: a step of a bias, a shift of the sensor on its mounting, or
lost samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Column, Shaped, Variant, on_rate, per_axis
from planrunner.error_model.observed import Observed
from planrunner.plan.units import STANDARD_GRAVITY as G

_SCALES = {"gyro": ("deg/s", np.pi / 180, 1e-2), "accel": ("mg", 1e-3 * G, 1.0)}

_ARCSEC = np.pi / 180 / 3600
_CROSS = ((1, 2, 1.0), (2, 0, 1.0), (0, 1, 1.0), (2, 1, -1.0), (0, 2, -1.0), (1, 0, -1.0))
"""The terms (i, j, s) of the cross product v × e. Component j of v × e is the sum of s·eᵢ·vₖ over the two terms with this j, where
k is the third axis."""


def _about(triad: str) -> About:
    return About(
        f"{triad} bias changes abruptly",
        f"At one moment the bias of the {triad}s changes to another value, as after a shock.",
        Actor.SENSOR,
        "Look for a shock or a change of mode at this time, and evaluate the segments before and after it separately: {found}.",
    )


def _moments(observed: Observed) -> Array:
    """Returns the moments at which a diagnosis starts its search for the step: the starts of all segments but the first, and the middles
    of the first and the last segment. The diagnosis then also searches between these moments. All intervals between neighbouring moments
    have the same prior probability, and the evidence is averaged over these intervals."""
    bounds = observed.bounds
    middles = observed.time[[bounds[1] // 2, (bounds[-2] + bounds[-1]) // 2]]
    return np.unique(np.maximum([middles[0], *observed.time[bounds[1:-1]], middles[1]], 1e-9))


class _BiasStep(Shaped):
    """Adds s to the bias of each axis after a moment; this moment is the shape parameter."""

    stage, shape_name, shape_unit = "sensor", "time", "s"
    kind: str

    def grid(self, observed: Observed) -> Array:
        return _moments(observed) if observed.of_kind(self.kind) else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        return self._from(observed, value, np.ones((len(observed.time), 1)))

    def groups(self, observed: Observed) -> Iterator[list[Variant]]:
        ones = np.ones((len(observed.time), 1))
        yield [self._from(observed, float(value), ones) for value in self.grid(observed)]

    def _from(self, observed: Observed, value: float, ones: Array) -> Variant:
        unit, factor, natural = _SCALES[self.kind]
        after, acting = _after(observed, value, ones)
        columns = per_axis(observed, self.kind, "s", unit, factor, natural * factor, after[:, 0])
        return Variant(tuple(replace(column, segments=acting) for column in columns), value)


class GyroBiasStep(_BiasStep):
    """Adds s to the bias of each gyro after a moment, which is a time since power-on."""

    id, kind, about = "gyro_bias_step", "gyro", _about("gyro")


class AccelBiasStep(_BiasStep):
    """Adds s to the bias of each accelerometer after a moment, which is a time since power-on."""

    id, kind, about = "accel_bias_step", "accel", _about("accelerometer")


class MountShift(Shaped):
    """Turns the sensor by three small angles about its own axes after a moment, which is a time since power-on. A rotation by θ
    changes a vector v in sensor axes by −θ×v."""

    id, stage, shape_name, shape_unit = "mount_shift", "stimulus", "time", "s"
    about = About(
        "sensor has shifted on its mounting",
        "At one moment the sensor turns on its mounting by a small angle, as if a screw or an adhesive joint gave way.",
        Actor.BENCH,
        "Fasten the sensor, and evaluate the segments before and after this time separately: {found}.",
    )

    def grid(self, observed: Observed) -> Array:
        return _moments(observed) if observed.channels and observed.along is None else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        return self._from(observed, value, _both_signs(observed))

    def groups(self, observed: Observed) -> Iterator[list[Variant]]:
        felt = _both_signs(observed)
        for within, values in groupby(self.grid(observed).tolist(), key=lambda value: _within(observed, value)):
            if within:
                yield from ([self._from(observed, value, felt)] for value in values)
            else:
                yield [self._from(observed, value, felt) for value in values]

    @staticmethod
    def _from(observed: Observed, value: float, felt: Array) -> Variant:
        """Returns the columns of the shift. `felt`: array of shape (N, 12): angular rate, specific force, the negative angular rate
        and the negative specific force. `value`: the moment of the shift, s since power-on."""
        after, acting = _after(observed, value, felt)
        parts: list[dict[int, Array]] = [{}, {}, {}]
        for index, channel in enumerate(observed.channels):
            for about, seen, sign in _CROSS:
                if seen == channel.axis:
                    place = 3 - about - seen + 3 * (channel.kind == "accel") + 6 * (sign < 0)
                    parts[about][index] = after[:, place]
        columns = (
            Column(
                f"about_{'xyz'[about]}",
                "arcsec",
                _ARCSEC,
                100 * _ARCSEC,
                own,
                acting,
                axis=None,
                smallest=-np.pi,
                largest=np.pi,
            )
            for about, own in enumerate(parts)
        )
        return Variant(tuple(columns), value)


class SamplesDropped(Shaped):
    """The sensor loses samples at a certain time since power-on. The time stamps of later samples do not include the lost samples.
    After the loss, the gyros show the motion at a later time than their time stamps state. `lost`: the lost time [s] for which the
    columns are exact. For a short lost time, the change of the rate is the lost time multiplied by the angular acceleration."""

    id, stage, hypothesis, shape_name, shape_unit = "samples_dropped", "acquisition", False, "time", "s"
    about = About(
        "samples were lost",
        "Samples of the sensor were lost at one moment, so the time stamps of all later samples are too early.",
        Actor.BENCH,
        "Record a counter or the time of each sample, and correct the times after this moment: {found}.",
    )

    def __init__(self, lost: float = 0.0):
        self.lost = lost

    def secant(self, amplitudes: Array) -> SamplesDropped:
        return SamplesDropped(float(amplitudes[0]))

    def grid(self, observed: Observed) -> Array:
        """Returns possible moments of the loss, s since power-on, shape (n,), from the start of the first segment in which the rate
        changes to the end of the last such segment."""
        if not observed.unsteady.any() or not observed.of_kind("gyro") or observed.along is not None:
            return np.empty(0)
        moments, first = _moments(observed), int(np.flatnonzero(observed.unsteady)[0])
        return np.asarray(
            moments[(moments >= observed.time[observed.bounds[first]]) & (moments < self._last(observed))]
        )

    def at(self, observed: Observed, value: float) -> Variant:
        return self._from(observed, value, self._shown(observed))

    def groups(self, observed: Observed) -> Iterator[list[Variant]]:
        grid = self.grid(observed)
        shown = self._shown(observed) if len(grid) else np.empty((0, 0))
        yield [self._from(observed, float(value), shown) for value in grid]

    @staticmethod
    def _from(observed: Observed, value: float, shown: Array) -> Variant:
        after, acting = _after(observed, value, shown)
        parts = {index: after[:, place] for place, index in enumerate(observed.of_kind("gyro"))}
        return Variant(
            (Column("lost", "ms", 1e-3, 1e-2, parts, acting & observed.unsteady, axis=None, smallest=0.0),), value
        )

    @staticmethod
    def _last(observed: Observed) -> float:
        """Returns the end of the last segment in which the rate changes, s since power-on."""
        return float(observed.time[observed.bounds[np.flatnonzero(observed.unsteady)[-1] + 1] - 1])

    def _shown(self, observed: Observed) -> Array:
        """Returns the change of the gyros' outputs, divided by the lost time, shape (N, G) for G gyros."""
        later = observed.turn_before(-self.lost) / self.lost if self.lost else observed.swing
        return np.column_stack(list(on_rate(observed, later).values()))


def _both_signs(observed: Observed) -> Array:
    return np.hstack([observed.omega, observed.force, -observed.omega, -observed.force])


def _within(observed: Observed, moment: float) -> bool:
    """Returns True if a segment begins before a moment and ends after it."""
    first, last = observed.time[observed.bounds[:-1]], observed.time[observed.bounds[1:] - 1]
    return bool(((first < moment) & (last >= moment)).any())


def _after(observed: Observed, moment: float, table: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Returns a copy of a table (N, P) with zeros before a moment, and a mask (S,) of the segments that end after this moment. If
    no segment contains the moment, returns the table itself instead of a copy, so that all columns of this table are evaluated
    together."""
    acting = np.asarray(observed.time[observed.bounds[1:] - 1] >= moment)
    if not _within(observed, moment):
        return table, acting
    return table * (observed.time >= moment)[:, None], acting
