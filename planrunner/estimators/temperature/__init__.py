"""Coefficients over temperature: polynomials and splines, and the order that data support."""
