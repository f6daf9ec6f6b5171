"""Evaluates the patterns outside the basis of the coefficients: tones and bursts. They appear in the remainder, that is, in the
samples minus the components that the coefficients represent.

A tone keeps its frequency and its phase over the whole run. Tones are found in the periodogram of the remainder.

A burst is a window of a few seconds with a shifted bias or with larger noise, at a random time in a run. Every window contains a
burst with the same small probability. The windows are parts of the remainder, so the part of a burst that the coefficients absorb
is missing. A deviation that appears in most windows of segments of equal length is slow noise, not a burst. Bursts of independent
channels and sizes are rare events of the noise (`hypotheses.short_offsets`). Their evidence is stated separately.

In array shapes, N is the number of all samples, K is the number of channels, F is the number of frequencies, W is the number of
windows, E is the number of energies of a burst, and Q is the number of rates of events.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import STRONGEST, WEAKEST, log_mean_exp
from planrunner.gap.evidence.noise_levels import HOLDS
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import Factor, Pattern, Sort
from planrunner.gap.hypotheses.short_offsets import CHANCES, KEPT, LARGEST, LENGTHS, RATES
from planrunner.plan.schedule import Rest, Spin

TONE = Pattern("a tone", Sort.TONE, Factor.BAND)
PLAIN = 8.0
"""If the log Bayes factor of a tone is above this value, the tone is reported. If the log Bayes factor of one sort of patterns is
at least this value, the coefficients of this sort are removed before the other sorts are evaluated."""
LONGEST_SCAN = 1 << 22  # largest number of points of the time grid of a scan
BLOCK = 1024  # number of frequencies in a block of a periodogram
MATERIAL = float(np.expm1(2 * HOLDS))
"""If the power of a tone, divided by the variance of the noise, is at least this value, the tone is not a part of correctly
declared noise."""
_TUNINGS = 4  # number of corrections of the frequency of a fitted tone
_NEAR = 8  # number of spacings on each side of a frequency that are searched at finer steps
_BLOCKS = 1024  # number of blocks of time over which shifted samples are summed


@dataclass(frozen=True, slots=True)
class Line:
    """Describes a tone that keeps its phase over the whole run.

    `frequency`: frequency of the tone, Hz. `amplitude`: in the unit of the channel. `evidence`: log Bayes factor of the tone.
    """

    channel: str
    frequency: float
    amplitude: float
    evidence: float


@dataclass(frozen=True)
class Outside:
    """Contains the evidence for the patterns outside the basis of the coefficients.

    `log_bayes`: log Bayes factor of each pattern in each scope. `lines`: the strongest tone of each channel that shows a tone.
    `causes`: the tones in `lines` that count as separate causes. `events`: array of shape (Q,), log Bayes factor of events of the
    noise at each rate (`short_offsets.RATES`).
    """

    log_bayes: dict[Pattern, Array]
    lines: tuple[Line, ...]
    causes: tuple[Line, ...]
    events: Array


def outside(weighing: Weighing) -> Outside:
    """Evaluates the patterns outside the basis of the coefficients.

    Real noise often contains lines (supply, dither, resonances). A line counts as a separate cause only if it is a single tone with
    a power of at least `MATERIAL`. Other lines belong to the noise and are only reported.
    """
    scopes, scans = scopes_of(weighing), _scans(weighing)
    periodograms = [_Periodogram.of(scan, scan.samples) for scan in scans]
    tones = np.array([_tone([periodograms[index].power for index in scope]) for scope in scopes])
    lines, causes = [], dict[int, Line]()
    for index, (scan, periodogram, evidence) in enumerate(zip(scans, periodograms, tones, strict=False)):
        if evidence > PLAIN:
            channel = weighing.observed.channels[index]
            rest, frequency = _without_tone(weighing, scan, periodogram.frequency, periodogram.spacing)
            lines.append(Line(channel.name, frequency, periodogram.amplitude / channel.factor, float(evidence)))
            material = scan.energy(scan.samples) >= (1 + MATERIAL) * scan.energy(rest)
            if material and _tone([_Periodogram.of(scan, rest).power]) <= PLAIN:
                causes[index] = lines[-1]
    tones = np.where([bool(causes.keys() & set(scope)) for scope in scopes], tones, np.minimum(tones, 0.0))
    several, events = bursts(weighing, scopes)
    return Outside({TONE: tones, BURSTS: several}, tuple(lines), tuple(causes.values()), events)


def scopes_of(weighing: Weighing) -> list[list[int]]:
    """Returns the scopes of patterns, as lists of channel indices: every single channel, then the triads."""
    triads = [members for kind in ("gyro", "accel") if len(members := weighing.observed.of_kind(kind)) > 1]
    return [[index] for index in range(len(weighing.observed.channels))] + triads


@dataclass(frozen=True)
class _Scan:
    """Contains the remainder of a channel (samples minus their components in the basis) in segments at rest and turning, prepared
    for a periodogram.

    `chosen`: array of shape (n,), indices of the samples that are used. `weight`: array of shape (n,), number of raw samples that
    each of these samples combines. `samples`: array of shape (n,), the samples in SI units, each divided by the level of the noise
    of its segment. `slot`: array of shape (n,), position of each sample on a time grid of `length` steps of `step` seconds.
    `white`: standard deviation of the white noise of a sample, SI. `level`: array of shape (n,), level of the noise, as a standard
    deviation relative to `white`. `coloured`: True if the spectrum of the noise is not white. If the run is too long or too short,
    or if the counts (digital steps) of the channel are coarse, the scan has no samples.
    """

    chosen: NDArray[np.int64]
    weight: Array
    samples: Array
    slot: NDArray[np.int64]
    length: int
    step: float
    level: Array
    white: float
    coloured: bool

    def energy(self, samples: Array) -> float:
        """Returns the energy of samples (n,), SI². This is the sum of their squares, each multiplied by the number of raw samples
        that the sample combines. `samples`: samples divided by the level of the noise, as in the attribute `samples`."""
        return float(self.weight @ samples**2)


@dataclass(frozen=True)
class _Periodogram:
    """Contains the periodogram of a scan.

    `power`: array of shape (F,), power at each frequency in units of the noise power. The frequencies are the first F multiples of
    `spacing`, Hz. `frequency`: the frequency with the highest power, Hz. `amplitude`: amplitude of a sine with this power, SI.
    `spacing`, `frequency` and `amplitude` are NaN if the scan has no samples.
    """

    power: Array
    spacing: float
    frequency: float
    amplitude: float

    @classmethod
    def of(cls, scan: _Scan, samples: Array) -> _Periodogram:
        """Computes the periodogram of samples. `samples`: array of shape (n,), values at the same times as the samples of
        `scan`."""
        from scipy.fft import next_fast_len, rfft

        if not len(samples):
            return cls(np.empty(0), np.nan, np.nan, np.nan)
        length = next_fast_len(scan.length, real=True)
        grid = np.bincount(scan.slot, samples * scan.weight, length)
        total = float(scan.weight.sum())
        seen = np.abs(rfft(grid)[1 : length // 2])
        power = seen**2 / (scan.white**2 * total)
        if scan.coloured:
            power /= _local_level(power)
        top, lasting = int(np.argmax(power)), length * scan.step
        amplitude = 2 * float(seen[top]) / total * float(np.sqrt(np.mean(scan.level**2)))
        return cls(power, 1 / lasting, (top + 1) / lasting, amplitude)


def _scans(weighing: Weighing) -> list[_Scan]:
    """Returns the scan of each channel. The scans share the arrays that do not depend on the channel."""
    observed, noise = weighing.observed, weighing.noise
    moved = np.array([isinstance(motion, Rest | Spin) for motion in observed.motions])
    step = (float(observed.bin_size[moved].max()) if moved.any() else 1.0) / observed.sample_rate
    slot = np.round((observed.time - observed.time[0]) / step).astype(np.int64)
    length = int(slot[-1]) + 1
    chosen = np.flatnonzero(moved[observed.owner])
    if length > LONGEST_SCAN or length <= 16:
        chosen = chosen[:0]
    slot, owner = slot[chosen], observed.owner[chosen]
    weight = np.ones(len(chosen)) if observed.bins is None else observed.bin_size[owner].astype(float)
    found = []
    for index in range(len(observed.channels)):
        used = slice(0 if weighing.coarse[index] else len(chosen))
        level = np.sqrt(noise.level[owner[used], index])
        found.append(
            _Scan(
                chosen[used],
                weight[used],
                weighing.spectrum.remainder[chosen[used], index] / (level * np.sqrt(weight[used])),
                slot[used],
                length,
                step,
                level,
                float(weighing.white[index]),
                bool(noise.coloured[:, index].any()),
            )
        )
    return found


def _without_tone(weighing: Weighing, scan: _Scan, frequency: float, spacing: float) -> tuple[Array, float]:
    """Fits a sine to the samples of a scan, with Gauss–Newton steps in the frequency, and subtracts the part of the sine that lies
    outside the basis of the coefficients. Returns the remaining samples (n,) and the fitted frequency, Hz. `frequency`: approximate
    frequency of the sine, Hz. `spacing`: distance between the frequencies of the periodogram, Hz. The search starts at the
    frequency with the highest power among closely spaced frequencies around `frequency`. The closely spaced frequencies are
    necessary because gaps between segments make neighbouring values of the periodogram almost as high as the highest one."""
    observed, spectrum = weighing.observed, weighing.spectrum
    time = observed.time - observed.time.mean()
    root = np.sqrt(scan.weight)
    found = scan.samples
    frequency += _highest(time[scan.chosen], scan.samples * scan.weight, frequency, spacing)
    for _ in range(_TUNINGS):
        phase = 2 * np.pi * frequency * time
        waves = np.column_stack([np.cos(phase), np.sin(phase)])
        waves = spectrum.outside(observed, np.column_stack([waves, waves * time[:, None] / time[-1]]))
        columns = waves[scan.chosen] / scan.level[:, None] * root[:, None]
        fitted = np.linalg.lstsq(columns, scan.samples * root, rcond=None)[0]
        found = scan.samples - columns @ fitted / root
        cosine, sine, cosine_drift, sine_drift = fitted
        turned = (sine * cosine_drift - cosine * sine_drift) / (cosine**2 + sine**2)
        frequency += float(turned / time[-1] / (2 * np.pi))
    return np.asarray(found), frequency


def _highest(time: Array, samples: Array, frequency: float, spacing: float) -> float:
    """Searches closely spaced frequencies around `frequency` for the highest power. Returns the distance of the best frequency from
    `frequency`, Hz. The samples (n,) are first shifted to frequency zero. The shifted samples change little within a block of time,
    so sums over blocks are sufficient. `time`: array of shape (n,), times of the samples, s. `spacing`: distance between the
    frequencies of the periodogram, Hz."""
    place = ((time - time[0]) * (_BLOCKS / (time[-1] - time[0]) * (1 - 1e-9))).astype(np.int64)
    shifted = samples * np.exp(-2j * np.pi * frequency * time)
    sums = np.bincount(place, shifted.real, _BLOCKS) + 1j * np.bincount(place, shifted.imag, _BLOCKS)
    middles = time[0] + (np.arange(_BLOCKS) + 0.5) / _BLOCKS * (time[-1] - time[0])
    about = spacing * np.linspace(-_NEAR, _NEAR, 20 * _NEAR + 1)
    return float(about[int(np.argmax(np.abs(np.exp(-2j * np.pi * np.outer(about, middles)) @ sums)))])


def _local_level(power: Array) -> Array:
    """Returns the level of coloured noise at each frequency of a periodogram, shape (F,). `power`: array of shape (F,), power at
    each frequency. The level is interpolated linearly, in logarithms, between medians over blocks. A line does not raise the median
    of its block."""
    blocks = np.array_split(power, max(len(power) // BLOCK, 1))
    middles = np.cumsum([len(block) for block in blocks]) - [len(block) / 2 for block in blocks]
    levels = [np.log(np.median(block) / np.log(2.0) + 1e-300) for block in blocks]
    return np.asarray(np.exp(np.interp(np.arange(len(power)), middles, levels)))


def _tone(powers: list[Array]) -> float:
    """Returns the log Bayes factor of a tone of unknown frequency that keeps its phase and appears in several channels. `powers`:
    for each channel, the powers of its periodogram."""
    powers = [power for power in powers if len(power)]
    if not powers:
        return -np.inf
    power = np.sum(powers, axis=0)
    s2 = np.geomspace(WEAKEST, STRONGEST, 12) / len(powers)
    each = [float(log_mean_exp(power * s / (1 + s), 0)) - len(powers) * np.log1p(s) for s in s2]
    return float(log_mean_exp(np.array(each), 0))


BURSTS = Pattern("bursts", Sort.BURSTS, Factor.TIME)
ENERGIES = np.geomspace(4.0, 4000.0, 12)  # energies of a burst in one channel, in units of the noise
FEWEST = 16  # smallest number of windows in segments of equal length, and of samples in a window
_MEDIAN = 0.4549  # median of the square of a normal variable
_DEVIATION = 0.6745  # median absolute value of a normal variable


@dataclass(frozen=True)
class _Windows:
    """A set of windows with the same number of samples.

    `starts`: array of shape (W,), first sample of each window. `lasting`: array of shape (W,), number of samples of the segment to
    which each window belongs. `kept`: array of shape (W,), fraction of the energy of a constant bias in the window that the
    coefficients do not absorb.
    """

    starts: NDArray[np.int64]
    lasting: NDArray[np.int64]
    kept: Array

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Returns a mask of the windows in which a constant bias would be visible. In the other windows, only the scatter is
        examined."""
        return self.kept > KEPT


