"""Lists and evaluates the hypotheses: the effects of the catalogue, and patterns that no effect explains."""
