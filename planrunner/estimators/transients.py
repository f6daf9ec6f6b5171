"""Finds transients that all segments of an estimate have in common, such as a table that still speeds up when a segment begins.

A transient at the beginning or at the end of every segment changes the means. If it is the same in all segments, it looks like a
part of a constant term. If it is proportional to the input, such as a spin-up, it looks like a part of the scale factor. The
residuals are then small, and repeats agree.

Each segment is divided into equal parts. A straight line is fitted to the means of the inner parts, and extrapolated to the two
parts at one end. Over all segments, the deviation d of these two parts from the line is fitted by d = a + b·m, where m is the mean of
the inner parts. Noise alone gives an F statistic with 2 and n − 2 degrees of freedom, for n segments. The variance of d is the larger
of two estimates: one from the scatter of d about the fit, the other from the scatter of the inner parts about their lines.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.error_model.observed import axis_of
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.observation.screening import varies
from planrunner.plan.schedule import Rest, Spin

_END = 2  # parts at an end that are compared with the line
_LEFT_OUT = 2  # parts between them and the inner parts
_FEWEST = 5  # segments
_ALONG = (
    1 - 1e-9
)  # smallest cosine of the planned angle between the axes of an output and of the rotation; 1 but for rounding
_CHANCE = 1e-5
"""Probability that noise alone gives a warning about one end of the segments of one output."""


def transient_words(
    segments: Sequence[RecordedSegment], channels: Collection[str], sensor: SensorModel
) -> tuple[Said, ...]:
    """Warns of each output that has a transient in common at the beginning or at the end of the segments. `channels`: the channels
    to check; if empty, all outputs of the sensor. Only segments in which the input of the output is constant are used. The element
    of a stabilised platform drifts while the platform rests, so its inputs are not constant."""
    words = []
    for output in () if sensor.stabilised else sensor.outputs:
        if not varies(output) or (channels and output.name not in channels):
            continue
        having = [one for one in segments if output.name in one.parts and _constant(one, output)]
        if len(having) < _FEWEST:
            continue
        means = np.array([one.parts[output.name] for one in having])
        for end, ordered in (("beginning", means), ("end", means[:, ::-1])):
            off, chance = _transient(ordered)
            if chance >= _CHANCE:
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


def _constant(segment: RecordedSegment, output: OutputModel) -> bool:
    """Returns True if the input of an output is constant: at rest, or if the sensor turns about the axis of the output. A sensor that
    turns about another axis also turns relative to the Earth rate and to gravity."""
    motion, attitude = segment.segment.motion, segment.segment.attitude
    if isinstance(motion, Rest):
        return True
    axis = axis_of(output.name)
    if axis is None or attitude is None or not isinstance(motion, Spin):
        return False
    return bool(abs(np.asarray(attitude)[axis] @ np.asarray(motion.about)) > _ALONG)


def _transient(means: Array) -> tuple[Array, float]:
    """Tests whether n segments have a transient at the beginning in common. `means`: array of shape (n, parts). Returns the
    deviations of the first parts, shape (n,), and the probability that noise alone gives deviations that agree so well."""
    from scipy.special import fdtrc

    n, parts = means.shape
    inner = np.arange(_END + _LEFT_OUT, parts)
    line = np.column_stack([np.ones(len(inner)), inner - inner.mean()])
    to_line = np.linalg.pinv(line)
    ahead = np.array([1.0, (_END - 1) / 2 - inner.mean()])
    weights = -(ahead @ to_line)
    off = means[:, :_END].mean(axis=1) + means[:, inner] @ weights
    scatter = means[:, inner] - (means[:, inner] @ to_line.T) @ line.T
    by_noise = float(np.mean(np.sum(scatter**2, axis=1))) / (len(inner) - 2) * (1 / _END + float(weights @ weights))
    level = means[:, inner].mean(axis=1)
    size = float(np.abs(level - level.mean()).max())
    design = np.column_stack([np.ones(n), (level - level.mean()) / size if size > 0 else np.zeros(n)])
    fitted = design @ np.linalg.lstsq(design, off, rcond=None)[0]
    rank = int(np.linalg.matrix_rank(design))
    variance = max(float(np.sum((off - fitted) ** 2)) / (n - rank), by_noise)
    if variance <= 0:
        return off, 1.0
    return off, float(fdtrc(rank, n - rank, float(np.sum(fitted**2)) / rank / variance))