def bursts(weighing: Weighing, scopes: Sequence[Sequence[int]]) -> tuple[Array, Array]:
    """Computes the log Bayes factor of bursts in the channels of each scope, shape (scopes,), and of events of the noise at each rate,
    shape (Q,). If the recording is too short for windows, the first is −∞ and the second is zero."""
    observed = weighing.observed
    several, events = [], []
    sums = _Sums.of(weighing)
    within = {id(basis): _summed(basis.vectors) for basis in weighing.spectrum.bases}
    overdispersion = np.maximum(weighing.noise.inefficiency, _of_short_windows(weighing, sums, within))
    for length in LENGTHS:
        size = round(length * observed.sample_rate / float(observed.bin_size.max()))
        for begin in (0, size // 2):
            windows = _windows(weighing, within, size, begin) if size >= FEWEST else None
            if windows is not None:
                forms = _forms(sums, windows, size, scopes, overdispersion)
                several.append(log_mean_exp(np.array([list(map(_here_and_there, own)) for own in forms]), 1))
                events.append(_now_and_then(forms, length))
    if not several:
        return np.full(len(scopes), -np.inf), np.zeros(len(RATES))
    return log_mean_exp(np.array(several), 0), log_mean_exp(np.array(events), 0)


@dataclass(frozen=True)
class _Sums:
    """Contains cumulative sums over the samples of a run, in units of the noise, each of shape (N + 1, K). `samples`: sums of the
    samples. `white`, `squares`: sums of the whitened samples (`NoiseWithin.whitened`), and of their squares. Otherwise, the energies
    of smoothed noise would scatter like those of bursts.
    """

    samples: Array
    white: Array
    squares: Array

    @classmethod
    def of(cls, weighing: Weighing) -> _Sums:
        observed, noise = weighing.observed, weighing.noise
        remainder = np.where(weighing.coarse, 0.0, weighing.spectrum.remainder)
        remainder /= (weighing.white * np.sqrt(noise.level))[observed.owner]
        samples = white = _summed(remainder)
        if noise.coloured.any():
            for index, part in enumerate(observed.segments()):
                half = observed.sample_rate / int(observed.bin_size[index]) / 2
                remainder[part] = noise.whitened(index, remainder[part], half)
            white = _summed(remainder)
        return cls(samples, white, _summed(np.square(remainder, out=remainder)))


def _of_short_windows(weighing: Weighing, sums: _Sums, within: Mapping[int, Array]) -> Array:
    """Returns the overdispersion (K,) of the energies of the shortest windows. Noise with many small values and a few large ones
    has a large overdispersion. The short windows are numerous, so they show the overdispersion more precisely than longer windows.
    `within`: the same as in `_windows`."""
    windows = _windows(weighing, within, FEWEST, 0)
    if windows is None:
        return np.ones(len(weighing.white))
    return _overdispersion(_normalised(sums, windows, FEWEST)[1], FEWEST - 1.0)


def _summed(values: Array) -> Array:
    """Returns the cumulative sums of samples (N, K), shape (N + 1, K). The first sum is zero."""
    out = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=out[1:])
    return out


