"""Simulated instruments in a separate process, on loopback TCP and pseudo-terminals. They share no code with the drivers."""
