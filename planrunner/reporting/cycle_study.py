"""Makes the output of a design study of a rotation cycle: the residuals and moves of the cycles, a summary of the searches, and
plots over time."""

from __future__ import annotations

import math

import numpy as np

from planrunner.design.cycles import StudiedCycle
from planrunner.design.study import FoundCycles, Study, Subject
from planrunner.estimators.tables import Plot, Role, Shown, Table, TableColumn, alike, table_of
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.reporting import words

POINTS = 1500  # of a plotted curve
ROUNDS = 3  # number of plotted periods of the longest cycle
FOOTER = (
    "Not modulated: the share of a constant horizontal error that acts as if the sensor did not turn. Schuler "
    "drive: the free Schuler oscillation that a constant gyro drift builds up within the dwell with this cycle, divided by the oscillation "
    "without rotation; it is 0 for cycles much shorter than 84.4 min."
)
TITLES = {"planned": "as planned", "same order": "same order of stops", "free order": "free order of stops"}


def study(found: FoundCycles, subject: Subject) -> Study:
    """Makes the study of a designed cycle: a headline, tables, notes and plots."""
    about = facts(found)
    said = notes(found)
    reason = found.reasons.get(found.chosen, "none was found")
    return Study(
        subject,
        "a rotation cycle",
        f"cycle of '{found.segment.label}': stops of {about['Stops']}, turns at {about['Turns']}",
        about,
        (_left(found), _moves(found), _rounds(found)),
        said,
        FOOTER,
        _data(found, said),
        found.text,
        f"a cycle with the {found.chosen} of stops cannot be written: {reason}",
        plots(found),
    )


def facts(found: FoundCycles) -> dict[str, str]:
    planned = found.cycles["planned"].cycle
    return {
        "Segment": found.segment.label,
        "Axis": found.axis.name,
        "Stops": f"{words.duration(planned.stop)} each",
        "Turns": f"{math.degrees(planned.rate):g} °/s, ramps of {math.degrees(planned.acceleration):g} °/s²",
    }


def _left(found: FoundCycles) -> Table:
    columns: tuple[Shown[tuple[str, StudiedCycle]], ...] = (
        Shown(TableColumn("Cycle"), lambda item: TITLES[item[0]]),
        Shown(TableColumn("Moves", Role.COUNT), lambda item: len(item[1].moves)),
        Shown(TableColumn("Period"), lambda item: f"{item[1].cycle.period:.1f} s"),
        Shown(TableColumn("Stops leave"), lambda item: vector(item[1].cycle.integral()[0])),
        Shown(TableColumn("Turns leave"), lambda item: vector(item[1].cycle.integral()[1])),
        Shown(TableColumn("Not modulated", Role.SHARE), lambda item: _not_modulated(item[1].cycle)),
        Shown(TableColumn("Mean angle", Role.VALUE, "°"), lambda item: _degrees(item[1].cycle.mean_angle)),
        Shown(TableColumn("Cable from … to", unit="°"), lambda item: " … ".join(map(_degrees, item[1].cycle.reach))),
        Shown(TableColumn("Schuler drive", Role.VALUE), lambda item: f"{item[1].drive:.2f}"),
    )
    return table_of("Residual of a constant horizontal error after one cycle", columns, list(found.cycles.items()))


def _not_modulated(cycle: RotationCycle) -> str:
    return f"{100 * abs(cycle.residual) / cycle.period:.3f} %"


def _degrees(angle: float) -> str:
    return words.number(round(math.degrees(angle), 6))


def _moves(found: FoundCycles) -> Table:
    rows = [(TITLES[name], ", ".join(one.moves)) for name, one in found.cycles.items()]
    return Table("Moves", alike(Role.LABEL, "Cycle", "Moves"), tuple(rows))


def _rounds(found: FoundCycles) -> Table:
    rows = [
        (TITLES[name], one.moves, one.tried, one.balanced, one.wound, "all" if one.exhaustive else "stopped")
        for name, search in found.searches.items()
        for one in search.rounds
    ]
    counts = alike(Role.COUNT, "Moves", "Cycles tried", "without residual", "of these, with cable wind-up")
    columns = (TableColumn("Search"), *counts, TableColumn("Tried"))
    return Table("Search", columns, tuple(rows))


