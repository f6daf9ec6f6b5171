"""Describes patterns that effects of the catalogue do not cause. The patterns are the possible forms of "something else". They
refer to the coefficients that describe each segment (`evidence.spectrum`). Each pattern is a design, that is, a set of columns.

The patterns are offsets, changes of the scale factor, changes within segments (transients), and waveforms per turn or per rocking
period. Some patterns differ at random from segment to segment; others change smoothly with rate, gravity, temperature or time.

In array shapes, M is the number of coefficients of a channel, and S is the number of segments.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.table import RIPPLES
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.weighing import AtRows, DesignColumns, Rows
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.observation.surroundings import CHANGED
from planrunner.plan.schedule import Motion, RecordedMotion, Rest, Rock, Spin


class Sort(Enum):
    """Names the kind of coefficients that a pattern consists of. For a pattern outside the basis of the coefficients, it names the
    kind of the pattern itself. `SEVERAL`: the pattern consists of coefficients of more than one kind."""

    MEANS = "means"
    TRANSIENT = "transient"
    ROCKING = "rocking"
    ONCE_PER_TURN = "1"
    TWICE_PER_TURN = "2"
    THRICE_PER_TURN = "3"
    NOISE = "noise"
    TONE = "tone"
    BURSTS = "bursts"
    SEVERAL = ""


class Factor(StrEnum):
    """Names a factor that a gap may follow. Random differences from segment to segment count as `TIME`."""

    CHANNEL = "channel"
    ORIENTATION = "orientation"
    RATE = "rate"
    TEMPERATURE = "temperature"
    TIME = "time"
    TABLE_ANGLE = "table angle"
    BAND = "band"


@dataclass(frozen=True, slots=True)
class Pattern:
    """Describes one pattern outside the catalogue. `factor`: the factor that the gap follows if this pattern explains the gap."""

    name: str
    sort: Sort
    factor: Factor


PatternDesign = tuple[Pattern, list[DesignColumns]]
"""A pattern and its design in each channel. The columns of the design are not whitened."""
HARMONICS = {1: Sort.ONCE_PER_TURN, 2: Sort.TWICE_PER_TURN, 3: Sort.THRICE_PER_TURN}
WHOLE = {
    Sort.MEANS: Pattern("offset per segment", Sort.MEANS, Factor.TIME),
    Sort.TRANSIENT: Pattern("transient per segment", Sort.TRANSIENT, Factor.BAND),
    Sort.ROCKING: Pattern("rocking waveform", Sort.ROCKING, Factor.TABLE_ANGLE),
    **{sort: Pattern(f"{h} per turn, per segment", sort, Factor.TABLE_ANGLE) for h, sort in HARMONICS.items()},
}
"""For each sort (kind of coefficients), the pattern that contains all coefficients of this sort."""
CHANGING = Pattern("offset and transient while the temperature changes", Sort.SEVERAL, Factor.TEMPERATURE)
"""The pattern that acts both on the segment means and on the changes within the segments, in segments within which the temperature
changes."""
SIZES = Pattern("size of the effect by motion", Sort.SEVERAL, Factor.RATE)
SMOOTH_ORDERS = 6
TIME_ORDERS = 40  # number of orders of a drift over the run


def designs(weighing: Weighing) -> Iterator[PatternDesign]:
    observed, spectrum = weighing.observed, weighing.spectrum
    everywhere = len(observed.channels)
    counts = np.sqrt(observed.counts)
    starts = observed.bounds[:-1]
    coordinates = _coordinates(weighing)
    smooth = {factor: _smooth(values) for factor, values in coordinates.items()}
    offsets = [(f"{factor}", factor, basis) for factor, basis in smooth.items()]
    offsets.append(("time, in many turns", Factor.TIME, _smooth(coordinates[Factor.TIME], TIME_ORDERS, 0.0)))
    offsets.append(("gravity", Factor.ORIENTATION, _monomials(observed.force[starts] / observed.site.gravity)))

    def at_means(table: Array) -> AtRows:
        return AtRows(spectrum.means, table * counts[:, None])

    yield WHOLE[Sort.MEANS], [at_means(np.eye(len(observed)))] * everywhere
    for name, factor, basis in offsets:
        yield _offset(f"offset smooth in {name}", factor), [at_means(basis)] * everywhere
    yield (
        _BY_ORIENTATION,
        [at_means(_levels([_upward(observed, s) for s in range(len(observed))]))] * everywhere,
    )
    states = _levels([_state(observed, s) for s in range(len(observed))])
    yield _offset("offset by motion", Factor.RATE), [at_means(states)] * everywhere
    moving = _levels([not isinstance(motion, Rest) for motion in observed.motions])
    if not np.array_equal(moving, states):
        yield _offset("offset while the table moves", Factor.RATE), [at_means(moving)] * everywhere
    turned = _orientations(observed)
    for factor in (Factor.TEMPERATURE, Factor.TIME):
        both = (turned[:, :, None] * smooth[factor][:, None, :2]).reshape(len(turned), -1)
        yield _offset(f"offset with orientation, smooth in {factor}", factor), [at_means(both)] * everywhere
    rates = np.column_stack([observed.rate[starts] * observed.table_axis[starts, axis] for axis in range(3)])
    scales = [_offset("scale factor per segment", Factor.RATE)]
    scales += [_offset(f"scale factor smooth in {factor}", factor) for factor in (Factor.TEMPERATURE, Factor.TIME)]
    for pattern, basis in zip(
        scales, (np.eye(len(observed)), smooth[Factor.TEMPERATURE], smooth[Factor.TIME]), strict=True
    ):
        by_axis = [at_means(rates[:, [axis]] * basis) for axis in range(3)]
        yield (
            pattern,
            [by_axis[channel.axis] for channel in observed.channels],
        )
    rows = sorts(weighing)
    yield WHOLE[Sort.TRANSIENT], [rows[Sort.TRANSIENT]] * everywhere
    for h, sort in HARMONICS.items():
        yield WHOLE[sort], [rows[sort]] * everywhere
        alike = Pattern(f"{h} per turn, alike", sort, Factor.TABLE_ANGLE)
        same = _alike(weighing, rows[sort])
        if h in RIPPLES:  # an effect of the catalogue
            yield alike, [same] * everywhere
        else:
            along = _along_axis(weighing, h)
            yield alike, [np.hstack([same, along[channel.axis]]) for channel in observed.channels]
    yield WHOLE[Sort.ROCKING], [rows[Sort.ROCKING]] * everywhere
    slow = (spectrum.harmonic == 0) & _changing(observed)[spectrum.segment]
    yield CHANGING, [slow] * everywhere


def _offset(name: str, factor: Factor) -> Pattern:
    """Makes a pattern of the segment means."""
    return Pattern(name, Sort.MEANS, factor)


_BY_ORIENTATION = _offset("offset by orientation", Factor.ORIENTATION)


def sorts(weighing: Weighing) -> dict[Sort, Rows]:
    """Returns, for each kind of coefficients, a mask (M,) of the coefficients of this kind."""
    spectrum, motions = weighing.spectrum, weighing.observed.motions
    spin = np.array([isinstance(motion, Spin) for motion in motions])[spectrum.segment]
    rock = np.array([isinstance(motion, Rock) for motion in motions])[spectrum.segment]
    return {
        Sort.MEANS: spectrum.frequency == 0,
        Sort.TRANSIENT: (spectrum.harmonic == 0) & (spectrum.frequency > 0),
        Sort.ROCKING: rock & (spectrum.harmonic > 0),
        **{sort: spin & (spectrum.harmonic == h) for h, sort in HARMONICS.items()},
    }


def factors(weighing: Weighing) -> Iterator[PatternDesign]:
    """Yields patterns that effects of the catalogue can also follow, with designs like those of `designs`. These patterns are used
    to locate the gap, and they do not count as unknown. For each factor, the pattern has the simplest form. Thus a factor that
    needs few parameters can prevail over a factor that needs many. For an accelerometer, every orientation of the sensor counts
    separately. For a gyro, orientations count as equal if gravity has the same direction in the sensor's axes and, at rest, North
    has the same direction too.
    """
    observed, spectrum = weighing.observed, weighing.spectrum
    segments = range(len(observed))

    def at_means(table: Array) -> AtRows:
        return AtRows(spectrum.means, table * np.sqrt(observed.counts)[:, None])

    levels = {
        "gyro": _levels([_upward(observed, s) for s in segments]),
        "accel": _levels([_coarse(observed.attitude[s]) for s in segments]),
    }
    yield _BY_ORIENTATION, [at_means(levels[channel.kind]) for channel in observed.channels]
    states = _levels([_state(observed, s) for s in segments])
    yield (
        _offset("offset by orientation and motion", Factor.ORIENTATION),
        [at_means(np.hstack([levels[channel.kind], states])) for channel in observed.channels],
    )
    if observed.along is None:
        cosines = _orientations(observed)
        along = _offset("offset along orientation", Factor.ORIENTATION)
        yield along, [at_means(cosines[:, channel.axis :: 3]) for channel in observed.channels]
    yield (
        _offset("offset by kind of motion", Factor.RATE),
        [at_means(_levels([_state(observed, s, False) for s in segments]))] * len(observed.channels),
    )
    slopes = np.add.reduceat(observed.temperature_rate, observed.bounds[:-1]) / np.diff(observed.bounds)
    changes = np.column_stack([slopes, observed.last_change])
    yield (
        _offset("offset by change of temperature", Factor.TEMPERATURE),
        [at_means(changes / (np.abs(changes).max(0) + 1e-300))] * len(observed.channels),
    )
    turning = np.array([isinstance(motion, Spin) for motion in observed.motions])[observed.owner]
    if not turning.any():
        return
    rate = observed.rate / np.abs(observed.rate[turning]).max()
    for order, sort in ((1, Sort.ONCE_PER_TURN), (2, Sort.TWICE_PER_TURN)):
        waves = np.column_stack([wave(order * observed.angle) * turning for wave in (np.cos, np.sin)])
        common = [spectrum.project(observed, waves), spectrum.project(observed, waves * rate[:, None])]
        own = [spectrum.project(observed, waves * (rate * observed.table_axis[:, axis])[:, None]) for axis in range(3)]
        by_rate = Pattern(f"{order} per turn, by rate", sort, Factor.TABLE_ANGLE)
        yield by_rate, [np.hstack([*common, own[channel.axis]]) for channel in observed.channels]


def _coordinates(weighing: Weighing) -> dict[Factor, Array]:
    observed = weighing.observed
    middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
    return {
        Factor.RATE: observed.rate[observed.bounds[:-1]],
        Factor.TEMPERATURE: observed.temperature[middles],
        Factor.TIME: observed.time[middles],
    }


def _orientations(observed: Observed) -> Array:
    """Returns the direction cosines of East, North and Up in the sensor's axes, averaged over each segment, shape (S, 9)."""
    axes = [observed.in_sensor_axes(axis) for axis in np.eye(3)]
    counts = np.diff(observed.bounds)[:, None]
    return np.hstack([np.add.reduceat(axis, observed.bounds[:-1], axis=0) / counts for axis in axes])


