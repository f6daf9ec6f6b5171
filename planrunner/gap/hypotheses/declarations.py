"""Finds and corrects wrong declarations of signs, axes, units, sense of rotation or mounting, and delays between the outputs and the
recorded channels that show the motion. This is done before effects of the sensor are evaluated.

For each triad, the means of the segments are fitted by a bias and a 3×3 matrix M whose elements are all free. With correct
declarations, M differs from the identity only by scale factors and misalignments. A wrong declaration makes M a signed permutation,
possibly multiplied by a known factor between two units. A declaration counts as wrong only if the corrected recording follows the
plan. Elements of M along directions in which the plan does not vary the stimulus remain undetermined.

A recorded motion often goes back and forth, so its mean over a segment is nearly zero. Segments with a recorded motion are
therefore divided into blocks, and the means of the blocks are used instead of the mean of the segment.

For a delay d, the outputs y of the gyros are compared with the recorded rates ω of an earlier time, y(t) = b + M·ω(t − d), with a
free bias b and a free matrix M. The delay of a segment is the delay with the smallest sum of squared residuals. A delay that is the
same in all segments has its cause in the clocks or filters of the two devices. A delay that changes from one segment to the next
shows lost samples, or clocks that run at different rates.

A small delay is not corrected here, because the diagnosis removes the response to this delay from the samples (decision 83). The
response is proportional to the angular acceleration only if the delay is much shorter than the changes of the motion. Therefore,
large delays are corrected before the diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.declared import rearranged, turned_back
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.recording_checks import MISFIT, STIRRED, means_over
from planrunner.physics.moved_body import by_attitude
from planrunner.plan.schedule import RecordedMotion
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


@dataclass(frozen=True, slots=True)
class AttitudeReading:
    """Describes how the quaternions of an attitude reference are read. `order`: for each component, real part first, its place in the
    declared order. `conjugate`: True if the quaternions convert vectors from East-North-Up to the sensor's axes."""

    order: tuple[int, int, int, int]
    conjugate: bool


DECLARED_ORDER, REAL_PART_LAST = (0, 1, 2, 3), (3, 0, 1, 2)
ATTITUDE_READINGS = (
    AttitudeReading(DECLARED_ORDER, True),
    AttitudeReading(REAL_PART_LAST, False),
)
"""Readings that are tried if the recording does not follow the attitudes as declared. If both mistakes are made at once, the wrong
attitudes differ from the true ones by a fixed rotation, so the recording looks as if axes were exchanged and reversed."""


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


def attitude_read_otherwise(observed: Observed) -> AttitudeReading | None:
    """Finds another reading of the quaternions of an attitude reference with which the recording follows the plan, although it does not
    follow the plan with the declared reading. Returns None if there is no such reading, or if the recording has no attitude
    reference."""
    if observed.along is not None or len(observed) < 2:
        return None
    parts = _parts(observed)
    planned = _fit(observed, parts)
    gyros = [(index, observed.channels[index].axis) for index in observed.of_kind("gyro")]
    told = [planned.readings[index] for index, _ in gyros]
    if planned.sound and not (told and all(one is not None and one.sign < 0 for one in told)):
        return None
    for reading in ATTITUDE_READINGS:
        other = _with_attitude(observed, reading)
        if other is None:
            return None
        fit = _fit(other, parts)
        straight = all(fit.readings[index] == _Reading(axis, 1.0, 1.0) for index, axis in gyros)
        if fit.sound and straight and planned.misfit > CLEARLY**2 * fit.misfit:
            return reading
    return None


