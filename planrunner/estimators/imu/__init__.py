"""Estimators of bias, scale factor, misalignment and g-sensitivity of an inertial measurement unit, from positions and rates."""
