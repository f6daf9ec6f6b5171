"""The simulated bench. The virtual table and the virtual chamber change a common virtual world, and the virtual sensor measures
it."""
