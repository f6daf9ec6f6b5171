"""The simulated bench: one world that the virtual table and chamber change and the virtual sensor measures."""
