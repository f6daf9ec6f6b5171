"""Candidate effects: what may be missing from a simulation, one small class each."""