def _windows(weighing: Weighing, within: Mapping[int, Array], size: int, begin: int) -> _Windows | None:
    """Divides every segment in which the table rests or turns at a constant rate into windows of `size` samples; samples that do
    not fill a window are not used. The first window starts at the sample `begin` of the segment. Returns None if there are too few
    usable windows. `within`: for each basis, the cumulative sums of its vectors."""
    observed, spectrum = weighing.observed, weighing.spectrum
    starts, lasting, kept = [], [], []
    known: dict[int, Array] = {}
    parts = zip(observed.motions, spectrum.bases, observed.segments(), strict=True)
    for motion, basis, part in parts:
        own = np.arange(begin, part.stop - part.start - size + 1, size)
        if not isinstance(motion, Rest | Spin) or not len(own):
            continue
        if id(basis) not in known:
            sums = within[id(basis)]
            known[id(basis)] = 1 - ((sums[own + size] - sums[own]) ** 2).sum(1) / size
        starts.append(part.start + own)
        lasting.append(np.full(len(own), part.stop - part.start))
        kept.append(known[id(basis)])
    if not starts:
        return None
    every = [np.concatenate(each) for each in (starts, lasting, kept)]
    _, which, counts = np.unique(every[1], return_inverse=True, return_counts=True)
    many = counts[which] >= FEWEST
    return _Windows(*(each[many] for each in every)) if many.any() else None


