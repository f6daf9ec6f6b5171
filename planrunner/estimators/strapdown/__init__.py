"""Strapdown navigation: alignment, position errors and their prediction."""
