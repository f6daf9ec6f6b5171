"""Carrying out a schedule on a bench: the executor, its clocks, stopping on request and progress."""
