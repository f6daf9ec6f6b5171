"""Runs in progress: observing them in an archive, serving the live page, and showing them on a terminal."""
