"""Finds series of rates. A series consists of a start zero, the rates one after the other, and an end zero. At each temperature, a
series may be repeated.

A new series begins after each end zero, and at each change of the temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import takewhile

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.interface import EstimationError
from planrunner.plan.schedule import Rest, Segment, Spin
from planrunner.plan.selection import matches
from planrunner.plan.units import ZERO_CELSIUS


@dataclass(frozen=True, slots=True)
class RateSeries:
    """The indices of the segments of one series. `temperature`: planned temperature, K; None if the plan does not state it."""

    name: str
    temperature: float | None
    start: tuple[int, ...]
    spins: tuple[int, ...]
    end: tuple[int, ...]

    @property
    def lacks(self) -> Said | None:
        """Returns a text that names the missing parts; None if the series is complete."""
        parts = {said("start zero"): self.start, said("end zero"): self.end, said("rates"): self.spins}
        missing = [what for what, held in parts.items() if not held]
        if not missing:
            return None
        return reduce(lambda first, second: said("{first} and no {second}", first=first, second=second), missing)

    @property
    def segments(self) -> tuple[int, ...]:
        return (*self.start, *self.spins, *self.end)


def split_series(segments: Sequence[Segment], zero: Sequence[str]) -> tuple[RateSeries, ...]:
    """Divides segments, which are in the order of the plan, into series. `zero`: patterns for the labels of the segments at rest
    before and after the rates; other segments at rest, such as pauses, belong to no series.

    Raises `EstimationError` for a motion that is not a constant rate, and for rates about different directions.
    """
    _one_rotation_axis(segments)
    pieces: list[tuple[list[int], list[int], list[int]]] = []
    temperature: float | None = None
    for index, segment in enumerate(segments):
        resting = _is_zero(segment, zero)
        if not resting and isinstance(segment.motion, Rest):
            continue
        ended = bool(pieces and pieces[-1][2])
        if not pieces or ended or segment.temperature != temperature:
            pieces.append(([], [], []))
        temperature = segment.temperature
        start, spins, end = pieces[-1]
        (end if resting and spins else start if resting else spins).append(index)
    return tuple(_series(segments, *piece) for piece in pieces)


def by_temperature(series: Sequence[RateSeries]) -> dict[float | None, tuple[RateSeries, ...]]:
    """Returns the repeats at each planned temperature [K], by temperature, in the order in which the temperatures first occur. The
    key is None for temperatures that the plan does not state."""
    found: dict[float | None, list[RateSeries]] = {}
    for one in series:
        found.setdefault(one.temperature, []).append(one)
    return {kelvin: tuple(held) for kelvin, held in found.items()}


def temperature_label(kelvin: float | None) -> Said:
    return Said("") if kelvin is None else said("{celsius:g}degC", celsius=round(kelvin - ZERO_CELSIUS, 6))


def has_both_signs(rates: Array) -> bool:
    return bool(np.any(rates > 0) and np.any(rates < 0))


def _is_zero(segment: Segment, patterns: Sequence[str]) -> bool:
    named = any(matches(segment.label, pattern) for pattern in patterns)
    if named and not isinstance(segment.motion, Rest):
        raise EstimationError(
            f"segment '{segment.label}' is named in `zero`, but it moves: name segments at rest there"
        )
    if not isinstance(segment.motion, Rest | Spin):
        kind = type(segment.motion).__name__.lower()
        raise EstimationError(f"segment '{segment.label}' has no constant rate ({kind}): leave it out of `segments`")
    return named


def _one_rotation_axis(segments: Sequence[Segment]) -> None:
    spins = [segment for segment in segments if isinstance(segment.motion, Spin)]
    for segment in spins[1:]:
        assert isinstance(segment.motion, Spin) and isinstance(spins[0].motion, Spin)
        if segment.motion.about != spins[0].motion.about:
            raise EstimationError(
                f"'{segment.label}' turns about a different direction from '{spins[0].label}': a scale factor comes from one rotation axis"
            )


def _series(segments: Sequence[Segment], start: list[int], spins: list[int], end: list[int]) -> RateSeries:
    """Makes a series from the indices of its segments: the start zero, the rates and the end zero. The name of the series is the
    common beginning of all its labels, such as `20degC/r1`."""
    every = [*start, *spins, *end]
    paths = [segments[index].label.split("/") for index in every]
    shared = [parts[0] for parts in takewhile(lambda parts: len(set(parts)) == 1, zip(*paths, strict=False))]
    name = "/".join(shared) or paths[0][-1]
    return RateSeries(name, segments[every[0]].temperature, tuple(start), tuple(spins), tuple(end))
