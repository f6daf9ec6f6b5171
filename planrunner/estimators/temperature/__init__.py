"""Estimators of coefficients as functions of temperature: polynomials and splines, and the choice of their order."""
