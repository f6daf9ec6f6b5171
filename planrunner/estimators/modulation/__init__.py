"""Residual of constant errors in a navigation with a rotation cycle."""
