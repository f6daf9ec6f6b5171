"""Drivers of real chambers: the functions that all of them share (`wired_chamber`), and one file per controller with its commands."""
