"""Calibration of accelerometer triads from positions at rest: with known orientations, or with the magnitude of gravity alone."""
