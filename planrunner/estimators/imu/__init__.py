"""Estimators that calibrate an inertial measurement unit with positions and rates. The estimators determine bias, scale factor,
misalignment and g-sensitivity."""
