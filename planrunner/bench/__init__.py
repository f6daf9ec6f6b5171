"""Benches: with what and where a plan runs. Bench files, the models that they give, the connected bench and its clock."""
