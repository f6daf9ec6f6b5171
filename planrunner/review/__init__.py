"""Computes the meaning of plans, benches and runs, and the difference between two of them, for reviews."""