def _forms(
    sums: _Sums, windows: _Windows, size: int, scopes: Sequence[Sequence[int]], overdispersion: Array
) -> list[list[Array]]:
    """Returns, for each scope and each form of a burst (a shifted bias, larger noise, or both), the log Bayes factor of a burst in each
    window at each energy, shape (W, E). All windows have the same size. `overdispersion`: array of shape (K,), lower limit of the
    overdispersion (`_overdispersion`) of the scatter."""
    mean, rest = _normalised(sums, windows, size)
    offset = _larger(mean, 1.0, np.outer(windows.kept, ENERGIES)[:, None, :])
    offset[~windows.clear] = 0.0
    noisier = _larger(rest, size - 1.0, ENERGIES / (size - 1))
    noisier /= np.maximum(overdispersion, _overdispersion(rest, size - 1.0))[:, None]
    return [[part[:, scope].sum(1) for part in (offset, noisier, offset + noisier)] for scope in scopes]


def _normalised(sums: _Sums, windows: _Windows, size: int) -> tuple[Array, Array]:
    """Returns the energies of the mean and of the remaining scatter of each window, each of shape (W, K). The energies are divided
    by the median energy of the windows in segments of equal length, if this median exceeds the median for white noise. In windows
    in which a constant bias would not be visible (`_Windows.clear`), the energy of the mean is not used. `size`: number of samples
    of a window."""
    first, last = windows.starts, windows.starts + size
    mean = (sums.samples[last] - sums.samples[first]) ** 2 / size
    white = (sums.white[last] - sums.white[first]) ** 2 / size
    rest = np.maximum(sums.squares[last] - sums.squares[first] - white, 0.0)
    mean /= np.where(windows.clear, windows.kept, 1.0)[:, None]
    for lasting in np.unique(windows.lasting):
        alike = windows.lasting == lasting
        if (clear := alike & windows.clear).any():
            mean[clear] /= np.maximum(np.median(mean[clear], axis=0) / _MEDIAN, 1.0)
        rest[alike] /= np.maximum(np.median(rest[alike], axis=0) / (size - 1), 1.0)
    return mean, rest


