"""Instruments that a bench lacks, but with which it could distinguish explanations that its own segments cannot.

Such an instrument is evaluated in the same way as an additional segment.

Effects of the table and of the site act on every instrument on the table. Effects of the sensor under test and of its data do not
act on other instruments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column
from planrunner.error_model.observed import Channel, Observed
from planrunner.gap.answer.discrimination import Rival, expected_probability
from planrunner.gap.answer.foreseen import foresee
from planrunner.gap.answer.rivals import Layout
from planrunner.gap.hypotheses.candidates import Weighing, nominal_columns
from planrunner.plan.schedule import Segment
from planrunner.plan.units import STANDARD_GRAVITY

ENOUGH = 0.9  # expected probability of the true explanation with the instrument
ACCELEROMETER = 50e-6 * STANDARD_GRAVITY  # SI·√s, white noise of an additional instrument
ARCSECOND = np.pi / 180 / 3600  # standard uncertainty of an autocollimator with a level
_LOOKED_AT = 40  # segments


@dataclass(frozen=True)
class _Instrument:
    words: str
    channels: tuple[Channel, ...] = ()
    pointing: bool = False


def helpful(weighing: Weighing, rivals: Sequence[Rival], layout: Layout, options: Sequence[Segment]) -> str:
    """Describes the first instrument that would identify the true explanation; the description is empty if no instrument would do
    so."""
    few = [options[i] for i in np.unique(np.linspace(0, len(options) - 1, _LOOKED_AT).astype(int))]
    for instrument in _instruments(weighing):
        extended, information = _with(instrument, weighing, rivals, layout, few)
        if expected_probability(extended, information) >= ENOUGH:
            return instrument.words
    return ""


def _instruments(weighing: Weighing) -> list[_Instrument]:
    gyros = [weighing.observed.channels[c] for c in weighing.observed.of_kind("gyro")]
    accels = weighing.observed.of_kind("accel")
    found = [_Instrument("an autocollimator and a level on the table, accurate to one arc second", pointing=True)]
    if not accels:
        triad = [
            Channel(f"second_accel_{axis}", "accel", i, "m/s^2", 1.0, ACCELEROMETER) for i, axis in enumerate("xyz")
        ]
        found.append(_Instrument("three accelerometers of 50 µg/√Hz in addition to the gyros", tuple(triad)))
    if gyros:
        second = tuple(replace(channel, name=f"second_{channel.name}") for channel in gyros)
        found.append(_Instrument("a second triad of gyros like these on the same table", second))
    return found


def _with(
    instrument: _Instrument, weighing: Weighing, rivals: Sequence[Rival], layout: Layout, options: Sequence[Segment]
) -> tuple[list[Rival], Array]:
    """The rivals, extended by the instrument's own nominal parameters, and the total information from all options when they are
    measured with this instrument in addition."""
    observed = weighing.observed
    both = replace(observed, channels=(*observed.channels, *instrument.channels))
    own = len(observed.channels)
    white = np.concatenate([weighing.white, [c.white * sqrt(observed.sample_rate) for c in instrument.channels]])
    more = len(_further(both, own, layout))
    information = np.zeros((sum(layout.widths) + more,) * 2)
    for item in foresee(both, white, options, _columns(layout, observed.channels), [*layout.widths, more]):
        information += item.whole
    if instrument.pointing:
        information += np.diag(np.concatenate([_seen(layout), np.zeros(more)]))
    return [_widened(rival, sum(layout.widths), more) for rival in rivals], information


def _further(observed: Observed, own: int, layout: Layout) -> list[Column]:
    """The columns of the nominal parameters of the additional channels. Additional channels have the indices `own` and above; the
    sensor under test does not have them."""
    return [column for column in nominal_columns(observed, layout.nominal) if min(column.parts) >= own]


def _columns(layout: Layout, channels: tuple[Channel, ...]) -> Callable[[Observed], Sequence[Sequence[Column]]]:
    def columns(planned: Observed) -> Sequence[Sequence[Column]]:
        sensor = replace(planned, channels=channels, values=planned.values[:, : len(channels)])
        nominal, *groups = layout.columns(sensor)
        felt = [
            part.on(planned) if part.effect.stage == "stimulus" else group
            for part, group in zip(layout.parts, groups, strict=True)
        ]
        return [nominal, *felt, _further(planned, len(channels), layout)]

    return columns


def _seen(layout: Layout) -> Array:
    """Information (P,) that a direct measurement of pointing gives about the amplitudes of table effects that are angles."""
    found = [np.zeros(layout.widths[0])]
    for part, width in zip(layout.parts, layout.widths[1:], strict=True):
        columns = part.weighed.variant.columns
        angle = part.effect.stage == "stimulus" and columns[0].unit == "arcsec"
        found.append(np.full(width, (columns[0].magnitude / ARCSECOND) ** 2 if angle else 0.0))
    return np.concatenate(found)


def _widened(rival: Rival, size: int, more: int) -> Rival:
    precision = np.zeros((len(rival.mean) + more,) * 2)
    precision[: len(rival.mean), : len(rival.mean)] = rival.precision
    precision[len(rival.mean) :, len(rival.mean) :] = 1e-6 * np.eye(more)
    columns = np.concatenate([rival.columns, np.arange(size, size + more)])
    return replace(rival, columns=columns, mean=np.concatenate([rival.mean, np.zeros(more)]), precision=precision)
