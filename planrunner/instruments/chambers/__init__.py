"""Drivers of real chambers: one file per controller with its commands, and the functions that all drivers share (`wired_chamber`)."""