def _overdispersion(energy: Array, degrees: float) -> Array:
    """Returns the overdispersion of the energies of windows, shape (K,). `energy`: array of shape (W, K), energy of each window in
    each channel. The overdispersion is the variance of the energies divided by their variance for white noise, which is 2·degrees.
    The overdispersion exceeds 1 because the level of real noise always varies a little. The variance is computed from the median
    absolute deviation, which bursts in a few windows do not increase. `degrees`: degrees of freedom of each energy."""
    spread = np.median(np.abs(energy - np.median(energy, axis=0)), axis=0) / _DEVIATION
    return np.asarray(spread**2 / (2 * degrees))


def _larger(energy: Array, degrees: float, added: Array) -> Array:
    """Returns the log Bayes factor of the variance 1 + a relative to the variance 1, for each value a of `added`, shape (W, K, E).
    `energy`: array of shape (W, K), energies with the given degrees of freedom."""
    return 0.5 * energy[:, :, None] * (added / (1 + added)) - 0.5 * degrees * np.log1p(added)


def _here_and_there(windows: Array) -> float:
    """Returns the log Bayes factor of bursts with a common energy: every window contains a burst with the same small probability.
    `windows`: array of shape (W, E), log Bayes factor of a burst in each window at each energy."""
    each = []
    for chance in CHANCES:
        gains = np.logaddexp(0.0, np.log(chance / (1 - chance)) + windows)
        each.append(len(windows) * np.log1p(-chance) + gains.sum(0))
    return float(log_mean_exp(np.concatenate(each), 0))


def _now_and_then(forms: Sequence[Sequence[Array]], length: float) -> Array:
    """Returns the log Bayes factor of events of the noise at each rate, shape (Q,). Each event has its own channels, form and energy,
    and at most the evidence `LARGEST`. `forms`: the result of `_forms`. `length`: length of the windows, s."""
    each = np.array([log_mean_exp(np.minimum(part, LARGEST), 1) for own in forms for part in own])
    chance = -np.expm1(-RATES * length)[:, None]
    return np.asarray(np.logaddexp(np.log1p(-chance), np.log(chance) + log_mean_exp(each, 0)).sum(1))
