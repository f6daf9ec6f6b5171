"""Hypotheses: the effects of the catalogue, patterns that no effect explains, and the evidence for each."""
