"""Navigates a recording purely inertially, and computes the errors relative to the true position. After an alignment during a stop,
the strapdown mechanisation gives attitude, velocity and position.

The module `alignment` checks the conditions for an alignment and aligns; `reading` handles units, gaps and the times of samples;
`navigation_errors` and `results` compute the reported figures; `design` predicts the errors. docs/navigation.md gives conventions
and definitions.
"""

from __future__ import annotations

from planrunner.estimators.interface import Design, DesignRequest, Estimate, EstimateRequest, Foresight
from planrunner.estimators.strapdown.navigating import StrapdownNavigationParameters, navigate


class StrapdownNavigation:
    """Implements the estimator `strapdown_navigation`."""

    summary = "Inertial navigation by strapdown mechanisation: attitude, velocity and position errors, CEP rate"
    Parameters = StrapdownNavigationParameters

    def design(self, request: DesignRequest[StrapdownNavigationParameters]) -> Design:
        """Returns remarks on the planned segments. Raises `EstimationError` if the plan is not suitable."""
        from planrunner.estimators.strapdown.design import design

        return design(request)

    def foresee(self, request: DesignRequest[StrapdownNavigationParameters]) -> Foresight:
        """Predicts the navigation errors from the declared properties of the sensor."""
        from planrunner.estimators.strapdown.design import foresee

        return foresee(request)

    def estimate(self, request: EstimateRequest[StrapdownNavigationParameters]) -> Estimate:
        """Computes the errors of the navigation from the recording. Raises `EstimationError` if the plan or the data are not
        suitable."""
        from planrunner.estimators.strapdown.results import assemble

        return assemble(request, navigate(request))
