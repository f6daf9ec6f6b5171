"""Decides which drift functions the data show, and which drift functions are fitted together with the terms. A drift function is a
power of the time or a recorded temperature; the drift of an output may be proportional to this function.

A drift function is adopted if its amplitude in one output, or its amplitudes in all outputs together, are larger than chance
explains. `SIGNIFICANCE` is the level of this test for all tried drift functions together. The size that amplitudes can have by
chance is computed from the noise within the segments and the declared effects, if these explain the residuals of the fit without
the drift. Otherwise, it is computed from these residuals. After the drift is fitted, the noise and the effects must explain the
residuals. If they do not, the model is incomplete, and the drift is not adopted, because a part of the residuals of an incomplete
model always looks like a drift. At least `LEAST_LEFT` degrees of freedom must remain over all outputs, because otherwise any
scatter would look like a drift. A drift is rarely exactly linear: after a power of the time is adopted, the next power is fitted as
well if the segments allow it.

A drift is not adopted if a nonlinearity of the outputs explains the data better. To test this, the square of the outputs' fitted
values is fitted as a further column (regression specification error test: J. B. Ramsey, J. R. Stat. Soc. B 31, 1969). The
nonlinearity explains the data better if two conditions hold: this fit leaves residuals that are no larger than noise, and it has a
lower information criterion (BIC).

A drift function that is not adopted is called suspected in two cases, and the report then names it. In the first case, the evidence
is a little weaker than required, and the drift function would change a coefficient by more than its standard uncertainty. In the
second case, the drift function is a recorded temperature that changed, and the segments do not separate it well from a coefficient.
An amplitude that the data do not exclude would then change the coefficient by several standard uncertainties.

With few degrees of freedom, the test may miss even a drift that changes coefficients by several standard uncertainties. For this
reason, weak evidence, either for a drift function or in the residuals of all outputs, is sufficient to call the drift function
doubted. The change that it would cause is then added to the uncertainties, as an error that is not corrected (JCGM 100:2008,
F.2.4.5). The same applies to a suspected temperature that the segments do not separate well from a coefficient.
Drift functions that are proportional to each other, such as the time and a temperature that rises evenly, describe the same drift:
they count as one, both in the tests and in the uncertainties.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators import rank
from planrunner.estimators.drift_order import COUPLED
from planrunner.estimators.least_squares import LinearFit
from planrunner.observation.drift import ClockJump, DriftCourse, DriftCourses
from planrunner.observation.observations import SIGNIFICANCE, WithinSegmentNoise

LEAST_LEFT = 2
"""A drift function is adopted only if at least this number of degrees of freedom remains, over all outputs together."""
SUSPECTED = 2 * SIGNIFICANCE
"""A drift that is not adopted is suspected if its p-value is below this value. With this limit, fewer than one in twenty fits of
two outputs give a false warning in any of their tests."""
FEW = 4
"""If an output has fewer degrees of freedom than this, a drift that changes coefficients can remain unnoticed."""
DOUBTED = 0.2
"""In a fit with fewer than `FEW` degrees of freedom, a drift that is not adopted is doubted if its p-value, or the p-value of the
residuals, is below this value. The change that a doubted drift would cause is included in the uncertainty."""
_LEFT_BY_JUMP = 3  # least degrees of freedom of each output if a jump of the clock is assumed
_SUPPORT = 100.0  # least ratio of the likelihoods of a jump of the clock and of scatter between segments
_SEPARABLE = 1e-3  # smallest fraction of a drift function that the terms of the model must not reproduce
_ROUNDING = 1e-9  # of the largest fitted value: smaller amplitudes are rounding errors


@dataclass(frozen=True, slots=True, eq=False)
class SuspectedDrift:
    """Describes a drift function (`course`) that is not fitted, although the data do not exclude a drift large enough to matter.
    The other fields describe the coefficient that this drift function affects most.

    `output`, `term`: indices of the output and of the term of this coefficient. `growth`: factor by which the standard uncertainty
    of the coefficient grows if the drift function is fitted; infinite if the segments cannot separate the drift function from the
    coefficient. `change`: change of the coefficient if the drift function is fitted, in the unit of the fit; 0 if the segments
    cannot separate the drift function from the coefficient. `probability`: probability that chance alone gives an amplitude at
    least as large as the fitted one; 1 if the drift function was not tested.
    """

    course: DriftCourse
    output: int
    term: int
    name: str
    growth: float
    change: float = 0.0
    probability: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class DoubtedDrift:
    """Describes a drift function that is not fitted, although there is some evidence for it. `amplitudes`: array of shape (m, r),
    for each output and each column of the drift function, √(a² + u²) of the fitted amplitude a and its standard uncertainty u.
    `probability`: the smaller of two probabilities. One is the probability that chance alone gives amplitudes at least as large as
    the fitted amplitudes. The other is the probability that chance alone gives residuals at least as large as the residuals of the
    fit without drift. `probability` is 1 for a drift function that was not tested."""

    course: DriftCourse
    amplitudes: Array
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class FittedDrift:
    """Contains the result of the search for a drift in a fit.

    `courses`: the fitted drift functions. `by_evidence`: True if these functions were chosen because the data show them, False if
    the plan asks for them. `judged`: True if the data permitted a search for a drift. `without`: array of shape (m, p), the
    coefficients of a fit without drift. `explained`: array of shape (m,), the fraction of the sum of squared residuals that the
    drift explains. `without` and `explained` are None if no drift function was adopted. `suspected`: the suspected drift functions,
    if none was adopted. `rivals`: drift functions that the data show, but that are not adopted because a nonlinearity explains the
    residuals equally well. `nonlinear`: array of shape (m,), the fraction of the sum of squared residuals that the nonlinearity
    explains. `doubted`: the doubted drift functions; no two of them are proportional to each other. The module docstring defines
    the terms suspected and doubted. `jumped`: a jump of the recording's clock; without it, a drift would explain the residuals. None
    if there is no such jump.
    """

    courses: tuple[DriftCourse, ...] = ()
    by_evidence: bool = False
    judged: bool = True
    without: Array | None = None
    explained: Array | None = None
    suspected: tuple[SuspectedDrift, ...] = ()
    rivals: tuple[DriftCourse, ...] = ()
    nonlinear: Array | None = None
    doubted: tuple[DoubtedDrift, ...] = ()
    jumped: ClockJump | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{course.name} drift {part}".strip() for course in self.courses for part in course.parts)

    @property
    def units(self) -> tuple[str, ...]:
        """Returns, for each of the q fitted amplitudes, the denominator of its unit, such as h for a drift per hour."""
        return tuple(course.per for course in self.courses for _ in course.parts)

    def doubts(self, course: DriftCourse) -> bool:
        """Returns True if `doubted` contains the drift function, or a drift function that is proportional to it. The uncertainties
        then include its effect."""
        return any(_same(one.course, course) for one in self.doubted)


NOTHING_FITTED = FittedDrift()

Fits = Callable[[Array], Sequence[LinearFit]]


def joined(matrix: Array, courses: Sequence[DriftCourse]) -> Array:
    """Returns the design matrix: the columns of the terms, `matrix` (n, p), followed by the columns of the drift functions."""
    return np.hstack([matrix, *(course.columns for course in courses)]) if courses else matrix


def sizes(magnitudes: Array, columns: Array) -> Array:
    """Returns the magnitudes of the columns that `joined` returns. A term has its declared magnitude. The magnitude of a drift
    function is its root mean square."""
    further = columns[:, len(magnitudes) :]
    return np.concatenate([magnitudes, np.sqrt(np.mean(further**2, axis=0))]) if further.size else magnitudes


def fitted_drift(
    matrix: Array,
    magnitudes: Array,
    names: Sequence[str],
    drift: DriftCourses,
    noises: Sequence[WithinSegmentNoise],
    correlation: Array,
    fits: Fits,
    basis: str,
) -> FittedDrift:
    """Chooses the drift functions to fit, and returns them with the results of their tests.

    `names`: names of the p terms. `correlation`: array of shape (m, m), correlation between the noise of the outputs. `fits`: a
    function that fits all outputs with the columns of a given matrix (as `joined` returns it), with weights from the noise and the
    declared effects. `basis`: kind of uncertainty, residual or within_segment. `matrix`: array of shape (n, p), the columns of the
    terms. `magnitudes`: array of shape (p,), declared magnitudes of these columns.
    """
    if not drift.courses:
        return NOTHING_FITTED
    if not drift.by_evidence:
        return FittedDrift(drift.courses)
    chosen: tuple[DriftCourse, ...] = ()
    judged, plain = bool(drift.shown), fits(matrix)
    hinted: tuple[DriftCourse, float] | None = None
    by_chance: dict[str, float] = {}
    while tried := _next(matrix, magnitudes, drift, chosen, len(noises)):
        if drift.shown:
            if _is_rounding(matrix, tried[0], fits(joined(matrix, (*chosen, tried[0])))):
                break
            chosen = (*chosen, tried[0])
            continue
        judged = True
        before = fits(joined(matrix, chosen))
        found = {course.name: fits(joined(matrix, (*chosen, course))) for course in tried}
        chances = [_chance(before, found[course.name], course, noises, correlation) for course in tried]
        best = tried[int(np.argmin(chances))]
        probability = min(chances) * _different(tried) * drift.fits
        if _is_rounding(matrix, best, found[best.name]):
            break
        if probability >= SIGNIFICANCE:
            hinted = (best, probability)
            break
        chosen, by_chance[best.name] = (*chosen, best), probability
    if not chosen:
        suspected = _suspected(matrix, magnitudes, names, drift, hinted, fits)
        doubted: tuple[DoubtedDrift, ...] = ()
        if hinted is not None:
            course, probability = hinted
            doubted = _doubted(matrix, course, min(probability, _scattering(plain, noises)), plain, noises, fits, basis)
        doubted += _hidden(matrix, suspected, doubted, plain, noises, fits, basis)
        jumped = _jumped(matrix, magnitudes, drift, plain, noises, fits)
        return FittedDrift(by_evidence=True, judged=judged, suspected=suspected, doubted=doubted, jumped=jumped)
    if not drift.shown and any(course.order for course in chosen):
        chosen += tuple(one for one in _next(matrix, magnitudes, drift, chosen, len(noises)) if one.order)
    whole = fits(joined(matrix, chosen))
    if not drift.shown and not explained_by_noise(whole, noises):
        suspected = _suspected(matrix, magnitudes, names, drift, None, fits)
        jumped = _jumped(matrix, magnitudes, drift, plain, noises, fits)
        return FittedDrift(by_evidence=True, judged=True, suspected=suspected, jumped=jumped)
    bent = () if drift.shown else _nonlinear(matrix, plain, fits)
    if bent and explained_by_noise(bent, noises) and _criterion(bent, len(matrix)) < _criterion(whole, len(matrix)):
        doubted = tuple(
            one
            for course in chosen[:1]
            for one in _doubted(matrix, course, by_chance.get(course.name, 0.0), plain, noises, fits, basis)
        )
        return FittedDrift(by_evidence=True, judged=True, rivals=chosen, nonlinear=_taken(plain, bent), doubted=doubted)
    without, explained = np.array([one.coefficients for one in plain]), _taken(plain, whole)
    made = FittedDrift(chosen, True, True, without, explained)
    if drift.shown and not explained_by_noise(plain, noises):
        bent = _nonlinear(matrix, plain, fits)
        if bent and _criterion(bent, len(matrix)) < _criterion(whole, len(matrix)):
            return replace(made, nonlinear=_taken(plain, bent))
    return made


def _jumped(
    matrix: Array,
    magnitudes: Array,
    drift: DriftCourses,
    plain: Sequence[LinearFit],
    noises: Sequence[WithinSegmentNoise],
    fits: Fits,
) -> ClockJump | None:
    """Returns a jump of the recording's clock if the noise does not explain the residuals of the fits without a drift (`plain`), but
    explains the residuals of fits with a drift in the time without this jump. This function is used if no drift in the recorded time is
    adopted. `matrix`: array of shape (n, p), the columns of the terms. `magnitudes`: array of shape (p,), their magnitudes.

    A random walk also gives such residuals by chance. Therefore, at least `_LEFT_BY_JUMP` degrees of freedom of each output must remain,
    and the data must support the jump `_SUPPORT` times better than scatter of unknown size between the segments (BIC). The scatter is
    that of three kinds of fits: without a drift, with a drift in the recorded time, and with a change of the outputs at the place of the
    jump. The place counts as a further coefficient."""
    if not (drift.jumps and plain[0].degrees_of_freedom) or explained_by_noise(plain, noises):
        return None
    n = len(matrix)
    for jump in drift.jumps:
        chosen: tuple[DriftCourse, ...] = ()
        without = DriftCourses(jump.courses)
        further = [one for one in (*drift.courses, jump.step) if one.order < 2 and _separable(matrix / magnitudes, one)]
        rivals = [plain, *(fits(joined(matrix, (one,))) for one in further)]
        least = min(_criterion_of_scatter(rival, n) for rival in rivals) - 2 * np.log(_SUPPORT)
        while tried := _next(matrix, magnitudes, without, chosen, len(noises)):
            chosen = (*chosen, *tried)
            found = fits(joined(matrix, chosen))
            if found[0].degrees_of_freedom < _LEFT_BY_JUMP:
                break
            if explained_by_noise(found, noises) and _criterion(found, n) + np.log(n * len(found)) < least:
                return jump
    return None


def _scattering(plain: Sequence[LinearFit], noises: Sequence[WithinSegmentNoise]) -> float:
    """Tests the residuals of all outputs together. Returns the probability that the noise within the segments causes residuals at
    least as large (F-test). Returns 1 if the noise is unknown, or if the residuals are so large that another warning reports them.
    Unlike the test of one drift function, this test finds a drift of any form."""
    found = _probability_of_residuals(plain, noises)
    return 1.0 if found is None or found < SIGNIFICANCE else found


def _doubted(
    matrix: Array,
    course: DriftCourse,
    probability: float,
    plain: Sequence[LinearFit],
    noises: Sequence[WithinSegmentNoise],
    fits: Fits,
    basis: str,
) -> tuple[DoubtedDrift, ...]:
    """Returns a `DoubtedDrift` if the drift function, which is not fitted, is doubted; otherwise an empty tuple. A drift function
    is doubted if `probability`, the probability that chance explains the data, is below `DOUBTED`, and a fit with the drift
    function has fewer than `FEW` degrees of freedom. `plain`: the fits of the outputs without the drift function. `matrix`: array
    of shape (n, p), the columns of the terms."""
    found = fits(joined(matrix, (course,)))
    if probability >= DOUBTED or found[0].degrees_of_freedom >= FEW:
        return ()
    return (DoubtedDrift(course, _not_corrected(course, plain, found, noises, basis), probability),)


def _hidden(
    matrix: Array,
    suspected: Sequence[SuspectedDrift],
    doubted: Sequence[DoubtedDrift],
    plain: Sequence[LinearFit],
    noises: Sequence[WithinSegmentNoise],
    fits: Fits,
    basis: str,
) -> tuple[DoubtedDrift, ...]:
    """Makes a `DoubtedDrift` for each recorded temperature that changed and that the segments can hardly separate from a
    coefficient. A temperature is left out if it cannot be separated at all, or if it is proportional to a doubted drift function.
    `plain`: the fits of the outputs without a drift. `matrix`: array of shape (n, p), the columns of the terms."""
    return tuple(
        DoubtedDrift(
            one.course,
            _not_corrected(one.course, plain, fits(joined(matrix, (one.course,))), noises, basis),
            one.probability,
        )
        for one in suspected
        if one.course.changed
        and np.isfinite(one.growth)
        and not any(_same(one.course, other.course) for other in doubted)
    )


def _not_corrected(
    course: DriftCourse,
    plain: Sequence[LinearFit],
    found: Sequence[LinearFit],
    noises: Sequence[WithinSegmentNoise],
    basis: str,
) -> Array:
    """Returns the sizes of the error that a drift function causes if it is not corrected, shape (m, r), for m outputs and r columns
    of the drift function. A size is √(a² + u²), where a is the fitted amplitude and u is its standard uncertainty. `plain`,
    `found`: the fits of the outputs without and with the drift function. If the uncertainties are based on residuals, u follows
    from the residuals of the fits with the drift function. If these fits have no degrees of freedom, u follows from the residuals
    of the fits without the drift function."""
    r = course.columns.shape[1]
    amplitudes = np.array([one.coefficients[-r:] for one in found])
    by_noise = [noise.known and basis != "residual" for noise in noises]
    scattering = found if found[0].degrees_of_freedom else plain
    scales = [1.0 if known else one.variance_factor for one, known in zip(scattering, by_noise, strict=True)]
    variances = np.array([scale * np.diag(one.cofactor)[-r:] for one, scale in zip(found, scales, strict=True)])
    return np.asarray(np.sqrt(amplitudes**2 + variances))


def _taken(before: Sequence[LinearFit], after: Sequence[LinearFit]) -> Array:
    """Returns the fraction of the sum of squared residuals that additional columns explain, shape (m,) for m outputs. `before`,
    `after`: the fits without and with these columns."""
    left, all_ = (np.array([one.chi_squared for one in each]) for each in (after, before))
    return 1 - left / np.where(all_ > 0, all_, 1.0)


def _criterion(found: Sequence[LinearFit], n: int) -> float:
    """Returns the Bayesian information criterion of fits with n observations each. The criterion is χ² of all fits, plus ln N for
    each fitted coefficient, where N is the number of observations of all fits together."""
    terms = sum(n - one.degrees_of_freedom for one in found)
    return sum(one.chi_squared for one in found) + terms * float(np.log(n * len(found)))


def _criterion_of_scatter(found: Sequence[LinearFit], n: int) -> float:
    """Returns the information criterion of fits as `_criterion` does, but for residuals whose size is unknown. The size that is most
    likely, but is not smaller than the noise, is used for each output."""
    criterion = _criterion(found, n)
    for one in found:
        factor = max(one.variance_factor, 1.0) if one.degrees_of_freedom else 1.0
        criterion += one.degrees_of_freedom * float(np.log(factor)) + one.chi_squared * (1 / factor - 1)
    return criterion


def _nonlinear(matrix: Array, plain: Sequence[LinearFit], fits: Fits) -> tuple[LinearFit, ...]:
    """Returns the fits of m outputs with an additional column, which is the square of the output's fitted values. The result is
    empty if the terms can reproduce this column for one of the outputs. `matrix`: array of shape (n, p), the columns of the
    terms."""
    found = []
    for k, one in enumerate(plain):
        fitted = matrix @ one.coefficients
        square = (fitted / np.max(np.abs(fitted), initial=np.finfo(float).tiny)) ** 2
        basis = np.linalg.qr(matrix / np.max(np.abs(matrix), axis=0, initial=np.finfo(float).tiny))[0]
        own = square - basis @ (basis.T @ square)
        if np.linalg.norm(own) <= _SEPARABLE * np.linalg.norm(square):
            return ()
        found.append(fits(np.column_stack([matrix, own]))[k])
    return tuple(found)


def _next(
    matrix: Array, magnitudes: Array, drift: DriftCourses, chosen: Sequence[DriftCourse], outputs: int
) -> tuple[DriftCourse, ...]:
    """Returns the drift functions that may be added: the lowest missing power of the time, and the missing temperatures. A drift
    function is left out if the terms and the chosen drift functions can reproduce it, or if too few degrees of freedom would
    remain. `matrix`: array of shape (n, p), the columns of the terms. `magnitudes`: array of shape (p,), their declared magnitudes.
    `outputs`: number of outputs."""
    base, names = joined(matrix, chosen), {course.name for course in chosen}
    allowed = [one for one in drift.courses if not drift.shown or one.name in drift.shown]
    missing = [course for course in allowed if course.name not in names]
    lowest = min((course.order for course in missing if course.order), default=0)
    scaled = base / sizes(magnitudes, base)
    found = []
    for course in missing:
        left = len(matrix) - base.shape[1] - course.columns.shape[1]
        enough = left >= 1 and outputs * left >= LEAST_LEFT
        if enough and course.order in (0, lowest) and _separable(scaled, course):
            found.append(course)
    return tuple(found)


def _separable(scaled: Array, course: DriftCourse) -> bool:
    """Returns True if the drift function is linearly independent of the columns `scaled` (n, P), which are already divided by their
    magnitudes."""
    basis = np.linalg.svd(scaled, full_matrices=False)[0][:, : rank.look(scaled).rank]
    own = course.columns - basis @ (basis.T @ course.columns)
    return bool(np.all(np.sum(own**2, axis=0) > _SEPARABLE**2 * np.sum(course.columns**2, axis=0)))


def _same(course: DriftCourse, other: DriftCourse) -> bool:
    """Returns True if two drift functions are proportional to each other."""
    norms = np.linalg.norm(other.columns, axis=0)
    return not _separable(other.columns / np.where(norms > 0, norms, 1.0), course)


def _different(courses: Sequence[DriftCourse]) -> int:
    """Returns the number of different drift functions; those that are proportional to each other count once."""
    return sum(not any(_same(course, other) for other in courses[:k]) for k, course in enumerate(courses))


def _suspected(
    matrix: Array,
    magnitudes: Array,
    names: Sequence[str],
    drift: DriftCourses,
    hinted: tuple[DriftCourse, float] | None,
    fits: Fits,
) -> tuple[SuspectedDrift, ...]:
    """Returns the suspected drift functions. This function is used if no drift function is adopted. `hinted`: the most likely of
    the tested drift functions, and the probability that chance alone gives its amplitude. `matrix`: array of shape (n, p), the
    columns of the terms. `magnitudes`: array of shape (p,), their declared magnitudes."""
    found = []
    for course in drift.courses:
        probability = hinted[1] if hinted is not None and hinted[0] is course else 1.0
        if probability >= SUSPECTED and not course.changed:
            continue
        one, moved = _affected(matrix, magnitudes, names, course, fits)
        if (course.changed and one.growth >= COUPLED) or (probability < SUSPECTED and moved > 1):
            found.append(replace(one, probability=probability))
    return tuple(found)


def _affected(
    matrix: Array, magnitudes: Array, names: Sequence[str], course: DriftCourse, fits: Fits
) -> tuple[SuspectedDrift, float]:
    """Returns the coefficient that a drift function affects most, and the largest change of any coefficient in units of its
    standard uncertainty. `matrix`: array of shape (n, p), the columns of the terms. `magnitudes`: array of shape (p,), their
    declared magnitudes."""
    n, p = matrix.shape
    before = fits(matrix)
    spreads = np.array([np.sqrt(np.diag(one.cofactor)) for one in before])
    if n < p + course.columns.shape[1] or not _separable(matrix / magnitudes, course):
        gained = np.linalg.lstsq(matrix / magnitudes, course.columns, rcond=None)[0]
        imitated = np.sum(np.abs(gained), axis=1) / magnitudes / spreads
        k, term = np.unravel_index(int(np.argmax(imitated)), imitated.shape)
        return SuspectedDrift(course, int(k), int(term), names[int(term)], float("inf")), 0.0
    after = fits(joined(matrix, (course,)))
    growth = np.array([np.sqrt(np.diag(one.cofactor)[:p]) for one in after]) / spreads
    changes = np.array([one.coefficients[:p] - own.coefficients for one, own in zip(after, before, strict=True)])
    k, term = np.unravel_index(int(np.argmax(growth)), growth.shape)
    one = SuspectedDrift(course, int(k), int(term), names[int(term)], float(growth[k, term]), float(changes[k, term]))
    return one, float(np.max(np.abs(changes) / spreads))


def _chance(
    before: Sequence[LinearFit],
    after: Sequence[LinearFit],
    course: DriftCourse,
    noises: Sequence[WithinSegmentNoise],
    correlation: Array,
) -> float:
    """Returns the probability that chance alone reduces χ² as much as the drift function does, in one output or in all outputs
    together (F-tests, Bonferroni's bound). Outputs with correlated noise count as fewer outputs, according to Satterthwaite's
    formula. `before`, `after`: the fits without and with the drift function. `correlation`: array of shape (m, m), correlation
    between the noise of the outputs."""
    from scipy.special import fdtrc

    r, left = course.columns.shape[1], after[0].degrees_of_freedom
    explained = explained_by_noise(after, noises)
    freedom = sum(noise.degrees_of_freedom for noise in noises)
    m, smallest, drops = len(after), 1.0, 0.0
    for one, other, noise in zip(before, after, noises, strict=True):
        drop = max(one.chi_squared - other.chi_squared, 0.0) / r
        if explained:
            chance = float(fdtrc(r, noise.degrees_of_freedom, drop))
        elif other.chi_squared > 0:
            chance = float(fdtrc(r, left, drop / (other.chi_squared / left)))
        else:
            chance = 0.0 if drop > 0 else 1.0
        smallest, drops = min(smallest, chance), drops + drop
    if not explained or m == 1:
        return m * smallest
    together = float(fdtrc(r * m**2 / np.sum(correlation**2), freedom, drops / m))
    return 2 * min(m * smallest, together)


def explained_by_noise(after: Sequence[LinearFit], noises: Sequence[WithinSegmentNoise]) -> bool:
    """Returns True if the noise within the segments explains the residuals of all outputs together (F-test); False if it does not,
    or if the noise is unknown."""
    found = _probability_of_residuals(after, noises)
    return found is not None and found >= SIGNIFICANCE


def _probability_of_residuals(found: Sequence[LinearFit], noises: Sequence[WithinSegmentNoise]) -> float | None:
    """Tests the residuals of all outputs together (F-test). Returns the probability that the noise within the segments causes
    residuals at least as large; None if the noise is unknown."""
    from scipy.special import fdtrc

    if not all(noise.known for noise in noises):
        return None
    left = sum(one.degrees_of_freedom for one in found)
    ratio = sum(one.chi_squared for one in found) / left
    return float(fdtrc(left, sum(noise.degrees_of_freedom for noise in noises), ratio))


def _is_rounding(matrix: Array, course: DriftCourse, after: Sequence[LinearFit]) -> bool:
    """Returns True if the fitted drift function changes the observations by no more than rounding errors. `matrix`: array of shape
    (n, p), the columns of the terms. `after`: the fits with the drift function."""
    p, r = matrix.shape[1], course.columns.shape[1]
    for one in after:
        moved = np.max(np.abs(course.columns @ one.coefficients[-r:]))
        if moved > _ROUNDING * np.max(np.abs(matrix) @ np.abs(one.coefficients[:p])):
            return False
    return True
