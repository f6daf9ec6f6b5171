"""Candidate effects that a simulation may lack, one small class each."""
