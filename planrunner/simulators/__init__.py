"""Simulated instruments as a process of their own, on loopback TCP and pseudo-terminals; they share no code with the drivers."""
