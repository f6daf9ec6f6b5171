"""Compares a recording with two simulations of its plan: one without the effects that a diagnosis found, and one with them.

The recording and both simulations are reduced to the coefficients of `evidence.spectrum`: the means of segments, their slow
changes, and the harmonics of turns and of rocking. First, the outputs that follow from the nominal motion are subtracted from the
recording and from each simulation. Times and table angles therefore need not agree exactly. The nominal parameters of the simulated
sensor differ from those of the recorded sensor. Therefore, the nominal columns are fitted to the difference between recording and
simulation.

In array shapes, S is the number of segments, M is the number of coefficients, and K is the number of channels. m counts the
coefficients that the recording and both simulations have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.documents import JsonObject
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.apart import clearly_repeated
from planrunner.gap.evidence.spectrum import Spectrum, spectrum, white_level
from planrunner.gap.hypotheses.candidates import Weighing, simulated
from planrunner.observation.refusals import ObservationError

FEWEST = 3
"""Smallest number of segments that the recording and the simulation must have in common."""
MOST_HELD = 1 / 3
"""Fraction of a segment that may consist of samples that repeat an earlier sample. If more samples of a channel repeat, the segment
is not compared: the other samples hardly determine its coefficients."""


@dataclass(frozen=True)
class ChannelComparison:
    """Compares one channel of the recording with the same channel of the two simulations, in the unit `unit`.

    `before`: size of the difference between the recording and the simulation without the effects. `after`: size of the difference
    between the recording and the simulation with the effects. `before` and `after` are root mean squares over the means, slow
    changes and harmonics of the segments. `noise`: size of the difference that noise alone would cause. `before_sigma`,
    `after_sigma`: `before` and `after` in standard deviations of the noise; 1 if there is only noise. `sample_noise`: standard
    deviation of a single sample in the recording and in both simulations. `means`: three arrays of shape (S,), one for the
    recording and one for each simulation. They contain the offset of each common segment after the fit of the nominal parameters.
    `sigma`: array of shape (S,), standard uncertainty of the offsets in the recording due to noise.
    """

    unit: str
    before: float
    after: float
    noise: float
    before_sigma: float
    after_sigma: float
    sample_noise: tuple[float, float, float]
    means: tuple[Array, Array, Array] = field(repr=False)
    sigma: Array = field(repr=False)


@dataclass(frozen=True)
class GapComparison:
    """Compares a recording with two simulations of its plan: one without the effects that a diagnosis found, and one with them.
    `labels`: labels of the segments that the recording and both simulations have in common."""

    labels: tuple[str, ...]
    channels: dict[str, ChannelComparison]

    @property
    def before_sigma(self) -> float:
        """Returns the root mean square of `before_sigma` over the channels."""
        return float(np.sqrt(np.mean([one.before_sigma**2 for one in self.channels.values()])))

    @property
    def after_sigma(self) -> float:
        return float(np.sqrt(np.mean([one.after_sigma**2 for one in self.channels.values()])))

    def to_json(self) -> JsonObject:
        """Returns JSON data according to `comparison` of `schemas/diagnosis.schema.json`."""
        channels: JsonObject = {}
        for name, one in self.channels.items():
            recorded, before, after = one.means
            channels[name] = {
                "unit": one.unit,
                "before": one.before,
                "after": one.after,
                "noise": one.noise,
                "before_sigma": one.before_sigma,
                "after_sigma": one.after_sigma,
                "sample_noise": dict(zip(("recorded", "before", "after"), one.sample_noise, strict=True)),
                "means": {
                    "recorded": recorded.tolist(),
                    "before": before.tolist(),
                    "after": after.tolist(),
                    "noise": one.sigma.tolist(),
                },
            }
        return {"segments": list(self.labels), "channels": channels}


def compare(weighing: Weighing, nominal: Sequence[str], before: Observed, after: Observed) -> GapComparison:
    """Compares the recording in `weighing` with two simulations: `before` does not contain the effects, `after` contains them.
    `nominal`: names of the terms that the nominal simulation fits. Samples that repeat an earlier sample are excluded from the
    recording and from both simulations. Raises `ObservationError` if the recording and the simulations share too few segments, or
    if a simulation lacks a channel of the recording."""
    recorded = _Reduced.of(weighing.observed, weighing.spectrum, weighing.white, weighing.held)
    first, second = (_Reduced.simulated(one, nominal) for one in (before, after))
    labels = [name for name in recorded.rows if name in first.rows and name in second.rows]
    names = [channel.name for channel in recorded.observed.channels]
    if len(labels) < FEWEST or any(name not in one.columns for name in names for one in (first, second)):
        hint = "simulate the plan of the recording on a bench whose sensor has the same outputs"
        raise ObservationError("recording and simulation have too few segments or channels in common", hint)
    at = _common(labels, recorded, first, second)
    channels = {name: _channel(weighing, index, (recorded, first, second), at) for index, name in enumerate(names)}
    return GapComparison(tuple(labels), channels)


@dataclass(frozen=True)
class _Reduced:
    """Contains a recording or simulation that was reduced to coefficients.

    `values`: array of shape (M, K) in SI units, the coefficients, each scaled so that it is a root mean square over its segment.
    `counts`: array of shape (M,), number of samples in the segment of each coefficient. `harmonic`: array of shape (M,), kind of
    each coefficient, as in `SpectralBasis`. `rows`: the rows of each segment that is compared, by label; the first row is the mean.
    `columns`: the column of each channel, by name. `white`: array of shape (K,), standard deviation of the white noise of a single
    sample.
    """

    observed: Observed
    values: Array
    counts: Array
    harmonic: NDArray[np.int64]
    rows: dict[str, slice]
    columns: dict[str, int]
    white: Array

    @classmethod
    def of(cls, observed: Observed, found: Spectrum, white: Array, held: NDArray[np.bool_] | None) -> _Reduced:
        counts = observed.counts[found.segment].astype(float)
        ends = [*found.means[1:], len(found.segment)]
        shares = [0.0 if held is None else held[part].mean(axis=0).max() for part in observed.segments()]
        rows = {
            label: slice(int(a), int(b))
            for label, a, b, share in zip(observed.labels, found.means, ends, shares, strict=True)
            if share <= MOST_HELD
        }
        columns = {channel.name: index for index, channel in enumerate(observed.channels)}
        return cls(observed, found.values / np.sqrt(counts)[:, None], counts, found.harmonic, rows, columns, white)

    @classmethod
    def simulated(cls, observed: Observed, nominal: Sequence[str]) -> _Reduced:
        repeats = clearly_repeated(observed)
        held = None if repeats is None else repeats.held
        found = spectrum(observed, simulated(observed, nominal), held)
        counts = np.array([channel.resolution for channel in observed.channels])
        return cls.of(observed, found, np.maximum(white_level(observed, found)[0], counts / np.sqrt(12)), held)


@dataclass(frozen=True)
class _Common:
    """Lists the rows that the recording and both simulations have in common. `rows`: indices (m,) of these rows in the recording
    and in each simulation. `means`: array of shape (m,), True for rows that are means of segments."""

    rows: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
    means: NDArray[np.bool_]


def _common(labels: Sequence[str], *three: _Reduced) -> _Common:
    """Finds the common rows. If the basis of a segment is the same in the recording and in both simulations, all coefficients of
    the segment are common rows. Otherwise, only the mean of the segment is a common row."""
    found: list[list[NDArray[np.int64]]] = [[], [], []]
    means = []
    for label in labels:
        kinds = [one.harmonic[one.rows[label]].tolist() for one in three]
        size = len(kinds[0]) if kinds[0] == kinds[1] == kinds[2] else 1
        for listed, one in zip(found, three, strict=True):
            listed.append(one.rows[label].start + np.arange(size))
        means.append(np.arange(size) == 0)
    recorded, before, after = (np.concatenate(listed) for listed in found)
    return _Common((recorded, before, after), np.concatenate(means))


def _channel(
    weighing: Weighing, index: int, three: tuple[_Reduced, _Reduced, _Reduced], at: _Common
) -> ChannelComparison:
    channel = weighing.observed.channels[index]
    columns = [one.columns[channel.name] for one in three]
    recorded, first, second = (
        one.values[rows, column] for one, rows, column in zip(three, at.rows, columns, strict=True)
    )
    white = [float(one.white[column]) for one, column in zip(three, columns, strict=True)]
    root = np.sqrt(three[0].counts[at.rows[0]])
    nominal = weighing.whole[index][at.rows[0]] / root[:, None]
    own = white[0] ** 2 / root**2
    spread = _slow(weighing, index, at)
    variances = [own + white[k] ** 2 / three[k].counts[at.rows[k]] + 2 * spread for k in (1, 2)]
    before = _left(recorded - first, nominal, variances[0])
    after = _left(recorded - second, nominal, variances[1])
    degrees = max(len(recorded) - np.linalg.matrix_rank(nominal), 1) if nominal.shape[1] else len(recorded)
    segments = float(np.count_nonzero(at.means))

    def size(values: Array) -> float:
        return float(np.sqrt(values.sum() / segments * len(recorded) / degrees)) / channel.factor

    means = tuple(_left(part, nominal, own + spread)[at.means] / channel.factor for part in (recorded, first, second))
    sigma = np.sqrt((own + spread)[at.means]) / channel.factor
    return ChannelComparison(
        channel.unit,
        size(before**2),
        size(after**2),
        float(np.sqrt(variances[1].sum() / segments)) / channel.factor,
        float(np.sqrt((before**2 / variances[0]).sum() / degrees)),
        float(np.sqrt((after**2 / variances[1]).sum() / degrees)),
        (white[0] / channel.factor, white[1] / channel.factor, white[2] / channel.factor),
        (means[0], means[1], means[2]),
        sigma,
    )


def _slow(weighing: Weighing, index: int, at: _Common) -> Array:
    """Returns the variances due to slow noise and rounding in the segment means of the recording, shape (m,). The variances are
    zero for coefficients that are not means."""
    weight, found = weighing.weights[index][0], weighing.spectrum
    counts = weighing.observed.counts.astype(float)
    whole = weight.variances[found.means] / counts - weighing.white[index] ** 2 / counts
    out = np.zeros(len(at.means))
    out[at.means] = np.maximum(whole[found.segment[at.rows[0]][at.means]], 0.0)
    return out


def _left(values: Array, nominal: Array, variance: Array) -> Array:
    """Returns the residuals (m,) of values (m,) after a weighted fit of the nominal columns (m, q). `variance`: array of shape
    (m,), variance of each value."""
    if not nominal.shape[1]:
        return values
    weight = 1 / np.sqrt(variance)
    size = np.linalg.norm(nominal, axis=0) + 1e-300
    fit = np.linalg.lstsq(nominal / size * weight[:, None], values * weight, rcond=None)[0]
    return np.asarray(values - nominal / size @ fit)
