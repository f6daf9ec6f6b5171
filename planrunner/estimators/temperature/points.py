"""Collects values at different temperatures: coefficients that other estimates give for each temperature, and means of channels
over segments or along a ramp."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from fnmatch import fnmatchcase
from functools import partial

import numpy as np

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.estimators.interface import Estimate, EstimationError
from planrunner.estimators.temperature.branches import approached, branches
from planrunner.observation.correlated_errors import mixed
from planrunner.observation.flicker import mean_covariance
from planrunner.observation.observations import pooled_noise, recorded_times
from planrunner.plan.units import DIMENSIONS, ZERO_CELSIUS, UnknownUnitError, unit
from planrunner.uncertainty.influences import Aspect, Inputs
from planrunner.uncertainty.monte_carlo import square_root

_LEAST_IN_BIN = 3  # fewest samples in a bin from which a scatter about a line is computed
_PIECES = 4096  # most pieces of a segment, whose mean temperatures show the turning points
_IN_PIECE = 4  # samples at least
_INTERVALS = 512  # intervals of all segments together, for the correlation of flicker
_FEWEST_INTERVALS = 8  # of each segment


@dataclass(frozen=True)
class Points:
    """Contains the values of one quantity at n temperatures.

    `temperature`: array of shape (n,) in degC. `uncertainty`: array of shape (n,), standard uncertainties, NaN for values whose
    uncertainty is not known. `direction`: array of shape (n,), +1 if the temperature was rising or was reached from below, −1 if it
    was falling or was reached from above, 0 if the direction is not known. `ramp`: array of shape (n,), index of the ramp, or of
    the sweep of held temperatures; −1 for a value without a direction. `labels`: source of each value. `along`: True if the values
    follow each other along ramps. `expected`: True if the values are expected values of a schedule, which have no scatter.
    `covariance`: array of shape (n, n), covariance of the values, which includes the flicker that the bench declares; None if no
    flicker is declared, or if the uncertainties are not known. `time`: array of shape (n,) in s, the mean time of each value; empty
    if the times are not known. `freedom`: degrees of freedom of the uncertainties. `unstated`: array of shape (n, r), a matrix L
    for which L·Lᵀ is the covariance due to flicker with B = 1; None unless the bench file states no flicker.
    """

    name: str
    unit: str
    temperature: Array
    value: Array
    uncertainty: Array
    direction: Integers
    ramp: Integers
    labels: tuple[str, ...]
    along: bool = False
    expected: bool = False
    covariance: Array | None = None
    time: Array = field(default_factory=partial(np.zeros, 0))
    freedom: float = math.inf
    unstated: Array | None = None

    @property
    def series(self) -> Integers:
        """Returns the index of the ramp that contains each value, shape (n,); −1 at a held temperature."""
        return self.ramp if self.along else np.full(len(self.value), -1, dtype=np.int64)

    @property
    def sigma(self) -> Array:
        """Returns the positive standard uncertainties for the weights, shape (n,). If some uncertainties are not known, all are 1."""
        known = np.isfinite(self.uncertainty).all() and bool((self.uncertainty > 0).all())
        return self.uncertainty if known else np.ones(len(self.value))

    @property
    def known(self) -> bool:
        return bool(np.isfinite(self.uncertainty).all() and (self.uncertainty > 0).all())


def from_estimates(uses: Mapping[str, Estimate], patterns: Sequence[str]) -> list[Points]:
    """Collects the coefficients that the used estimates give for each temperature. Values of the same coefficient from several
    estimates become one quantity.

    Raises `EstimationError` for an estimate that gives no coefficients for a temperature, for a pattern that matches no name, and
    for a coefficient in different units.
    """
    gathered: dict[str, list[tuple[str, Mapping[str, object]]]] = {}
    for used, estimate in uses.items():
        by_temperature = given_by_temperature(estimate)
        if not by_temperature:
            raise EstimationError(
                f"'{used}' ({estimate.estimator}) gives no coefficients over temperature: state the same "
                "temperature for all its segments, or use another estimate"
            )
        for name, data in by_temperature.items():
            gathered.setdefault(name, []).append((used, data))
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in gathered):
            raise EstimationError(f"no coefficient matches '{pattern}': {closest(pattern, gathered)}")
    wanted = [name for name in gathered if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)]
    expected = all(estimate.expected for estimate in uses.values())
    return [replace(_joined(name, gathered[name]), expected=expected) for name in wanted]


def given_by_temperature(estimate: Estimate) -> Mapping[str, Mapping[str, object]]:
    """Returns the coefficients that an estimate gives for each temperature (see `interface.Estimate`); empty if there are none."""
    found = estimate.extra.get("by_temperature")
    return found if isinstance(found, Mapping) else {}


def _joined(name: str, data: Sequence[tuple[str, Mapping[str, object]]]) -> Points:
    units = sorted({str(one["unit"]) for _, one in data})
    if len(units) > 1:
        raise EstimationError(
            f"'{name}' is given in different units ({', '.join(units)}): use estimates of the same kind"
        )

    def put(key: str) -> Array:
        return np.concatenate([np.atleast_1d(np.asarray(one[key], dtype=float)) for _, one in data])

    labels = tuple(used for used, one in data for _ in np.atleast_1d(np.asarray(one["value"])))
    temperature, value = put("temperature_degC"), put("value")
    if not (np.isfinite(temperature).all() and np.isfinite(value).all()):
        raise EstimationError(f"'{name}' is not a finite number at every temperature")
    none = np.zeros(len(value), dtype=np.int64)
    time = put("time_s") if all("time_s" in one for _, one in data) else np.zeros(0)
    return Points(name, units[0], temperature, value, put("standard_uncertainty"), none, none - 1, labels, time=time)


def from_channels(
    segments: Sequence[RecordedSegment],
    channels: Sequence[str],
    thermometer: str | None,
    width: float,
    inputs: Inputs,
    span: float,
) -> list[Points]:
    """Computes the means of channels at different temperatures. If there is a thermometer, the samples of a ramp are divided into
    temperature bins of width `width` [K], and a value is the mean of the samples in one bin. Without a thermometer, a value is the
    mean of a segment at its planned temperature. `inputs`: the stated inputs, among them the declared flicker. `span`: the time
    over which a constant error is defined as an average, s. Raises `EstimationError` for channels that are missing or
    unsuitable."""
    for recorded in segments:
        for channel in (*channels, *([thermometer] if thermometer else [])):
            if channel not in recorded.units:
                raise EstimationError(
                    f"segment '{recorded.label}' has no channel '{channel}': {closest(channel, recorded.units)}"
                )
    expected = all(recorded.expected for recorded in segments)
    found, kernel = [], None
    for channel in channels:
        points, intervals, shares = _channel(segments, channel, thermometer, width)
        points = replace(points, time=shares @ (intervals[0] + intervals[1]) / 2)
        declared = inputs.of_output(Aspect.BIAS_INSTABILITY, channel)
        flickers = declared is not None and declared.standard_uncertainty > 0
        silent = channel in inputs.without_flicker and not expected
        if (flickers or silent) and points.known:
            kernel = mean_covariance(*intervals, span) if kernel is None else kernel
            root = square_root(shares @ kernel @ shares.T)
            if declared is not None and flickers:
                points = replace(points, covariance=mixed(points.uncertainty, declared.standard_uncertainty * root))
            else:
                points = replace(points, unstated=root)
        found.append(replace(points, expected=expected))
    return found


Intervals = tuple[Array, Array]
"""Start times and end times of q intervals, s, each of shape (q,)."""


def _channel(
    segments: Sequence[RecordedSegment], channel: str, thermometer: str | None, width: float
) -> tuple[Points, Intervals, Array]:
    """Returns the n values of a channel, q intervals of time, and an array of shape (n, q): for each value, the fraction of its
    samples in each interval. `width`: width of a temperature bin, K."""
    units = sorted({recorded.units[channel] for recorded in segments})
    if len(units) > 1:
        raise EstimationError(f"channel '{channel}' is recorded in different units ({', '.join(units)})")
    if thermometer is None:
        return _at_held(segments, channel, units[0], width), recorded_times(segments), np.eye(len(segments))
    held = in_time_order(segments)
    intervals = max(_FEWEST_INTERVALS, _INTERVALS // len(held))
    labelled = [
        (ramp, place) for place, one in enumerate(held) for ramp in _ramps(one, channel, thermometer, width, intervals)
    ]
    if not labelled:
        raise EstimationError(f"channel '{channel}' has no usable samples in the chosen segments")
    ramps = [ramp for ramp, _ in labelled]
    sizes = [len(ramp.count) for ramp in ramps]
    count = np.concatenate([ramp.count for ramp in ramps])
    squares = np.concatenate([ramp.squares for ramp in ramps])
    enough = count >= _LEAST_IN_BIN
    freedom = float(np.sum(count[enough] - 2))
    scatter = math.sqrt(float(np.sum(squares[enough])) / freedom) if freedom > 0 else math.nan
    shares = np.zeros((len(count), len(held), intervals))
    shares[np.arange(len(count)), np.repeat([place for _, place in labelled], sizes)] = np.concatenate(
        [ramp.shares for ramp in ramps]
    )
    start, end = recorded_times(held)
    edges = start[:, None] + (end - start)[:, None] * np.linspace(0, 1, intervals + 1)
    points = Points(
        channel,
        units[0],
        np.concatenate([ramp.celsius for ramp in ramps]),
        np.concatenate([ramp.mean for ramp in ramps]),
        scatter / np.sqrt(count),
        np.repeat([ramp.direction for ramp in ramps], sizes),
        np.repeat(_numbers(ramps, width), sizes),
        tuple(held[place].label for (_, place), size in zip(labelled, sizes, strict=True) for _ in range(size)),
        along=True,
        freedom=freedom,
    )
    return points, (edges[:, :-1].ravel(), edges[:, 1:].ravel()), shares.reshape(len(count), -1)


def _at_held(segments: Sequence[RecordedSegment], channel: str, text: str, width: float) -> Points:
    """Returns the means of segments at their planned temperatures. The order in time shows whether a temperature was reached from
    below or from above. `text`: unit of the channel. `width`: a change of at most this size [K] counts as no change."""
    found = np.array([_planned(recorded, channel) for recorded in segments])
    order = np.argsort([recorded.segment.start for recorded in segments], kind="stable")
    direction, sweep = np.empty(len(order), dtype=np.int64), np.empty(len(order), dtype=np.int64)
    direction[order], sweep[order] = approached(found[order, 0].tolist(), width)
    labels = tuple(recorded.label for recorded in segments)
    start, end = recorded_times(segments)
    freedom = np.array([recorded.statistics.freedom for recorded in segments], dtype=np.float64)
    uncertainty, noise = found[:, 2], pooled_noise(found[:, 2], end - start, freedom)
    if noise.known and np.isfinite(uncertainty).all() and (uncertainty > 0).all():
        uncertainty = noise.sigma
    return Points(
        channel, text, found[:, 0], found[:, 1], uncertainty, direction, sweep, labels, freedom=float(freedom.sum())
    )


def _planned(recorded: RecordedSegment, channel: str) -> tuple[float, float, float]:
    """Returns the planned temperature of a segment [degC], the mean of the channel, and the standard error of the mean."""
    segment, statistics = recorded.segment, recorded.statistics
    if segment.temperature is None or segment.ramp_to is not None:
        raise EstimationError(
            f"segment '{recorded.label}' has no planned temperature: name the sensor's temperature channel in `temperature_channel`"
        )
    if not statistics.count:
        raise EstimationError(f"segment '{recorded.label}' has no usable samples: leave it out of `segments`")
    k = statistics.of(channel)
    return segment.temperature - ZERO_CELSIUS, float(statistics.mean[k]), float(statistics.standard_error[k])


@dataclass(frozen=True, slots=True)
class _Ramp:
    """One branch of a segment's temperature, divided into b bins of ascending temperature.

    `direction`: +1 or −1, 0 if the temperature hardly changes. `ends`: first and last temperature of the branch, degC. `count`:
    array of shape (b,), number of samples in each bin. `celsius`: array of shape (b,), mean temperature in each bin. `mean`: array
    of shape (b,), mean value in each bin. `squares`: array of shape (b,), sum of squares about a straight line within each bin.
    `shares`: array of shape (b, q), for each bin, the fraction of its samples in each of the q intervals of equal length into which
    the segment is divided.
    """

    direction: int
    ends: tuple[float, float]
    count: Array
    celsius: Array
    mean: Array
    squares: Array
    shares: Array


def _ramps(recorded: RecordedSegment, channel: str, thermometer: str, width: float, intervals: int) -> list[_Ramp]:
    """Returns the branches of a segment, found in one pass over its samples. In this pass, sums over the samples are stored for
    each temperature bin within each short piece of the segment. The mean temperatures of these pieces determine the branches.
    `width`: width of a temperature bin, K. `intervals`: number of intervals of equal length into which the segment is divided."""
    try:
        scale = unit(recorded.units[thermometer])
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    if scale.dimension != DIMENSIONS["temperature"]:
        raise EstimationError(
            f"channel '{thermometer}' is recorded in {scale.text}, which is not a unit of temperature"
        )
    rows = recorded.statistics.count + recorded.statistics.rejected
    pieces, row = min(_PIECES, max(1, rows // _IN_PIECE)), 0
    keys: list[Integers] = []  # of a bin within a piece: piece, bin
    sums: list[Array] = []  # n, ΣT, ΣT², Σy, Σy², ΣTy about the first sample
    first: tuple[float, float] | None = None
    for block in recorded.blocks([channel, thermometer]):
        celsius = block.channels[thermometer] * scale.factor + scale.offset - ZERO_CELSIUS
        value = block.channels[channel]
        piece = (row + np.arange(len(value))) * pieces // max(rows, 1)
        row += len(value)
        good = np.isfinite(celsius) & np.isfinite(value)
        celsius, value, piece = celsius[good], value[good], piece[good]
        if not celsius.size:
            continue
        first = first or (float(celsius[0]), float(value[0]))
        t, y = celsius - first[0], value - first[1]
        both = np.column_stack([piece, np.floor(celsius / width).astype(np.int64)])
        own, inverse = _distinct(both)
        keys.append(own)
        parts = (None, t, t * t, y, y * y, t * y)
        sums.append(np.column_stack([np.bincount(inverse, part, minlength=len(own)) for part in parts]))
    if first is None:
        return []
    key, total = np.concatenate(keys), np.concatenate(sums)
    _, place = np.unique(key[:, 0], return_inverse=True)
    course = np.bincount(place, total[:, 1]) / np.bincount(place, total[:, 0])
    number = branches(course, width)
    turning = np.diff(number) != 0
    clear = ~(np.append(turning, False) | np.append(False, turning))[
        place
    ]  # a piece at a turning point belongs to both branches
    own, inverse = _distinct(np.column_stack([number[place], key[:, 1]])[clear])
    shares = np.zeros((len(own), intervals))
    np.add.at(shares, (inverse, (key[clear, 0] * intervals) // pieces), total[clear, 0])
    shares /= shares.sum(axis=1, keepdims=True)
    n, t1, t2, y1, y2, ty = (np.bincount(inverse, column, minlength=len(own)) for column in total[clear].T)
    tt, cross = t2 - t1**2 / n, ty - t1 * y1 / n
    left = y2 - y1**2 / n - np.where(tt > 0, cross**2 / np.where(tt > 0, tt, 1.0), 0.0)
    found = []
    for one in range(int(number[-1]) + 1):
        at, here = own[:, 0] == one, course[number == one]
        # A branch begins at the extreme at which the preceding branch ends.
        begin = float(course[number < one][-1] if one else here[0])
        direction = int(np.sign(here[-1] - begin)) if abs(here[-1] - begin) > width else 0
        squares = np.maximum(left[at], 0.0)
        ends = (first[0] + begin, first[0] + float(here[-1]))
        found.append(
            _Ramp(direction, ends, n[at], first[0] + t1[at] / n[at], first[1] + y1[at] / n[at], squares, shares[at])
        )
    return found


def _numbers(ramps: Sequence[_Ramp], width: float) -> list[int]:
    """Returns the indices of the ramps in chronological order; −1 for a ramp whose temperature hardly changes. A ramp that continues the
    preceding ramp in the same direction has the same index as that ramp. `width`: largest difference [K] between the end of a ramp
    and the start of the next ramp for which the next ramp counts as a continuation."""
    found: list[int] = []
    last: _Ramp | None = None
    for ramp in ramps:
        if not ramp.direction:
            found.append(-1)
            continue
        same = last is not None and last.direction == ramp.direction and abs(last.ends[1] - ramp.ends[0]) <= width
        found.append(max(found, default=-1) + (not same))
        last = ramp
    return found


def _distinct(pairs: Integers) -> tuple[Integers, Integers]:
    """Returns the distinct rows of pairs (n, 2), ascending, and the index of each given row among them."""
    low = pairs[:, 1].min()
    span = int(pairs[:, 1].max() - low) + 1
    code, inverse = np.unique(pairs[:, 0] * span + (pairs[:, 1] - low), return_inverse=True)
    return np.column_stack([code // span, code % span + low]), inverse
