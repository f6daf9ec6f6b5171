"""Strapdown navigation: alignment, position errors and what predicts them."""
