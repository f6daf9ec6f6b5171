"""Drivers of real chambers: the common functions (`wired_chamber`), and one file per controller with its commands."""
