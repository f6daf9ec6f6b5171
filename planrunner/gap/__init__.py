"""Diagnosis of the gap between a recording and the simulation of the same plan: where they differ and which effect explains it."""
