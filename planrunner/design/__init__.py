"""Computes what a planned test can and cannot determine, before the test runs."""
