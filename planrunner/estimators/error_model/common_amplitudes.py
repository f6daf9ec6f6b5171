"""Combines amplitudes that several outputs have in common, such as the tilt of the table, into one value.

The outputs are first fitted separately. The values z of all amplitudes have the joint covariance C. Least squares then adjusts z so
that the values of each common amplitude agree. The adjusted values are z − C·Rᵀ(R·C·Rᵀ)⁻¹·R·z, where R·z = 0 states the agreement
(H. Theil, Principles of Econometrics, 1971, 6.8). The result is equivalent to a joint fit of all outputs. The adjustment also
changes amplitudes that only one output has, if they are correlated with a common amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.error_model.outputs import ModelledOutput, ReportedAmplitude
from planrunner.estimators.outputs_fit import OutputsFit


@dataclass(frozen=True, slots=True, eq=False)
class CommonAmplitudes:
    """Contains the amplitudes of all outputs, and states which amplitudes are common to several outputs.

    `amplitudes`: the q reported amplitudes. The reported amplitudes are computed from the p amplitudes of the separate fits; the p
    amplitudes are listed output after output. `members`: for each reported amplitude, the indices of the fitted amplitudes that it
    combines; a single index if only one output has this amplitude. `outputs`: for each of the p fitted amplitudes, the name of its
    output.
    """

    amplitudes: tuple[ReportedAmplitude, ...]
    members: tuple[tuple[int, ...], ...]
    outputs: tuple[str, ...]

    @property
    def contrasts(self) -> Array:
        """Returns the matrix R, shape (r, p). For each common amplitude, the matrix computes the differences between the other
        members and the first member."""
        rows = []
        for places in self.members:
            for place in places[1:]:
                row = np.zeros(len(self.outputs))
                row[places[0]], row[place] = -1.0, 1.0
                rows.append(row)
        return np.array(rows).reshape(-1, len(self.outputs))

    def joining(self, covariance: Array) -> Array:
        """Returns the matrix that computes the reported amplitudes from the separately fitted amplitudes, shape (q, p).
        `covariance`: array of shape (p, p), covariance C of the separately fitted amplitudes."""
        picked = np.eye(len(self.outputs))[[places[0] for places in self.members]]
        R = self.contrasts
        if not len(R):
            return picked
        size = np.sqrt(np.maximum(np.diag(R @ covariance @ R.T), np.finfo(float).tiny))
        scaled = (R / size[:, None]) @ covariance
        apart = scaled @ (R / size[:, None]).T
        moved = np.eye(len(self.outputs)) - scaled.T @ np.linalg.pinv(apart, hermitian=True) @ (R / size[:, None])
        return np.asarray(picked @ moved)

    def disagreement(self, values: Array, covariance: Array) -> tuple[float, int]:
        """Tests whether the members of the common amplitudes agree. Returns the χ² of their differences, and the degrees of freedom
        of this χ². `values`: array of shape (p,), fitted amplitudes. `covariance`: array of shape (p, p), their covariance,
        including all stated inputs."""
        R = self.contrasts
        if not len(R):
            return 0.0, 0
        away, own = R @ values, R @ covariance @ R.T
        size = np.sqrt(np.maximum(np.diag(own), np.finfo(float).tiny))
        away, own = away / size, own / np.outer(size, size)
        return float(away @ np.linalg.pinv(own, hermitian=True) @ away), len(R)


def common_amplitudes(outputs: Sequence[ModelledOutput]) -> CommonAmplitudes:
    """Groups the amplitudes of all outputs. An amplitude that several outputs have in common becomes one reported amplitude."""
    each = [(one, output.name) for output in outputs for one in output.coefficients]
    places: dict[str | int, list[int]] = {}
    for place, (one, _) in enumerate(each):
        places.setdefault(one.name if one.common else place, []).append(place)
    held = tuple(tuple(own) for own in places.values())
    return CommonAmplitudes(tuple(each[own[0]][0] for own in held), held, tuple(name for _, name in each))


def between_outputs(fits: Sequence[OutputsFit], rows: Sequence[Sequence[int]], correlation: Array, basis: str) -> Array:
    """Returns the covariance between the fitted amplitudes of different outputs, shape (p, p); it is zero within an output. The
    covariance follows from the correlation between the samples of the outputs. Only the means of segments are treated as
    correlated, not the contrasts within segments.

    `rows`: for each fit, the indices of its segments among the segments of the estimate. `correlation`: array of shape (m, m),
    correlation between the samples of the outputs.
    """
    n = 1 + max(max(own) for own in rows)
    roots = []
    for fit, own in zip(fits, rows, strict=True):
        size = float(np.sqrt(fit.variance_factors[0])) if basis == "residual" else 1.0
        noise = fit.spreads[0] if basis == "residual" else fit.noises[0].sigma
        root = np.zeros((fit.coefficients.size, n))
        root[:, list(own)] = (fit.gains[0] * noise * size)[:, : len(own)]
        roots.append(root)
    owner = np.repeat(np.arange(len(fits)), [len(root) for root in roots])
    whole = np.vstack(roots)
    other = np.where(owner[:, None] != owner, correlation[np.ix_(owner, owner)], 0.0)
    return np.asarray(whole @ whole.T * other)
