"""Accelerometer triads from positions: with known orientations, or with the magnitude of gravity alone."""
