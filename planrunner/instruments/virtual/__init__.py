"""The simulated bench: one world that the virtual table and the virtual chamber change and that the virtual sensor measures."""
