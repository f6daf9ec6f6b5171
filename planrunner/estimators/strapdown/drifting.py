"""Uses the readings at the stops to find biases that drift during a navigation. Computes the navigation errors that the drift
causes.

The fit has a separate constant for each position in which the sensor stops; the drift is the same function for all positions. The
drift functions and the test of a drift are the same as in the static methods (`observation.drift`, `drift_fit`). The navigation is
not corrected for the drift, because the estimate reports the errors of this sensor on this day. With constant biases, the errors
would be different; this difference is stated as an error that is not corrected (JCGM 100:2008, F.2.4.5). The difference is computed
with the linear error equations (`wandering`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.estimators.drift_fit import FittedDrift, explained_by_noise, fitted_drift, joined
from planrunner.estimators.least_squares import LinearFit
from planrunner.estimators.strapdown.standing import Stops
from planrunner.estimators.strapdown.wandering import WanderingBias
from planrunner.observation.drift import DriftCourse, courses_by_evidence
from planrunner.observation.flicker import mean_covariance
from planrunner.observation.observations import SIGNIFICANCE, Weighting, WithinSegmentNoise

_MOST_POSITIONS = 0.5  # positions per observation; with more, a drift looks like a change of position


@dataclass(frozen=True, slots=True, eq=False)
class StopDrift:
    """States what the readings at the stops show about a drift of the six sensors.

    `fitted`: the fitted drift functions. `changes`: array of shape (6,), for each sensor, the largest minus the smallest bias
    during alignment and navigation according to the fitted drift, rad/s and m/s². `uncertainties`: array of shape (6,),
    uncertainties of these changes. `effect`: array of shape (7, n, r), errors that the drift causes at n times of the navigation,
    in the states that `error_equations` defines. The first of the r columns is the effect of the fitted drift of all sensors. Each
    other column is the effect of an independent change of the drift that is as large as its uncertainty. `time`: array of shape
    (n,), s since the navigation began. `scatter`: array of shape (6,), for each sensor, the standard deviation of the readings
    about the fitted drift, divided by the expected standard deviation. `unexplained`: array of shape (6,), True if noise and stated
    flicker do not explain this ratio.
    """

    fitted: FittedDrift
    changes: Array
    uncertainties: Array
    time: Array
    effect: Array
    scatter: Array
    unexplained: NDArray[np.bool_]


def stop_drift(stops: Stops, response: WanderingBias, flicker: Mapping[int, float]) -> StopDrift | None:
    """Searches for a drift of the six sensors in the readings at the stops. `flicker`: maps the index of a sensor to its stated
    bias instability, rad/s or m/s². Returns None if the stops cannot show a drift."""
    n = len(stops.time)
    if not n or not (stops.white > 0).all():
        return None
    places, position = np.unique(stops.position, return_inverse=True)
    if len(places) > _MOST_POSITIONS * n:
        return None
    matrix = np.eye(len(places))[position]
    middles = response.middles
    time, seconds = np.append(stops.time, middles), np.append(stops.seconds, np.zeros(len(middles)))
    kelvin = None
    if np.isfinite(stops.kelvin).all():
        kelvin = np.append(stops.kelvin, np.interp(middles, stops.time, stops.kelvin))
    lasting = np.append(stops.seconds, np.full(len(middles), response.step))
    seen, whole = courses_by_evidence(time - lasting / 2, time + lasting / 2, seconds, kelvin, n)
    sigma = stops.white[:, None] / np.sqrt(stops.seconds)
    kernel = mean_covariance(stops.time - stops.seconds / 2, stops.time + stops.seconds / 2, response.span)
    instability = np.array([flicker.get(k, 0.0) for k in range(len(sigma))])
    names = [f"position {k + 1}" for k in range(len(places))]

    def judged(scale: Array) -> tuple[FittedDrift, Sequence[LinearFit], Sequence[LinearFit], bool]:
        """Returns four values: the fitted drift; the fits with this drift; the fits with all drift functions; and True if noise
        explains the residuals of the fits with all drift functions. `scale`: array of shape (6,), assumed standard deviations of
        the readings, divided by the expected standard deviations."""
        spread, whitening = scale[:, None] * sigma, None
        if flicker:
            noise = np.array([np.diag(one**2) for one in spread])
            whitening = least_squares.whitener(noise + (scale * instability)[:, None, None] ** 2 * kernel)

        def fits(columns: Array) -> Sequence[LinearFit]:
            return least_squares.fit_each(columns, stops.means.T, spread, whitening=whitening)

        noises = [WithinSegmentNoise(one, True, Weighting.INDIVIDUAL, stops.freedom) for one in spread]
        level, alike = np.ones(len(places)), np.eye(len(sigma))
        found = fitted_drift(matrix, level, names, seen, noises, alike, fits, "within_segment")
        full = fits(joined(matrix, seen.courses))
        return found, fits(joined(matrix, found.courses)), full, explained_by_noise(full, noises)

    expected = np.ones(len(sigma))
    found, fits, full, explained = judged(expected)
    if not explained and not found.courses:
        # Noise and drift do not explain the residuals: the scatter about the drift functions replaces the noise.
        expected = np.maximum(1.0, np.sqrt([one.variance_factor for one in full]))
        found, fits, _, _ = judged(expected)
    shown = [next(one for one in whole.courses if one.name == course.name) for course in found.courses]
    return _with_effect(found, fits, expected, shown, n, response, stops.freedom)


def _with_effect(
    found: FittedDrift,
    fits: Sequence[LinearFit],
    expected: Array,
    courses: Sequence[DriftCourse],
    observed: int,
    response: WanderingBias,
    freedom: float,
) -> StopDrift:
    """Returns the fitted drift together with its effect on the navigation. `expected`: array of shape (6,), standard deviations
    that the fits assume for the readings, divided by the standard deviations that noise and stated flicker explain. `courses`: the
    fitted drift functions, each with one column of n + l rows: n rows for the observations, then l rows for the intervals of the
    response. `observed`: number n of observations."""
    from scipy.special import fdtrc

    left = fits[0].degrees_of_freedom
    scatter = expected * np.sqrt([one.chi_squared / left for one in fits])
    unexplained = len(fits) * fdtrc(left, freedom, scatter**2) < SIGNIFICANCE
    columns = (
        np.hstack([one.columns for one in courses]) if courses else np.zeros((observed + len(response.middles), 0))
    )
    q, later = columns.shape[1], columns[observed:]
    amplitudes = np.array([one.coefficients[len(one.coefficients) - q :] for one in fits])
    roots = [np.linalg.cholesky(one.cofactor[len(one.cofactor) - q :, len(one.cofactor) - q :]) for one in fits]
    changes = np.ptp(later @ amplitudes.T, axis=0)
    uncertainties = np.array([np.linalg.norm(np.ptp(later @ root, axis=0)) for root in roots])
    biases = np.zeros((len(fits), len(later), 1 + q * len(fits)))
    biases[:, :, 0] = (later @ amplitudes.T).T
    for k, root in enumerate(roots):
        biases[k, :, 1 + q * k : 1 + q * (k + 1)] = later @ root
    time = response.step * np.arange(len(response.attitude) + 1.0)
    return StopDrift(found, changes, uncertainties, time, response.errors(biases), scatter, unexplained)
