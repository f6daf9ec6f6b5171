"""Drivers of inertial sensors that stream frames over a serial line, with one file for each family of sensors."""
