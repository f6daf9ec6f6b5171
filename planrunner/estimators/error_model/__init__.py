"""Amplitudes of any effects of the catalogue from the means of segments."""
