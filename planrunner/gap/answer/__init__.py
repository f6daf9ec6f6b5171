"""Computes what a diagnosis answers: the posterior, the verdict, the part of the recording that shows the gap, the closure, and
what to measure next."""
