"""Strapdown navigation: alignment, navigation errors and their prediction."""
