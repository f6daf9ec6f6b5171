"""Drivers of real tables: one file per controller with its commands, and the functions that all drivers share (`axis_table`)."""
