"""Describes a bias that repeats with an unknown period: as a sine, a smooth waveform, or a waveform with edges such as a saw-tooth.

The periods range from twice the duration of the run to half a segment; at most `MOST` periods are tried. A waveform is a sum of
harmonics whose amplitudes decrease as 1/order. A waveform with edges has many harmonics, which remain coherent over the run only if
the period is accurate. Such a waveform is therefore evaluated on a finer grid of periods. This grid covers only periods near those
that are likely for a sine or a smooth waveform.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import averaged, from_eigen, log_mean_exp
from planrunner.gap.evidence.covariance import lasting
from planrunner.gap.evidence.weighing import Eigen, Left
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import Factor, Pattern, Sort

PERIODIC = Pattern("offset periodic in time", Sort.SEVERAL, Factor.TIME)
WAVEFORM = 4  # harmonics of a smooth one
EDGED = 16  # harmonics of a waveform with edges
MOST = 400  # periods that are tried at most
CYCLES = 2  # of a segment, at the shortest period
FINER = 8  # by which the grid about a likely period is finer
PEAKS = 3  # likely periods of a scope
NOTABLE = 4.0  # nats of the best period at and above which edges are searched for
NODES = 24  # of a segment, at which waves are taken


class Repeating:
    """Contains designs of the coefficients for biases that repeat with an unknown period."""

    def __init__(self, weighing: Weighing):
        observed, spectrum = weighing.observed, weighing.spectrum
        self.starts, self.ends = lasting(observed)
        self.rows = np.flatnonzero(spectrum.harmonic == 0)
        self._segment = spectrum.segment[self.rows]
        self._order = self.rows - spectrum.means[self._segment]
        self._root = np.sqrt(observed.counts)
        self._run = float(self.ends[-1] - self.starts[0])
        self.frequencies = np.arange(2, min(4 * CYCLES * len(self.starts), MOST + 2)) / (4 * self._run)
        self._coarse = self.waves(self.frequencies, WAVEFORM)

    def weighed(self, scopes: Sequence[Sequence[int]], channels: Sequence[Left]) -> list[float]:
        """Returns the log Bayes factor of a bias with an unknown period in the channels of each scope."""
        parts = [self._eigen(left, self._coarse, (2, 2 * WAVEFORM)) for left in channels]
        found = []
        for scope in scopes:
            sine, smooth = (_evidence([parts[index][form] for index in scope]) for form in (0, 1))
            edged = float(log_mean_exp(smooth, 0))
            likely = np.maximum(sine, smooth)
            if likely.max() > NOTABLE:
                edged = self._edged(np.argsort(-likely)[:PEAKS], [channels[index] for index in scope])
            found.append(float(log_mean_exp(np.array([*(log_mean_exp(each, 0) for each in (sine, smooth)), edged]), 0)))
        return found

    def _edged(self, peaks: NDArray[np.int64], channels: Sequence[Left]) -> float:
        """Returns the log Bayes factor of a waveform with edges. The waveform is evaluated only at periods near the `peaks`. In the
        mean over the finer grid, all other periods count with a Bayes factor of zero."""
        steps = (np.arange(FINER) - (FINER - 1) / 2) / FINER
        near = (self.frequencies[peaks, None] + steps / (4 * self._run)).ravel()
        waves = self.waves(near, EDGED)
        each = _evidence([self._eigen(left, waves, (2 * EDGED,))[0] for left in channels])
        return float(log_mean_exp(each, 0) + np.log(len(near) / (FINER * len(self.frequencies))))

    def waves(self, frequencies: Array, harmonics: int) -> Array:
        """Returns the cosines and sines of the H harmonics of each of F frequencies, as coefficients in the n `rows`, shape (n, F,
        H, 2)."""
        orders = np.arange(1, harmonics + 1)
        pulses = 2 * np.pi * np.outer(frequencies, orders)
        within = _within(np.round(self.ends - self.starts, 9), pulses.ravel(), int(self._order.max()) + 1)
        beginning = np.exp(1j * np.outer(self.starts - self.starts[0], pulses.ravel())) * self._root[:, None]
        raw = beginning[self._segment]
        raw *= within[self._segment, self._order]
        raw /= np.broadcast_to(orders, pulses.shape).ravel()
        return raw.view(float).reshape(len(self.rows), *pulses.shape, 2)

    def _eigen(self, left: Left, waves: Array, counts: Sequence[int]) -> list[Eigen]:
        """Returns one item for each number n in `counts`: the eigenvalues (F, n) and the squared scores (F, n) of the first n
        columns at each of F frequencies."""
        periods = waves.shape[1]
        at, whitened = left.whitened(waves.reshape(len(self.rows), -1), self.rows)
        size = whitened.shape[1] // periods
        taken = (left.basis[at].T @ whitened).reshape(-1, periods, size).transpose(1, 0, 2)
        score = (whitened.T @ left.residual[at]).reshape(periods, size)
        own = np.ascontiguousarray(whitened.reshape(-1, periods, size).transpose(1, 0, 2))
        gram = np.swapaxes(own, 1, 2) @ own - np.swapaxes(taken, 1, 2) @ taken
        found = []
        for count in counts:
            values, vectors = np.linalg.eigh(gram[:, :count, :count])
            along = np.einsum("fji,fj->fi", vectors, score[:, :count]) ** 2
            found.append((np.maximum(values, 0.0), along))
        return found


def _evidence(parts: Sequence[Eigen]) -> Array:
    """Returns the log Bayes factor of each frequency in several channels together, with one prior for the total energy, shape (F,)."""
    size, along = (np.concatenate([part[k] for part in parts], axis=1) for k in (0, 1))
    unit = np.maximum(size.sum(1, keepdims=True), 1e-300)
    return averaged(from_eigen(size / unit, along / unit, 1.0))


def _within(lasting_: Array, pulses: Array, orders: int) -> Array:
    """Returns the coefficients of the cosine transform of exp(iωt), shape (S, orders, P). The time t starts at zero in every
    segment. `lasting_`: array of shape (S,), durations of the segments; segments of equal duration are computed once."""
    middles = (np.arange(NODES) + 0.5) / NODES
    cosines = (
        np.cos(np.pi * np.arange(orders)[:, None] * middles)
        * np.where(np.arange(orders) == 0, 1.0, np.sqrt(2.0))[:, None]
    )
    spans, which = np.unique(lasting_, return_inverse=True)
    waves_ = np.exp(1j * (spans[:, None, None] * middles[:, None] * pulses))
    return np.asarray((cosines / NODES @ waves_)[which])