def _levels(names: Sequence[Hashable]) -> Array:
    """Returns an indicator matrix with one column for each distinct name, shape (S, levels)."""
    distinct = list(dict.fromkeys(names))
    return np.array([[float(name == other) for other in distinct] for name in names])


def _coarse(values: Array) -> tuple[float, ...]:
    """Rounds values to a tenth, so that equal orientations get equal keys."""
    return tuple((np.round(values, 1) + 0.0).ravel().tolist())


def _upward(observed: Observed, segment: int) -> Hashable:
    """Returns a key for the direction of gravity in the sensor's axes and, at rest, also for the direction of North. `segment`:
    index of the segment."""
    first = int(observed.bounds[segment])
    still = isinstance(observed.motions[segment], Rest)
    north = observed.attitude[segment][:, 1] if still else np.zeros(3)
    return _coarse(observed.force[first] / observed.site.gravity) + _coarse(north)


def sizes(weighing: Weighing, signatures: Sequence[Array]) -> tuple[Pattern, list[Array]]:
    """Makes a pattern in which an effect has a separate size for each motion: for each rate of turning, for each frequency and
    amplitude of rocking, and for each segment of a recorded motion. A cause outside the catalogue that resembles the effect usually
    depends on the motion in a different way from the effect.

    `signatures`: for each channel, the coefficients (M,) that the effect causes."""
    motions = [_speed(motion, index) for index, motion in enumerate(weighing.observed.motions)]
    here = _levels(motions)[weighing.spectrum.segment]
    return SIZES, [own[:, None] * here for own in signatures]