def vector(left: complex) -> str:
    """Returns the residual of a sensor error as text, in seconds: the component along the sensor error and, if it is not zero, the
    perpendicular component."""
    along, across = (f"{part:+.2f}" if abs(part) >= 5e-3 else "0" for part in (left.real, left.imag))
    return f"{along} s" if across == "0" else f"{along} s, {across} s across"


def notes(found: FoundCycles) -> tuple[str, ...]:
    """Explains the numbers, in sentences."""
    said = [f"{TITLES[name].capitalize()}: {reason}." for name, reason in found.reasons.items()]
    for name, search in found.searches.items():
        title = TITLES[name].capitalize()
        if search.cycle is None:
            said.append(f"{title}: none of the cycles tried has a zero residual and leaves the cables unwound.")
        said += [
            f"{title}: with {one.moves} moves, no suitable cycle was found, because every cycle with a zero residual winds up the cables."
            for one in search.rounds
            if one.exhaustive and one.balanced and one.balanced == one.wound
        ]
    driven = [TITLES[name] for name, one in found.cycles.items() if one.drive >= 1]
    if driven:
        said.append(
            f"The Schuler oscillation is driven at least as strongly as without rotation: {', '.join(driven)}. Shorten the stops."
        )
    said.append(
        "In the navigation frame, each cycle adds an error: the residual in seconds, multiplied by the constant "
        "horizontal gyro drift or accelerometer bias as it is oriented at the first position. No cycle "
        "modulates the error along the rotation axis."
    )
    return tuple(said)


def plots(found: FoundCycles) -> tuple[Plot, ...]:
    """Makes plots of the table's angle over one period of the longest cycle, and of the accumulated sensor error over several
    periods."""
    longest = max(one.cycle.period for one in found.cycles.values())
    times = np.linspace(0, longest, POINTS)
    angles = {
        TITLES[name]: tuple(np.round(np.degrees(one.cycle.angle(times)), 3).tolist())
        for name, one in found.cycles.items()
    }
    minutes = tuple(np.round(times / 60, 4).tolist())
    course = Plot("The table’s angle", "time [min]", "angle from the first position [°]", minutes, angles, lines=True)
    sums = {TITLES[name]: _added(one.cycle, ROUNDS * longest) for name, one in found.cycles.items()}
    minutes = tuple(np.round(np.linspace(0, ROUNDS * longest, POINTS) / 60, 4).tolist())
    added = Plot(
        "Accumulated error along its direction at the first position", "time [min]", "integral [s]", minutes, sums,
        lines=True,
    )  # fmt: skip
    return course, added


def _added(cycle: RotationCycle, seconds: float) -> tuple[float, ...]:
    """Returns the integral ∫ cos θ dt [s] up to each of `POINTS` times, by the trapezoidal rule on a grid of at most a quarter of a
    second."""
    fine = max(1, math.ceil(4 * seconds / POINTS))
    times = np.linspace(0, seconds, (POINTS - 1) * fine + 1)
    along = np.cos(cycle.angle(times))
    sums = np.concatenate(([0.0], np.cumsum((along[1:] + along[:-1]) / 2))) * (times[1] - times[0])
    return tuple(np.round(sums[::fine], 3).tolist())


def _data(found: FoundCycles, said: tuple[str, ...]) -> dict[str, object]:
    return {
        "segment": found.segment.label,
        "chosen": found.chosen,
        "cycles": {name: _json(one) for name, one in found.cycles.items()},
        "searches": {
            name: [
                {
                    "moves": one.moves, "tried": one.tried, "leave_nothing": one.balanced, "wind_up": one.wound,
                    "exhaustive": one.exhaustive,
                }
                for one in search.rounds
            ]
            for name, search in found.searches.items()
        },
        "notes": list(said),
    }  # fmt: skip


def _json(one: StudiedCycle) -> dict[str, object]:
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
