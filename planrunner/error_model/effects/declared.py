"""Effects that are wrong declarations: the plan or the bench file states axes, signs, units or senses of rotation wrongly.

These effects change a whole output. A diagnosis therefore does not evaluate them like other effects:
`gap/hypotheses/declarations.py` finds them before the effects of the sensor are evaluated. If such an effect is added to a
simulation, the simulated recordings contain the mistake.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Column, Variant, on_stimulus, single, whole
from planrunner.error_model.effects.table import secant
from planrunner.error_model.observed import Observed
from planrunner.plan.schedule import Spin

DEG = np.pi / 180
CYCLES = ("xy", "yz", "zx", "xyz", "xzy")
"""Exchanges of outputs. The output of each axis shows the input of the axis with the next letter, and the output of the last axis
shows the input of the first axis."""


def _channels(observed: Observed) -> Iterator[tuple[str, int, int]]:
    """Yields the name (such as gyro_x), the index and the axis of every channel; nothing if the orientations of the sensor are
    unknown."""
    if observed.along is None:
        for index, channel in enumerate(observed.channels):
            yield f"{channel.kind}_{'xyz'[channel.axis]}", index, channel.axis


class AxisReversed:
    """Multiplies the output of a channel by −1: its sign is the opposite of the declared sign. Amplitude 1 means reversed,
    amplitude 0 means as declared."""

    id, stage, hypothesis = "axis_reversed", "output", False
    of_declaration: Literal[True] = True
    about = About(
        "sign of a channel is reversed",
        "A channel measures along the opposite direction of the declared axis.",
        Actor.BOOKKEEPING,
        "Change the `sign` of the channel in the bench file: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        nominal = observed.nominal_output
        return single(
            [
                Column(name, "1", 1.0, 1.0, {index: -2 * nominal[:, index]}, axis=axis)
                for name, index, axis in _channels(observed)
            ]
        )


class AxesMirrored:
    """Multiplies the outputs of the gyro and of the accelerometer along one axis by −1: the declared axes of the sensor form a
    left-handed system."""

    id, stage, hypothesis = "axes_mirrored", "output", False
    of_declaration: Literal[True] = True
    about = About(
        "axes of the sensor are declared left-handed",
        "Gyro and accelerometer both measure along the opposite direction of one declared axis, so that the "
        "declared axes form a left-handed system.",
        Actor.BOOKKEEPING,
        "Change the `sign` of both channels of this axis in the bench file: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        nominal, columns = observed.nominal_output, []
        for axis, letter in enumerate("xyz"):
            own = {index: -2 * nominal[:, index] for _, index, other in _channels(observed) if other == axis}
            if len(own) > 1:
                columns.append(Column(f"mirrored_{letter}", "1", 1.0, 1.0, own, axis=None))
        return single(columns)


class AxesExchanged:
    """The names of two or three outputs of a triad are exchanged. Amplitude 1 means exchanged, amplitude 0 means as declared."""

    id, stage, hypothesis = "axes_exchanged", "output", False
    of_declaration: Literal[True] = True
    about = About(
        "channels of two axes are exchanged",
        "Within a triad, the names of channels are exchanged, so a channel has the name of another axis.",
        Actor.BOOKKEEPING,
        "Exchange the columns of these channels in the bench file: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        nominal, columns = observed.nominal_output, []
        for kind in ("gyro", "accel"):
            at = {"xyz"[axis]: index for _, index, axis in _channels(observed) if observed.channels[index].kind == kind}
            for cycle in CYCLES:
                if set(cycle) <= set(at):
                    nexts = dict(zip(cycle, cycle[1:] + cycle[:1], strict=True))
                    parts = {at[own]: nominal[:, at[source]] - nominal[:, at[own]] for own, source in nexts.items()}
                    columns.append(Column(f"{kind}_{cycle}", "1", 1.0, 1.0, parts, axis=None))
        return single(columns)


class UnitWrong:
    """Multiplies an output by 1 + e: its values are in a unit other than the declared unit, and 1 + e is the factor between the two
    units."""

    id, stage, hypothesis = "unit_wrong", "output", False
    of_declaration: Literal[True] = True
    about = About(
        "unit of a channel is wrong",
        "The unit of the values of a channel differs from the unit in the bench file, or a constant factor is missing.",
        Actor.BOOKKEEPING,
        "Correct the `unit` or `per_unit` of the channel in the bench file: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        nominal = observed.nominal_output
        return single(
            [
                Column(f"excess_{name}", "1", 1.0, 1.0, {index: nominal[:, index]}, axis=axis)
                for name, index, axis in _channels(observed)
            ]
        )


class TableSenseReversed:
    """Multiplies the rate and the angle of the table by −1: the table turns in the opposite sense to the plan."""

    id, stage, hypothesis = "table_sense_reversed", "stimulus", False
    of_declaration: Literal[True] = True
    about = About(
        "table turns in the opposite sense",
        "The table turns in the sense opposite to the declared sense of rotation.",
        Actor.BENCH,
        "State the sense of rotation of the table correctly in the plan (`sense: clockwise`) or in its controller: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        if not observed.rate.any() or observed.along is not None:
            return []
        seen = turned_back(observed)
        return single([whole(on_stimulus(observed, seen.omega - observed.omega, seen.force - observed.force))])


class MountTurned:
    """Turns the sensor on its mounting: its orientation on the table differs from the declared orientation. The amplitudes are the
    components of a rotation vector in sensor axes; the rotation need not be small."""

    id, stage, hypothesis = "mount_turned", "stimulus", False
    of_declaration: Literal[True] = True
    about = About(
        "sensor is mounted in a different orientation",
        "Gyros and accelerometers are turned together, relative to the orientation in the plan.",
        Actor.PLAN,
        "Correct the orientations in the plan, or mount the sensor as planned: {found}.",
    )

    def variants(self, observed: Observed) -> list[Variant]:
        return self.around(observed, np.zeros(3))

    def around(self, observed: Observed, amplitudes: Array) -> list[Variant]:
        if observed.along is not None:
            return []
        columns = []
        for letter, axis in zip("xyz", np.eye(3), strict=True):
            felt = (secant(axis, vector, amplitudes) for vector in (observed.omega, observed.force))
            columns.append(Column(f"about_{letter}", "deg", DEG, DEG, on_stimulus(observed, *felt), axis=None))
        return single(columns)


def turned_back(observed: Observed) -> Observed:
    """Returns the recording with the opposite sense of rotation of the table."""
    motions = tuple(replace(m, rate=-m.rate) if isinstance(m, Spin) else m for m in observed.motions)
    return replace(
        observed,
        motions=motions,
        angle=-observed.angle,
        rate=-observed.rate,
        acceleration=-observed.acceleration,
    )


def rearranged(observed: Observed, sources: Sequence[int], factors: Sequence[float]) -> Observed:
    """Returns the recording with corrected channels: channel k is the output of channel `sources[k]` divided by `factors[k]`."""
    return replace(observed, values=observed.values[:, list(sources)] / np.asarray(factors))
