"""Benches: the equipment and site that a plan runs on. This package contains bench files, the models made from them, the connected
bench and its clock."""
