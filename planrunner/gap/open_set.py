"""Competitors that are nobody's effect, so that a diagnosis can say "something that the catalogue does not hold".

Each is a pattern of the whitened residual: offsets, scale-like errors, transients and waveforms per turn or per rocking period that differ
at random from segment to segment, or change smoothly with rate, gravity, temperature or time, in one channel or in a triad; one odd
segment; more noise in one band; and a tone that keeps its phase over the whole run. They are weighed like effects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.gap.candidates import Weighing
from planrunner.gap.evidence import STRONGEST, WEAKEST, averaged, from_eigen, log_mean_exp
from planrunner.gap.observed import Observed
from planrunner.gap.spectrum import BANDS
from planrunner.gap.weighing import lasting
from planrunner.plan.schedule import Rest, Rock, Spin

Array = NDArray[np.float64]
Setting = dict[str, int]  # triad → index of its noise
SMOOTH_ORDERS = 6
TIME_ORDERS = 40  # of a drift over the run
LONGEST_SCAN = 1 << 22  # points of the line scan's time grid
WAVEFORM = 4  # harmonics of a bias that repeats itself
NODES = 24  # of a segment, at which slow functions of time are taken


@dataclass(frozen=True)
class Kinds:
    """Competitors, under names such as 'offset smooth in time'. log_bayes: (G,) of each against none over the settings of the noise, −∞
    where the gyros' bias walks. by_channel: (K,) of each in one channel alone, at the first setting."""

    log_bayes: dict[str, Array]
    by_channel: dict[str, Array]


