"""Predicts which quantities a planned test can and cannot determine."""
