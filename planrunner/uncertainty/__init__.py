"""Uncertainty: coverage and decision rules."""
