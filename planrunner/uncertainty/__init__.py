"""Computes uncertainty: budgets, coverage factors, decision rules, and Monte Carlo validation."""
