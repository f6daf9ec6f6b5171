"""Checks a recording before its diagnosis, and reports problems as findings. A finding is an error if a diagnosis would be empty or
wrong. A finding is a warning if the diagnosis can continue, but the user should know about the problem.

The means of the segments are also checked for two mistakes of bookkeeping that look like effects of the sensor, or that hide them: one
segment was recorded in another state than the plan says, or an earlier program removed the mean of each segment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment, Statistics, in_time_order
from planrunner.base.arrays import Array
from planrunner.base.findings import Findings, Mark, count_of
from planrunner.error_model.observed import Observed
from planrunner.instruments.models import SensorModel
from planrunner.observation.samples import measures_motion
from planrunner.plan.schedule import Rest, Spin
from planrunner.plan.units import STANDARD_GRAVITY

INTERVALS = 1.5
"""A step of the time is a gap if it is longer than this number of sample intervals. Shorter steps are jitter."""
RATE_TOLERANCE = 0.1
"""The clock of a segment counts as wrong if its sample rate deviates from the declared rate by more than this fraction."""
MOST_JUMPS = 10
"""If a segment contains more than this number of equally long steps, these steps show another sample rate, not lost samples."""
PRESENT = 0.9
"""A segment is reported as short if less than this fraction of its planned dwell was recorded. It is reported as poor if less than
this fraction of its rows is usable."""
STIRRED = {"gyro": np.radians(1.0), "accel": 0.1 * STANDARD_GRAVITY}
"""A misfit is visible only if the stimulus of a channel scatters over the segments by more than this value [rad/s, m/s²]."""
MISFIT = 0.5
"""The nominal model does not fit if its residual exceeds this fraction of the planned input, or if the fitted matrix of scale
factors and misalignments differs from the identity by more than this value. Usual errors of a sensor do not explain such a
difference."""
OTHER_NOISE = 5.0
"""If the noise differs from its declaration by more than this factor, the declaration is wrong or the channel is defective."""

PARTS = 20
"""Number of parts of a segment whose mean rates are compared."""
UNSTEADY = 0.02
"""Smallest relative deviation from a steady rate that is reported. No effect of the catalogue causes such a deviation only at the
ends of a segment."""
UNEVEN = 0.1
"""If the mean rates scatter by more than this fraction of the rate, the rate counts as never steady, for example in a turn by
hand."""
FAR = 6.0
"""If the mean of a part deviates by more than this number of standard deviations, scatter does not explain the deviation."""
EXCHANGED = 10.0
"""Two labels count as exchanged if exchanging them reduces the misfit by at least this factor. An exchange of labels cannot
compensate an effect of the catalogue so well."""
RANK = 1e-9
"""The stimulus counts as constant along a direction whose singular value is below this fraction of the largest singular value."""
SPARE = 3
"""To find exchanged labels, a recording needs at least this number of segments more than there are parameters."""

POSE_PARAMETERS = 9
"""Number of parameters that the condition |f| = g can determine: three biases, three scale factors and three
non-orthogonalities."""


LIMITED = 20
"""An output counts as limited if at least this number of samples have its extreme value, and if this value occurs this many times as
often as the value next to it."""
HIDDEN = 0.03
"""If the noise variance that the third differences of the rates suggest is at least this fraction of the variance of the rates, the
differences show fast motion rather than noise."""

LEAST_ANGLE = 5.0
"""Smallest angle [deg] between the planned and the measured direction that is reported. Tables and fixtures have much smaller
errors."""
OPPOSITE = 170.0
"""Smallest angle [deg] between the planned and the measured rate at which the table turned in the opposite sense."""
SAME_SIZE = 0.03
"""Largest relative deviation of the measured magnitude of gravity or of the rate from the planned magnitude. With a larger
deviation, not only the direction differs from the plan."""
SOUND = 0.5
"""A triad shows a direction only if its gain is at least this large along all directions that the plan varies."""
REMOVED = 0.1
"""A mean is nearly zero if its magnitude is at most this fraction of its standard error. With white noise around zero, 8 % of the means
are nearly zero."""
SLOW_ORDERS = slice(3, 11)
"""Orders of the Fourier coefficients that show the noise of a mean, in periods per segment. A slope has nearly no part in them."""
BY_CHANCE = 1e-6
"""Removed means are reported if noise alone makes so many means nearly zero with at most this probability (binomial distribution)."""


def check_recording(recording: Sequence[RecordedSegment], sensor: SensorModel, where: str, log: Findings) -> None:
    """Checks the segments, missing numbers, the clock and the ranges of a recording. `where`: name of the run or recording, used in
    messages."""
    mark = Mark(where)
    if len(recording) < 2:
        held = (
            f"the recording contains only the segment '{recording[0].label}'"
            if recording
            else "no segment was recorded"
        )
        hint = (
            "record at least two states: a single state cannot separate nominal parameters or effects. A recording in a file is "
            "divided by `segments` or `pauses` in the bench file, or by intervals at rest: `diagnosis: {segments: {detect: still, …}}`"
        )
        log.error("gap-one-segment", mark, held, hint)
        return
    _check_overlaps(recording, mark, log)
    _check_missing(recording, mark, log)
    _check_length(recording, mark, log)
    _check_clock(recording, sensor.sample_rate, mark, log)
    _check_ranges(recording, sensor, mark, log)


def check_observed(observed: Observed, where: str, log: Findings) -> None:
    """Checks whether enough segments can be held out, and whether the nominal model fits the segment means. Also checks the noise,
    the labels, the rates of the table, the reference of the motion, and the limits of the outputs."""
    mark = Mark(where)
    if observed.along is not None:
        _check_poses(observed, mark, log)
        return
    _check_noise(observed, mark, log)
    _check_labels(observed, mark, log)
    _check_steady_rates(observed, mark, log)
    _note_reference(observed, mark, log)
    _check_limits(observed, mark, log)
    for kind, word in (("gyro", "angular rate"), ("accel", "acceleration")):
        channels = observed.of_kind(kind)
        if not channels:
            continue
        stimulus = segment_means(observed, observed.omega if kind == "gyro" else observed.force)
        design = np.column_stack([stimulus, np.ones(len(stimulus))])
        rank = int(np.linalg.matrix_rank(design / np.maximum(np.abs(design).max(axis=0), 1e-30)))
        if len(observed) <= rank:
            message = (
                f"{len(observed)} segments are too few: with {rank} nominal parameters per channel of {word}, no segment can be "
                "withheld"
            )
            log.warning(
                "gap-no-held-out",
                mark,
                message,
                "add segments in other states: without withheld segments, no closure can be computed",
            )
        means = segment_means(observed, observed.values[:, channels])
        fitted = np.linalg.lstsq(design, means, rcond=None)[0]
        left = means - design @ fitted
        told = rank == design.shape[1] and float(stimulus.std(axis=0).min()) > STIRRED[kind]
        for column, index in enumerate(channels):
            channel = observed.channels[index]
            put_in = float(stimulus[:, channel.axis].std())
            share = float(left[:, column].std()) / put_in if put_in else 0.0
            if put_in > STIRRED[kind] and share > MISFIT:
                left_over = (
                    f"the fit of bias, scale factor and misalignments does not explain {share:.0%} of the applied input"
                )
                message = f"'{channel.name}' does not follow the plan: {left_over}"
                # At a place other than that of the reference, an accelerometer may measure a larger acceleration than the common one.
                add = log.warning if observed.moved.any() else log.error
                add("gap-nominal-misfit", mark, message, _LOOK)
            elif told and float(np.abs(fitted[:3, column] - np.eye(3)[channel.axis]).max()) > MISFIT:
                reads = ", ".join(
                    f"{value:.3g} of {axis}" for axis, value in zip("xyz", fitted[:3, column], strict=True)
                )
                message = f"'{channel.name}' does not follow the plan: it shows {reads} of the applied {word}"
                log.error("gap-nominal-misfit", mark, message, _LOOK)


_LOOK = (
    "check the labels, orientations and signs of rates in the plan, and the columns, signs and units in the bench file"
)


def _check_steady_rates(observed: Observed, mark: Mark, log: Findings) -> None:
    """Warns if the rate of the table still changes at the start of the record of a segment, or already changes before the end of
    this record."""
    found = []
    for index, motion in enumerate(observed.motions):
        if not isinstance(motion, Spin):
            continue
        along = observed.attitude[index] @ np.asarray(motion.about)
        gyros = observed.of_kind("gyro")
        best = max(gyros, key=lambda channel: abs(along[observed.channels[channel].axis]), default=None)
        if best is None or abs(rate := motion.rate * along[observed.channels[best].axis]) < abs(motion.rate) / 2:
            continue
        lasting, share = _unsteady(
            observed.values[observed.segments()[index], best], abs(rate), observed.site.earth_rate
        )
        if lasting > 0:
            seconds = lasting * float(np.ptp(observed.time[observed.segments()[index]]))
            found.append((share, observed.labels[index], seconds))
    if found:
        share, label, seconds = max(found)
        message = (
            f"the rate of the table is not steady in {_named([one for _, one, _ in found])}: in '{label}', it differs by up to "
            f"{share:.0%} for about {seconds:.2g} s"
        )
        hint = "begin the segments later or end them earlier, so that the rate is constant throughout"
        log.warning("gap-unsteady-rate", mark, message, hint)


def _note_reference(observed: Observed, mark: Mark, log: Findings) -> None:
    """Adds a note about the errors of the channels that measure the motion. White noise of variance s² in a rate makes a fitted
    scale factor smaller by s²/v, where v is the variance of the rate (W. A. Fuller, Measurement Error Models, 1987, section 1.1).
    s² is estimated from the third differences, which have the variance 20·s² for white noise. The third differences also contain
    fast motion, so the result is an upper limit. If it is at least the fraction `HIDDEN` of v, the note states no number."""
    whole = zip(observed.segments(), observed.moved, np.diff(observed.bounds), strict=True)
    parts = [rows for rows, moved, count in whole if moved and count > 3]
    if not parts:
        return
    rates = np.concatenate([observed.turn[rows] for rows in parts])
    noise = np.concatenate([np.diff(observed.turn[rows], 3, axis=0) for rows in parts]).var(axis=0) / 20
    axis = int(np.argmax(variance := rates.var(axis=0)))
    if variance[axis] > 0:
        share = noise[axis] / variance[axis]
        message = (
            "the channels that show the motion are treated as exact: an error of their scale factor looks like a scale-factor error "
            "of the sensor, and "
        )
        if share < HIDDEN:
            message += f"their noise makes fitted scale factors too small by up to {share * 1e6:.2g} ppm"
        else:
            message += "their noise makes fitted scale factors too small, by an amount that the fast motion hides"
        log.note(
            "gap-reference", mark, message, "add the calibration uncertainty of the reference to that of the result"
        )


def _unsteady(values: Array, rate: float, earth_rate: float) -> tuple[float, float]:
    """Compares the output (n,) of a gyro at the start and the end of a segment with its output in the middle. Returns two numbers:
    the fraction of the segment in which the output deviates because the rate changes, and the largest such deviation relative to
    the rate. Both numbers are 0 if the rate is steady. For the comparison, the segment is divided into `PARTS` parts. The output
    also changes for other reasons, such as an uneven motion. The size of these changes is estimated from the scatter between the
    means of the parts in the middle half. If this scatter is large, the function returns the values for a segment without any
    steady part. `earth_rate`: amplitude of the input that the Earth's rotation may cause once per turn, rad/s."""
    if len(values) < 4 * PARTS:
        return 0.0, 0.0
    means = np.array([part.mean() for part in np.array_split(values, PARTS)])
    middle = means[PARTS // 4 : -PARTS // 4]
    level = float(np.median(middle))
    scatter = 1.4826 * float(np.median(np.abs(middle - level)))
    off = np.abs(means - level)
    noise = float(np.diff(values).std()) / float(np.sqrt(2 * len(values) / PARTS))
    if scatter > max(UNEVEN * rate + earth_rate, FAR * noise):
        return 1.0, float(off.max()) / rate
    away = off > max(UNSTEADY * rate + 2 * earth_rate, FAR * scatter)
    ends = np.argmin(away), np.argmin(away[::-1])
    return float(sum(ends)) / PARTS, float(off[away].max(initial=0.0)) / rate if any(ends) else 0.0


def _check_limits(observed: Observed, mark: Mark, log: Findings) -> None:
    """Warns if the output of a channel is limited during a recorded motion. A limited output has its largest or smallest value in
    many samples, but the next value in hardly any sample. If the counts are only coarse, both values occur about equally often,
    unless the motion itself rests at this value. The reference shows whether it does (`_rests`)."""
    moved = observed.moved[observed.owner]
    for index, channel in enumerate(observed.channels if moved.any() else ()):
        values = observed.values[moved, index]
        for extreme in (values.max(), values.min()):
            at = np.isclose(values, extreme, rtol=1e-9, atol=0.0)
            others, count = values[~at], int(np.count_nonzero(at))
            if count < LIMITED or not len(others):
                continue
            nearest = others[np.argmin(np.abs(others - extreme))]
            often = count >= LIMITED * np.count_nonzero(np.isclose(others, nearest, rtol=1e-9, atol=0.0))
            stimulus = (observed.omega if channel.kind == "gyro" else observed.force)[moved]
            if often and not _rests(values, stimulus, at, abs(float(nearest - extreme))):
                value = f"{extreme / channel.factor:.4g} {channel.unit}"
                message = f"'{channel.name}' has the value {value} in {count / len(values):.1%} of the samples, and no sample beyond it"
                hint = "the output is limited, which looks like an effect: lower the rates, or set a larger measurement range"
                log.warning("gap-saturated", mark, message, hint)


def _rests(values: Array, stimulus: Array, at: NDArray[np.bool_], step: float) -> bool:
    """Returns True if an output has a value because the motion rests there. The nominal model is fitted to the samples between the
    smallest and the largest value. If it gives the value itself, within a count, the output is not limited.

    `values`: array of shape (n,). `stimulus`: array of shape (n, 3), motion that the reference shows. `at`: array of shape (n,), True
    for samples with the value. `step`: distance to the next value that occurs, in the unit of `values`."""
    design = np.column_stack([stimulus, np.ones(len(stimulus))])
    between = (values > values.min()) & (values < values.max()) & ~at
    fitted = np.linalg.lstsq(design[between], values[between], rcond=RANK)[0]
    return bool(abs(float(np.mean(design[at] @ fitted - values[at]))) <= step)


def _check_labels(observed: Observed, mark: Mark, log: Findings) -> None:
    """Warns if the nominal model would fit far better if the labels of two segments were exchanged."""
    found = exchanged_labels(observed)
    if found is not None:
        first, second, times = found
        labels = f"'{observed.labels[first]}' and '{observed.labels[second]}'"
        message = (
            f"the labels {labels} seem to be exchanged: if each label is given to the other segment, the misfit is "
            f"{times:.3g} times smaller"
        )
        hint = "check the order in which these segments were recorded, and exchange them in the table of segments or in the plan"
        log.warning("gap-labels-exchanged", mark, message, hint)


def exchanged_labels(observed: Observed) -> tuple[int, int, float] | None:
    """Finds two segments with possibly exchanged labels. An exchange of these labels reduces the misfit between the nominal model
    and the segment means by at least the factor `EXCHANGED`. Returns their indices and the ratio of the root mean square misfits
    before and after the exchange; None if there are no such segments.

    Let M be the projection onto the residuals of the fit, and e the difference of the unit vectors of the two segments. An exchange
    adds δ·e with δ = −eᵀy to the means y, and 2δ·eᵀMy + δ²·eᵀMe to the sum of squares of the residuals.
    """
    segments = len(observed)
    before, after = 0.0, np.zeros((segments, segments))
    for kind in ("gyro", "accel"):
        channels = observed.of_kind(kind)
        if not channels:
            continue
        stimulus = segment_means(observed, observed.omega if kind == "gyro" else observed.force)
        design = np.column_stack([stimulus, np.ones(segments)])
        left, size, _ = np.linalg.svd(design / np.maximum(np.abs(design).max(axis=0), 1e-30), full_matrices=False)
        basis = left[:, size > RANK * size.max()]
        if segments < basis.shape[1] + SPARE:
            return None
        projection = np.eye(segments) - basis @ basis.T
        diagonal = np.diag(projection)
        across = diagonal[:, None] + diagonal - 2 * projection
        for mean in segment_means(observed, observed.values[:, channels]).T:
            scale = max(float(mean.var()), 1e-300)
            residual = projection @ mean
            step = mean - mean[:, None]
            before += float(residual @ residual) / scale
            after += (2 * step * (residual[:, None] - residual) + step**2 * across) / scale
    row, column = np.unravel_index(int(np.argmin(after)), after.shape)
    rest = max(before + float(after[row, column]), 1e-12 * before)
    ratio = float(np.sqrt(before / rest)) if before > 0 else 1.0
    return (int(min(row, column)), int(max(row, column)), ratio) if ratio >= EXCHANGED else None


def _check_noise(observed: Observed, mark: Mark, log: Findings) -> None:
    """Warns if the noise between consecutive samples of a channel at rest differs strongly from its declaration."""
    still = [s for s, motion in enumerate(observed.motions) if isinstance(motion, Rest)]
    if not still:
        return
    root = np.sqrt(observed.bin_size[still] / 2)
    parts = [np.diff(observed.values[observed.segments()[s]], axis=0).std(axis=0) for s in still]
    seen = np.median(np.array(parts) * root[:, None], axis=0)
    for channel, sigma in zip(observed.channels, seen, strict=True):
        declared = channel.white * np.sqrt(observed.sample_rate)
        smallest = max(declared / OTHER_NOISE, channel.resolution)
        if declared > 0 and (sigma > OTHER_NOISE * max(declared, channel.resolution) or sigma < smallest < declared):
            noise = f"{sigma / channel.factor:.3g} {channel.unit} from sample to sample"
            message = f"'{channel.name}' has a noise at rest of {noise}, but the declared noise is {declared / channel.factor:.3g}"
            hint = "correct the noise in the bench file, because the gap is compared with it; or check the sensor"
            log.warning("gap-noise", mark, message, hint)


def _check_poses(observed: Observed, mark: Mark, log: Findings) -> None:
    """Checks poses of unknown orientation: whether their readings have the magnitude of gravity, and whether there are enough poses
    to hold some out."""
    expected = segment_means(observed, observed.seen(0, observed.force)[:, None])[:, 0]
    ratio = float(np.median(segment_means(observed, observed.values)[:, 0] / expected))
    if abs(ratio - 1) > MISFIT:
        message = f"at rest the accelerometers read {ratio:.3g} times gravity"
        log.error("gap-nominal-misfit", mark, message, "check the channels' units and signs in the bench file")
    if len(observed) <= POSE_PARAMETERS:
        message = (
            f"{len(observed)} poses are too few: with {POSE_PARAMETERS} nominal parameters, no pose can be withheld"
        )
        log.warning(
            "gap-no-held-out",
            mark,
            message,
            "add poses in other orientations: without withheld poses, no closure can be computed",
        )


def segment_means(observed: Observed, values: Array) -> Array:
    """Computes the means of values (N, K) over the segments. Returns an array of shape (S, K)."""
    return means_over(observed.segments(), values)


def means_over(parts: Sequence[slice], values: Array) -> Array:
    """Computes the means of values (N, K) over parts of the recording. Returns an array with one row for each part."""
    return np.array([values[part].mean(axis=0) for part in parts])


def _check_overlaps(recording: Sequence[RecordedSegment], mark: Mark, log: Findings) -> None:
    """Reports an error if segments share samples. Shared samples would count twice in the evidence."""
    used = [item for item in in_time_order(recording) if item.statistics.count > 1]
    for before, after in pairwise(used):
        shared = before.statistics.start + before.statistics.duration - after.statistics.start
        if shared > before.statistics.period / 2:
            message = f"'{before.label}' and '{after.label}' share {shared:.4g} s of the recording"
            hint = "end one segment where the other begins, or leave one of them out of `segments` under `diagnosis`"
            log.error("gap-overlap", mark, message, hint)
            return


def _check_missing(recording: Sequence[RecordedSegment], mark: Mark, log: Findings) -> None:
    poor = [
        item
        for item in recording
        if item.statistics.count < PRESENT * max(item.statistics.count + item.statistics.rejected, 1)
    ]
    rejected = sum(item.statistics.rejected for item in recording)
    empty = [item.label for item in recording if item.statistics.count == 0]
    if empty:
        hint = "remove the segment from the plan and the recording, or record it again"
        log.error("gap-missing-numbers", mark, f"no complete row in {_named(empty)}", hint)
    elif rejected:
        where = f", most of them in {_named([item.label for item in poor])}" if poor else ""
        message = (
            f"{count_of(rejected, 'row')} with a missing number {'was' if rejected == 1 else 'were'} left out{where}"
        )
        log.warning("gap-missing-numbers", mark, message, "check the logger; a few missing rows do no harm")


def _check_length(recording: Sequence[RecordedSegment], mark: Mark, log: Findings) -> None:
    short = []
    for item in recording:
        lasted, dwell = item.statistics.duration, item.segment.dwell
        if item.truncated or (dwell is not None and lasted < PRESENT * dwell):
            short.append(item.label)
    if short:
        message = f"shorter than planned: {_named(short)}"
        log.warning("gap-short-segment", mark, message, "the recorded part is used")


def _check_clock(recording: Sequence[RecordedSegment], declared: float, mark: Mark, log: Findings) -> None:
    gaps, changes, other = [], [], []
    for item in recording:
        known = item.statistics
        rate = item.segment.sample_rate or declared
        rows = known.count + known.rejected
        steps_off = rows > 2 and abs(known.duration * rate / rows - 1) > RATE_TOLERANCE
        if known.largest_gap * rate > INTERVALS and not known.rejected:
            if known.largest_gap < INTERVALS * known.period:
                other.append(item.label)
            elif steps_off and _long_steps(known, rate) > MOST_JUMPS:
                changes.append((item.label, 1 / known.largest_gap))
            else:
                gaps.append((item.label, known.largest_gap))
        elif steps_off:
            other.append(item.label)
    if gaps:
        label, gap = max(gaps, key=lambda pair: pair[1])
        message = f"time jumps within {_named([name for name, _ in gaps])}: by {gap:.3g} s in '{label}'"
        log.warning("gap-clock", mark, message, "samples were lost or the clock was set: check the logger")
    if changes:
        label, slowest = min(changes, key=lambda pair: pair[1])
        message = (
            f"the sample rate changes within {_named([name for name, _ in changes])}: from the declared {declared:g} Hz to about "
            f"{slowest:.3g} Hz in '{label}'"
        )
        hint = "check the settings of the logger, or end the segments where the rate changes"
        log.warning("gap-clock", mark, message, hint)
    if other:
        message = f"not sampled at the declared {declared:g} Hz: {_named(other)}"
        log.warning("gap-clock", mark, message, "correct `sample_rate` in the bench file, or check the logger's clock")


def _long_steps(known: Statistics, rate: float) -> float:
    """Computes how many samples a segment lacks at the sample rate `rate` [Hz]. Returns how many gaps, each as long as the longest
    gap found, would explain this number."""
    missing = (known.end - known.start) * rate - (known.count - 1)
    return missing / (known.largest_gap * rate - 1)


def _check_ranges(recording: Sequence[RecordedSegment], sensor: SensorModel, mark: Mark, log: Findings) -> None:
    """Reports channels of the sensor that are constant, have no noise, or reach their full scale."""
    for name, text in recording[0].units.items():
        known = [item for item in recording if name in item.statistics.channels and item.statistics.count > 1]
        output = sensor.output(name)
        if not known or output is None or not measures_motion(text):
            continue
        lowest = [float(item.statistics.minimum[item.statistics.of(name)]) for item in known]
        highest = [float(item.statistics.maximum[item.statistics.of(name)]) for item in known]
        standing = [low == high for low, high in zip(lowest, highest, strict=True)]
        if min(lowest) == max(highest):
            message = f"'{name}' stays at {lowest[0]:g} {text} in every segment"
            log.error("gap-dead-channel", mark, message, "check the sensor, and the column in the bench file")
            continue
        if all(standing):
            message = f"'{name}' has one value per segment and no noise with which a gap can be compared"
            log.error("gap-no-noise", mark, message, "give the recorded samples, not their means")
            continue
        reached = [max(-low, high) >= output.full_scale * (1 - 1e-9) for low, high in zip(lowest, highest, strict=True)]
        labels = [item.label for item in known]
        if any(reached):
            where = _named([label for label, one in zip(labels, reached, strict=True) if one])
            message = f"'{name}' reaches its full scale of {output.full_scale:g} {text} in {where}"
            hint = "clipped samples look like an effect: lower the rates"
            log.warning("gap-saturated", mark, message, hint)
        elif any(standing):
            where = _named([label for label, one in zip(labels, standing, strict=True) if one])
            message = f"'{name}' has the same value throughout {where}"
            hint = "the reading is stuck or clipped, which looks like an effect: check the sensor, or leave the segment out"
            log.warning("gap-saturated", mark, message, hint)


def _named(labels: Sequence[str]) -> str:
    shown = ", ".join(f"'{label}'" for label in labels[:3])
    return f"{shown} and {count_of(len(labels) - 3, 'more segment')}" if len(labels) > 3 else f"{shown}"


@dataclass(frozen=True, slots=True)
class OtherState:
    """Describes a segment that was recorded in another state than planned. `segment`: its index. `kind`: gyro or accel. `angle`: angle
    between the planned and the measured direction, deg. `times`: how many times smaller the misfit is without this segment."""

    segment: int
    kind: str
    angle: float
    times: float


def check_segments(observed: Observed, where: str, log: Findings) -> None:
    """Warns about a segment in another state than planned, and about removed means. `where`: name of the run or recording, used in
    messages."""
    if observed.along is not None:
        return
    mark = Mark(where)
    found = other_state(observed)
    if found is not None and exchanged_labels(observed) is None:
        label = observed.labels[found.segment]
        shown = (
            f"the accelerometers show a direction of gravity that deviates by {found.angle:.3g} deg from the plan"
            if found.kind == "accel"
            else "the gyros show a rate in the opposite sense to the plan"
        )
        message = f"in '{label}', {shown}; without this segment, the misfit is {found.times:.3g} times smaller"
        hint = "check the label and the state of this segment: correct the plan, or leave the segment out of `segments` under `diagnosis`"
        log.warning("gap-other-state", mark, message, hint)
    removed = removed_means(observed)
    if removed:
        names = ", ".join(f"'{name}'" for name in removed)
        message = (
            f"the means of {names} over many segments are closer to zero than noise allows: an earlier program seems to have removed the "
            "means, and with them the effects on the bias"
        )
        hint = (
            "diagnose the original recording, in which each segment still has its mean; otherwise, effects that change the means "
            "remain hidden"
        )
        log.warning("gap-means-removed", mark, message, hint)


def other_state(observed: Observed) -> OtherState | None:
    """Finds the one segment without which the nominal model fits the segment means at least `EXCHANGED` times better, if the outputs in
    this segment show a stimulus of the planned magnitude in another direction. Returns None if there is no such segment.

    Let h be the leverage of a segment in the fit, and r its residual. Without this segment, the sum of squares of the residuals is
    smaller by r²/(1 − h)."""
    for kind, motion in (("accel", Rest), ("gyro", Spin)):
        channels = observed.of_kind(kind)
        if not channels:
            continue
        stimulus = segment_means(observed, observed.omega if kind == "gyro" else observed.force)
        means = segment_means(observed, observed.values[:, channels])
        design = np.column_stack([stimulus, np.ones(len(stimulus))])
        left, size, _ = np.linalg.svd(design / np.maximum(np.abs(design).max(axis=0), 1e-30), full_matrices=False)
        basis = left[:, size > RANK * size.max()]
        if len(observed) < basis.shape[1] + 1 + SPARE:
            continue
        scaled = means / np.maximum(means.std(axis=0), 1e-300)
        residual = scaled - basis @ (basis.T @ scaled)
        kept = 1 - np.einsum("ij,ij->i", basis, basis)
        drop = np.where(kept > RANK, (residual**2).sum(axis=1) / np.maximum(kept, RANK), 0.0)
        one, before = int(np.argmax(drop)), float((residual**2).sum())
        times = float(np.sqrt(before / max(before - float(drop[one]), 1e-12 * before))) if before > 0 else 1.0
        if times < EXCHANGED or not isinstance(observed.motions[one], motion):
            continue
        angle = _angle(stimulus, means, one, STIRRED[kind])
        if angle is not None and angle >= (LEAST_ANGLE if kind == "accel" else OPPOSITE):
            return OtherState(one, kind, angle, times)
    return None


def _angle(stimulus: Array, means: Array, one: int, least: float) -> float | None:
    """Computes the angle [deg] between the planned stimulus of a segment and the stimulus that its outputs show. The gains and
    biases of the channels are fitted to the other segments. Returns None if the outputs do not show the stimulus, or if its
    magnitude differs from the plan. `stimulus`: array of shape (S, 3). `means`: array of shape (S, K), outputs. `one`: index of the
    segment. `least`: smallest scatter of the stimulus along a direction that the plan varies."""
    others = np.arange(len(stimulus)) != one
    centre, level = stimulus[others].mean(axis=0), means[others].mean(axis=0)
    left, size, directions = np.linalg.svd(stimulus[others] - centre, full_matrices=False)
    used = size / np.sqrt(np.count_nonzero(others)) > least
    seen = directions[used]
    if not used.any() or means.shape[1] < len(seen):
        return None
    gains = (left[:, used].T @ (means[others] - level)) / size[used][:, None]
    if np.linalg.svd(gains, compute_uv=False).min() < SOUND:
        return None
    shown = seen @ centre + np.linalg.lstsq(gains.T, means[one] - level, rcond=None)[0]
    planned = seen @ stimulus[one]
    sizes = float(np.linalg.norm(shown)), float(np.linalg.norm(planned))
    if min(sizes) < least or abs(sizes[0] / sizes[1] - 1) > SAME_SIZE:
        return None
    return float(np.degrees(np.arccos(np.clip(shown @ planned / (sizes[0] * sizes[1]), -1, 1))))


def removed_means(observed: Observed) -> tuple[str, ...]:
    """Returns the channels whose means over the segments are closer to zero than their noise allows. A segment counts for a channel if
    the table rests or turns at a constant rate, and if the planned input of the channel is constant."""
    from scipy.stats import binom, norm

    nearly_zero = float(2 * norm.cdf(REMOVED) - 1)
    used = [part for part, unsteady in zip(observed.segments(), observed.unsteady, strict=True) if not unsteady]
    used = [part for part in used if part.stop - part.start > 2 * SLOW_ORDERS.stop]
    if not used:
        return ()
    means = means_over(used, observed.values)
    error = np.array([_slow_error(observed.values[part]) for part in used])
    felt = {"gyro": observed.omega, "accel": observed.force}
    found = []
    for index, channel in enumerate(observed.channels):
        seen = observed.seen(index, felt[channel.kind])
        varies = np.array([seen[part].std() for part in used])
        counted = (error[:, index] > 0) & (varies <= error[:, index])
        number = int(np.count_nonzero(np.abs(means[counted, index]) <= REMOVED * error[counted, index]))
        if binom.sf(number - 1, np.count_nonzero(counted), nearly_zero) < BY_CHANCE:
            found.append(channel.name)
    return tuple(found)


def _slow_error(values: Array) -> Array:
    """Computes the standard errors of the means of K channels from their noise at low frequencies. A vibration does not change the
    result: a Hann window keeps it away from the lowest frequencies, and the median omits single lines. `values`: array of shape (n, K).
    Returns an array of shape (K,).

    The error is the square root of σ²/n. In white noise, the squared magnitudes of the coefficients of the windowed samples are
    distributed exponentially with the mean σ²·Σw², so that their median is ln 2 times this mean (Percival and Walden, Spectral Analysis
    for Physical Applications, 1993, chapter 6)."""
    n = len(values)
    window = np.hanning(n + 1)[:-1]
    coefficients = np.fft.rfft(window[:, None] * (values - values.mean(axis=0)), axis=0)[SLOW_ORDERS]
    return np.asarray(np.sqrt(np.median(np.abs(coefficients) ** 2, axis=0) / np.log(2) / (window @ window) / n))
