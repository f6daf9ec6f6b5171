"""Drivers of inertial sensors that stream frames over a serial line; each file is for one family of sensors."""
