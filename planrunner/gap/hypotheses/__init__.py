"""Hypotheses: the effects of the catalogue, and patterns that no effect explains, weighed by the evidence."""
