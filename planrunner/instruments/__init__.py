"""Instruments: their capabilities (`interfaces`), their models for planning (`models`), and one file per instrument."""