def _with_attitude(observed: Observed, reading: AttitudeReading) -> Observed | None:
    """Returns the recording with another reading of its attitudes; None if the recording shows no attitude. The declared reading gave
    the quaternion of an attitude, up to its sign. The sign does not matter, because opposite quaternions describe the same attitude."""
    from scipy.spatial.transform import Rotation

    shown = [isinstance(motion, RecordedMotion) and bool(motion.attitude) for motion in observed.motions]
    if not any(shown):
        return None
    courses = list(observed.courses)
    for index, rows in enumerate(observed.segments()):
        course = courses[index]
        if course is None or not shown[index]:
            continue
        declared = Rotation.from_matrix(course.attitude.swapaxes(1, 2)).as_quat(scalar_first=True)
        quaternions = declared[:, list(reading.order)] * (1, *[-1 if reading.conjugate else 1] * 3)
        by_gravity = np.allclose(course.force, course.attitude @ observed.site.specific_force_enu)
        courses[index] = by_attitude(
            observed.time[rows], quaternions, observed.site, None if by_gravity else course.force
        )
    return replace(observed, courses=tuple(courses))


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
        axes = [observed.channels[index].axis for index in channels]
        follows = np.linalg.norm(rest, axis=0) <= FITS * np.linalg.norm(means, axis=0)
        for place, other in _taken_for_each_other(gains, seen, axes, follows):
            sign = float(np.sign(gains[:, other] @ seen[:, axes[place]]))
            readings[channels[place]] = _Reading(axes[other], 1.0, 1.0)
            readings[channels[other]] = _Reading(axes[place], sign, 1.0)
            judged += 1
        for place, index in enumerate(channels):
            own = seen[:, axes[place]]
            if readings[index] is not None or np.linalg.norm(own) < SEEN or _stuck(observed, index):
                continue
            judged += 1
            if not follows[place]:
                sound = False
                continue
            readings[index] = _reading(gains[:, place], seen, axes[place], kind)
            sound &= readings[index] is not None
    return _Fit(tuple(readings), sound, misfit, judged)


def _taken_for_each_other(
    gains: Array, seen: Array, axes: Sequence[int], follows: NDArray[np.bool_]
) -> list[tuple[int, int]]:
    """Finds pairs of exchanged channels. The plan varies the input of only one channel of each pair, for example of the channel along the
    axis of a table, but not of the channel across it. The channel of the varied axis hardly shows the input; exactly one channel of an
    axis that is not varied shows all of it. Returns the places of the two channels of each such pair in `axes`.

    `gains`: array of shape (r, K), gain of each channel along the directions. `seen`: array of shape (r, 3), the directions that the
    plan varies. `axes`: declared axis of each of the K channels. `follows`: array of shape (K,), True for channels that follow the
    plan."""
    varied = [bool(np.linalg.norm(seen[:, axis]) >= SEEN) for axis in axes]
    found = []
    for place, axis in enumerate(axes):
        direction = seen[:, axis]
        if not varied[place] or float(np.linalg.norm(gains[:, place])) > NEAR * float(np.linalg.norm(direction)):
            continue
        size = float(np.linalg.norm(direction))
        showing = [
            other
            for other in range(len(axes))
            if not varied[other]
            and follows[other]
            and min(float(np.linalg.norm(gains[:, other] - sign * direction)) for sign in (1, -1)) <= NEAR * size
        ]
        if len(showing) == 1:
            found.append((place, showing[0]))
    return found


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


