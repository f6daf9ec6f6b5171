"""Computes inertial navigation: the ellipsoid WGS-84, strapdown mechanisation, alignment at rest, and the growth of errors."""