def _speed(motion: Motion, segment: int) -> str:
    """Returns a key for the rate of a turning motion, or for the frequency and amplitude of a rocking motion. A recorded motion is
    different in each segment. `segment`: index of the segment."""
    if isinstance(motion, Spin):
        return f"{abs(motion.rate):.6g}"
    if isinstance(motion, RecordedMotion):
        return f"segment {segment}"
    return f"{motion.frequency:.6g}, {motion.amplitude:.6g}" if isinstance(motion, Rock) else ""


def _state(observed: Observed, segment: int, fast: bool = True) -> str:
    """Returns a key for the kind of motion of the table, the sensor axis about which it turns, and (if `fast`) its rate. `segment`:
    index of the segment."""
    motion, first = observed.motions[segment], int(observed.bounds[segment])
    axis = _coarse(observed.table_axis[first])
    if isinstance(motion, Spin):
        return f"{motion.rate:.6g} about {axis}" if fast else f"turning about {axis}"
    return f"rocking about {axis}" if isinstance(motion, Rock) else "at rest"


def _smooth(values: Array, most: int = SMOOTH_ORDERS, fading: float = 1.0) -> Array:
    """Returns smooth functions of a coordinate, such as the temperature, shape (S, at most `most`). `values`: array of shape (S,),
    coordinate of each segment. The functions are cosines, of orders 1 to `most`, of the position of the coordinate within its
    range. Each order has the weight 1/order^fading."""
    span = float(np.ptp(values))
    if span <= 0:
        return np.zeros((len(values), 0))
    orders = np.arange(1, min(most, len(np.unique(np.round(values / span, 6)))) + 1)
    cosines: Array = np.cos(np.pi * orders * (values[:, None] - values.min()) / span) / orders**fading
    return cosines