LATE = 0.02
"""Smallest delay that is corrected, s. It must also be at least `PERIODS` sampling periods."""
PERIODS = 2.0
LONGEST = 2.0
"""Longest delay that the search considers, s. The search also considers no delay longer than a quarter of the segment."""
FINEST = 0.005
"""Smallest step of the search, s."""
HALVED = 0.5
"""A delay counts only if it reduces the sum of the squared residuals to at most this fraction."""
ALIKE = 0.1
"""Several delays may explain the data almost equally well, for example in a periodic motion. If the sums of squared residuals of
such delays differ by at most this fraction of the explained part, the shortest delay is chosen."""
SURE = 5.0
"""A delay, or a change of the delay, must exceed its standard uncertainty by this factor."""
_ROUNDS = 3  # largest number of corrections; each correction measures the remaining delay
FEWEST = 30
"""Smallest number of samples with which the delay of a segment is measured."""


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of the outputs in one segment, and its standard uncertainty, both in s. A negative delay means that the channels that show
    the motion are late."""

    seconds: float
    uncertainty: float


def in_step(
    observed: Observed, read: Callable[[Mapping[str, float]], Observed], period: float
) -> tuple[Observed, list[WrongDeclaration]]:
    """Corrects large delays between the outputs and the recorded motion. Returns the corrected recording, and the delay as a wrong
    declaration. The recording is unchanged if there is no large delay.

    `read`: function that reads the recording again and shifts the outputs by given delays. Its argument maps the label of each
    segment to the delay [s]. `period`: sampling period of the recording, s.
    """
    least = max(LATE, PERIODS * period)
    if not observed.moved.any():
        return observed, []
    found = delays(corrected(observed)[0], least)
    if not any(abs(one.seconds) >= max(least, SURE * one.uncertainty) for one in found.values()):
        return observed, []
    total = dict.fromkeys(found, 0.0)
    steps = {label: period * float(size) for label, size in zip(observed.labels, observed.bin_size, strict=True)}
    for _ in range(_ROUNDS):
        # The outputs are shifted by whole samples. The remaining delay is measured again and must not count twice.
        total = {
            label: steps[label] * round((late + found[label].seconds) / steps[label])
            for label, late in total.items()
            if label in found
        }
        known = _carried(observed, total)
        seen = read(known)
        found = delays(corrected(seen)[0], least)
        if not found:  # the shifted outputs do not follow the motion
            return observed, []
        if set(found) < set(total) or all(abs(one.seconds) < steps[label] for label, one in found.items()):
            break
    u = max(one.uncertainty for one in found.values())
    whole = {label: Delay(late + (found[label].seconds if label in found else 0.0), u) for label, late in total.items()}
    return seen, [_declared(observed, whole, max(steps.values()))]


def _carried(observed: Observed, known: Mapping[str, float]) -> dict[str, float]:
    """Returns the delays [s] of all segments with a recorded motion, by label. `known`: the delays [s] of the segments that show
    their delay, by label. A segment that does not show its delay gets the delay of the segment before it; the first segments get
    the delay of the first segment that shows it."""
    late, found = next(iter(known.values())), {}
    for label, moved in zip(observed.labels, observed.moved, strict=True):
        if moved:
            late = found[label] = known.get(label, late)
    return found


def _declared(observed: Observed, whole: Mapping[str, Delay], step: float) -> WrongDeclaration:
    """Describes delays as a wrong declaration. If the outputs become earlier at the start of a segment, the declaration describes
    lost samples; otherwise, it describes a delay. The outputs are shifted by whole samples, so the standard uncertainty is at least
    that of a rounding to whole samples. `whole`: the delay of each segment, by label. `step`: longest interval between samples (or
    bins), s."""
    labels, values = list(whole), np.array([one.seconds for one in whole.values()])
    u = float(np.hypot(max(one.uncertainty for one in whole.values()), step / np.sqrt(12)))
    if np.ptp(values) <= max(LATE, SURE * u):
        late = float(np.median(values))
        size = f"{abs(late) * 1e3:.4g} ± {u * 1e3:.2g} ms"
        message = f"the outputs follow the recorded motion {size} {'late' if late > 0 else 'early'}"
        if late < 0:
            return WrongDeclaration("reference_latency", {"delay": -late}, message, size)
        filtered = "a low-pass filter of the sensor, which delays slow motions in the same way"
        return WrongDeclaration("time_latency", {"delay": late}, message, size, filtered)
    at = int(np.argmax(np.abs(np.diff(values))))
    before, after = float(np.median(values[: at + 1])), float(np.median(values[at + 1 :]))
    size = f"{abs(after - before) * 1e3:.4g} ± {u * np.sqrt(2) * 1e3:.2g} ms"
    way = "later" if after > before else "earlier"
    message = f"from '{labels[at + 1]}' on, the outputs follow the recorded motion {size} {way} than before"
    end = float(observed.time[observed.bounds[observed.labels.index(labels[at]) + 1] - 1])
    if after > before:
        hint = f"{size} of the channels that show the motion were lost after {end:.5g} s, or their clock is slower"
        return WrongDeclaration("reference_latency", {"delay": before - after}, message, hint)
    return WrongDeclaration(
        "samples_dropped", {"time": end, "lost": (before - after) * 1e3}, message, f"{size} were lost after {end:.5g} s"
    )


def delays(observed: Observed, least: float) -> dict[str, Delay]:
    """Measures the delays of the segments with a recorded motion. Returns them by label; segments whose motion does not show the
    delay are left out. Successive segments get the same delay, unless the delay changes clearly and by more than `least` [s]."""
    each: dict[str, Delay] = {}
    for label, rows, moved in zip(observed.labels, observed.segments(), observed.moved, strict=True):
        own = _of_segment(observed, rows) if moved else None
        if own is not None:
            each[label] = own
    return _in_groups(each, least) if each else {}


def _in_groups(each: Mapping[str, Delay], least: float) -> dict[str, Delay]:
    """Divides successive segments into groups. Between the groups, the delay changes clearly and by more than `least` [s]. Returns,
    for each segment, the median of the delays in its group. The delays of a group may differ by more than `least` and by more than
    their uncertainties explain, for example if there are few segments, or if the clocks run at different rates. Each segment of
    such a group keeps its own delay."""
    labels, values = list(each), np.array([one.seconds for one in each.values()])
    steps = np.abs(np.diff(values))
    typical = 1.4826 * float(np.median(steps)) / np.sqrt(2) if len(steps) else 0.0
    scatter = max(typical, min(one.uncertainty for one in each.values()))
    edges = [0, *(np.flatnonzero(steps > max(least, SURE * np.sqrt(2) * scatter)) + 1).tolist(), len(values)]
    found: dict[str, Delay] = {}
    for begin, end in pairwise(edges):
        own = {label: each[label] for label in labels[begin:end]}
        worst = max(one.uncertainty for one in own.values())
        if np.ptp(values[begin:end]) > max(least, SURE * np.sqrt(2) * worst):
            found |= own
            continue
        one = Delay(float(np.median(values[begin:end])), scatter * float(np.sqrt(np.pi / 2 / (end - begin))))
        found |= dict.fromkeys(labels[begin:end], one)
    return found


def _of_segment(observed: Observed, rows: slice) -> Delay | None:
    """Measures the delay of one segment; None if its motion does not show the delay. A search over all delays with `_unexplained`
    finds the region of the best delay. In this region, the delay is found from the residuals of the samples. `rows`: the samples of
    the segment."""
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    channels = observed.of_kind("gyro")
    time, rates = observed.time[rows], observed.omega[rows]
    if not channels or len(time) < FEWEST:
        return None
    longest = min(LONGEST, float(np.ptp(time)) / 4)
    inside = (time > time[0] + longest) & (time < time[-1] - longest)
    centred = rates - rates.mean(axis=0)
    _, size, directions = np.linalg.svd(centred, full_matrices=False)
    seen = directions[size / np.sqrt(len(time)) > STIRRED["gyro"]]
    axes = [observed.channels[index].axis for index in channels]
    told = [place for place, axis in enumerate(axes) if len(seen) and np.linalg.norm(seen[:, axis]) > np.sqrt(0.5)]
    if not told or np.count_nonzero(inside) < FEWEST:
        return None
    values = observed.values[rows][inside][:, [channels[place] for place in told]]
    values = values - values.mean(axis=0)
    energy = np.maximum((values**2).sum(axis=0), 1e-300)
    course, own = CubicSpline(time, rates @ seen.T), seen[:, [axes[place] for place in told]]

    def residual(delay: float) -> float:
        """Returns the fraction of an output's energy that the rates of `delay` seconds earlier do not explain, averaged over the
        outputs. The fraction counts as 1 for an output that follows the rates with the wrong sign."""
        earlier = course(time[inside] - delay)
        gains, *_ = np.linalg.lstsq(earlier - earlier.mean(axis=0), values, rcond=None)
        left = values - (earlier - earlier.mean(axis=0)) @ gains
        right = (gains * own).sum(axis=0) > 0
        return float(np.where(right, (left**2).sum(axis=0) / energy, 1.0).mean())

    step = max(FINEST, float(np.median(np.diff(time))) / 40)
    each = CubicSpline(time, observed.values[rows][:, [channels[place] for place in told]])
    uniform = np.arange(time[0], time[-1], step)
    steps = int(longest / step)
    tried = step * np.arange(-steps, steps + 1)
    shares = _unexplained(course(uniform), each(uniform), own, steps)
    without = residual(0.0)
    good = np.flatnonzero(shares <= shares.min() + ALIKE * max(without - shares.min(), 0.0))
    near = good[np.argmin(np.abs(tried[good]))]
    for way in (-1, 1):  # goes on to the local minimum
        while 0 < near < len(tried) - 1 and shares[near + way] < shares[near]:
            near += way
    bottom = minimize_scalar(
        residual, bounds=(tried[near] - step, tried[near] + step), method="bounded", options={"xatol": 1e-6}
    )
    delay, share = float(bottom.x), float(bottom.fun)
    bend = (residual(delay + step) - 2 * share + residual(delay - step)) / step**2
    if share > HALVED**2 or bend <= 0 or abs(delay) > longest - step:
        return None
    if abs(delay) >= LATE and share > HALVED * without:
        return None
    count = np.count_nonzero(inside) * len(told)
    uncertainty = float(np.sqrt(2 * share / count / bend))
    return Delay(delay, uncertainty) if uncertainty < longest else None


def _unexplained(rates: Array, outputs: Array, axes: Array, steps: int) -> Array:
    """Returns, for delays of −`steps` to `steps` samples, the fraction of an output's energy that the rates do not explain, shape (2 ·
    steps + 1,). The fraction is averaged over the outputs; it counts as 1 for an output that follows the rates with the wrong sign.

    `rates`: array of shape (n, r), at uniform times. `outputs`: array of shape (n, p), at the same times. `axes`: array of shape
    (r, p), the rates about the axis of each output for a rate of 1. The products of the outputs and the earlier rates are computed
    for all delays at once, as a correlation by FFT.
    """
    from scipy.signal import correlate

    inside = outputs[steps : len(outputs) - steps]
    inside = inside - inside.mean(axis=0)
    energy = np.maximum((inside**2).sum(axis=0), 1e-300)
    first, count = np.arange(2 * steps, -1, -1), len(inside)

    def windowed(values: Array) -> Array:
        """Returns the sum of values (n, …) over the window of each delay, shape (2 · steps + 1, …). The window contains the samples
        of the rates that this delay assigns to the outputs."""
        total = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0)
        return np.asarray(total[first + count] - total[first])

    sums = windowed(rates)
    gram = windowed(rates[:, :, None] * rates[:, None]) - sums[:, :, None] * sums[:, None] / count
    cross = np.array([[correlate(rate, output, "valid", "fft")[first] for output in inside.T] for rate in rates.T])
    cross = np.moveaxis(cross, 2, 0)  # (delays, r, p)
    gains = np.linalg.pinv(gram, hermitian=True) @ cross
    left = 1 - (gains * cross).sum(axis=1) / energy
    return np.asarray(np.where((gains * axes).sum(axis=1) > 0, left, 1.0).mean(axis=1))