def competitors(weighing: Weighing) -> Kinds:
    """All competitors weighed."""
    settings = np.flatnonzero(np.isfinite(weighing.log_prior[0]))
    accels = weighing.shape[1]
    designs, waves = list(_designs(weighing)), _waves(weighing)
    each = {g: _at(weighing, designs, waves, {"gyro": int(g) // accels, "accel": int(g) % accels}) for g in settings}
    found = {name: np.full(len(weighing.base), -np.inf) for name in each[settings[0]]}
    for g, values in each.items():
        for name, value in values.items():
            found[name][g] = float(log_mean_exp(value, 0))
    channels = len(weighing.observed.channels)
    alone = {name: value[:channels] for name, value in each[settings[0]].items() if len(value) >= channels}
    for name, per_channel in _factors(weighing):
        spectra = [_eigen(weighing, index, design, {"gyro": 0, "accel": 0}) for index, design in enumerate(per_channel)]
        alone[name] = np.array([float(averaged(from_eigen(*one))) if one[0].sum() > 0 else -np.inf for one in spectra])
    return Kinds(found, alone)


def unknown(each: dict[str, Array]) -> Array:
    """log BF (G,) of "something else": the mean over its kinds, and over several of them at once."""
    return log_mean_exp(np.array([*each.values(), several(each)]), 0)


def several(each: dict[str, Array]) -> Array:
    """log BF (G,) of patterns of several sorts at once, each sort there or not with even odds.

    Sorts live in coefficients that have nothing in common, so that what they say adds up: means, slow changes within segments, each
    harmonic of the motion, and what lies outside the basis. One cause far from the catalogue often shows in more than one.
    """
    sorts: dict[str, list[Array]] = {}
    for name, value in each.items():
        word = name.split()[0]
        sorts.setdefault(word if word in ("1", "2", "3", "rocking", "transient", "noise", "a") else "means", []).append(
            value
        )
    there = [log_mean_exp(np.array(values), 0) for values in sorts.values()]
    return np.asarray(np.sum([np.logaddexp(value, 0.0) - np.log(2.0) for value in there], axis=0))


def _at(weighing: Weighing, designs: list[tuple[str, list[Array]]], waves: Array, setting: Setting) -> dict[str, Array]:
    """log BF of each competitor by scope: every channel alone, then triads; of one odd segment in any."""
    found: dict[str, list[float]] = {}
    channels = weighing.observed.channels
    scopes = [[index] for index in range(len(channels))]
    scopes += [members for kind in ("gyro", "accel") if len(members := weighing.observed.of_kind(kind)) > 1]
    for name, per_channel in designs:
        spectra = [_eigen(weighing, index, design, setting) for index, design in enumerate(per_channel)]
        for scope in scopes:
            values = np.concatenate([spectra[index][0] for index in scope])
            along = np.concatenate([spectra[index][1] for index in scope])
            if any(spectrum[0].sum() > 0 for spectrum in spectra):
                found.setdefault(name, []).append(
                    float(averaged(from_eigen(values, along))) if values.sum() > 0 else -np.inf
                )
    found["one odd segment"] = [_one_segment(weighing, setting)]
    found["noise of one band"] = _bands(weighing)
    powers = [_line(weighing, index) for index in range(len(channels))]
    found["a tone"] = [_tone([powers[index] for index in scope]) for scope in scopes]
    found["offset periodic in time"] = _periodic(weighing, waves, scopes, setting)
    return {name: np.array(each) for name, each in found.items() if each}


def _designs(weighing: Weighing) -> Iterator[tuple[str, list[Array]]]:
    """Name, and per channel raw columns (M, P)."""
    observed, spectrum = weighing.observed, weighing.spectrum
    everywhere = len(observed.channels)
    counts = np.sqrt(observed.counts)
    starts = observed.bounds[:-1]
    kinds = {name: _smooth(values) for name, values in _coordinates(weighing).items()}
    kinds["time, in many turns"] = _smooth(_coordinates(weighing)["time"], TIME_ORDERS, 0.0)
    kinds["gravity"] = _monomials(observed.force[starts] / observed.site.gravity)

    def at_means(table: Array) -> Array:
        out = np.zeros((len(spectrum.segment), table.shape[1]))
        out[spectrum.means] = table * counts[:, None]
        return out

    yield "offset per segment", [at_means(np.eye(len(observed)))] * everywhere
    for name, basis in kinds.items():
        yield f"offset smooth in {name}", [at_means(basis)] * everywhere
    yield (
        "offset by orientation",
        [at_means(_levels([_upward(observed, s) for s in range(len(observed))]))] * everywhere,
    )
    states = _levels([_state(observed, s) for s in range(len(observed))])
    yield "offset by motion", [at_means(states)] * everywhere
    turned = _orientations(observed)
    for name in ("temperature", "time"):
        both = (turned[:, :, None] * kinds[name][:, None, :2]).reshape(len(turned), -1)
        yield f"offset with orientation, smooth in {name}", [at_means(both)] * everywhere
    rates = np.column_stack([observed.rate[starts] * observed.table_axis[starts, axis] for axis in range(3)])
    for name, basis in {"segment": np.eye(len(observed)), **{k: kinds[k] for k in ("temperature", "time")}}.items():
        word = "per" if name == "segment" else "smooth in"
        yield (
            f"scale factor {word} {name}",
            [at_means(rates[:, [channel.axis]] * basis) for channel in observed.channels],
        )
    low = (spectrum.harmonic == 0) & (spectrum.frequency > 0)
    yield "transient per segment", [np.eye(len(low))[:, low]] * everywhere
    spin = np.array([isinstance(motion, Spin) for motion in observed.motions])[spectrum.segment]
    rock = np.array([isinstance(motion, Rock) for motion in observed.motions])[spectrum.segment]
    for h in (1, 2, 3):
        rows = spin & (spectrum.harmonic == h)
        yield f"{h} per turn, per segment", [np.eye(len(rows))[:, rows]] * everywhere
        yield f"{h} per turn, alike", [_alike(weighing, rows)] * everywhere
    rows = rock & (spectrum.harmonic > 0)
    yield "rocking waveform", [np.eye(len(rows))[:, rows]] * everywhere


def _coordinates(weighing: Weighing) -> dict[str, Array]:
    observed = weighing.observed
    middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
    return {
        "rate": observed.rate[observed.bounds[:-1]],
        "temperature": observed.temperature[middles],
        "time": observed.time[middles],
    }


def _orientations(observed: Observed) -> Array:
    """Direction cosines of East, North and Up in the sensor's axes, means over each segment, (S, 9)."""
    axes = [observed.in_sensor_axes(axis) for axis in np.eye(3)]
    counts = np.diff(observed.bounds)[:, None]
    return np.hstack([np.add.reduceat(axis, observed.bounds[:-1], axis=0) / counts for axis in axes])


def _levels(names: list[str]) -> Array:
    """One column for each distinct name, (S, levels)."""
    distinct = list(dict.fromkeys(names))
    return np.array([[float(name == other) for other in distinct] for name in names])


def _upward(observed: Observed, segment: int) -> str:
    """Where gravity lies in the sensor's axes and, at rest, where North does."""
    first = int(observed.bounds[segment])
    still = isinstance(observed.motions[segment], Rest)
    north = observed.attitude[segment][:, 1] if still else np.zeros(3)
    return str([*np.round(observed.force[first] / observed.site.gravity, 1) + 0.0, *np.round(north, 1) + 0.0])


def _state(observed: Observed, segment: int) -> str:
    """How the table moves, and about which of the sensor's axes."""
    motion, first = observed.motions[segment], int(observed.bounds[segment])
    axis = np.round(observed.table_axis[first], 1) + 0.0
    if isinstance(motion, Spin):
        return f"{motion.rate:.6g} about {axis}"
    return f"rocking about {axis}" if isinstance(motion, Rock) else "at rest"


def _smooth(values: Array, most: int = SMOOTH_ORDERS, fading: float = 1.0) -> Array:
    """Cosines of a coordinate's position in its range, orders 1 to `most`, each weaker as 1/order^fading; (S, ≤ orders)."""
    span = float(np.ptp(values))
    if span <= 0:
        return np.zeros((len(values), 0))
    orders = np.arange(1, min(most, len(np.unique(np.round(values / span, 6)))) + 1)
    return np.cos(np.pi * orders * (values[:, None] - values.min()) / span) / orders**fading


def _monomials(direction: Array) -> Array:
    """Monomials of degrees 2 to 4 of the direction of gravity."""
    columns = [
        direction[:, 0] ** a * direction[:, 1] ** b * direction[:, 2] ** (d - a - b)
        for d in (2, 3, 4)
        for a in range(d + 1)
        for b in range(d + 1 - a)
    ]
    return np.column_stack(columns)


def _alike(weighing: Weighing, rows: NDArray[np.bool_]) -> Array:
    """Cosine and sine of a harmonic with the same amplitude in all segments, or in proportion to rate and its square."""
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


def _factors(weighing: Weighing) -> Iterator[tuple[str, list[Array]]]:
    """Designs, as `_designs` gives them, of what effects of the catalogue do as well: they say where, and are not what is unknown."""
    observed, spectrum = weighing.observed, weighing.spectrum
    levels = _levels([_upward(observed, s) for s in range(len(observed))])
    table = np.zeros((len(spectrum.segment), levels.shape[1]))
    table[spectrum.means] = levels * np.sqrt(observed.counts)[:, None]
    yield "offset by orientation", [table] * len(observed.channels)
    turning = np.array([isinstance(motion, Spin) for motion in observed.motions])[observed.owner]
    if not turning.any():
        return
    rate = observed.rate / np.abs(observed.rate[turning]).max()
    for order in (1, 2):
        waves = np.column_stack([wave(order * observed.angle) * turning for wave in (np.cos, np.sin)])
        common = [spectrum.project(observed, waves), spectrum.project(observed, waves * rate[:, None])]
        own = [spectrum.project(observed, waves * (rate * observed.table_axis[:, axis])[:, None]) for axis in range(3)]
        yield f"{order} per turn, by rate", [np.hstack([*common, own[channel.axis]]) for channel in observed.channels]


def _eigen(weighing: Weighing, index: int, design: Array, setting: Setting) -> tuple[Array, Array]:
    """Eigenvalues of a design's whitened Gram matrix and the squared scores along its eigenvectors."""
    if not design.shape[1] or not design.any():
        return np.zeros(0), np.zeros(0)
    weight = weighing.weights[index][setting[weighing.observed.channels[index].kind]]
    columns = weight.project(design)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    return np.maximum(values, 0.0), ((columns @ vectors).T @ weight.residual) ** 2


def _one_segment(weighing: Weighing, setting: Setting) -> float:
    """One segment's means of all channels stand off, whichever it is."""
    observed, spectrum = weighing.observed, weighing.spectrum
    design = np.zeros((len(spectrum.segment), len(observed)))
    design[spectrum.means, np.arange(len(observed))] = 1.0
    each = []
    for index in range(len(observed.channels)):
        weight = weighing.weights[index][setting[weighing.observed.channels[index].kind]]
        columns = weight.project(design)
        size = (columns**2).sum(0)
        score = (columns.T @ weight.residual) ** 2
        each.append(averaged(from_eigen(size[:, None], score[:, None], float(size.max()))))
    return float(log_mean_exp(np.concatenate(each), 0))


def _bands(weighing: Weighing) -> list[float]:
    """More noise than white in one band of one channel, segments at rest and turning; the uppermost two define white, unless they are
    those of bins."""
    observed, spectrum = weighing.observed, weighing.spectrum
    chosen = np.array([isinstance(motion, Rest | Spin) for motion in observed.motions])
    found = []
    for index in range(len(observed.channels)):
        each = [-np.inf]
        if observed.channels[index].flicker > 0 or not chosen.any():
            found.append(-np.inf)
            continue
        for band in range(BANDS - 2 if observed.bins is None else BANDS):
            energy, count = float(spectrum.energy[chosen, band, index].sum()), float(spectrum.count[chosen, band].sum())
            if count < 8:
                continue
            excess = np.log(max(energy, 1e-300) / count / weighing.white[index] ** 2)
            sigma = np.hypot(np.sqrt(2 / count), 0.01)
            grid = np.linspace(0.0, np.log(10.0), 400)
            each.append(float(log_mean_exp(-0.5 * ((excess - grid) / sigma) ** 2, 0) + 0.5 * (excess / sigma) ** 2))
        found.append(float(log_mean_exp(np.array(each), 0)))
    return found


def _line(weighing: Weighing, index: int) -> Array:
    """Periodogram, in units of the white noise, of what the basis leaves, segments at rest and turning; empty where the run is too long."""
    observed, spectrum = weighing.observed, weighing.spectrum
    chosen = np.array([isinstance(motion, Rest | Spin) for motion in observed.motions])
    step = (float(observed.bin_size[chosen].max()) if chosen.any() else 1.0) / observed.sample_rate
    slot = np.round((observed.time - observed.time[0]) / step).astype(np.int64)
    chosen = chosen[observed.owner]
    if slot[-1] >= LONGEST_SCAN or slot[-1] < 16 or not chosen.any():
        return np.empty(0)
    from scipy.fft import next_fast_len, rfft

    grid = np.zeros(next_fast_len(int(slot[-1]) + 1, real=True))
    if observed.bins is None:
        grid[slot[chosen]] = spectrum.remainder[chosen, index]
        samples = float(chosen.sum())
    else:
        size = observed.bin_size[observed.owner][chosen]
        grid += np.bincount(slot[chosen], spectrum.remainder[chosen, index] * np.sqrt(size), len(grid))
        samples = float(size.sum())
    return np.asarray(np.abs(rfft(grid)[1:-1]) ** 2 / (weighing.white[index] ** 2 * samples))


def _tone(powers: list[Array]) -> float:
    """log BF of a tone of any frequency that keeps its phase, in all of some channels alike, from their periodograms."""
    power = np.sum(powers, axis=0)
    if not len(power):
        return -np.inf
    s2 = np.geomspace(WEAKEST, STRONGEST, 12) / len(powers)
    each = [float(log_mean_exp(power * s / (1 + s), 0)) - len(powers) * np.log1p(s) for s in s2]
    return float(log_mean_exp(np.array(each), 0))


def _waves(weighing: Weighing) -> Array:
    """Coefficients (M, F, H, 2) of a bias that repeats itself with any period, from twice the run down to two segments: cosines and
    sines of its harmonics, which fade as 1/order."""
    starts, ends = lasting(weighing.observed)
    orders = np.arange(1, WAVEFORM + 1)
    frequencies = np.arange(2, 2 * len(starts)) / (4 * float(ends[-1] - starts[0]))
    pulses = 2 * np.pi * np.outer(frequencies, orders)
    raw = within(weighing, lambda time: np.exp(1j * time[..., None] * pulses.ravel())).reshape(-1, *pulses.shape)
    return np.stack([raw.real, raw.imag], axis=-1) / orders[:, None]


def _periodic(weighing: Weighing, waves: Array, scopes: list[list[int]], setting: Setting) -> list[float]:
    """log BF of such a bias in each scope: a sine, or a waveform."""
    rows, periods = waves.shape[:2]
    parts: list[list[tuple[Array, Array]]] = []
    for index, channel in enumerate(weighing.observed.channels):
        weight = weighing.weights[index][setting[channel.kind]]
        columns = weight.project(waves.reshape(rows, -1)).reshape(waves.shape)
        parts.append([])
        for harmonics in (1, WAVEFORM):
            own = columns[:, :, :harmonics].reshape(rows, periods, -1).transpose(1, 0, 2)
            size, vectors = np.linalg.eigh(np.swapaxes(own, 1, 2) @ own)
            score = np.swapaxes(own, 1, 2) @ weight.residual
            parts[-1].append((np.maximum(size, 0.0), np.einsum("fji,fj->fi", vectors, score) ** 2))
    found = []
    for scope in scopes:
        each = []
        for form in (0, 1):
            size, along = (np.concatenate([parts[index][form][k] for index in scope], axis=1) for k in (0, 1))
            unit = size.sum(1, keepdims=True)
            each.append(averaged(from_eigen(size / unit, along / unit, 1.0)))
        found.append(float(log_mean_exp(np.concatenate(each), 0)))
    return found


def within(weighing: Weighing, function: Callable[[Array], Array]) -> Array:
    """Coefficients (M, P) of slow functions of time since the run began: `function` takes times (S, n) to (S, n, P)."""
    observed, spectrum = weighing.observed, weighing.spectrum
    starts, ends = lasting(observed)
    middles = (np.arange(NODES) + 0.5) / NODES
    slow = np.flatnonzero(spectrum.harmonic == 0)
    order = slow - spectrum.means[spectrum.segment[slow]]
    waves = (
        np.cos(np.pi * np.arange(order.max() + 1)[:, None] * middles)
        * np.where(np.arange(order.max() + 1) == 0, 1.0, np.sqrt(2.0))[:, None]
    )
    values = function(starts[:, None] - starts[0] + (ends - starts)[:, None] * middles)
    parts = np.einsum("kn,snp->skp", waves / NODES, values) * np.sqrt(observed.counts)[:, None, None]
    out = np.zeros((len(spectrum.segment), values.shape[-1]), dtype=values.dtype)
    out[slow] = parts[spectrum.segment[slow], order]
    return out
