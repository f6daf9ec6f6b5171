"""Estimators that describe coefficients as functions of temperature by polynomials or splines, and choose their order."""
