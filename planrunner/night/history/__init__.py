"""Keeps the history of devices: an index of run folders, and statistics of coefficients over time."""
