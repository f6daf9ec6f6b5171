"""Hypotheses: the effects of the catalogue, and patterns that no effect explains, with their evidence."""
