"""Estimators that calibrate an inertial measurement unit with positions and rates. They determine bias, scale factor, misalignment
and g-sensitivity."""
