"""Executes a schedule on a bench: the executor, stopping on request, and progress."""
