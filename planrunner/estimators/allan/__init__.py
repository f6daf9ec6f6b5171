"""Estimators that compute Allan deviations from long records and fit noise coefficients to them."""
