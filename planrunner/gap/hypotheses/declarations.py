"""Finds wrong declarations of signs, axes, units, sense of rotation or mounting. Wrong declarations are found before effects of the
sensor are evaluated.

For each triad, the means of the segments are fitted by a bias and a 3×3 matrix M whose elements are all free. With correct
declarations, M differs from the identity only by scale factors and misalignments. A wrong declaration makes M a signed permutation,
possibly multiplied by a known factor between two units. A declaration counts as wrong only if the corrected recording follows the
plan. Elements of M along directions in which the plan does not vary the stimulus remain undetermined.

A recorded motion often goes back and forth, so its mean over a segment is nearly zero. Segments with a recorded motion are
therefore divided into blocks, and the means of the blocks are used instead of the mean of the segment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.declared import rearranged, turned_back
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.recording_checks import MISFIT, STIRRED, means_over
from planrunner.plan.units import STANDARD_GRAVITY

FITS = 0.1
"""If the residual of the fit of a channel, relative to the applied input, is at most this value, the matrix M describes the
channel."""
NEAR = 0.2
"""A row of M is compared with a row of a signed permutation multiplied by a factor. If their distance is at most this fraction of
the factor, the two rows agree."""
FACTOR = 0.03
"""Largest relative deviation from a known factor. This deviation is larger than usual scale-factor errors, and smaller than half
the distance between two factors."""
CLEARLY = 3.0
"""If the root mean square misfits of the two senses of rotation differ at least by this ratio, the data distinguish the two
senses."""
SEEN = 0.5
"""The unit vector of an axis is projected onto the directions that the plan varies. If the projection is at least this long, the
channel of the axis can be judged."""
BLOCKS = (0.1, 0.3, 1.0, 3.0)
"""Lengths of the blocks of a recorded motion that are tried, s. In long blocks a fast motion averages out; in short blocks, the noise and
a delay of the reference disturb the fit. The length with the best fit is used."""
FACTORS: Mapping[str, tuple[tuple[float, str, str], ...]] = {
    "gyro": (
        (180 / np.pi, "degrees", "radians"),
        (3600.0, "units per hour", "units per second"),
        (60.0, "units per minute", "units per second"),
        (3600 * 180 / np.pi, "degrees per hour", "radians per second"),
        (1000.0, "thousandths", "whole units"),
        (2.0, "half units", "whole units"),
    ),
    "accel": (
        (STANDARD_GRAVITY, "m/s²", "g"),
        (1000.0, "thousandths", "whole units"),
        (1000 * STANDARD_GRAVITY, "mm/s²", "g"),
        (100.0, "hundredths", "whole units"),
        (2.0, "half units", "whole units"),
    ),
}
"""Factors between units. Each factor is stated with two units: the unit of the values and the declared unit. For the inverse
factor, the two units are exchanged."""


@dataclass(frozen=True, slots=True)
class WrongDeclaration:
    """Describes a wrong declaration in the bench file that explains the gap.

    `effect`: name of the effect in the catalogue. `parameters`: parameters of the effect with which a simulation reproduces the
    mistake. `message`: description of the mistake, for a finding. `where`: the channels or axes, for the hint that tells the user
    what to correct. `alternative`: another declaration that may be wrong instead, because the recording cannot distinguish the two;
    empty if there is none.
    """

    effect: str
    parameters: Mapping[str, float]
    message: str
    where: str
    alternative: str = ""


@dataclass(frozen=True)
class _Reading:
    """Describes which input a channel shows: the input along one axis (0, 1 or 2), multiplied by a sign and a factor."""

    axis: int
    sign: float
    factor: float


@dataclass(frozen=True)
class _Fit:
    """Contains the result of the fit with a free matrix M for each triad.

    `readings`: the reading of each channel, None if the plan does not determine it. `sound`: True if every determined channel
    follows the plan. A channel with a wrong axis, sign or factor also follows the plan if its reading describes this mistake.
    `misfit`: sum, over the channels, of the squared residuals divided by the sum of squares of the means. `judged`: number of channels
    whose input varies enough to judge them.
    """

    readings: tuple[_Reading | None, ...]
    sound: bool
    misfit: float
    judged: int


def corrected(observed: Observed) -> tuple[Observed, list[WrongDeclaration]]:
    """Corrects wrong declarations. Returns the corrected recording and the wrong declarations. The recording is unchanged if no
    wrong declaration is found, or if no correction makes the recording follow the plan."""
    if observed.along is not None or len(observed) < 2:
        return observed, []
    parts = _parts(observed)
    planned, found = _fit(observed, parts), []
    if observed.rate.any():
        other = turned_back(observed)
        opposite = _fit(other, parts)
        if _sense_is_reversed(observed, planned, opposite):
            alternative = ""
            if planned.sound and planned.misfit <= CLEARLY**2 * opposite.misfit:
                encoder = "the sign of the recorded angle, or " if observed.moved.any() else ""
                alternative = f"{encoder}the signs of all gyros, which these segments cannot distinguish from it"
            message = "the recording follows a table that turns in the opposite sense of rotation to the declared one"
            found.append(
                WrongDeclaration("table_sense_reversed", {"share": 1.0}, message, "rates and angles × -1", alternative)
            )
            observed, planned = other, opposite
    if not planned.sound:
        return (observed, found) if found else (observed, [])
    wrong, sources, factors = _of_channels(observed, planned.readings)
    if not wrong:
        return observed, found
    better = rearranged(observed, sources, factors)
    again = _fit(better, parts)
    if not again.sound or _of_channels(better, again.readings)[0]:
        return observed, found
    return better, found + wrong


def _parts(observed: Observed) -> list[slice]:
    """Returns the parts of the recording whose means are fitted: each segment, or the blocks of a segment whose motion is recorded.
    The length of the blocks is chosen so that as many channels as possible can be judged; among several such lengths, the length
    with the smallest misfit is chosen."""
    if not observed.moved.any():
        return observed.segments()
    tried = [_blocks(observed, seconds) for seconds in BLOCKS]

    def quality(parts: Sequence[slice]) -> tuple[int, float]:
        fit = _fit(observed, parts)
        return -fit.judged, fit.misfit

    return min(tried, key=quality)


def _blocks(observed: Observed, seconds: float) -> list[slice]:
    """Divides every segment whose motion is recorded into blocks of about the given length. A block has at least one sample."""
    parts: list[slice] = []
    for rows, moved in zip(observed.segments(), observed.moved, strict=True):
        count = rows.stop - rows.start
        blocks = round(float(np.ptp(observed.time[rows])) / seconds) if moved else 1
        edges = np.linspace(rows.start, rows.stop, min(max(blocks, 1), count) + 1).astype(int).tolist()
        parts += [slice(a, b) for a, b in pairwise(edges)]
    return parts


def _fit(observed: Observed, parts: Sequence[slice]) -> _Fit:
    """Fits a bias and a matrix M for each triad to the means over `parts`."""
    readings: list[_Reading | None] = [None] * len(observed.channels)
    sound, misfit, judged = True, 0.0, 0
    for kind in ("gyro", "accel"):
        channels = observed.of_kind(kind)
        if not channels:
            continue
        stimulus = means_over(parts, observed.omega if kind == "gyro" else observed.force)
        stimulus = stimulus - stimulus.mean(axis=0)
        left, size, directions = np.linalg.svd(stimulus, full_matrices=False)
        used = size / np.sqrt(len(stimulus)) > STIRRED[kind]
        if not used.any():
            continue
        seen = directions[used]
        means = means_over(parts, observed.values[:, channels])
        means = means - means.mean(axis=0)
        gains = (left[:, used].T @ means) / size[used][:, None]
        rest = means - stimulus @ seen.T @ gains
        misfit += float((rest**2).sum(axis=0) @ (1 / np.maximum((means**2).sum(axis=0), 1e-300)))
        for place, index in enumerate(channels):
            own = seen[:, observed.channels[index].axis]
            if np.linalg.norm(own) < SEEN or _stuck(observed, index):
                continue
            judged += 1
            if float(np.linalg.norm(rest[:, place])) > FITS * float(np.linalg.norm(means[:, place])):
                sound = False
                continue
            readings[index] = _reading(gains[:, place], seen, observed.channels[index].axis, kind)
            sound &= readings[index] is not None
    return _Fit(tuple(readings), sound, misfit, judged)


def _stuck(observed: Observed, index: int) -> bool:
    """Returns True if a channel is constant throughout at least one segment although it has noise in most segments. Such a channel
    is at a limit, so it shows only a part of its input. A channel with coarse counts does not count as stuck, because it is
    constant in most segments at rest."""
    spread = np.array([np.ptp(observed.values[part, index]) for part in observed.segments()])
    return bool(np.median(spread) > 0 and spread.min() == 0)


def _reading(gain: Array, seen: Array, own: int, kind: str) -> _Reading | None:
    """Returns the axis, sign and factor of a channel that agree with its measured gain (r,) along the directions (r, 3) of the
    plan; None if no axis agrees. The declared axis, sign and factor are kept if they fit within the usual scale factors and
    misalignments. `seen`: array of shape (r, 3), the directions. `own`: declared axis of the channel. `kind`: gyro or accel."""
    if float(np.linalg.norm(gain - seen[:, own])) <= MISFIT * float(np.linalg.norm(seen[:, own])):
        known = _factor(gain, seen[:, own], kind)
        if known == 1.0 or known is None:
            return _Reading(own, 1.0, 1.0)
    best: tuple[float, _Reading] | None = None
    for axis in sorted(range(3), key=lambda axis: axis != own):
        direction = seen[:, axis]
        if np.linalg.norm(direction) < SEEN:
            continue
        along = float(gain @ direction) / float(direction @ direction)
        if along == 0.0:
            continue
        distance = float(np.linalg.norm(gain - along * direction)) / abs(along) / float(np.linalg.norm(direction))
        known = _factor(np.sign(along) * gain, direction, kind)
        if distance <= NEAR and known is not None and (best is None or distance < best[0] - NEAR / 2):
            best = distance, _Reading(axis, float(np.sign(along)), known)
    return None if best is None else best[1]


def _factor(gain: Array, direction: Array, kind: str) -> float | None:
    """Returns the known factor between two units that agrees with a measured gain (r,) along r directions of the plan: 1 for an
    ordinary scale factor, None if no known factor agrees. `direction`: array of shape (r,), component of each of these directions
    along the axis of the channel."""
    size = float(gain @ direction) / float(direction @ direction)
    if size <= 0:
        return None
    known = [factor for one, *_ in FACTORS[kind] for factor in (one, 1 / one)]
    nearest = min(known, key=lambda factor: abs(np.log(size / factor)))
    if abs(size / nearest - 1) <= FACTOR:
        return nearest
    return 1.0 if abs(size - 1) <= NEAR else None


def _sense_is_reversed(observed: Observed, planned: _Fit, opposite: _Fit) -> bool:
    """Returns True if the opposite sense of rotation explains the recording. There are two cases: the opposite sense fits clearly
    better, or it fits equally well but the planned sense would require that all gyros are reversed."""
    told = [index for index in observed.of_kind("gyro") if opposite.readings[index] is not None]
    straight = [one is None or one.sign > 0 for one in opposite.readings]
    if not told or not opposite.sound or not all(straight[index] for index in told):
        return False
    if planned.misfit > CLEARLY**2 * opposite.misfit:
        return True
    reversed_ = all((one := planned.readings[index]) is not None and one.sign < 0 for index in told)
    return planned.sound and reversed_ and opposite.misfit <= CLEARLY**2 * planned.misfit


def _of_channels(
    observed: Observed, readings: Sequence[_Reading | None]
) -> tuple[list[WrongDeclaration], list[int], list[float]]:
    """Returns three values: the wrong declarations of channels; for every channel, the index of the channel that actually measures
    its declared axis; and, for every channel, the signed factor of this measuring channel. If two channels show the same axis, no
    declaration counts as wrong."""
    sources, factors = list(range(len(readings))), [1.0] * len(readings)
    shown: dict[str, dict[int, _Reading]] = {}
    for kind in ("gyro", "accel"):
        at = {observed.channels[index].axis: index for index in observed.of_kind(kind)}
        own = {axis: readings[index] or _Reading(axis, 1.0, 1.0) for axis, index in at.items()}
        if sorted(one.axis for one in own.values()) != sorted(at):
            return [], sources, factors
        for axis, one in own.items():
            sources[at[one.axis]], factors[at[one.axis]] = at[axis], one.sign * one.factor
        shown[kind] = own
    found = _together(observed, shown) or [
        one
        for kind, own in shown.items()
        for one in (*_exchanged(observed, kind, own), *_reversed(observed, kind, own))
    ]
    found += [one for kind, own in shown.items() for one in _units(observed, kind, own)]
    return found, sources, factors


def _together(observed: Observed, shown: Mapping[str, Mapping[int, _Reading]]) -> list[WrongDeclaration]:
    """Returns the wrong declaration that explains both triads if both show the same wrong axes: a mounting in another orientation,
    or a left-handed system. Otherwise, the result is empty. `shown`: for gyros and for accelerometers, the reading of the channel
    of each declared axis."""
    matrices = []
    for own in shown.values():
        if len(own) < 3:
            return []
        matrix = np.zeros((3, 3))
        for axis, one in own.items():
            matrix[axis, one.axis] = one.sign
        matrices.append(matrix)
    if not np.array_equal(matrices[0], matrices[1]) or np.array_equal(matrices[0], np.eye(3)):
        return []
    matrix = matrices[0]
    if np.linalg.det(matrix) > 0:
        from scipy.spatial.transform import Rotation

        turn = np.degrees(Rotation.from_matrix(matrix.T).as_rotvec())
        axes = ", ".join(
            f"{letter} measures along {'-' if sign < 0 else '+'}{'xyz'[axis]}"
            for letter, axis, sign in _rows(matrix)
            if (axis, sign) != ("xyz".index(letter), 1.0)
        )
        parameters = {f"about_{letter}": float(round(value, 6)) for letter, value in zip("xyz", turn, strict=True)}
        message = f"gyros and accelerometers are turned together from the orientation in the plan: {axes}"
        return [WrongDeclaration("mount_turned", parameters, message, axes)]
    if np.count_nonzero(matrix - np.eye(3)) == 1:
        letter = "xyz"[int(np.argmin(np.diag(matrix)))]
        message = f"gyro and accelerometer both measure along -{letter}: the declared axes form a left-handed system"
        return [WrongDeclaration("axes_mirrored", {f"mirrored_{letter}": 1.0}, message, f"the axis {letter}")]
    return []


def _rows(matrix: Array) -> list[tuple[str, int, float]]:
    """Returns three values for each axis: its letter, the index of the axis that it actually measures, and the sign. `matrix`:
    array of shape (3, 3), signed permutation."""
    axes = np.abs(matrix).argmax(axis=1)
    return [
        (letter, int(axis), float(matrix[row, axis]))
        for row, (letter, axis) in enumerate(zip("xyz", axes, strict=True))
    ]


def _exchanged(observed: Observed, kind: str, own: Mapping[int, _Reading]) -> list[WrongDeclaration]:
    moved = {axis: one.axis for axis, one in own.items() if one.axis != axis}
    if not moved:
        return []
    cycle = next(
        "".join("xyz"[axis] for axis in order)
        for order in permutations(moved)
        if all(moved[a] == b for a, b in zip(order, (*order[1:], order[0]), strict=True))
    )
    names = {channel.axis: channel.name for channel in observed.channels if channel.kind == kind}
    listed = " and ".join(f"'{names[axis]}'" for axis in sorted(moved))
    if len(cycle) == 2:
        cycle = {"yx": "xy", "zy": "yz", "xz": "zx"}.get(cycle, cycle)
        message = f"{listed} are exchanged: each follows the input of the other axis"
    else:
        cycle = cycle[cycle.index("x") :] + cycle[: cycle.index("x")]
        message = "; ".join(
            f"'{names[axis]}' follows the input along {'xyz'[source]}" for axis, source in moved.items()
        )
    return [WrongDeclaration("axes_exchanged", {f"{kind}_{cycle}": 1.0}, message, listed)]


def _reversed(observed: Observed, kind: str, own: Mapping[int, _Reading]) -> list[WrongDeclaration]:
    names = {channel.axis: channel.name for channel in observed.channels if channel.kind == kind}
    backward = [axis for axis, one in own.items() if one.sign < 0]
    if not backward:
        return []
    listed = " and ".join(f"'{names[axis]}'" for axis in backward)
    message = f"{listed} {'has' if len(backward) == 1 else 'have'} the opposite sign of the input"
    return [WrongDeclaration("axis_reversed", {f"{kind}_{'xyz'[axis]}": 1.0 for axis in backward}, message, listed)]


def _units(observed: Observed, kind: str, own: Mapping[int, _Reading]) -> list[WrongDeclaration]:
    names = {channel.axis: channel.name for channel in observed.channels if channel.kind == kind}
    by_factor: dict[float, list[int]] = {}
    for axis, one in own.items():
        if one.factor != 1.0:
            by_factor.setdefault(one.factor, []).append(axis)
    found = []
    for factor, axes in by_factor.items():
        given, declared = next(
            (one, other) if factor == value else (other, one)
            for value, one, other in FACTORS[kind]
            if factor in (value, 1 / value)
        )
        listed = ", ".join(f"'{names[axis]}'" for axis in axes)
        message = (
            f"{listed}: {factor:.4g} times the input. This is the factor between {given} in the recording and {declared} "
            "in the bench file"
        )
        parameters = {f"excess_{kind}_{'xyz'[axis]}": factor - 1 for axis in axes}
        found.append(WrongDeclaration("unit_wrong", parameters, message, f"{listed}, divide by {factor:.7g}"))
    return found
