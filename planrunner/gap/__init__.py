"""Diagnosis of the gap between a recording and the simulation of the same plan: where the two differ, and which effect explains the
difference."""
