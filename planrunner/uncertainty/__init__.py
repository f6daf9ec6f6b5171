"""Uncertainty: budgets, coverage, decision rules and Monte Carlo validation."""
