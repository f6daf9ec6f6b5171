"""Compares the requirements of a motion with the limits of a table's axes: rate, acceleration, and travel between the joint limits.

These rules are defined only here. The check of a plan reports a motion that exceeds a limit; drivers and simulated tables refuse
it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.physics.kinematics import SLACK, TableAxis, joint_directions, limits_in_words, spin_axis
from planrunner.physics.rotation_cycle import RotationCycle
from planrunner.plan.schedule import Cycle, Motion, Rock, Spin

_GRANTED = 1 + 1e-9  # allowance for rounding at a limit


@dataclass(frozen=True, slots=True)
class Excess:
    """Describes a requirement of a motion that an axis does not meet. `kind`: 'rings' (the table has too few axes), 'axis' (no axis
    has the direction), 'rate', 'acceleration' or 'travel'. `message`: what the motion requires and what the axis offers."""

    kind: str
    message: str


@dataclass(frozen=True, slots=True)
class SpinCourse:
    """A spin as a table executes it.

    `joint`: index of the axis that turns. `rate`: signed rate of this joint, rad/s. `ramp`: time from rest to the full rate, s; the
    time back to rest is the same.
    """

    joint: int
    rate: float
    ramp: float

    @classmethod
    def of(
        cls, motion: Spin, axes: Sequence[TableAxis], joints: Sequence[float] | Array, azimuth: float = 0.0
    ) -> SpinCourse:
        """Finds how a table executes a spin. `joints`: joint angles at the start of the spin, rad. `azimuth`: azimuth of the site,
        rad. Raises `Unreachable` if no axis has the direction of the spin."""
        index = spin_axis(axes, joints, motion.about, azimuth)
        along = float(joint_directions(axes, joints, azimuth)[index] @ np.asarray(motion.about))
        ramp = abs(motion.rate) / axes[index].max_acceleration
        return cls(index, math.copysign(1.0, along) * motion.rate, ramp)

    def travel(self, seconds: float) -> float:
        """Returns the angle [rad] that the axis covers from rest to rest if the rate is held for `seconds`. During a ramp, the axis
        covers half of the angle that it would cover at the full rate in the same time."""
        return self.rate * (seconds + self.ramp)


def spin_excess(
    axes: Sequence[TableAxis], joints: Sequence[float] | Array, course: SpinCourse, seconds: float | None
) -> list[Excess]:
    """Returns the requirements of a spin that exceed the limits of the axis; the spin starts at the joint angles `joints` [rad].
    `seconds`: time for which the rate is held; None if unknown."""
    axis = axes[course.joint]
    found = _beyond(axis, "spinning", abs(course.rate))
    if not found and seconds is not None and not axis.continuous:
        turned = course.travel(seconds)
        end = float(joints[course.joint]) + turned
        if not axis.lowest - SLACK <= end <= axis.highest + SLACK:
            found.append(
                Excess(
                    "travel",
                    f"spinning (with spin-up, settling and stopping) turns the {axis.name} axis by {_deg(turned)} deg, from "
                    f"{_deg(float(joints[course.joint]))} to {_deg(end)} deg; {limits_in_words(axis)}",
                )
            )
    return found


def rock_excess(axes: Sequence[TableAxis], joints: Sequence[float] | Array | None, motion: Rock) -> list[Excess]:
    """Returns the requirements of a rocking motion that exceed the limits of the axes. `joints`: the joint angles about which the
    axes rock, rad; None if unknown."""
    found: list[Excess] = []
    if len(motion.phases) > len(axes):
        found.append(Excess("rings", f"{len(motion.phases)} rings are planned to rock, but the table has {len(axes)}"))
    circular = 2 * math.pi * motion.frequency
    for index, axis in enumerate(axes[: len(motion.phases)]):
        found += _beyond(axis, "rocking", motion.amplitude * circular, motion.amplitude * circular**2)
        if joints is None:
            continue
        low, high = float(joints[index]) - motion.amplitude, float(joints[index]) + motion.amplitude
        if low < axis.lowest - SLACK or high > axis.highest + SLACK:
            found.append(
                Excess(
                    "travel",
                    f"rocking turns the {axis.name} axis from {_deg(low)} to {_deg(high)} deg; {limits_in_words(axis)}",
                )
            )
    return found


def cycle_excess(axis: TableAxis, start: float | None, motion: Cycle) -> list[Excess]:
    """Returns the requirements of a cycle that exceed the limits of the axis. `start`: joint angle at the start of the cycle, rad;
    None if unknown."""
    found = _beyond(axis, "turning", motion.rate)
    low, high = RotationCycle.of(motion, axis.max_acceleration).reach
    if high - low > axis.highest - axis.lowest + SLACK:
        there = f"the {axis.name} axis allows {_deg(axis.highest - axis.lowest)} deg"
        found.append(Excess("travel", f"the cycle turns through {_deg(high - low)} deg; {there}"))
    elif start is not None and (start + low < axis.lowest - SLACK or start + high > axis.highest + SLACK):
        reached = f"from {_deg(start + low)} to {_deg(start + high)} deg"
        found.append(Excess("travel", f"the cycle turns the {axis.name} axis {reached}; {limits_in_words(axis)}"))
    return found


def about_one_axis(motion: Motion) -> bool:
    """Returns True if one angle describes the motion, that is, if the motion does not turn several axes."""
    return not (isinstance(motion, Rock) and len(motion.phases) > 1)


def _beyond(axis: TableAxis, what: str, rate: float, acceleration: float = 0.0) -> list[Excess]:
    """Returns the requirements that exceed the largest rate or the largest acceleration of an axis. `rate`: required rate, rad/s.
    `acceleration`: required acceleration, rad/s²."""
    found = []
    if rate > axis.max_rate * _GRANTED:
        able = f"the {axis.name} axis reaches at most {_deg(axis.max_rate)} deg/s"
        found.append(Excess("rate", f"{what} needs {_deg(rate)} deg/s; {able}"))
    if acceleration > axis.max_acceleration * _GRANTED:
        able = f"the {axis.name} axis reaches at most {_deg(axis.max_acceleration)} deg/s^2"
        found.append(Excess("acceleration", f"{what} needs {_deg(acceleration)} deg/s^2; {able}"))
    return found


def _deg(radians: float) -> str:
    return f"{math.degrees(radians):g}"
