"""Instruments: what they can do (`interfaces`), their models for planning (`models`), and one file per instrument."""
