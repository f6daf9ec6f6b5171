"""Checks the means of the segments of a recording for two mistakes of bookkeeping that look like effects of the sensor, or that hide
them: one segment was recorded in another state than the plan says, or an earlier program removed the mean of each segment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.findings import Findings, Mark
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.recording_checks import EXCHANGED, RANK, SPARE, STIRRED, exchanged_labels, segment_means
from planrunner.plan.schedule import Rest, Spin

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
BY_CHANCE = 1e-6
"""Removed means are reported if noise alone makes so many means nearly zero with at most this probability (binomial distribution)."""


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
        hint = "diagnose the recording as the sensor gave it; otherwise, effects that change the mean of a segment remain hidden"
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
    """Returns the channels whose means over the segments are closer to zero than their noise allows. A segment with a recorded motion
    counts only if the reference shows a mean that the channel should have."""
    from scipy.stats import binom, norm

    nearly_zero = float(2 * norm.cdf(REMOVED) - 1)
    found = []
    for index, channel in enumerate(observed.channels):
        means = segment_means(observed, observed.values[:, [index]])[:, 0]
        error = np.array(
            [observed.values[part, index].std() / np.sqrt(part.stop - part.start) for part in observed.segments()]
        )
        stimulus = segment_means(observed, observed.omega if channel.kind == "gyro" else observed.force)[
            :, channel.axis
        ]
        counted = (error > 0) & (~observed.moved | (np.abs(stimulus) > 3 * error))
        number = int(np.count_nonzero(np.abs(means[counted]) <= REMOVED * error[counted]))
        if binom.sf(number - 1, np.count_nonzero(counted), nearly_zero) < BY_CHANCE:
            found.append(channel.name)
    return tuple(found)
