"""Estimates the drift of a platform while its base rocks, from gravity and from gimbal angles."""
