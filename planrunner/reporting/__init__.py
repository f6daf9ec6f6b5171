"""Reporting: data for templates, plots, pictures of orientations, terminal tables and coefficient files."""
