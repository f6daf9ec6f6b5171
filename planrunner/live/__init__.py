"""Observes the runs in progress in an archive, serves the live page, and shows runs in progress on a terminal."""
