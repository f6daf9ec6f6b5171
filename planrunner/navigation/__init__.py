"""Inertial navigation: WGS-84, strapdown mechanisation, alignment at rest, and how errors grow."""
