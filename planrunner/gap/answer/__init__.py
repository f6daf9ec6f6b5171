"""Answers: posterior, verdict, where the gap is, whether it closes, and what to measure next."""
