"""Diagnoses the gap between a recording and the simulation of the same plan: finds where the two differ, and which effect explains
the difference."""
