"""Output of a design study of a rotation cycle: tables for the terminal, plain data, and a page with plots of the cycles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from planrunner.design.cycles import FoundCycle, StudiedCycle
from planrunner.estimators.interface import Plot, Role, Table, TableColumn
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.reporting import words
from planrunner.reporting.columns import alike
from planrunner.reporting.study_page import StudyPage

POINTS = 1500  # of a plotted curve
ROUNDS = 3  # number of plotted periods of the longest cycle
FOOTER = (
    "Not modulated: the share of a constant horizontal error that acts as if the sensor did not turn. Schuler drive: "
    "the ratio of the free Schuler oscillation that a constant gyro drift builds up within the dwell with this cycle to the one without "
    "rotation; 0 for cycles much shorter than 84.4 min."
)
TITLES = {"planned": "as planned", "same order": "same order of stops", "free order": "free order of stops"}


@dataclass(frozen=True, slots=True)
class CycleContext:
    """label: of the segment; cycles, searches, reasons: by `planned`, `same order`, `free order`, if available; chosen: the one for the
    plan."""

    title: str
    label: str
    axis: str
    cycles: Mapping[str, StudiedCycle]
    searches: Mapping[str, FoundCycle]
    reasons: Mapping[str, str]
    chosen: str
    facts: Mapping[str, str] = field(default_factory=dict)


def render_page(context: CycleContext, folder: Path | None = None) -> str:
    """One self-contained HTML page. Raises `ReportError`."""
    said = {**context.facts, **facts(context)}
    study = StudyPage(
        "Design of a rotation cycle", context.title, said, tables(context), plots(context), notes(context), FOOTER
    )
    return study.render(folder)


def heading(context: CycleContext) -> str:
    said = facts(context)
    return f"cycle of '{context.label}': stops of {said['Stops']}, turns at {said['Turns']}"


def facts(context: CycleContext) -> dict[str, str]:
    planned = context.cycles["planned"].cycle
    return {
        "Segment": context.label,
        "Axis": context.axis,
        "Stops": f"{words.duration(planned.stop)} each",
        "Turns": f"{math.degrees(planned.rate):g} °/s, ramps of {math.degrees(planned.acceleration):g} °/s²",
    }


def tables(context: CycleContext) -> list[Table]:
    """Tables of the residuals of the cycles, their moves, and the search."""
    return [_left(context), _moves(context), _rounds(context)]


def _left(context: CycleContext) -> Table:
    columns = (
        TableColumn("Cycle"),
        TableColumn("Moves", Role.COUNT),
        *alike(Role.LABEL, "Period", "Stops leave", "Turns leave"),
        TableColumn("Not modulated", Role.SHARE),
        TableColumn("Mean angle", Role.VALUE, "°"),
        TableColumn("Cable from … to", unit="°"),
        TableColumn("Schuler drive", Role.VALUE),
    )
    rows = []
    for name, one in context.cycles.items():
        stops, turns = one.cycle.integral()
        low, high = (f"{round(math.degrees(angle), 6):g}" for angle in one.cycle.reach)
        rows.append(
            (
                TITLES[name], len(one.moves), f"{one.cycle.period:.1f} s", vector(stops), vector(turns),
                f"{100 * abs(one.cycle.residual) / one.cycle.period:.3f} %",
                words.number(round(math.degrees(one.cycle.mean_angle), 6)), f"{low} … {high}", f"{one.drive:.2f}",
            )
        )  # fmt: skip
    return Table("Residual of a constant horizontal error after one cycle", columns, tuple(rows))


def _moves(context: CycleContext) -> Table:
    rows = [(TITLES[name], ", ".join(one.moves)) for name, one in context.cycles.items()]
    return Table("Moves", alike(Role.LABEL, "Cycle", "Moves"), tuple(rows))


def _rounds(context: CycleContext) -> Table:
    rows = [
        (TITLES[name], one.moves, one.tried, one.balanced, one.wound, "all" if one.exhaustive else "stopped")
        for name, found in context.searches.items()
        for one in found.rounds
    ]
    counts = alike(Role.COUNT, "Moves", "Cycles tried", "leave nothing", "of these wind up")
    columns = (TableColumn("Search"), *counts, TableColumn("Tried"))
    return Table("Search", columns, tuple(rows))


def vector(left: complex) -> str:
    """A residual as (along, across) in seconds."""
    along, across = (f"{part:+.2f}" if abs(part) >= 5e-3 else "0" for part in (left.real, left.imag))
    return f"{along} s" if across == "0" else f"{along} s, {across} s across"


def notes(context: CycleContext) -> list[str]:
    """Explanations of the figures, in sentences."""
    said = [f"{TITLES[name].capitalize()}: {reason}." for name, reason in context.reasons.items()]
    for name, found in context.searches.items():
        title = TITLES[name].capitalize()
        if found.cycle is None:
            said.append(f"{title}: none of the cycles tried has a zero residual without winding up the cables.")
        said += [
            f"{title}: with {one.moves} moves there is none; all {one.balanced} with a zero residual wind up the cables."
            for one in found.rounds
            if one.exhaustive and one.balanced and one.balanced == one.wound
        ]
    driven = [TITLES[name] for name, one in context.cycles.items() if one.drive >= 1]
    if driven:
        said.append(
            f"The Schuler oscillation is driven at least as strongly as without rotation: {', '.join(driven)}. Shorten the stops."
        )
    said.append(
        "Seconds times a constant horizontal gyro drift or accelerometer bias, oriented as at the first position, is what a cycle adds in "
        "the navigation frame. The error along the rotation axis is not modulated by any cycle."
    )
    return said


def plots(context: CycleContext) -> list[Plot]:
    """Plots of the table's angle over one period of the longest cycle, and of the accumulated error over several periods."""
    longest = max(one.cycle.period for one in context.cycles.values())
    times = np.linspace(0, longest, POINTS)
    angles = {
        TITLES[name]: tuple(np.round(np.degrees(one.cycle.angle(times)), 3).tolist())
        for name, one in context.cycles.items()
    }
    minutes = tuple(np.round(times / 60, 4).tolist())
    course = Plot("The table’s angle", "time [min]", "angle from the first position [°]", minutes, angles, lines=True)
    sums = {TITLES[name]: _added(one.cycle, ROUNDS * longest) for name, one in context.cycles.items()}
    minutes = tuple(np.round(np.linspace(0, ROUNDS * longest, POINTS) / 60, 4).tolist())
    added = Plot(
        "Accumulated error along its direction at the first position", "time [min]", "integral [s]", minutes, sums,
        lines=True,
    )  # fmt: skip
    return [course, added]


