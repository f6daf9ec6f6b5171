"""Computes rocking drifts with uncertainties from the drifts of runs, and compares the two methods in random pairs of runs.

The rocking drift of a quadruple is the mean of its dynamic runs minus the mean of its static runs (step 6). The quadruples of one
state are repeats of each other. For an axis that is level in several states, the result is the mean over these states.

The module also warns about implausible drifts of single runs. Such drifts reveal, for example, a reversed channel, which the
differences between runs hardly show.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.rocking.runs import Quadruple
from planrunner.observation.observations import SIGNIFICANCE
from planrunner.uncertainty.budget import effective_degrees_of_freedom

AXES = "xyz"
WEIGHTS = np.array([-0.5, 0.5, 0.5, -0.5])


@dataclass(frozen=True, slots=True)
class StateDrifts:
    """Contains the drifts of all quadruples of one state.

    `level`: the two level axes. `quadruples`: the q quadruples of the state. `drifts`: array of shape (q, 4, k) in deg/h, the
    drifts of the four runs of each quadruple. The first two of the k columns are the drifts about the two level axes according to
    the accelerometers. If there are encoders, the next two columns are these drifts according to the gimbals. `expected`: only for
    a prediction, the covariance (k, k) of the rocking drift of one quadruple.
    """

    name: str
    level: tuple[int, int]
    quadruples: tuple[Quadruple, ...]
    drifts: Array
    expected: Array | None = None

    @property
    def rocking(self) -> Array:
        """Returns the rocking drift of each quadruple [deg/h], shape (q, k)."""
        return np.asarray(np.einsum("r,qrk->qk", WEIGHTS, self.drifts))

    @property
    def runs(self) -> tuple[Array, Array]:
        """Returns the drifts of the static runs and the drifts of the dynamic runs [deg/h] as two arrays of shape (2q, k)."""
        static, dynamic = self.drifts[:, [0, 3]], self.drifts[:, [1, 2]]
        return static.reshape(-1, static.shape[2]), dynamic.reshape(-1, dynamic.shape[2])

    def scatter(self) -> tuple[Array, float]:
        """Returns the covariance of the mean rocking drift, shape (k, k), and the degrees of freedom of this covariance.

        With several quadruples, the covariance comes from their scatter. With a single quadruple, it comes from the difference
        between the two dynamic runs and the difference between the two static runs. In this case, one degree of freedom is used.
        Welch's formula would give between one and two degrees of freedom, but it requires the true variances of both pairs, which
        are not known.
        """
        count = len(self.quadruples)
        if self.expected is not None:
            return self.expected / count, max(1.0, count - 1.0)
        if count > 1:
            return np.atleast_2d(np.cov(self.rocking.T)) / count, count - 1.0
        static, dynamic = self.runs
        differences = (static[1] - static[0], dynamic[1] - dynamic[0])
        return sum((np.outer(d, d) for d in differences), np.zeros((static.shape[1],) * 2)) / 4, 1.0


@dataclass(frozen=True, slots=True)
class CombinedDrifts:
    """Contains the m rocking drifts, averaged over the states. The drifts that the accelerometers give come first.

    `axes`: the axis of each drift. `by_gimbals`: array of shape (m,), True for each drift that comes from the gimbals. `values`:
    array of shape (m,) in deg/h, the drifts. `covariance`: array of shape (m, m), covariance of the drifts. `shares`: for each
    state, a matrix (m, k) with the weights of the k drifts of this state in the m results.
    """

    axes: tuple[int, ...]
    by_gimbals: tuple[bool, ...]
    values: Array
    covariance: Array
    degrees_of_freedom: tuple[float, ...]
    shares: tuple[Array, ...]


def combine(states: Sequence[StateDrifts]) -> CombinedDrifts:
    """Averages the rocking drifts about each level axis, separately for each method, over the states in which the axis is level."""
    columns = states[0].drifts.shape[2]
    seen = sorted({axis for state in states for axis in state.level})
    rows = [(axis, gimbals) for gimbals in (False, True)[: columns // 2] for axis in seen]
    shares = []
    for state in states:
        share = np.zeros((len(rows), columns))
        for m, (axis, gimbals) in enumerate(rows):
            if axis in state.level:
                together = sum(axis in other.level for other in states)
                share[m, 2 * gimbals + state.level.index(axis)] = 1 / together
        shares.append(share)
    values = sum((s @ state.rocking.mean(axis=0) for s, state in zip(shares, states, strict=True)), np.zeros(len(rows)))
    parts = [s @ state.scatter()[0] @ s.T for s, state in zip(shares, states, strict=True)]
    freedoms = [state.scatter()[1] for state in states]
    degrees = tuple(_freedom([part[m, m] for part in parts], freedoms) for m in range(len(rows)))
    axes, by_gimbals = tuple(row[0] for row in rows), tuple(row[1] for row in rows)
    return CombinedDrifts(axes, by_gimbals, values, np.sum(parts, axis=0), degrees, tuple(shares))


def _freedom(variances: Sequence[float], degrees: Sequence[float]) -> float:
    """Returns the effective degrees of freedom of a sum of variances. If all variances are zero, returns the smallest of their
    degrees of freedom."""
    return effective_degrees_of_freedom(np.sqrt(variances).tolist(), degrees) if any(variances) else min(degrees)


@dataclass(frozen=True, slots=True)
class Pairings:
    """Contains random pairs of a static and a dynamic run, for one axis. `accelerometers`: array of shape (p,) in deg/h, the
    rocking drift of each pair according to the accelerometers. `gimbals`: array of shape (p,) in deg/h, the same according to the
    gimbals."""

    axis: int
    accelerometers: Array
    gimbals: Array

    @property
    def smaller(self) -> float:
        """Returns the fraction of pairs in which the accelerometers give the smaller drift."""
        return float(np.mean(np.abs(self.accelerometers) < np.abs(self.gimbals)))

    @property
    def deviations(self) -> tuple[float, float]:
        """Returns the standard deviation [deg/h] of the rocking drifts, for each of the two methods."""
        return _deviation(self.accelerometers), _deviation(self.gimbals)


def _deviation(values: Array) -> float:
    return float(np.std(values, ddof=1)) if values.size > 1 else math.nan


def pair(states: Sequence[StateDrifts], most: int, seed: int) -> list[Pairings]:
    """Makes random pairs of a static and a dynamic run of the same state. Returns one `Pairings` for each axis that is level in a
    state; it contains the pairs of all states in which this axis is level. If a state has at most `most` pairs, all of them are
    used."""
    draw = np.random.default_rng(seed)
    found: dict[int, list[Array]] = {}
    for state in states:
        static, dynamic = state.runs
        chosen = np.arange(len(static) * len(dynamic))
        if chosen.size > most:
            chosen = draw.choice(chosen, most, replace=False)
        differences = dynamic[chosen % len(dynamic)] - static[chosen // len(dynamic)]
        for place, axis in enumerate(state.level):
            found.setdefault(axis, []).append(differences[:, [place, place + 2]])
    pairings = []
    for axis, parts in sorted(found.items()):
        pairs = np.concatenate(parts)
        pairings.append(Pairings(axis, pairs[:, 0], pairs[:, 1]))
    return pairings


def implausible(states: Sequence[StateDrifts], earth_rate: float, stated: float) -> Iterator[Said]:
    """Returns warnings about runs whose drift is larger than half of the Earth rate. Also returns warnings about differences
    between the drifts that the two methods give.

    `earth_rate`: the Earth rate, deg/h. `stated`: standard uncertainty [deg/h] of the difference between the two methods, due to
    the declared errors of the rings.
    """
    tests = sum(2 * len(state.level) for state in states)
    for state in states:
        for dynamic, drifts in zip((False, True), state.runs, strict=True):
            for place, axis in enumerate(state.level):
                runs = _runs(dynamic, state.name, AXES[axis])
                mean = float(np.mean(drifts[:, place]))
                if abs(mean) > earth_rate / 2:
                    yield said(
                        "{runs}: the drift by accelerometers is {drift:.3g} deg/h, more than half the Earth rate. A reversed "
                        "accelerometer causes such a drift: check the signs of the accelerometers and the orientation.",
                        runs=runs,
                        drift=mean,
                    )
                elif drifts.shape[1] > 2:
                    difference = drifts[:, place + 2] - drifts[:, place]
                    if _differs(difference, stated, SIGNIFICANCE / tests):
                        yield said(
                            "{runs}: the drifts by gimbal angles and by accelerometers differ by {difference:.3g} deg/h, more than "
                            "their scatter and the position uncertainty of the table explain: check the signs of the "
                            "accelerometers, gimbals and rings, and `gimbal_axes`.",
                            runs=runs,
                            difference=float(np.mean(difference)),
                        )


def _runs(dynamic: bool, state: str, axis: str) -> Said:
    if dynamic:
        return said("dynamic runs, {state}, {axis}", state=state, axis=axis)
    return said("static runs, {state}, {axis}", state=state, axis=axis)


def _differs(difference: Array, stated: float, level: float) -> bool:
    """Returns True if the mean of n differences deviates significantly from zero (Student's t-test). `stated`: a standard
    uncertainty that is added in quadrature to the standard uncertainty of the mean. `level`: level of significance."""
    from scipy.special import stdtrit

    count = len(difference)
    spread = math.hypot(float(np.std(difference, ddof=1)) / math.sqrt(count), stated)
    return abs(float(np.mean(difference))) > float(stdtrit(count - 1, 1 - level / 2)) * spread