def _changing(observed: Observed) -> Rows:
    """Returns a mask of the segments within which the temperature changes, shape (S,)."""
    spans = np.maximum.reduceat(observed.temperature, observed.bounds[:-1])
    spans -= np.minimum.reduceat(observed.temperature, observed.bounds[:-1])
    return np.asarray(spans > CHANGED)


def _monomials(direction: Array) -> Array:
    """Returns the monomials of degrees 2 to 4 of the components of the direction of gravity, shape (S, monomials). `direction`:
    array of shape (S, 3)."""
    columns = [
        direction[:, 0] ** a * direction[:, 1] ** b * direction[:, 2] ** (d - a - b)
        for d in (2, 3, 4)
        for a in range(d + 1)
        for b in range(d + 1 - a)
    ]
    return np.column_stack(columns)


def _alike(weighing: Weighing, rows: NDArray[np.bool_]) -> Array:
    """Returns columns (M, 6) for the cosine and sine of a harmonic. The amplitude of the harmonic is the same in all segments,
    proportional to the rate, or proportional to the square of the rate. `rows`: array of shape (M,), True for the coefficients of
    the harmonic."""
    observed, spectrum = weighing.observed, weighing.spectrum
    if not rows.any():
        return np.zeros((len(rows), 0))
    owners = spectrum.segment[rows]
    first = np.r_[True, np.diff(owners) != 0]
    rate = observed.rate[observed.bounds[:-1]][owners]
    rate = rate / np.abs(rate).max()
    size = np.sqrt(observed.counts)[owners]
    out = np.zeros((len(rows), 6))
    for part, phase in enumerate((first, ~first)):
        for power in range(3):
            out[rows, 3 * part + power] = np.where(phase, size * rate**power, 0.0)
    return out


def _along_axis(weighing: Weighing, h: int) -> list[Array]:
    """Returns, for each axis of the sensor, columns for an error of the table that is proportional to its rate and has `h` periods
    per turn. Such an error appears in all segments in which the table moves, and only along the axis of the table."""
    observed, spectrum = weighing.observed, weighing.spectrum
    moving = np.array([isinstance(motion, Spin | Rock) for motion in observed.motions])
    fastest = float(np.abs(observed.rate).max())
    if not moving.any() or fastest <= 0:
        return [np.zeros((len(spectrum.segment), 0))] * 3
    waves = (
        np.column_stack([np.cos(h * observed.angle), np.sin(h * observed.angle)]) * (observed.rate / fastest)[:, None]
    )
    return [spectrum.project(observed, waves * observed.table_axis[:, axis : axis + 1], moving) for axis in range(3)]
