"""Estimators for flexure gyros: one fits the static coefficients, another checks the residuals after compensation."""
