"""Evidence: how much better the data are predicted with some amplitudes than without.

Amplitudes θ ~ N(0, s²·D) on whitened signatures that are free of the nominal parameters: with G the signatures' Gram matrix and c
their product
with the data, log BF = −½·log det(I + s²DG) + ½·s²·cᵀD½(I + s²D½GD½)⁻¹D½c. s² is log-uniform: s²·tr(DG), the energy that the
effect is expected to have in units of the noise, runs from `WEAKEST` to `STRONGEST`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WEAKEST, STRONGEST = 2.0, 4e4
ENERGIES = np.geomspace(WEAKEST, STRONGEST, 21)


def log_bayes_factors(gram: Array, score: Array, trace: float | None = None, energies: Array = ENERGIES) -> Array:
    """log BF averaged over s², for stacks: gram (…, p, p), score (…, p), in units of the prior magnitudes (D = I).

    trace: the energy of a unit amplitude that the grid of s² is scaled by; tr(gram) of the first without it.
    """
    return log_mean_exp(by_energy(gram, score, trace, energies), -1)


def by_energy(gram: Array, score: Array, trace: float | None = None, energies: Array = ENERGIES) -> Array:
    """log BF (…, E) at each expected energy."""
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    along = np.einsum("...ji,...j->...i", vectors, score) ** 2
    return from_eigen(values, along, trace, energies)


def from_eigen(values: Array, along: Array, trace: float | None = None, energies: Array = ENERGIES) -> Array:
    """The same from eigenvalues (…, p) of the Gram matrix and squared scores (…, p) along its eigenvectors."""
    if trace is None:
        trace = float(values.reshape(-1, values.shape[-1])[0].sum())
    s2 = energies / max(trace, 1e-300)
    grown = 1 + s2[:, None] * values[..., None, :]
    terms = -0.5 * np.log(grown) + 0.5 * s2[:, None] * along[..., None, :] / grown
    return np.asarray(terms.sum(-1))


def best_amplitudes(gram: Array, score: Array, trace: float, energies: Array = ENERGIES) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of the amplitudes at the most probable s², in units of their magnitudes."""
    s2 = energies[int(np.argmax(by_energy(gram, score, trace, energies)))] / trace
    covariance = np.linalg.inv(gram + np.eye(len(gram)) / s2)
    return covariance @ score, covariance


def pair_log_bayes_factor(gram: Array, score: Array, first: int, traces: tuple[float, float], energies: Array) -> float:
    """log BF of two effects together: columns 0 … first − 1 and the rest, each with its own s² on the grid `energies`."""
    p = len(score)
    one, two = np.meshgrid(energies / traces[0], energies / traces[1], indexing="ij")
    root = np.sqrt(np.where(np.arange(p) < first, one.ravel()[:, None], two.ravel()[:, None]))
    inner = np.eye(p) + root[:, :, None] * gram * root[:, None, :]
    lower = np.linalg.cholesky(inner)
    scaled = np.linalg.solve(lower, (root * score)[:, :, None])[:, :, 0]
    each = -np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1) + 0.5 * (scaled**2).sum(1)
    return float(log_mean_exp(each, 0))


def log_mean_exp(values: Array, axis: int, weights: Array | None = None) -> Array:
    """log of the mean of exp along an axis, with weights (their sum 1) where given."""
    top = np.max(values, axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    grown = np.exp(values - top)
    mean = grown.mean(axis=axis) if weights is None else (grown * weights).sum(axis=axis)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(mean) + np.squeeze(top, axis=axis))
