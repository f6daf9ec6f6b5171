"""Estimates a platform's drift while it rocks, from gravity and from gimbal angles."""
