"""Coefficients over temperature: polynomials and splines, and the choice of their order."""
