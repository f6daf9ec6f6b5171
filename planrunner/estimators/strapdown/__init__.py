"""Estimators for strapdown navigation: alignment, navigation errors and their prediction."""
