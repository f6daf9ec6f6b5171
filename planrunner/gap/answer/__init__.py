"""Answers: posterior, verdict, place of the gap, closure, and what to measure next."""
