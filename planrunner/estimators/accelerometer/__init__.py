"""Calibrates accelerometer triads at rest in several positions. Either the orientations are known, or only the magnitude of
gravity."""
