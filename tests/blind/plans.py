"""Plans of the blind recordings: tables of segments in the columns of `segments.csv`, from a poor plan to a rich one."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

Axis = str | tuple[float, float, float]
"""Where an axis of the sensor points: along one of the site's, by name, or a unit vector east, north, up."""
Axes = tuple[Axis, Axis, Axis]

X_UP: Axes = ("up", "north", "west")
Y_UP: Axes = ("north", "up", "east")
Z_UP: Axes = ("north", "west", "up")
VERTICAL = {"x": X_UP, "y": Y_UP, "z": Z_UP}
SIX: tuple[Axes, ...] = (
    X_UP,
    ("down", "north", "east"),
    Y_UP,
    ("south", "down", "east"),
    ("east", "north", "up"),
    ("west", "north", "down"),
)
TWELVE: tuple[Axes, ...] = (
    *SIX,
    ("up", "south", "east"),
    ("down", "south", "west"),
    ("north", "down", "west"),
    ("south", "up", "west"),
    ("east", "up", "south"),
    ("west", "down", "south"),
)
HEADER = (
    *("label", "kind", "x_axis", "y_axis", "z_axis", "table_rate_deg_per_s", "rock_amplitude_deg", "rock_frequency_hz"),
    *("chamber_degC", "ramp", "start_s", "end_s"),
)


@dataclass(frozen=True)
class Segment:
    """One row: angles deg, rate deg/s, temperature degC, times s since power-on; `ramp` marks a move to `chamber` while recording."""

    label: str
    kind: str
    axes: Axes
    duration: float
    rate: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    chamber: float = 25.0
    ramp: bool = False
    start: float = 0.0

    @property
    def end(self) -> float:
        return self.start + self.duration


def still(prefix: str, places: Sequence[Axes], duration: float, chamber: float = 25.0) -> list[Segment]:
    return [Segment(f"{prefix}{i:02d}", "static", axes, duration, chamber=chamber) for i, axes in enumerate(places, 1)]


def turns(prefix: str, rates: Sequence[float], duration: float, chamber: float = 25.0) -> list[Segment]:
    """Each rate in both senses, about each of the sensor's axes."""
    return [
        Segment(f"{prefix}{axis}{sign * rate:+g}", "rate", VERTICAL[axis], duration, rate=sign * rate, chamber=chamber)
        for axis in VERTICAL
        for rate in rates
        for sign in (1, -1)
    ]


def rocks(prefix: str, motions: Sequence[tuple[float, float]], duration: float) -> list[Segment]:
    """Rocking of each (amplitude deg, frequency Hz) about each of the sensor's axes."""
    return [
        Segment(f"{prefix}{axis}{frequency:g}Hz", "rock", VERTICAL[axis], duration, 0.0, amplitude, frequency)
        for axis in VERTICAL
        for amplitude, frequency in motions
    ]


def ramp(label: str, chamber: float, duration: float = 120.0, rate: float = 0.0) -> list[Segment]:
    """A move of the chamber to `chamber` degC that is recorded, at rest or turning."""
    return [Segment(label, "rate" if rate else "static", X_UP, duration, rate, chamber=chamber, ramp=True)]


def timed(segments: Sequence[Segment], first: float, move: float, soak: float) -> tuple[Segment, ...]:
    """Start times from `first` s after power-on: `move` s before a segment, and `soak` s more after a ramp."""
    placed: list[Segment] = []
    now = first
    for segment in segments:
        now += move + (soak if placed and placed[-1].ramp else 0.0)
        placed.append(replace(segment, start=now))
        now += segment.duration
    return tuple(placed)


def _hot_and_cold(at: Sequence[float], rates: Sequence[float], duration: float, turning: float = 0.0) -> list[Segment]:
    found: list[Segment] = []
    for i, chamber in enumerate(at, 1):
        found += ramp(f"T{i}", chamber, rate=turning * (-1) ** i)
        found += still(f"U{i}-", SIX, duration, chamber) + turns(f"V{i}", rates, duration, chamber)
    return found


PLANS: dict[str, tuple[Segment, ...]] = {
    "poor": timed(still("S", SIX, 20) + turns("R", [60], 15), 120, 10, 0),
    "tumble": timed(
        still("S", TWELVE, 20) + turns("R", [40], 18) + ramp("T1", 50) + still("H", TWELVE, 20, 50), 300, 15, 1500
    ),
    "rates": timed(still("S", SIX, 15) + turns("R", [5, 20, 50, 100, 200, 350], 10) + still("E", SIX, 15), 60, 8, 0),
    "rocking": timed(
        still("S", SIX, 15) + turns("R", [30, 120], 12) + rocks("K", [(8, 0.5), (5, 1.0), (2, 3.0), (1, 6.0)], 15),
        600,
        12,
        0,
    ),
    "thermal": timed(
        still("S", SIX, 20) + turns("R", [20, 100], 12) + _hot_and_cold([-20, 60, 25], [20, 100], 12, 40), 900, 15, 1800
    ),
    "rich": timed(
        still("S", TWELVE, 30)
        + turns("R", [10, 30, 60, 120, 200, 300], 12)
        + rocks("K", [(8, 0.5), (4, 1.5), (2, 4.0)], 20)
        + _hot_and_cold([-20, 60], [20, 150], 18)
        + ramp("T3", 25)
        + still("E", SIX, 30),
        600,
        15,
        1800,
    ),
}


def write_segments(path: Path, segments: Sequence[Segment]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for s in segments:
            rock = (s.amplitude, s.frequency) if s.kind == "rock" else ("", "")
            times = (f"{s.start:.3f}", f"{s.end:.3f}")
            writer.writerow([s.label, s.kind, *s.axes, s.rate or "0", *rock, s.chamber, int(s.ramp), *times])


def read_segments(path: Path) -> tuple[Segment, ...]:
    """The same segments again; raises KeyError or ValueError where the table is not one of ours."""
    with path.open(encoding="utf-8", newline="") as file:
        return tuple(
            Segment(
                row["label"],
                row["kind"],
                (row["x_axis"], row["y_axis"], row["z_axis"]),
                round(float(row["end_s"]) - float(row["start_s"]), 6),
                float(row["table_rate_deg_per_s"]),
                float(row["rock_amplitude_deg"] or 0),
                float(row["rock_frequency_hz"] or 0),
                float(row["chamber_degC"]),
                row["ramp"] == "1",
                float(row["start_s"]),
            )
            for row in csv.DictReader(file)
        )
