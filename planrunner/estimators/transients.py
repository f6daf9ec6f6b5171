"""Finds transients that all segments of an estimate have in common, such as a table that still speeds up when a segment begins.

A transient at the beginning or at the end of every segment changes the means. If it is the same in all segments, it looks like a
part of a constant term. If it is proportional to the input, such as a spin-up, it looks like a part of the scale factor. The
residuals are then small, and repeats agree.

Each segment is divided into equal parts. A straight line is fitted to the means of the inner parts, and extrapolated to the two
parts at one end. Over all segments, the deviation d of these two parts from the line is fitted by d = a + b·m, where m is the mean of
the inner parts. Noise alone gives an F statistic with 2 and n − 2 degrees of freedom, for n segments. The variance of d is the larger
of two estimates: one from the scatter of d about the fit, the other from the scatter of the inner parts about their lines. If the
bench file declares a count, the variance of a part is at least the one that rounding to this count causes: coarse counts can hide
all noise, so that the inner parts do not scatter.

A filter in the sensor gives transients that follow the preceding change of the input and that end after a fixed time. They are
not the same function of the input in all segments, so this test may miss them. A second test therefore compares the two ends of the
segments. Let z be the deviation of an end, divided by its standard deviation according to the scatter of the inner parts of the
same segment. Noise of any spectrum deviates equally at both ends, so the ratio of the sums of z² over the n segments follows an F
distribution with n and n degrees of freedom. The sum at the end with transients must also be too large for the scatter of the inner
parts, and at least a quarter of the segments (and at least two) must deviate clearly.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.error_model.observed import axis_of
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.screening import varies
from planrunner.plan.schedule import Rest, Spin
from planrunner.plan.units import METERED, unit

_END = 2  # parts at an end that are compared with the line
_LEFT_OUT = 2  # parts between them and the inner parts
_FEWEST = 5  # segments
_ALONG = (
    1 - 1e-9
)  # smallest cosine of the planned angle between the axes of an output and of the rotation; 1 but for rounding
_CHANCE = 1e-5
"""Probability that noise alone gives a warning about one end of the segments of one output."""
_CLEAR = 5.0  # standard deviations of a clear deviation of one segment
_SEVERAL, _SHARE = (
    2,
    0.25,
)  # segments with a clear deviation, at least, and their share: single events are not transients
_LEAST = 0.1  # smallest mean square of the deviations at the other end that is assumed: a smaller one is chance


def transient_words(
    segments: Sequence[RecordedSegment], channels: Collection[str], sensor: SensorModel
) -> tuple[Said, ...]:
    """Warns of each output with a transient that segments have in common at their beginning or at their end. `channels`: the channels
    to check; if empty, all outputs of the sensor. Only segments in which the input of the output is constant are used. The element
    of a stabilised platform drifts while the platform rests, so its inputs are not constant. The supply voltage and the ambient
    pressure are not constant either."""
    words = []
    for output in () if sensor.stabilised else sensor.outputs:
        if not varies(output) or (channels and output.name not in channels) or unit(output.unit).dimension in METERED:
            continue
        having = [one for one in segments if output.name in one.parts and constant_input(one, output)]
        if len(having) < _FEWEST:
            continue
        means = np.array([one.parts[output.name] for one in having])
        samples = np.array([one.statistics.count for one in having]) / means.shape[1]
        for end, ordered in (("beginning", means), ("end", means[:, ::-1])):
            off, chance = _transient(ordered, output.noise, samples)
            if chance >= _CHANCE:
                words += _of_several(having, output, means, samples, end == "beginning")
                continue
            largest = int(np.argmax(np.abs(off)))
            values: dict[str, str | float] = {
                "output": output.name,
                "segment": having[largest].label,
                "size": float(off[largest]),
                "unit": output.unit,
                "chance": chance,
            }
            words.append(
                said(
                    "{output}: the beginnings of the segments differ from the rest in a way that all segments have in common: in "
                    "'{segment}', the mean of the first eighth differs by {size:.3g} {unit} (probability by chance: {chance:.2g}). "
                    "Such a transient changes the coefficients, but neither the residuals nor repeats show it. Start each segment "
                    "later, after the table and the sensor have settled.",
                    **values,
                )
                if end == "beginning"
                else said(
                    "{output}: the ends of the segments differ from the rest in a way that all segments have in common: in "
                    "'{segment}', the mean of the last eighth differs by {size:.3g} {unit} (probability by chance: {chance:.2g}). "
                    "Such a transient changes the coefficients, but neither the residuals nor repeats show it. End each segment "
                    "earlier, before the table begins to stop.",
                    **values,
                )
            )
    return tuple(words)


def _of_several(
    having: Sequence[RecordedSegment], output: OutputModel, means: Array, samples: Array, beginning: bool
) -> list[Said]:
    """Returns a warning if several segments have transients at one end that are larger than the deviations at the other end.
    `means`: array of shape (n, parts). `samples`: array of shape (n,), number of samples in a part."""
    from scipy.special import fdtrc

    n, sides = len(means), (means, means[:, ::-1])
    own, other = (_deviations(one, output.noise, samples) for one in (sides if beginning else sides[::-1]))
    away, opposite = own.in_deviations, other.in_deviations
    clear = np.abs(away) > _CLEAR
    square = float(away @ away)
    by_ends = float(fdtrc(n, n, square / max(float(opposite @ opposite), _LEAST * n)))
    by_noise = float(fdtrc(n, n * own.freedom, square / n))
    if max(by_ends, by_noise) >= _CHANCE or np.count_nonzero(clear) < max(_SEVERAL, _SHARE * n):
        return []
    largest = int(np.argmax(np.abs(own.off)))
    values: dict[str, str | float] = {
        "output": output.name,
        "count": int(np.count_nonzero(clear)),
        "segments": n,
        "segment": having[largest].label,
        "size": float(own.off[largest]),
        "unit": output.unit,
    }
    return [
        said(
            "{output}: the beginnings of {count} of {segments} segments differ from the rest: in '{segment}', the mean of the first "
            "eighth differs by {size:.3g} {unit}. Such transients change the coefficients. Start each segment later, after the table, "
            "the sensor and its filter have settled.",
            **values,
        )
        if beginning
        else said(
            "{output}: the ends of {count} of {segments} segments differ from the rest: in '{segment}', the mean of the last eighth "
            "differs by {size:.3g} {unit}. Such transients change the coefficients. End each segment earlier, before the table begins "
            "to stop.",
            **values,
        )
    ]


def constant_input(segment: RecordedSegment, output: OutputModel) -> bool:
    """Returns True if the input of an output is constant: at rest, or if the sensor turns about the axis of the output. A sensor that
    turns about another axis also turns relative to the Earth rate and to gravity."""
    motion, attitude = segment.segment.motion, segment.segment.attitude
    if isinstance(motion, Rest):
        return True
    axis = axis_of(output.name)
    if axis is None or attitude is None or not isinstance(motion, Spin):
        return False
    return bool(abs(np.asarray(attitude)[axis] @ np.asarray(motion.about)) > _ALONG)


@dataclass(frozen=True, slots=True)
class _Deviations:
    """Describes the deviations of the first parts of n segments from the line through the inner parts.

    `off`: array of shape (n,), the deviations. `sigma`: array of shape (n,), their standard deviations, from the scatter of the
    inner parts about the lines, with `freedom` degrees of freedom each. If the count is declared, they are at least as large as
    rounding makes them. `level`: array of shape (n,), means of the inner parts.
    """

    off: Array
    sigma: Array
    level: Array
    freedom: int

    @property
    def in_deviations(self) -> Array:
        """Returns the deviations, divided by their standard deviations; 0 where the inner parts do not scatter and no count is
        declared."""
        return np.where(self.sigma > 0, self.off / np.where(self.sigma > 0, self.sigma, 1.0), 0.0)


def _deviations(means: Array, noise: NoiseModel, samples: Array) -> _Deviations:
    """Returns the deviations of the first parts of n segments. `means`: array of shape (n, parts). `noise`: declared noise of the
    output. `samples`: array of shape (n,), number of samples in a part."""
    inner = np.arange(_END + _LEFT_OUT, means.shape[1])
    line = np.column_stack([np.ones(len(inner)), inner - inner.mean()])
    to_line = np.linalg.pinv(line)
    ahead = np.array([1.0, (_END - 1) / 2 - inner.mean()])
    weights = -(ahead @ to_line)
    off = means[:, :_END].mean(axis=1) + means[:, inner] @ weights
    scatter = means[:, inner] - (means[:, inner] @ to_line.T) @ line.T
    freedom = len(inner) - 2
    of_part = np.sum(scatter**2, axis=1) / freedom
    of_part = np.maximum(of_part, noise.rounding(samples, of_part * samples))
    variance = of_part * (1 / _END + float(weights @ weights))
    return _Deviations(off, np.sqrt(variance), means[:, inner].mean(axis=1), freedom)


def _transient(means: Array, noise: NoiseModel, samples: Array) -> tuple[Array, float]:
    """Tests whether n segments have a transient at the beginning in common. `means`: array of shape (n, parts). `noise`: declared
    noise of the output. `samples`: array of shape (n,), number of samples in a part. Returns the deviations of the first parts,
    shape (n,), and the probability that noise alone gives deviations that agree so well."""
    from scipy.special import fdtrc

    n = len(means)
    found = _deviations(means, noise, samples)
    off, level, by_noise = found.off, found.level, float(np.mean(found.sigma**2))
    size = float(np.abs(level - level.mean()).max())
    design = np.column_stack([np.ones(n), (level - level.mean()) / size if size > 0 else np.zeros(n)])
    fitted = design @ np.linalg.lstsq(design, off, rcond=None)[0]
    rank = int(np.linalg.matrix_rank(design))
    variance = max(float(np.sum((off - fitted) ** 2)) / (n - rank), by_noise)
    if variance <= 0:
        return off, 1.0
    return off, float(fdtrc(rank, n - rank, float(np.sum(fitted**2)) / rank / variance))
