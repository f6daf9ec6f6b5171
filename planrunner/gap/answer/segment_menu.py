"""The menu of further segments: orientations, rates, rocking and temperatures, as lines of a plan.

The menu is a coarse grid of options. The schedule decides whether the bench can execute an option.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.bench.model import BenchModels
from planrunner.plan.rewriting import cardinal_orientations, orientation_text
from planrunner.plan.schedule import Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS, unit

MOST_ORIENTATIONS = 16
OBLIQUE = 4  # beside those, where a table can set them
DWELLS = (1, 4)  # in dwells that are usual in the recording
RATE_SHARES = (0.9, 0.3, 0.1)  # of the largest rate
EVERYDAY = (0.0, 50.0)  # degC; commercial parts are made for 0 to 70 degC
ROCKING_HZ = (0.5, 2.0, 5.0)
_LARGEST_ROCKING = math.radians(10.0)
_WITHIN = 0.8  # of a table's limits
_APART = 5.0  # K


@dataclass(frozen=True)
class MenuEntry:
    """One line of a plan without its label."""

    orientation: str
    dwell: str
    motion: str = ""
    temperature: str = ""

    def line(self, label: str) -> str:
        keys = {
            "label": label,
            "orientation": self.orientation,
            "motion": self.motion,
            "temperature": self.temperature,
            "dwell": self.dwell,
        }
        return "{" + ", ".join(f"{name}: {value}" for name, value in keys.items() if value) + "}"


def menu(recorded: Sequence[Segment], models: BenchModels) -> list[MenuEntry]:
    """The options for segments that may follow the recorded ones. An option states a temperature only if the recorded plan does."""
    usual = float(np.median([segment.dwell for segment in recorded if segment.dwell]))
    places = _orientations(recorded, models)
    upright = list({tuple(np.round(place[:, 2], 3)): place for place in places}.values())
    largest = _largest_rate(recorded, models)
    rates = [sign * share * largest for share in RATE_SHARES for sign in (1, -1)] if largest else []
    rocking = list(_rocking(recorded, models))
    warm = _temperatures(recorded, models)
    found = []
    for kelvin in warm:
        here = warm[0] == kelvin
        for place in places if here else upright:
            found += [_entry(place, f"{usual * times:g} s", kelvin=kelvin) for times in DWELLS]
        for place in upright:
            for rate in rates if here else rates[:4]:
                found += [_turning(place, rate, usual * times, kelvin) for times in (DWELLS if here else DWELLS[:1])]
            for amplitude, hertz in rocking if here else ():
                rock = f"{{rock: {{amplitude: {math.degrees(amplitude):.4g} deg, frequency: {hertz:g} Hz}}}}"
                dwell = math.ceil(usual * hertz) / hertz
                found += [_entry(place, f"{dwell * times:g} s", rock, kelvin) for times in DWELLS]
    return found + list(_ramps(recorded, models, upright[0], warm))


def _entry(place: Array, dwell: str, motion: str = "", kelvin: float | None = None) -> MenuEntry:
    return MenuEntry(
        orientation_text(place), dwell, motion, "" if kelvin is None else f"{kelvin - ZERO_CELSIUS:.6g} degC"
    )


def _turning(place: Array, rate: float, seconds: float, kelvin: float | None) -> MenuEntry:
    turns = max(1, round(seconds * abs(rate) / (2 * math.pi)))
    return _entry(place, f"{{turns: {turns}}}", f"{{rate: {math.degrees(rate):.6g} deg/s}}", kelvin)


def _orientations(recorded: Sequence[Segment], models: BenchModels) -> list[Array]:
    """Lists the recorded orientations, then others along the site's axes, then oblique ones. If nothing can turn the sensor, lists
    only the recorded orientations."""
    visited = {
        tuple(np.round(item.attitude, 6).ravel() + 0.0): item.attitude for item in recorded if item.attitude is not None
    }
    places = list(visited.values())[:MOST_ORIENTATIONS]
    several = len({tuple(np.round(place[:, 2], 3)) for place in places}) > 2
    if not (models.table or (models.replays and several)):
        return places
    for place in cardinal_orientations():
        if len(places) < MOST_ORIENTATIONS and tuple(place.ravel() + 0.0) not in visited:
            places.append(place)
    return places + (_oblique() if models.table else [])


def _oblique() -> list[Array]:
    """Orientations with all three axes at equal angles to the vertical, one for each upper octant."""
    found = []
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        up = np.array([x, y, 1.0]) / math.sqrt(3)
        east = np.cross(up, [0.0, 0.0, 1.0])
        east /= np.linalg.norm(east)
        found.append(np.column_stack([east, np.cross(up, east), up]))
    return found[:OBLIQUE]


def _largest_rate(recorded: Sequence[Segment], models: BenchModels) -> float:
    """Largest rate [rad/s] that the table and the full scale of the gyros allow. For a recording that is played back, it is chosen
    so that the fastest option has the largest recorded rate."""
    visited = max((abs(item.motion.rate) for item in recorded if isinstance(item.motion, Spin)), default=0.0)
    if models.table is None:
        return visited / RATE_SHARES[0]
    largest = max(axis.max_rate for axis in models.table.axes)
    turning = unit("rad/s").dimension
    for output in models.sensor.outputs if models.sensor else ():
        if unit(output.unit).dimension == turning:
            largest = min(largest, output.full_scale * unit(output.unit).factor)
    return largest


def _rocking(recorded: Sequence[Segment], models: BenchModels) -> Iterator[tuple[float, float]]:
    """Amplitudes [rad] and frequencies [Hz] of rocking about the vertical."""
    visited = {(m.amplitude, m.frequency) for m in (item.motion for item in recorded) if isinstance(m, Rock)}
    yield from sorted(visited)
    if models.table is None or abs(models.table.axes[0].direction[2]) < 1 or visited:
        return
    axis = models.table.axes[0]
    for hertz in ROCKING_HZ:
        pulse = 2 * math.pi * hertz
        yield min(_LARGEST_ROCKING, _WITHIN * axis.max_rate / pulse, _WITHIN * axis.max_acceleration / pulse**2), hertz


def _temperatures(recorded: Sequence[Segment], models: BenchModels) -> list[float | None]:
    """Temperatures [K], the most frequent one first. An entry is None if the plan does not set the chamber. If the plan has fewer
    than two temperatures, common temperatures are added."""
    stated = [item.temperature for item in recorded if item.temperature is not None]
    visited = list(dict.fromkeys(round(kelvin, 2) for kelvin in stated))
    visited.sort(key=lambda kelvin: -sum(round(other, 2) == kelvin for other in stated))
    chamber = models.chamber
    if chamber is None:
        return [*visited] if visited and models.replays else [None]
    found: list[float | None] = [*visited] or [None]
    for celsius in EVERYDAY:
        kelvin = celsius + ZERO_CELSIUS
        near = any(abs(kelvin - (other or chamber.ambient)) < _APART for other in found)
        if len(visited) < 2 and chamber.lowest <= kelvin <= chamber.highest and not near:
            found.append(kelvin)
    return found


def _ramps(
    recorded: Sequence[Segment], models: BenchModels, place: Array, warm: Sequence[float | None]
) -> Iterator[MenuEntry]:
    """Temperature ramps during which samples are recorded, starting from the most frequent temperature."""
    if models.chamber is None:
        done = {(item.ramp_to, item.dwell) for item in recorded if item.ramp_to is not None}
        ramps = [(kelvin, dwell or 0.0) for kelvin, dwell in done]
    else:
        start = warm[0] or models.chamber.ambient
        ramps = [(kelvin, abs(kelvin - start) / models.chamber.ramp) for kelvin in warm[1:] if kelvin is not None]
    for kelvin, dwell in sorted(ramps):
        if dwell > 0:
            yield MenuEntry(
                orientation_text(place), f"{dwell:g} s", "", f"{{ramp_to: {kelvin - ZERO_CELSIUS:.6g} degC}}"
            )
