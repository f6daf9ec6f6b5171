"""Finds bursts: windows of a few seconds with a shifted bias or with larger noise, at random times in a run.

Every window contains a burst with the same small probability. The windows are parts of the remainder: the samples minus the
components that the coefficients represent. Therefore, a part of each burst is missing. A deviation that appears in most windows of
segments of equal length is slow noise, not a burst.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import log_mean_exp
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import Factor, Pattern, Sort
from planrunner.plan.schedule import Rest, Spin

BURSTS = Pattern("bursts", Sort.BURSTS, Factor.TIME)
LENGTHS = (1.0, 2.0, 4.0)  # s
CHANCES = (0.005, 0.02, 0.08)  # probability of a burst in a window
ENERGIES = np.geomspace(4.0, 4000.0, 12)  # of a burst in one channel, in units of the noise
FEWEST = 16  # windows of segments that last alike, and samples of one
KEPT = 0.5  # share of a shifted bias that must remain outside the coefficients
_MEDIAN = 0.4549  # of the square of a normal variable
_DEVIATION = 0.6745  # median absolute deviation of a normal variable


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


def bursts(weighing: Weighing, scopes: Sequence[Sequence[int]]) -> Array:
    """Computes the log Bayes factor of bursts in the channels of each scope, shape (scopes,); −∞ if the recording is too short for
    windows."""
    observed, found = weighing.observed, []
    remainder = np.where(weighing.coarse, 0.0, weighing.spectrum.remainder) / (
        weighing.white * np.sqrt(weighing.noise.level[observed.owner])
    )
    sums = _summed(remainder), _summed(remainder**2)
    within = {id(basis): _summed(basis.vectors) for basis in weighing.spectrum.bases}
    inefficiency = np.maximum(weighing.noise.inefficiency, _of_short_windows(weighing, sums, within))
    for length in LENGTHS:
        size = round(length * observed.sample_rate / float(observed.bin_size.max()))
        for begin in (0, size // 2):
            windows = _windows(weighing, within, size, begin) if size >= FEWEST else None
            if windows is not None:
                found.append(_evidence(sums, windows, size, scopes, inefficiency))
    return log_mean_exp(np.array(found), 0) if found else np.full(len(scopes), -np.inf)


def _of_short_windows(weighing: Weighing, both: tuple[Array, Array], within: Mapping[int, Array]) -> Array:
    """Returns the overdispersion (K,) of the energies of the shortest windows. Noise with many small values and a few large ones
    has a large overdispersion. The short windows are numerous, so they show the overdispersion more precisely than longer windows.
    `both`: the same as in `_evidence`."""
    windows = _windows(weighing, within, FEWEST, 0)
    if windows is None:
        return np.ones(len(weighing.white))
    return _overdispersion(_normalised(both, windows, FEWEST)[1], FEWEST - 1.0)


def _summed(values: Array) -> Array:
    """Returns the cumulative sums of the samples, shape (N + 1, K). The first sum is zero."""
    return np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])


def _windows(weighing: Weighing, within: Mapping[int, Array], size: int, begin: int) -> _Windows | None:
    """Divides every segment at rest or turning into whole windows of `size` samples. The first window starts at the sample `begin`
    of the segment. Returns None if there are too few usable windows. `within`: for each basis, the cumulative sums of its
    vectors."""
    observed, spectrum = weighing.observed, weighing.spectrum
    starts, lasting, kept = [], [], []
    known: dict[int, Array] = {}
    for motion, basis, part in zip(observed.motions, spectrum.bases, observed.segments(), strict=True):
        own = np.arange(begin, part.stop - part.start - size + 1, size)
        if not isinstance(motion, Rest | Spin) or not len(own):
            continue
        if id(basis) not in known:
            sums = within[id(basis)]
            known[id(basis)] = 1 - ((sums[own + size] - sums[own]) ** 2).sum(1) / size
        clear = known[id(basis)] > KEPT
        starts.append(part.start + own[clear])
        kept.append(known[id(basis)][clear])
        lasting.append(np.full(int(clear.sum()), part.stop - part.start))
    if not starts:
        return None
    found = _Windows(np.concatenate(starts), np.concatenate(lasting), np.concatenate(kept))
    _, which, counts = np.unique(found.lasting, return_inverse=True, return_counts=True)
    many = counts[which] >= FEWEST
    return _Windows(found.starts[many], found.lasting[many], found.kept[many]) if many.any() else None


def _evidence(
    both: tuple[Array, Array], windows: _Windows, size: int, scopes: Sequence[Sequence[int]], inefficiency: Array
) -> Array:
    """Returns the log Bayes factor of bursts, from windows of one size, shape (scopes,). `both`: cumulative sums of the samples in
    units of the noise, and cumulative sums of the squares of these samples. `inefficiency`: array of shape (K,), factor by which
    coloured noise reduces the degrees of freedom of a sum of squares."""
    mean, rest = _normalised(both, windows, size)
    offset = _larger(mean, 1.0, np.outer(windows.kept, ENERGIES)[:, None, :])
    noisier = _larger(rest, size - 1.0, ENERGIES / (size - 1))
    noisier /= np.maximum(inefficiency, _overdispersion(rest, size - 1.0))[:, None]
    found = np.empty((len(scopes), 3))
    for row, scope in enumerate(scopes):
        forms = (part[:, scope].sum(1) for part in (offset, noisier, offset + noisier))
        found[row] = [_here_and_there(form) for form in forms]
    return log_mean_exp(found, 1)


def _normalised(both: tuple[Array, Array], windows: _Windows, size: int) -> tuple[Array, Array]:
    """Returns the energies of the mean and of the remaining scatter of each window, each of shape (W, K). The energies are divided
    by the median energy of the windows in segments of equal length, if this median exceeds the median for white noise."""
    sums, squares = both
    first, last = windows.starts, windows.starts + size
    mean = (sums[last] - sums[first]) ** 2 / size
    rest = np.maximum(squares[last] - squares[first] - mean, 0.0)
    mean /= windows.kept[:, None]
    for lasting in np.unique(windows.lasting):
        alike = windows.lasting == lasting
        mean[alike] /= np.maximum(np.median(mean[alike], axis=0) / _MEDIAN, 1.0)
        rest[alike] /= np.maximum(np.median(rest[alike], axis=0) / (size - 1), 1.0)
    return mean, rest


def _overdispersion(energy: Array, degrees: float) -> Array:
    """Returns the overdispersion of the energies (W, K) of windows, shape (K,). The overdispersion is the variance of the energies
    divided by their variance for white noise, which is 2·degrees. The overdispersion exceeds 1 because the level of real noise
    always varies a little. The variance is computed from the median absolute deviation, which bursts in a few windows do not
    increase."""
    spread = np.median(np.abs(energy - np.median(energy, axis=0)), axis=0) / _DEVIATION
    return np.asarray(spread**2 / (2 * degrees))


def _larger(energy: Array, degrees: float, added: Array) -> Array:
    """Returns the log Bayes factor of the variance 1 + a relative to the variance 1, for each value a of `added`, shape (W, K, E).
    `energy`: array of shape (W, K), energies with the given degrees of freedom."""
    return 0.5 * energy[:, :, None] * (added / (1 + added)) - 0.5 * degrees * np.log1p(added)


def _here_and_there(windows: Array) -> float:
    """Returns the log Bayes factor of bursts relative to no bursts. With bursts, every window has the same small probability of
    containing one. `windows`: array of shape (W, E), log Bayes factor of a burst in each window at each energy."""
    each = [np.logaddexp(np.log1p(-chance), np.log(chance) + windows).sum(0) for chance in CHANCES]
    return float(log_mean_exp(np.array(each).ravel(), 0))
