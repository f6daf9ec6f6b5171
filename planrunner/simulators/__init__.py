"""Simulates instruments in a separate process, which is reached over loopback TCP and pseudo-terminals. They share no code with the
drivers."""
