"""Allan deviations of long records and the noise coefficients fitted to them."""
