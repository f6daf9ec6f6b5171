"""Drivers of real chambers: what every chamber does (`wired_chamber`), and one file a controller that says how it is told."""
