"""Finds effects that do not appear in the coefficients of a recording, for example a tone of constant frequency. The coefficients
describe each segment by its mean, its slow changes and its harmonics (`evidence.spectrum`). The effects outside the coefficients
are found first and removed from the samples, so that they do not influence the evaluation of the other effects. They are present or
absent independently of the other effects. Therefore, their log evidence is added to the log evidence of the other effects.

One effect of this kind is a stuck output: the output keeps one value for longer than its noise allows. The evidence compares stuck
stretches with sequences of equal samples that white noise produces by chance. With white noise, a sample repeats the previous count
with a probability r. The number L of consecutive equal samples therefore has the geometric distribution P(L) = (1 − r)·r^(L−1). To
estimate r, the samples of a segment that repeat the previous sample are counted; the longest sequence of equal samples is not
included. As real noise is correlated, √r is used instead of r. A stuck stretch may have any length; the prior is uniform in the
logarithm of the length, and one stuck stretch is expected in a recording. Channels with coarse counts are not examined, because
their noise often stays within one count for a long time. Recordings that consist of means over bins are not examined either,
because such means do not show repeated samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.added import LASTING
from planrunner.error_model.effects.interface import Column, Effect, OutsideCoefficients, Shaped, triad_of
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.parameters import ParameterEstimate
from planrunner.gap.evidence.bayes_factors import log_mean_exp
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.outside import PLAIN, TONE, Line, Outside, outside, scopes_of
from planrunner.plan.schedule import Rest, Spin

_RUNS = 20  # smallest number of sequences of equal samples in a segment from which r is estimated
_MOST = 0.3  # largest r of a usable channel; a larger r differs between the middle and the edges of a count


@dataclass(frozen=True, slots=True)
class RepeatedStretch:
    """Describes consecutive samples of a channel, each equal to the sample before it.

    `channel`: index of the channel. `first`: index of the first sample that repeats its predecessor. `count`: number of samples
    that repeat their predecessors.
    """

    channel: int
    first: int
    count: int


@dataclass(frozen=True)
class Repeated:
    """Contains the stuck stretches of a recording. `log_bayes`: log Bayes factor of stuck stretches, relative to none. `stretches`:
    the likely stretches, the longest first. `held`: array of shape (N, K), True for the samples of the stretches.
    """

    log_bayes: float
    stretches: tuple[RepeatedStretch, ...]
    held: NDArray[np.bool_]


def repeated(observed: Observed) -> Repeated:
    """Finds the stuck stretches of a recording of single samples. If the recording consists of means over bins, no stretches are
    found."""
    held = np.zeros(observed.values.shape, dtype=bool)
    found: list[RepeatedStretch] = []
    total, chance = 0.0, 1.0 / max(held.size, 2)
    parts = observed.segments() if observed.bins is None else []
    for part in parts:
        for channel in range(len(observed.channels)):
            values = observed.values[part, channel]
            ends = np.append(np.flatnonzero(values[1:] != values[:-1]), len(values) - 1)
            lengths = np.diff(ends, prepend=-1)
            longest = int(lengths.max())
            repeats = (len(values) - len(lengths) - (longest - 1)) / max(len(values) - longest, 1)
            if len(lengths) < _RUNS or repeats > _MOST:
                continue
            r = np.sqrt(max(repeats, 1 / len(lengths)))
            usual = np.log1p(-r) + (lengths - 1) * np.log(r)
            stuck = -np.log(lengths * np.log(len(values))) - usual + np.log(chance)
            total += float(np.logaddexp(np.log1p(-chance), stuck).sum())
            for run in np.flatnonzero(stuck > 0):
                first = part.start + int(ends[run] - lengths[run]) + 2
                found.append(RepeatedStretch(channel, first, int(lengths[run]) - 1))
                held[first : first + int(lengths[run]) - 1, channel] = True
    return Repeated(total, tuple(sorted(found, key=lambda one: -one.count)), held)


_ROUNDS = 5  # number of corrections of the frequency
_STEP = 1e-3  # step of the derivative with respect to the frequency, relative to the resolution 1/T


@dataclass(frozen=True)
class Apart:
    """Contains the effects that were found outside the coefficients of the recording.

    `log_bayes`: log Bayes factor of these effects. `parameters`: estimated parameters of these effects. `lines`: the effects among
    them that are tones. `removed`: array of shape (N, K) in SI units, contribution of the effects to the samples; None if no effect
    was found. `outside`: evidence for patterns that the coefficients cannot represent; None if `removed` changed the samples. This
    evidence must then be computed again.
    """

    log_bayes: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, list[ParameterEstimate]] = field(default_factory=dict)
    lines: tuple[Line, ...] = ()
    removed: Array | None = field(default=None, repr=False)
    outside: Outside | None = field(default=None, repr=False)


def likely_repeats(observed: Observed, effects: Sequence[Effect]) -> Repeated | None:
    """Finds stretches of repeated samples. Returns None if `effects` does not include stuck samples, or if the recording does not
    clearly show such stretches."""
    if not any(isinstance(effect, OutsideCoefficients) and effect.outside == "stuck" for effect in effects):
        return None
    return clearly_repeated(observed)


def clearly_repeated(observed: Observed) -> Repeated | None:
    """Finds stretches of repeated samples; None if a recording or simulation does not clearly show such stretches."""
    found = repeated(observed)
    return found if found.log_bayes > PLAIN and found.stretches else None


def repeated_parameters(observed: Observed, effect: str, found: Repeated) -> list[ParameterEstimate]:
    """Determines when the longest stretch of repeated samples begins, and how long it lasts. The result contains one duration if
    all outputs repeat their values, and otherwise one duration for each affected output. The start and the end of the stretch are
    each uniformly distributed over one interval between samples, so the duration has the triangular distribution of their
    difference."""
    step = 1 / observed.sample_rate
    longest = found.stretches[0]
    alike = {one.channel: one for one in reversed(found.stretches) if abs(one.first - longest.first) <= 1}
    of_time, of_duration = step / float(np.sqrt(12)), step / float(np.sqrt(6))
    begin = float(observed.time[longest.first]) - step / 2
    listed = [ParameterEstimate(effect, "time", begin, "s", of_time)]
    if len(alike) == len(observed.channels):
        return [*listed, ParameterEstimate(effect, LASTING, longest.count * step, "s", of_duration)]
    return listed + [
        ParameterEstimate(effect, f"{LASTING}_{observed.channels[c].name}", one.count * step, "s", of_duration)
        for c, one in sorted(alike.items())
    ]


def found_apart(weighing: Weighing, effects: Sequence[Effect], repeats: Repeated | None = None) -> Apart:
    """Finds the effects that appear in the samples of the recording but not in its coefficients. A line counts as an effect only if
    it has its own cause and is not a part of the noise (`hypotheses.outside`)."""
    seen, observed = outside(weighing), weighing.observed
    log_bayes, parameters, lines = {}, {}, list[Line]()
    removed = np.zeros_like(observed.values)
    for effect in effects:
        if repeats is not None and isinstance(effect, OutsideCoefficients) and effect.outside == "stuck":
            log_bayes[effect.id] = repeats.log_bayes
            parameters[effect.id] = repeated_parameters(observed, effect.id, repeats)
        if not (isinstance(effect, OutsideCoefficients) and effect.outside == "line" and isinstance(effect, Shaped)):
            continue
        members = observed.of_kind(triad_of(effect))
        names = {observed.channels[index].name for index in members}
        causes = [line for line in seen.causes if line.channel in names]
        if not causes:
            continue
        own = np.array([set(scope) <= set(members) for scope in scopes_of(weighing)])
        log_bayes[effect.id] = float(log_mean_exp(seen.log_bayes[TONE][own], 0))
        lines += causes
        strongest = max(causes, key=lambda line: line.evidence)
        frequency, u, columns, values = fitted_line(weighing, effect, strongest.frequency)
        parameters[effect.id] = [ParameterEstimate(effect.id, effect.shape_name, frequency, effect.shape_unit, u)]
        for column, (value, spread) in zip(columns, values.tolist(), strict=True):
            size, sigma = value / column.factor, spread / column.factor
            parameters[effect.id].append(ParameterEstimate(effect.id, column.name, size, column.unit, sigma))
            for channel, part in column.parts.items():
                removed[:, channel] += value * part
    if not lines:
        return Apart(log_bayes, parameters, outside=seen)
    return Apart(log_bayes, parameters, tuple(lines), removed)


def fitted_line(weighing: Weighing, effect: Shaped, frequency: float) -> tuple[float, float, Sequence[Column], Array]:
    """Fits one line, which is a tone of one frequency. Returns four values: the frequency [Hz] of the line; its standard
    uncertainty [Hz]; the columns of the effect at this frequency; and an array of shape (P, 2), the amplitudes and their standard
    uncertainties in SI units.

    `frequency`: frequency at which the search starts. It must agree with the frequency of the line within the frequency resolution
    of the recording. The fit takes Gauss–Newton steps in the frequency, which is the same for all channels. The basis vectors of
    the segments are projected out of every column, because they have also been removed from the samples. The noise level of a
    channel is computed from the samples without the line.
    """
    observed = weighing.observed
    used = np.array([isinstance(motion, Rest | Spin) for motion in observed.motions])[observed.owner]
    root = np.sqrt(observed.bin_size)[observed.owner]
    taken = sum(
        basis.removed.shape[1]
        for basis, at in zip(weighing.spectrum.bases, observed.segments(), strict=True)
        if used[at.start]
    )
    free = int(used.sum()) - taken
    step = _STEP / float(np.ptp(observed.time))
    found = frequency
    for _ in range(_ROUNDS):
        columns = effect.at(observed, found).columns
        beside = [effect.at(observed, found + way * step).columns for way in (1, -1)]
        size = len(columns) + 1
        normal, right = np.zeros((size, size)), np.zeros(size)
        for channel in sorted({index for column in columns for index in column.parts}):
            own = [k for k, column in enumerate(columns) if channel in column.parts]
            level = np.sqrt(weighing.noise.level[observed.owner, channel])[used]
            remainder = weighing.spectrum.remainder[used, channel] / level
            waves = [
                weighing.spectrum.outside(observed, np.column_stack([one[k].parts[channel] * root for k in own]))
                for one in (columns, *beside)
            ]
            waves = [wave[used] / level[:, None] for wave in waves]
            amplitudes = np.linalg.lstsq(waves[0], remainder, rcond=None)[0]
            rest = remainder - waves[0] @ amplitudes
            white = np.maximum(np.sqrt(rest @ rest / (free - len(own))), weighing.steps[channel] / np.sqrt(12))
            waves, remainder = [wave / white for wave in waves], remainder / white
            slope = (waves[1] - waves[2]) @ amplitudes / (2 * step)
            design = np.column_stack([waves[0], slope])
            at = [*own, size - 1]
            normal[np.ix_(at, at)] += design.T @ design
            right[at] += design.T @ remainder
        scale = np.sqrt(np.diag(normal)) + 1e-300
        covariance = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
        solved, spread = covariance @ right, np.sqrt(np.diag(covariance))
        found += float(solved[-1])
    return found, float(spread[-1]), columns, np.column_stack([solved, spread])[:-1]
