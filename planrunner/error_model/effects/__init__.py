"""The catalogue of candidate effects, which may act on a real sensor but not in its simulation. Each effect is a small class."""
