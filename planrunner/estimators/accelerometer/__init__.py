"""Calibrates accelerometer triads at rest in several positions. The reference is gravity in known orientations, or only the
magnitude of gravity."""
