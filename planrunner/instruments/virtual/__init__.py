"""The simulated bench: one world that the virtual table and chamber change and that the virtual sensor measures."""
