"""Contains the instruments: what they can do (`interfaces`), their models for planning (`models`), and one file for each
instrument."""
