"""Checks a cycle of turns and stops. Determines whether the axis of the table can execute the cycle, and how much of a constant
horizontal sensor error remains on average over the cycle.

A cycle cancels constant errors if its residual over the stops, its residual over the turns, and its mean angle are zero. The
figures come from `planrunner.physics.rotation_cycle`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from planrunner.base.findings import Findings, Mark
from planrunner.physics.earth import Site
from planrunner.physics.kinematics import TableAxis
from planrunner.physics.modulation import MEAN_RADIUS, schuler_drive, schuler_rate
from planrunner.physics.rotation_cycle import NOTHING, RotationCycle
from planrunner.physics.table_motion import cycle_excess
from planrunner.plan.schedule import Cycle

MarkOf = Callable[[str], Mark]
"""Function that returns the mark of one of the motion's keys."""

_UPRIGHT = math.cos(math.radians(0.1))
_DESIGN = "`planrunner design` finds cycles without a residual"


def check_cycle(
    axis: TableAxis, starts: Sequence[float], motion: Cycle, dwell: float | None, site: Site, at: MarkOf, log: Findings
) -> tuple[float, float]:
    """Adds findings about a cycle of the table. `starts`: the angles [rad] at which the joint may be when the cycle begins, the
    planned one first. For the other angles, only the limits of the axis are checked. Returns two values for a cycle that begins at
    the planned angle: the angle [rad] at which the joint rests after the dwell, and the time [s] to come to rest."""
    start = starts[0]
    excess = next(filter(None, (cycle_excess(axis, begin, motion) for begin in starts)), [])
    for one in excess:
        if one.kind == "rate":
            log.error("physics-rate", at("turn_rate"), one.message, "lower turn_rate")
        else:
            hint = "choose turns that return by the same path, or begin the cycle at another position"
            log.error("physics-cable-wrap", at("moves"), one.message, hint)
    if excess:
        return start, 0.0
    cycle = RotationCycle.of(motion, axis.max_acceleration)
    if abs(axis.direction[2]) < _UPRIGHT:
        message = (
            f"the cycle turns the {axis.name} axis, which is not vertical: it therefore modulates the errors perpendicular "
            "to that axis, and not the horizontal errors"
        )
        log.warning("physics-cycle-axis", at("cycle"), message, "use a bench whose outermost axis is vertical")
    stops, turns = cycle.integral()
    _check_residual(cycle, stops, turns, at("moves"), log)
    if abs(stops) > NOTHING * cycle.period:
        _check_stops(motion, at("moves"), log)
    if abs(cycle.mean_angle) > NOTHING * 2 * math.pi:
        heading = 1e-5 * math.degrees(cycle.mean_angle) * 3600
        message = (
            f"the mean angle of the cycle is {_deg(cycle.mean_angle)} deg: a scale factor error of 10 ppm in the azimuth gyro makes a mean "
            f"heading error of {heading:+.2g} arcsec"
        )
        log.warning("physics-cycle-angle", at("moves"), message, "make the cycle turn equally far to both sides")
    if dwell is None:
        return start, 0.0
    _check_schuler(cycle, dwell, site, at("stop"), log)
    _check_whole(cycle, dwell, at("moves"), log)
    rate = cycle.turning_rate(dwell)
    stopping = abs(rate) / axis.max_acceleration
    return start + float(cycle.angle(np.array([dwell]))[0]) + 0.5 * rate * stopping, stopping


def _check_residual(cycle: RotationCycle, stops: complex, turns: complex, mark: Mark, log: Findings) -> None:
    share = abs(stops + turns) / cycle.period
    if share <= NOTHING:
        return
    percent = f"{100 * share:.{2 if share < 0.995 else 3}g}"  # 100, not 1e+02
    miles = 0.01 * math.radians(1) * share * MEAN_RADIUS / 1852
    message = (
        f"in every cycle of {cycle.period:.1f} s, {seconds_of_error(stops)} of a constant horizontal error remain from the stops and "
        f"{seconds_of_error(turns)} from the turns: {percent} % of the error is not modulated. A gyro drift of 0.01 deg/h then acts like a "
        f"drift of {0.01 * share:.2g} deg/h ({miles:.2g} nautical miles per hour)"
    )
    log.warning("physics-cycle-residual", mark, message, _DESIGN)


def _check_stops(motion: Cycle, mark: Mark, log: Findings) -> None:
    """Adds a warning if the stops on one side have a longer total time in a cycle than the stops on the opposite side."""
    angles = {name: round(math.degrees(angle) % 360, 6) % 360 for name, angle in motion.positions.items()}
    names: dict[float, str] = {}
    held: dict[float, float] = {}
    for move in motion.moves:
        angle = angles[move.start]
        names.setdefault(angle, move.start)
        held[angle] = held.get(angle, 0.0) + motion.stop
    unlike = []
    for angle, seconds in held.items():
        opposite = held.get(round((angle + 180) % 360, 6) % 360, 0.0)
        if seconds > opposite:
            unlike.append(f"{names[angle]} for {seconds:g} s per cycle, the opposite side for {opposite:g} s")
    message = f"the stops do not balance: {'; '.join(unlike)}"
    log.warning("physics-cycle-stops", mark, message, "stop equally long on opposite sides")


def _check_schuler(cycle: RotationCycle, dwell: float, site: Site, mark: Mark, log: Findings) -> None:
    drive = schuler_drive(cycle, dwell, site)
    if drive < 1:
        return
    minutes = 2 * math.pi / schuler_rate(site) / 60
    message = (
        f"a cycle of {cycle.period / 60:.1f} min drives the Schuler oscillation of {minutes:.1f} min: within this dwell, a "
        f"constant horizontal gyro drift makes the oscillation {drive:.2g} times as large as without rotation"
    )
    log.warning(
        "physics-cycle-schuler",
        mark,
        message,
        "shorten the stops, so that no harmonic of the cycle is near the Schuler frequency",
    )


def _check_whole(cycle: RotationCycle, dwell: float, mark: Mark, log: Findings) -> None:
    count = dwell / cycle.period
    if abs(count - round(count)) * cycle.period < 1e-3:
        return
    message = f"the dwell holds {count:.2f} cycles of {cycle.period:.1f} s; the errors of the incomplete last cycle are not balanced"
    log.note("physics-cycle-part", mark, message, f"write dwell: {{cycles: {max(1, round(count))}}}")


def seconds_of_error(left: complex) -> str:
    """States in words how much of a sensor error remains after a cycle: the component in the direction of the error and, if it is
    not zero, the perpendicular component (positive to the left, seen from above)."""
    across = f"{left.imag:+.2f} s across" if abs(left.imag) > 5e-3 else ""
    if abs(left.real) <= 5e-3:
        return across or "0 s"
    return f"{left.real:+.2f} s along and {across}" if across else f"{left.real:+.2f} s"


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