def _added(cycle: RotationCycle, seconds: float) -> tuple[float, ...]:
    """∫ cos θ dt [s] at POINTS times, by the trapezoidal rule on a grid of at most a quarter of a second."""
    fine = max(1, math.ceil(4 * seconds / POINTS))
    times = np.linspace(0, seconds, (POINTS - 1) * fine + 1)
    along = np.cos(cycle.angle(times))
    sums = np.concatenate(([0.0], np.cumsum((along[1:] + along[:-1]) / 2))) * (times[1] - times[0])
    return tuple(np.round(sums[::fine], 3).tolist())


def to_json(context: CycleContext) -> dict[str, Any]:
    """The study as plain data."""
    return {
        "segment": context.label,
        "chosen": context.chosen,
        "cycles": {name: _json(one) for name, one in context.cycles.items()},
        "searches": {
            name: [
                {
                    "moves": one.moves, "tried": one.tried, "leave_nothing": one.balanced, "wind_up": one.wound,
                    "exhaustive": one.exhaustive,
                }
                for one in found.rounds
            ]
            for name, found in context.searches.items()
        },
        "notes": notes(context),
    }  # fmt: skip


def _json(one: StudiedCycle) -> dict[str, Any]:
    stops, turns = one.cycle.integral()
    return {
        "moves": list(one.moves),
        "period_s": one.cycle.period,
        "stops_leave_s": [stops.real, stops.imag],
        "turns_leave_s": [turns.real, turns.imag],
        "mean_angle_deg": math.degrees(one.cycle.mean_angle),
        "reach_deg": [math.degrees(angle) for angle in one.cycle.reach],
        "schuler_drive": one.drive,
    }
