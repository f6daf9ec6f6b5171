"""Simulates instruments in a separate process, which is reached over loopback TCP and pseudo-terminals. The simulated instruments
share no code with the drivers."""
