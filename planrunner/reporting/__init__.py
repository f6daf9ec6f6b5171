"""Makes reports: data for templates, plots, pictures of orientations, tables for the terminal, and files of coefficients."""
