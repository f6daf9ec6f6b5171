"""Reporting: what templates are given, plots, pictures of orientations, terminal tables and coefficient files."""
