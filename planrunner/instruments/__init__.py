"""Instruments: what they can do (`interfaces`), what the planner knows of them (`models`), and one file an instrument."""
