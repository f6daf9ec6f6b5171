"""Proposes what to measure next. The proposal is either segments that distinguish the remaining explanations in the shortest time
on this bench, or an instrument that the bench lacks.

Every remaining explanation, called a rival, is a linear model that predicts further recordings. The model consists of the nominal
parameters and of effects with normally distributed amplitudes. The posterior from the recording is the prior for the next
measurements. Therefore, if explanation A is true, the expected log evidence of A against explanation B is the Kullback-Leibler
divergence between their predictions. This divergence is the criterion of Box and Hill (Technometrics 9, 1967): T-optimality
(Atkinson and Fedorov, Biometrika 62, 1975), averaged over the uncertainty of the amplitudes. Only the information matrix of the new
measurements is needed, so the computing time does not depend on the number of samples.

The information that a segment would give is computed before the segment is measured. To save time, only a few seconds of each
segment are computed at the sampling rate of the recording. These seconds contain whole turns or periods. The rest of the segment is
treated as a repetition of these seconds.

The choice is greedy: each step takes the segment with the most expected evidence per second of test time, which includes moves and
temperature changes. The search ends when the expected probability of the true explanation is high enough, or when no segment helps.
A repetition of the recorded segments is evaluated in the same way, for comparison.

If the segments of the bench cannot distinguish the explanations, additional instruments are evaluated in the same way as segments.
Effects of the table and of the site act on every instrument on the table. Effects of the sensor under test and of its data
acquisition do not act on these instruments.

In array shapes, P is the number of columns of all explanations, R is the number of explanations, and K is the number of channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column, Effect, Shaped
from planrunner.error_model.observed import Channel, Observed
from planrunner.gap.answer.posterior import Posterior
from planrunner.gap.evidence.covariance import flicker
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing, nominal_columns, simulated
from planrunner.physics.sampled_motion import motion_at
from planrunner.plan.schedule import Rest, Rock, Segment, Spin
from planrunner.plan.units import STANDARD_GRAVITY, ZERO_CELSIUS

_FLAT = 1e-9  # precision of an unknown parameter, relative to its information from the recording
_AT_ONCE = 4_000_000  # numbers in the matrices that are evaluated at the same time; limits memory
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(21)


@dataclass(frozen=True)
class Rival:
    """Describes a rival explanation after a recording. `columns`: array of shape (p,), indices of the rival's columns among all
    columns. `mean` (p,) and `precision` (p, p) describe the posterior of the amplitudes of these columns."""

    name: str
    probability: float
    columns: NDArray[np.int64] = field(repr=False)
    mean: Array = field(repr=False)
    precision: Array = field(repr=False)

    @classmethod
    def learnt(
        cls, name: str, probability: float, columns: NDArray[np.int64], prior: Array, information: Array, score: Array
    ) -> Rival:
        """Returns the rival with the posterior of its amplitudes after a recording. `prior`: array of shape (p,), precision
        (inverse variance) of the amplitudes about zero before the recording. The precision is 0 for a nominal parameter.
        `information` (P, P) and `score` (P,): information matrix and score vector of the recording for all columns of all rivals,
        in units of the noise."""
        own = information[np.ix_(columns, columns)]
        precision = own + np.diag(prior + _FLAT * np.maximum(np.diag(own), 1.0))
        mean = np.asarray(np.linalg.solve(precision, score[columns]))
        return cls(name, probability, columns, mean, precision)


def expected_evidence(rivals: Sequence[Rival], information: Array) -> Array:
    """Returns the expected log evidence of measurements for rival i against rival j if i is true, shape (…, R, R). `information`:
    information of the measurements, shape (…, P, P)."""
    size = information.shape[-1]
    covariance = [np.linalg.inv(rival.precision) for rival in rivals]
    found = np.zeros((*information.shape[:-2], len(rivals), len(rivals)))
    gained, left, spent = [], [], []
    for rival in rivals:
        own = rival.columns
        across = information[..., own, :]
        after = rival.precision + across[..., own]
        solved = np.linalg.solve(after, across)
        gained.append(np.linalg.slogdet(after)[1] - np.linalg.slogdet(rival.precision)[1])
        left.append(information - np.swapaxes(across, -1, -2) @ solved)
        spent.append(np.trace(solved[..., own], axis1=-2, axis2=-1))
    for i, a in enumerate(rivals):
        for j, b in enumerate(rivals):
            if i == j:
                continue
            apart = np.zeros(size)
            apart[a.columns] += a.mean
            apart[b.columns] -= b.mean
            rows, columns = np.ix_(a.columns, a.columns)
            unsure = np.sum(left[j][..., rows, columns] * covariance[i], axis=(-2, -1))
            found[..., i, j] = 0.5 * (left[j] @ apart @ apart + unsure - spent[j] + gained[j] - gained[i])
    return np.maximum(found, 0.0)


def expected_loss(rivals: Sequence[Rival], information: Array) -> Array:
    """Returns the expected loss after measurements, shape (…). The loss is −log of the probability of the true rival. The best
    measurements have the smallest expected loss. The information of the measurements has the shape (…, P, P)."""
    many = information.reshape(-1, *information.shape[-2:])
    at_once = max(1, _AT_ONCE // (len(rivals) * many[0].size)) if len(many) else 1
    parts = [
        _averaged(rivals, expected_evidence(rivals, many[first : first + at_once]), np.log1p)
        for first in range(0, len(many), at_once)
    ]
    return np.concatenate([*parts, np.zeros(0)]).reshape(information.shape[:-2])


def expected_probability(rivals: Sequence[Rival], information: Array) -> float:
    """Returns the expected posterior probability of the true rival after measurements. The information of these measurements has
    the shape (P, P).

    The log evidence is assumed to be normal with the expectation D of `expected_evidence` and the variance 2D, as for two known signals.
    """
    return float(_averaged(rivals, expected_evidence(rivals, information), lambda odds: 1 / (1 + odds)))


def _averaged(rivals: Sequence[Rival], evidence: Array, measure: Callable[[Array], Array]) -> Array:
    """Averages a function of the posterior odds against the true rival. Each rival in turn is assumed to be the true one, and is
    weighted by its probability. For each, the average is also taken over the random log evidence. `evidence`: array of shape (…, R,
    R), expected log evidence of each rival against each other rival. The result has the shape (…). `measure`: function that is
    averaged; its argument is the odds against the true rival."""
    share = np.array([rival.probability for rival in rivals])
    share = share / share.sum()
    total = np.zeros(evidence.shape[:-2])
    for i in range(len(rivals)):
        others = np.arange(len(rivals)) != i
        d = evidence[..., i, others][..., None]
        log = np.clip(d + np.sqrt(2 * d) * _NODES, -700.0, 700.0)
        odds = (share[others, None] / share[i] * np.exp(-log)).sum(-2)
        total += share[i] * (measure(odds) @ _WEIGHTS) / _WEIGHTS.sum()
    return total


MOST = 5  # maximum number of explanations
SILENT = ("none", "unknown")
"""Explanations that make no predictions."""
LEAST = 0.01  # smallest probability of an explanation


@dataclass(frozen=True)
class ExplanationPart:
    """Describes one effect of an explanation, in the form that fits the recording best. `prior`: prior variance of the amplitudes
    of the effect, in units of the squared `magnitude` of each column."""

    effect: Effect
    weighed: Weighed
    prior: float

    @property
    def key(self) -> tuple[str, float | None]:
        return self.effect.id, self.weighed.variant.shape

    def on(self, observed: Observed) -> Sequence[Column]:
        """Returns the columns of the effect for another recording. The result is empty if the effect cannot act in that
        recording."""
        shape = self.weighed.variant.shape
        if isinstance(self.effect, Shaped):
            return self.effect.at(observed, float(shape or 0.0)).columns
        return next((v.columns for v in self.effect.variants(observed) if v.shape == shape), ())


@dataclass(frozen=True)
class Explanation:
    name: str
    probability: float
    parts: tuple[ExplanationPart, ...]


def explanations(found: Posterior, candidates: Sequence[Candidate]) -> list[Explanation]:
    """Returns the most probable explanations that predict different recordings, at most `MOST`.

    Effects that act only on the noise predict nothing. Explanations that differ only in such effects therefore count as one
    explanation. "Unknown" and "none" also predict nothing, so they count as one explanation too; it has the name of the more
    probable of the two.
    """
    by_id = {c.id: c for c in candidates if np.isfinite(c.log_bayes).any()}
    silent = max(SILENT, key=lambda name: found.probability[name])
    total: dict[str, float] = {}
    for name, probability in found.probability.items():
        key = "+".join(part for part in name.split("+") if part in by_id) or silent
        total[key] = total.get(key, 0.0) + probability
    chosen = sorted((item for item in _simplest(total).items() if item[1] >= LEAST), key=lambda item: -item[1])[:MOST]
    return [Explanation(name, probability, _parts(name, found, by_id)) for name, probability in chosen]


def _simplest(total: Mapping[str, float]) -> dict[str, float]:
    """Adds the probability of a set of effects to the probability of one of its subsets, if the subset is more probable. The reason
    is that the other effects of the set may be absent."""
    found: dict[str, float] = {}
    for name, value in sorted(total.items(), key=lambda item: item[0].count("+")):
        parts = set(name.split("+"))
        likelier = [one for one in found if set(one.split("+")) < parts and total[one] > value]
        target = max(likelier, key=lambda one: total[one], default=name)
        found[target] = found.get(target, 0.0) + value
    return found


def _parts(name: str, found: Posterior, by_id: Mapping[str, Candidate]) -> tuple[ExplanationPart, ...]:
    if name in SILENT:
        return ()
    together = found.sets.get(name)
    if together is None:
        forms = {one: by_id[one].best for one in name.split("+")}
        return tuple(ExplanationPart(by_id[one].effect, form, _size(form, slice(None))) for one, form in forms.items())
    return tuple(
        ExplanationPart(member.candidate.effect, member.form, _size(together.weighed, together.columns(member.id)))
        for member in sorted(together.members, key=lambda member: member.id)
    )


def _size(weighed: Weighed, columns: slice) -> float:
    """Returns the mean square of the posterior amplitudes."""
    mean, covariance = weighed.amplitudes
    return float(np.mean(mean[columns] ** 2 + np.diag(covariance)[columns]))


@dataclass(frozen=True)
class Layout:
    """Describes the order of all columns of several explanations: first the columns of the nominal parameters, then those of the
    effects. Each effect is identified by its name and shape."""

    nominal: tuple[str, ...]
    parts: tuple[ExplanationPart, ...]
    names: tuple[tuple[str, ...], ...]
    coefficients: tuple[float, ...]

    @classmethod
    def of(cls, listed: Sequence[Explanation], weighing: Weighing, nominal: Sequence[str], whole: Observed) -> Layout:
        """Makes the layout of the listed explanations. `whole`: the recording followed by all segments that may be measured next;
        it determines which columns exist."""
        distinct = tuple({part.key: part for item in listed for part in item.parts}.values())
        names = tuple(tuple(column.name for column in part.on(whole)) for part in distinct)
        return cls(tuple(nominal), distinct, names, _fitted(weighing))

    @property
    def widths(self) -> list[int]:
        return [len(self.coefficients), *(len(names) for names in self.names)]

    def columns(self, observed: Observed) -> list[Sequence[Column]]:
        """Returns the groups of columns for a recording: nominal parameters first, then one group for each effect."""
        nominal = nominal_columns(observed, self.nominal)
        output = simulated(observed, self.nominal)
        for column, value in zip(nominal, self.coefficients, strict=True):
            for channel, part in column.parts.items():
                output[:, channel] += part * (column.magnitude * value)
        observed.__dict__["nominal_output"] = (
            output  # a dead zone or a limit acts on the output of the sensor, not of an ideal sensor
        )
        return [nominal, *(part.on(observed) for part in self.parts)]

    def learnt(self, listed: Sequence[Explanation], weighing: Weighing) -> tuple[list[Rival], Array]:
        """Returns the posterior of the explanations, and the information from the recording, shape (P, P)."""
        information, score = self._recorded(weighing)
        starts = np.concatenate(([0], np.cumsum(self.widths)))
        rivals = []
        for item in listed:
            columns, prior = [np.arange(self.widths[0])], [np.zeros(self.widths[0])]
            for part in item.parts:
                at = [other.key for other in self.parts].index(part.key) + 1
                columns.append(np.arange(starts[at], starts[at + 1]))
                prior.append(np.full(self.widths[at], 1 / part.prior))
            rivals.append(
                Rival.learnt(
                    item.name, item.probability, np.concatenate(columns), np.concatenate(prior), information, score
                )
            )
        return rivals, information

    def _recorded(self, weighing: Weighing) -> tuple[Array, Array]:
        """Returns the information matrix (P, P) and the score vector (P,) of the recording for all columns."""
        size = sum(self.widths)
        starts = np.concatenate(([0], np.cumsum(self.widths)))
        information, score = np.zeros((size, size)), np.zeros(size)
        for channel, weights in enumerate(weighing.weights):
            table = np.zeros((len(weighing.spectrum.segment), size))
            own = [c for c, column in enumerate(weighing.nominal_columns) if channel in column.parts]
            table[:, own] = weighing.whole[channel]
            for part, names, start in zip(self.parts, self.names, starts[1:], strict=False):
                known = [column.name for column in part.weighed.variant.columns]
                table[:, [start + names.index(name) for name in known]] = part.weighed.raw[channel]
            whitened = weights[0].whiten(table)
            information += whitened.T @ whitened
            score += whitened.T @ weights[0].whiten(weighing.spectrum.values[:, [channel]])[:, 0]
        return information, score


def _fitted(weighing: Weighing) -> tuple[float, ...]:
    """Returns the nominal parameters, in magnitudes, from an unweighted fit to the recording without effects."""
    values = np.zeros(len(weighing.nominal_columns))
    for channel, nominal in enumerate(weighing.whole):
        own = [c for c, column in enumerate(weighing.nominal_columns) if channel in column.parts]
        size = np.linalg.norm(nominal, axis=0) + 1e-300
        values[own] = np.linalg.lstsq(nominal / size, weighing.spectrum.values[:, channel], rcond=None)[0] / size
    return tuple(float(value) for value in values)


Columns = Callable[[Observed], Sequence[Sequence[Column]]]
LATER = 600.0  # s, assumed time from the end of the recording to the start of a segment
_SAMPLED = 2.0  # s, computed part of a segment; in motion, whole turns or periods that take at least this time
_STUB = 8  # samples that represent a segment that is not computed in detail
_CHUNK = 25  # segments that are computed in detail at the same time; limits memory
_CHANGED = 1.0  # K, differences of temperature up to this value do not count as a change


@dataclass(frozen=True)
class Foreseen:
    """Contains the information that a segment with K channels is expected to give about the amplitudes of P columns, in units of
    the noise.

    `within`: array of shape (P, P), information per second from changes within the segment. `means`: array of shape (K, P), mean of
    each column over the segment. `noise`: array of shape (K,) in SI·√s, white noise density of each channel. `flicker`: array of
    shape (K,) in SI units, declared bias instability of each channel.
    """

    segment: Segment
    within: Array
    means: Array
    noise: Array
    flicker: Array

    @cached_property
    def whole(self) -> Array:
        """Returns the information for the planned dwell of the segment, shape (P, P)."""
        return self.information(self.segment.dwell or 0.0)

    def information(self, seconds: float) -> Array:
        """Returns the information for a dwell of `seconds`, shape (P, P). Slow noise limits the information that the mean of the
        segment gives."""
        slow = flicker(np.zeros(1), np.full(1, seconds))[0, 0]
        variance = self.noise**2 / seconds + self.flicker**2 * slow
        products: Array = seconds * self.within + (self.means / variance[:, None]).T @ self.means
        return products


def foresee(
    observed: Observed, white: Array, segments: Sequence[Segment], columns: Columns, widths: Sequence[int]
) -> Iterator[Foreseen]:
    """Yields the information that each segment would give if it were measured after the recording. `white`: array of shape (K,),
    standard deviation of the white noise of a sample.

    `columns`: function that computes groups of columns for a recording. `widths`: number of columns in each group. The P columns of
    all groups are numbered consecutively. A column is zero in a channel that it does not affect.
    """
    noise = white / math.sqrt(observed.sample_rate)
    flicker = np.array([channel.flicker for channel in observed.channels])
    for first in range(0, len(segments), _CHUNK):
        near = range(first, min(first + _CHUNK, len(segments)))
        planned, places = following(observed, segments, near)
        table = [np.zeros((len(planned.time), sum(widths))) for _ in planned.channels]
        at = 0
        for group, width in zip(columns(planned), widths, strict=True):
            for offset, column in enumerate(group):
                here = 1.0 if column.segments is None else column.segments[planned.owner]
                for channel, part in column.parts.items():
                    table[channel][:, at + offset] = part * (column.magnitude * here)
            at += width
        for index in near:
            rows = [part[places[index]] for part in table]
            means = np.array([part.mean(0) for part in rows])
            within = sum(
                (part - mean).T @ (part - mean) / (len(part) * sigma**2)
                for part, mean, sigma in zip(rows, means, noise, strict=True)
            )
            within -= _hidden(planned, len(observed) + index, rows, noise, segments[index].dwell or 0.0)
            yield Foreseen(segments[index], np.asarray(within), means, noise, flicker)


def _hidden(planned: Observed, number: int, rows: Sequence[Array], noise: Array, seconds: float) -> Array:
    """Returns the information that a segment loses per second because the angle of the turning table is unknown, shape (P, P).

    `rows`: for each channel, the columns (n, P) at the samples. `noise`: array of shape (K,), white noise density. `seconds`:
    length of the dwell, s.

    The nominal input has an amplitude A and an unknown phase (`Observed.unknown_phase`). A component c·√2·cos θ of a column cannot
    be distinguished completely from this input. Let the samples have the covariance σ²·I + A²·w·wᵀ, where w = cos θ and |w|² = T/2
    for a dwell T and unit density of the noise. Then the fraction A²T/2 ÷ (σ² + A²T/2) of the information about this component is
    lost (Sherman and Morrison). The same holds for sin θ."""
    amplitude = np.abs(planned.unknown_phase[number])
    size = rows[0].shape[1]
    lost = np.zeros((size, size))
    angle = planned.angle[planned.segments()[number]]
    waves = np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])
    for channel in np.flatnonzero(amplitude).tolist():
        power, variance = amplitude[channel] ** 2 * seconds / 2, noise[channel] ** 2
        seen = waves.T @ rows[channel] / len(angle)
        lost += power / (variance + power) * (seen.T @ seen) / variance
    return lost


def following(
    observed: Observed, segments: Sequence[Segment], near: Sequence[int] | range
) -> tuple[Observed, list[slice]]:
    """Returns the recording followed by additional segments, which have a motion but no outputs. Also returns, for each additional
    segment, the slice of its samples.

    A segment whose index is not in `near` is represented by a few samples. Thus, the properties of the whole set of segments, such
    as the orientations, do not depend on the number of segments that are sampled in full.
    """
    stubs = np.concatenate([np.arange(p.start, min(p.start + _STUB, p.stop)) for p in observed.segments()])
    counts = [min(_STUB, p.stop - p.start) for p in observed.segments()]
    warm = float(observed.temperature[-1])
    arrays: dict[str, list[Array]] = {name: [own[stubs]] for name, own in observed.sampled.items()}
    places, changes, begin = [], [], len(stubs)
    for index, segment in enumerate(segments):
        since = _times(segment, observed.sample_rate) if index in near else np.arange(_STUB) / observed.sample_rate
        part = motion_at(segment.motion, since, None)
        start, end = _temperatures(segment, warm)
        slope = (end - start) / segment.dwell if segment.dwell else 0.0
        part |= {"time": observed.time[-1] + LATER + since, "temperature": start + slope * since}
        part["temperature_rate"] = np.full(len(since), slope)
        for name, parts in arrays.items():  # supply and pressure stay as they are
            parts.append(part[name] if name in part else np.full(len(since), getattr(observed, name)[-1]))
        changes.append(np.sign(end - warm) if abs(end - warm) > _CHANGED else observed.last_change[-1])
        places.append(slice(begin, begin + len(since)))
        begin += len(since)
        counts.append(len(since))
    joined: dict[str, Any] = {name: np.concatenate(parts) for name, parts in arrays.items()}
    made = replace(
        observed,
        labels=(*observed.labels, *(segment.label for segment in segments)),
        motions=(*observed.motions, *(segment.motion for segment in segments)),
        attitude=np.concatenate([observed.attitude, [segment.attitude for segment in segments]]),
        bounds=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
        last_change=np.concatenate([observed.last_change, changes]),
        values=np.zeros((begin, len(observed.channels))),
        fitted=None,
        bins=None if observed.bins is None else observed.bins.followed(len(segments)),
        **joined,
    )
    return made, places


def _times(segment: Segment, rate: float) -> Array:
    """Returns the sample times [s], counted from the start of the segment, shape (n,). For a ramp, they cover the whole segment;
    for other motions, they cover a few seconds with whole turns or periods. `rate`: sampling rate, Hz."""
    assert segment.dwell is not None
    span, begin = _SAMPLED, 0.0
    if segment.ramp_to is not None:
        return np.linspace(0.0, segment.dwell, max(_STUB, min(2000, round(segment.dwell * rate))))
    if isinstance(segment.motion, Spin):
        turn = 2 * math.pi / abs(segment.motion.rate)
        span = turn * math.ceil(_SAMPLED / turn)
    elif isinstance(segment.motion, Rock):
        span = math.ceil(_SAMPLED * segment.motion.frequency) / segment.motion.frequency
        begin = segment.motion.steady
    else:
        assert isinstance(segment.motion, Rest)
    return begin + np.arange(max(_STUB, round(span * rate))) / rate


def _temperatures(segment: Segment, now: float) -> tuple[float, float]:
    """Returns the temperatures [degC] at the start and at the end of a segment. `now`: temperature at the end of the recording,
    degC."""
    start = now if segment.temperature is None else segment.temperature - ZERO_CELSIUS
    return start, start if segment.ramp_to is None else segment.ramp_to - ZERO_CELSIUS


Seconds = Callable[[Segment | None, Segment], float]
SETTLED = 0.95
"""If an explanation has at least this probability, no further measurement is needed. A proposal aims at a higher probability of the
true explanation."""
AIM = 0.97
FAINT = 0.05
"""If noise alone or an unknown cause is the most probable explanation, a measurement is proposed only for effects with at least
this probability."""
LONGEST = 12 * 3600.0  # s, longest test time of a proposal
FEWEST = 4
"""Smallest number of segments in a proposal. Fewer segments could be outliers."""
_BUNDLE = 4  # segments at another temperature that are evaluated together; a single one rarely justifies the change
_KEPT = 60  # number of moves that are kept after the first round
_REPEATS = (1, 2, 3, 5, 10, 20, 50)
_HELPS = 0.005  # smallest reduction of the expected loss that justifies a segment


@dataclass(frozen=True)
class SegmentProposal:
    """Contains the segments that a diagnosis proposes to measure next.

    `segments`: the proposed segments in order; empty if nothing on the bench helps. `rivals`: names and present probabilities of
    the explanations that remain possible. `now`: expected probability of the true explanation at present. `probability`: expected
    probability of the true explanation after the proposed segments. `seconds`: test time that these segments take, s. `repeating`:
    two values for comparison, namely the test time [s] of repetitions of the recorded segments, and the expected probability of the
    true explanation after these repetitions. `sensor`: description of an instrument that could distinguish the explanations, if the
    segments of the bench cannot.
    """

    segments: tuple[Segment, ...]
    rivals: tuple[tuple[str, float], ...]
    now: float
    probability: float
    seconds: float
    repeating: tuple[float, float]
    sensor: str = ""


def propose(
    weighing: Weighing,
    found: Posterior,
    candidates: Sequence[Candidate],
    nominal: Sequence[str],
    options: Sequence[Segment],
    seconds: Seconds,
    lasted: float,
) -> SegmentProposal | None:
    """Proposes the segments to measure next; None if one explanation is clear.

    `options`: segments that the bench can execute. `seconds`: function that computes the test time of a segment, including moves,
    settling and dwell. Its arguments are the previous segment (None for the first segment) and the segment itself. `lasted`: test
    time of the recording, s.
    """
    listed = explanations(found, candidates)
    if not options or not _open(listed):
        return None
    observed = weighing.observed
    whole, _ = following(observed, options, ())
    layout = Layout.of(listed, weighing, nominal, whole)
    rivals, recorded = layout.learnt(listed, weighing)
    each = list(foresee(observed, weighing.white, options, layout.columns, layout.widths))
    chosen = _chosen(rivals, each, seconds)
    information = _sum(chosen, len(recorded))
    lasting = _lasting([item.segment for item in chosen], seconds)
    now, then = (expected_probability(rivals, more) for more in (np.zeros_like(information), information))
    names = tuple((rival.name, rival.probability) for rival in rivals)
    repeated = _repeating(rivals, recorded, lasted, then)
    sensor = helpful(weighing, rivals, layout, options) if then < ENOUGH else ""
    if then < now + 0.01:
        return SegmentProposal((), names, now, now, 0.0, repeated, sensor)
    return SegmentProposal(tuple(item.segment for item in chosen), names, now, then, lasting, repeated, sensor)


def _open(listed: Sequence[Explanation]) -> bool:
    """Returns True if a further measurement can still change the answer."""
    if len(listed) < 2:
        return False
    least = FAINT if listed[0].name in SILENT else 0.0
    return listed[0].probability < SETTLED and listed[1].probability >= least


def _sum(items: Sequence[Foreseen], size: int) -> Array:
    total = np.zeros((size, size))
    for item in items:
        total += item.whole
    return total


def _lasting(segments: Sequence[Segment], seconds: Seconds) -> float:
    total, last = 0.0, None
    for segment in segments:
        total += seconds(last, segment)
        last = segment
    return total


def _chosen(rivals: Sequence[Rival], options: Sequence[Foreseen], seconds: Seconds) -> list[Foreseen]:
    """Chooses segments greedily, removes unnecessary ones, and groups the others by temperature. The time before the first segment,
    such as a soak of the sensor, is the same for all segments and does not influence the choice."""
    size = len(options[0].within)
    held = [item.segment for item in options if item.segment.ramp_to is None] or [item.segment for item in options]
    ahead = min(seconds(None, segment) - (segment.dwell or 0.0) for segment in held)

    def beyond(before: Segment | None, segment: Segment) -> float:
        lasting = seconds(before, segment)
        return lasting if before else max(lasting - ahead, segment.dwell or 0.0)

    total, chosen = np.zeros((size, size)), list[Foreseen]()
    loss, spent = float(expected_loss(rivals, total)), 0.0
    running: list[list[Foreseen]] = [[item] for item in options]
    first = True
    while spent < LONGEST and (len(chosen) < FEWEST or expected_probability(rivals, total) < AIM):
        last = chosen[-1].segment if chosen else None
        gains = _gains(rivals, total, loss, running)
        costs = [_chain(last, move, beyond) for move in running]
        if first:
            running, gains, costs = _shortened(running, gains, costs, rivals, size, last, beyond)
            first = False
        rate = np.array(gains) / np.array(costs)
        if len(chosen) < FEWEST:  # without those already selected
            rate[[any(item is taken for item in move for taken in chosen) for move in running]] = -np.inf
        best = int(np.argmax(rate))
        enough = expected_probability(rivals, total) >= AIM
        if gains[best] < (0.0 if enough else _HELPS * len(running[best])):
            break
        chosen += running[best]
        spent += costs[best]
        total = _sum(chosen, size)
        loss = float(expected_loss(rivals, total))
    return _by_temperature(_needed(rivals, chosen, size))


def _gains(rivals: Sequence[Rival], total: Array, loss: float, moves: Sequence[Sequence[Foreseen]]) -> list[float]:
    """Returns the reduction of the expected loss by each move, if the information `total` (P, P) is already available. A move is
    one segment or a bundle of segments."""
    after = np.array([total + _sum(move, len(total)) for move in moves])
    gains: list[float] = (loss - expected_loss(rivals, after)).tolist()
    return gains


def _chain(last: Segment | None, move: Sequence[Foreseen], seconds: Seconds) -> float:
    total = 0.0
    for item in move:
        total += seconds(last, item.segment)
        last = item.segment
    return total


def _shortened(
    running: list[list[Foreseen]],
    gains: list[float],
    costs: list[float],
    rivals: Sequence[Rival],
    size: int,
    last: Segment | None,
    seconds: Seconds,
) -> tuple[list[list[Foreseen]], list[float], list[float]]:
    """Shortens the list of moves, and returns the remaining moves with their gains and costs. A move is one segment or a bundle of
    segments. The shorter list contains the moves with the largest gain and with the largest gain per second, and the best moves at
    each temperature, individually and as a bundle.

    `running`: the moves. `gains`: reduction of the expected loss by each move. `costs`: test time of each move, s. `size`: number
    of all columns. `last`: the segment before the moves, None if there is none.
    """
    by_gain, by_rate = np.argsort(-np.array(gains)), np.argsort(-np.array(gains) / np.array(costs))
    temperatures: dict[float | None, list[int]] = {}
    for index in by_gain:
        temperatures.setdefault(_warmth(running[index][0].segment), []).append(int(index))
    kept = dict.fromkeys([*by_gain[:_KEPT].tolist(), *by_rate[:_KEPT].tolist()])
    for members in temperatures.values():
        kept |= dict.fromkeys(members[:_BUNDLE])
    bundles = [[running[i][0] for i in members[:_BUNDLE]] for members in temperatures.values() if len(members) > 1]
    nothing = np.zeros((size, size))
    loss = float(expected_loss(rivals, nothing))
    for bundle in bundles if len(temperatures) > 1 else []:
        gains += _gains(rivals, nothing, loss, [bundle])
        costs.append(_chain(last, bundle, seconds))
        running.append(bundle)
        kept[len(running) - 1] = None
    return [running[i] for i in kept], [gains[i] for i in kept], [costs[i] for i in kept]


def _warmth(segment: Segment) -> float | None:
    return segment.ramp_to if segment.ramp_to is not None else segment.temperature


def _needed(rivals: Sequence[Rival], chosen: list[Foreseen], size: int) -> list[Foreseen]:
    """Removes chosen segments that are not needed to reach the target probability. If even all chosen segments together give a lower
    probability than this target, their probability (less a small margin) is the target instead."""
    aim = min(AIM, expected_probability(rivals, _sum(chosen, size)) - 1e-4)
    index = 0
    while index < len(chosen) and len(chosen) > FEWEST:
        others = chosen[:index] + chosen[index + 1 :]
        if expected_probability(rivals, _sum(others, size)) >= aim:
            chosen = others
        else:
            index += 1
    return chosen


def _by_temperature(chosen: Sequence[Foreseen]) -> list[Foreseen]:
    """Returns the segments grouped by temperature; the groups have the order in which their temperatures first appear."""
    order = list(dict.fromkeys(_warmth(item.segment) for item in chosen))
    return sorted(chosen, key=lambda item: order.index(_warmth(item.segment)))


def _repeating(rivals: Sequence[Rival], recorded: Array, lasting: float, aim: float) -> tuple[float, float]:
    """Returns the test time [s] of repetitions of the recorded segments, and the expected probability of the true explanation after
    them. The number of repetitions is the smallest considered number for which this probability is at least `aim`. If no number of
    repetitions is enough, returns both values for the largest number considered. `recorded`: array of shape (P, P), information
    from the recording. `lasting`: test time of the recording, s."""
    for times in _REPEATS:
        reached = expected_probability(rivals, recorded * times)
        if reached >= aim:
            break
    return times * lasting, reached


ENOUGH = 0.9  # smallest expected probability of the true explanation with a proposed instrument
ACCELEROMETER = 50e-6 * STANDARD_GRAVITY  # SI·√s, white noise of an additional instrument
ARCSECOND = np.pi / 180 / 3600  # standard uncertainty of an autocollimator with a level
_LOOKED_AT = 40  # number of segments with which an instrument is evaluated


@dataclass(frozen=True)
class _Instrument:
    words: str
    channels: tuple[Channel, ...] = ()
    pointing: bool = False


def helpful(weighing: Weighing, rivals: Sequence[Rival], layout: Layout, options: Sequence[Segment]) -> str:
    """Describes the first instrument that would identify the true explanation. The text is empty if there is no such instrument."""
    few = [options[i] for i in np.unique(np.linspace(0, len(options) - 1, _LOOKED_AT).astype(int))]
    for instrument in _instruments(weighing):
        extended, information = _with(instrument, weighing, rivals, layout, few)
        if expected_probability(extended, information) >= ENOUGH:
            return instrument.words
    return ""


def _instruments(weighing: Weighing) -> list[_Instrument]:
    # A gyro without declared noise is as noisy as measured.
    measured = weighing.white / math.sqrt(weighing.observed.sample_rate)
    gyros = [
        replace(weighing.observed.channels[c], white=weighing.observed.channels[c].white or float(measured[c]))
        for c in weighing.observed.of_kind("gyro")
    ]
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
    """Returns the rivals, extended by the instrument's own nominal parameters. Also returns the total information from all segments
    in `options`, for the case that the instrument measures during these segments too. This information covers the P columns and the
    instrument's own q parameters, shape (P + q, P + q)."""
    observed = weighing.observed
    both = replace(observed, channels=(*observed.channels, *instrument.channels))
    own = len(observed.channels)
    white = np.concatenate([weighing.white, [c.white * math.sqrt(observed.sample_rate) for c in instrument.channels]])
    more = len(_further(both, own, layout))
    information = np.zeros((sum(layout.widths) + more,) * 2)
    for item in foresee(both, white, options, _columns(layout, observed.channels), [*layout.widths, more]):
        information += item.whole
    if instrument.pointing:
        information += np.diag(np.concatenate([_seen(layout), np.zeros(more)]))
    return [_widened(rival, sum(layout.widths), more) for rival in rivals], information


def _further(observed: Observed, own: int, layout: Layout) -> list[Column]:
    """Returns the columns of the nominal parameters of the additional channels. These are the channels that the sensor under test
    does not have. Their indices are `own` and above."""
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
    """Returns the information from a direct measurement of the angles of the table, for example with an autocollimator, shape (P,).
    Such a measurement gives information about the amplitudes of table effects that are angles."""
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
