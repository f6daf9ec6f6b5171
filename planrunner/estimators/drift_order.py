"""Checks whether a drift would change the coefficients if the segments are recorded in the planned order. Computes how much the
uncertainties grow if the drift is fitted, and proposes an order that avoids this.

Let A be the weighted design matrix of the terms, and T the weighted columns of the drift. Without the drift, the covariance of the
coefficients is C = (AᵀA)⁻¹. If the drift is fitted, the covariance increases to C + G·T·(Tᵀ·M·T)⁻¹·Tᵀ·Gᵀ, with G = C·Aᵀ and M = 1 −
A·G (Golub and Van Loan, Matrix Computations, 5.3). If all segments are recorded a second time in the opposite order, a linear drift
does not affect the coefficients, because all positions then have the same average time.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.kept import kept
from planrunner.estimators import rank
from planrunner.estimators.interface import DesignBlock, DesignRequest, Remark
from planrunner.observation.drift import BY_EVIDENCE, ORDERS, WITH_TEMPERATURE, asked, in_time, thermometer_of
from planrunner.plan.schedule import Segment

COUPLED = 2.0
"""Growth factor of a standard uncertainty above which planrunner comments on the order of the segments. Above this factor, the
drift increases the uncertainty more than a repetition of all segments would reduce it."""
_REORDERED = 12  # most segments for which another order is proposed
_ROUNDS = 20  # most exchanges of two segments
_INSEPARABLE = 1e-3  # smallest fraction of a drift function that the terms must not reproduce


class FittedWithDrift(Protocol):
    """Declares the plan keys of an estimator that can fit a drift together with its coefficients."""

    @property
    def uncertainty(self) -> str: ...

    @property
    def drift(self) -> tuple[str, ...]: ...

    @property
    def temperature_channel(self) -> str | None: ...


def planned_drift(request: DesignRequest[FittedWithDrift], blocks: Sequence[DesignBlock]) -> tuple[Remark, ...]:
    """Returns remarks about the drift that the plan requests, or about a drift that the segments could show. Raises
    `EstimationError` for options that exclude each other, and if a temperature that the plan requires is not recorded.

    If a linear drift is fitted only when the segments show it, the remark is a note. If the plan requests a drift and the order of
    the segments couples it to a coefficient, the remark is a warning. If the requested drift cannot be separated from the terms at
    all, the remark is an error.
    """
    parameters = request.parameters
    names, by_evidence = asked(parameters.drift), BY_EVIDENCE in parameters.drift
    if not by_evidence and set(names) & set(WITH_TEMPERATURE):
        thermometer_of(
            {output.name: output.unit for output in request.sensor.outputs}, parameters.temperature_channel, False
        )
    orders = 1 if by_evidence else sum(name in ORDERS for name in names)
    designs = [_Design.of(block, request.segments, orders) for block in _distinct(blocks)] if orders and names else []
    judged = [one for one in designs if one is not None]
    if not judged:
        return ()
    course = "a linear drift" if orders == 1 else f"a drift ({' and '.join(ORDERS[:orders])})"
    needed = orders + (parameters.uncertainty == "residual")
    short = next((one for one in judged if len(one.rows) < one.terms + needed), None)
    if short is not None:
        if by_evidence:
            return ()
        message = (
            f"{len(short.rows)} segments cannot determine {short.terms} coefficients, {course} and their uncertainties"
        )
        return (Remark("physics-drift", message, _CLOSING, "drift", error=True),)
    grown = [(one.growth(), one) for one in judged]
    worst, design = max(grown, key=lambda pair: float(pair[0].max()))
    largest = float(worst.max())
    if largest < COUPLED:
        return ()
    term = design.block.terms[int(worst.argmax())]
    if not np.isfinite(largest):
        message = f"in this order, {course} cannot be separated from the coefficients of {design.block.output}"
        return (Remark("physics-drift", message, _proposal(judged), "drift", error=not by_evidence, note=by_evidence),)
    message = (
        f"in this order, {course} would be hard to distinguish from the term '{term}' of {design.block.output}: if the drift were "
        f"fitted together with the coefficients, the standard uncertainty of this term would be {largest:.2g} times as large"
    )
    return (Remark("physics-drift", message, _proposal(judged), "drift", note=by_evidence),)


_CLOSING = "repeat the first segment at the end, or add segments"


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    """The design of one output for the planned segments.

    `matrix`: array of shape (n, p), the design matrix after its columns have been divided by their magnitudes and its rows
    multiplied by their weights. `weights`: array of shape (n,), weight of each row. `start`, `seconds`: arrays of shape (N,), start
    and duration of all segments of the estimate, s. `rows`: array of shape (n,), indices of the segments that this output uses, in
    the order of `block`. `orders`: number of powers of the time in the drift.
    """

    block: DesignBlock
    segments: tuple[Segment, ...]
    matrix: Array
    weights: Array
    start: Array
    seconds: Array
    rows: NDArray[np.int64]
    orders: int

    @classmethod
    def of(cls, block: DesignBlock, planned: Sequence[Segment], orders: int) -> _Design | None:
        """Returns the design for a block, or None if the times of the segments are not planned, or if the terms cannot be separated
        even without a drift. `orders`: number of powers of the time in the drift."""
        if any(segment.dwell is None for segment in planned) or len(block.labels) < 2:
            return None
        place = {segment.label: row for row, segment in enumerate(planned)}
        rows = np.array([place[label] for label in block.labels])
        weights = 1 / np.where(block.sigma > 0, block.sigma, 1.0)
        weights /= weights.max()  # plans that differ only in their dwell have the same design
        matrix = block.matrix / block.magnitudes * weights[:, None]
        start = np.array([segment.start for segment in planned])
        if not np.ptp(start[rows]) or len(rank.look(matrix).null):
            return None
        seconds = np.array([one.dwell or 1.0 for one in planned])
        return cls(block, tuple(planned[row] for row in rows), matrix, weights, start, seconds, rows, orders)

    @property
    def terms(self) -> int:
        return int(self.matrix.shape[1])

    def growth(self) -> Array:
        """Returns the factors by which the standard uncertainties grow in the planned order if the drift is fitted, shape (p,);
        infinite if the drift cannot be separated."""
        return _growth(self.matrix, self._courses(self.start, self.seconds)[self.rows], self.weights)

    def reordered(self, orders: NDArray[np.int64]) -> Array:
        """Returns the factors (k, p) by which the standard uncertainties grow if the segments are recorded in each of k other
        orders and the drift is fitted. `orders`: array of shape (k, n), for each order, the indices of the rows in the sequence in
        which they are recorded. All rows must have the same dwell."""
        # The middle of the test and the mean of a drift function do not change, so each place in the sequence keeps its value.
        places = self._courses(self.start, self.seconds)[self.rows[np.argsort(self.start[self.rows])]]
        return _growth(self.matrix, places[np.argsort(orders, axis=1)], self.weights)

    def closed(self) -> Array:
        """Returns the factors (p,) by which the standard uncertainties grow if the first segment is repeated at the end of the test
        and the drift is fitted."""
        order = np.argsort(self.start)
        ends = (self.start + self.seconds)[order]
        pauses = np.sort(
            self.start[order][1:] - ends[:-1]
        )  # `np.median` imports numpy.ma, which takes as long as five plans
        pause = float(pauses[(len(pauses) - 1) // 2] + pauses[len(pauses) // 2]) / 2
        row = self.rows[self.first]
        start = np.append(self.start, ends.max() + max(pause, 0.0))
        courses = self._courses(start, np.append(self.seconds, self.seconds[row]))
        closed = [*range(len(self.rows)), self.first]
        return _growth(self.matrix[closed], courses[[*self.rows, -1]], self.weights[closed])

    @property
    def first(self) -> int:
        """Returns the index of the row that is recorded first."""
        return int(self.start[self.rows].argmin())

    def _courses(self, start: Array, seconds: Array) -> Array:
        courses = [course.columns for course in in_time(start, start + seconds, seconds, self.orders)]
        return np.hstack(courses) if len(courses) > 1 else courses[0]


def _growth(matrix: Array, courses: Array, weights: Array) -> Array:
    """Returns the factors (…, p) by which the standard uncertainties grow if a drift with the columns `courses` (…, n, r) is
    fitted. The leading dimensions are different orders of the segments. `matrix`: array of shape (n, p), weighted design matrix.
    `weights`: array of shape (n,), factors by which the columns of the drift are multiplied."""
    weighted = courses * weights[:, None]
    scaled = weighted / np.sqrt((weighted**2).sum(axis=-2, keepdims=True) / len(matrix))
    gains, own, beside = _projections(matrix)
    _, values, directions = np.linalg.svd(beside @ scaled, full_matrices=False)  # Tᵀ·M·T = V·S²·Vᵀ
    separable = values[..., -1:] >= _INSEPARABLE * np.sqrt(len(matrix))
    share = gains @ scaled @ directions.swapaxes(-1, -2) / np.where(separable, values, 1.0)[..., None, :]
    return np.asarray(np.where(separable, np.sqrt(1 + (share**2).sum(axis=-1) / own), np.inf))


@kept(64)
def _projections(matrix: Array) -> tuple[Array, Array, Array]:
    """Returns three arrays for a weighted design matrix A: the pseudo-inverse G = A⁺ (p, n), the diagonal of G·Gᵀ (p,), and the
    matrix M = 1 − A·G (n, n)."""
    gains = np.asarray(np.linalg.pinv(matrix), dtype=np.float64)
    return gains, np.einsum("ij,ij->i", gains, gains), np.eye(len(matrix)) - matrix @ gains


def _distinct(blocks: Sequence[DesignBlock]) -> list[DesignBlock]:
    """Returns the blocks without those whose design equals the design of an earlier block. The outputs of a triad often have the
    same design."""
    found: dict[tuple[object, ...], DesignBlock] = {}
    for block in blocks:
        found.setdefault((block.labels, block.matrix.tobytes(), block.sigma.tobytes()), block)
    return list(found.values())


def _proposal(designs: Sequence[_Design]) -> str:
    """Proposes how to decouple the drift from the coefficients: repeat the first segment at the end, choose another order, or
    record all segments a second time in the opposite order."""
    first = designs[0].block.labels[designs[0].first]
    closed = max(float(one.closed().max()) for one in designs)
    if closed < COUPLED:
        return f"repeat '{first}' at the end (the standard uncertainty is then {closed:.2g} times as large)"
    exchanged = _reordered(designs)
    if exchanged is not None and exchanged[1] < COUPLED:
        labels = ", ".join(designs[0].block.labels[row] for row in exchanged[0])
        return f"use the order {labels} (the standard uncertainty is then {exchanged[1]:.2g} times as large)"
    return "record the segments a second time in the opposite order, so that a linear drift is decoupled from the coefficients"


def _reordered(designs: Sequence[_Design]) -> tuple[NDArray[np.int64], float] | None:
    """Returns a better order of the segments as an array of indices, and the largest growth factor in this order; None if the
    segments cannot be exchanged freely. In each step, the search exchanges the two segments whose exchange reduces the largest
    growth factor most."""
    one = designs[0]
    same = all(other.block.labels == one.block.labels for other in designs)
    alike = np.ptp(one.seconds[one.rows]) < 1e-6 and len({segment.temperature for segment in one.segments}) == 1
    if not (same and alike and len(one.segments) <= _REORDERED):
        return None
    order = np.argsort(one.start[one.rows])
    pairs = np.array(list(itertools.combinations(range(len(order)), 2)))
    best = float(_largest(designs, order[None])[0])
    for _ in range(_ROUNDS):
        exchanged = np.tile(order, (len(pairs), 1))
        np.put_along_axis(exchanged, pairs, order[pairs[:, ::-1]], axis=1)
        largest = _largest(designs, exchanged)
        if largest.min() >= best:
            break
        best, order = float(largest.min()), exchanged[int(largest.argmin())]
        if best < np.sqrt(COUPLED):
            break
    return order, best


def _largest(designs: Sequence[_Design], orders: NDArray[np.int64]) -> Array:
    """Returns, for each of k orders of the segments, the largest factor by which a standard uncertainty of any design grows if the
    drift is fitted, shape (k,). `orders`: as in `_Design.reordered`."""
    return np.asarray(np.max([design.reordered(orders).max(axis=1) for design in designs], axis=0))
