"""Amplitudes of effects of the catalogue, fitted to the means of segments."""
