"""Benches: with what and where a plan runs. Bench files, the models that they give, and the connected bench."""
