"""Benchmarks: ratios to a peer or to the limit, side by side in one run. `python -m benchmarks` runs them all."""
