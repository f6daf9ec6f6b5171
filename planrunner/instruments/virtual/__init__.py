"""The simulated bench. The virtual table and the virtual chamber change one world, and the virtual sensor measures this world."""
