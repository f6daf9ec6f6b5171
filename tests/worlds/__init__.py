"""Recordings from worlds that share no code with planrunner, and how often the intervals estimated from them hold the truth.

`felt`, `faults` and `campaigns` import nothing of planrunner: their physics, noise and truths are written apart. `coverage` has planrunner
estimate what they recorded; `python -m tests.worlds` prints the figures.
"""
