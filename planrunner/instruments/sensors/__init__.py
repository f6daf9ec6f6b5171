"""Drivers of inertial sensors that stream frames over a serial line, one file for each family."""
