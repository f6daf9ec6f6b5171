"""Simulated instruments in a separate process, reached over loopback TCP and pseudo-terminals. They share no code with the drivers."""
