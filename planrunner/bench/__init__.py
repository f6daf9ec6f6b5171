"""Benches: the equipment and site that a plan runs on. Bench files, the models made from them, the connected bench and its clock."""
