"""Calibrates accelerometer triads at rest in several positions. The orientations are known, or only the magnitude of gravity is
known."""
