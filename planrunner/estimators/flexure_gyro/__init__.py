"""Estimators of the static coefficients of a flexure gyro, and of the residuals after compensation."""
