"""Whitens a recording with its noise, and evaluates how much better certain amplitudes explain the recording than no amplitudes do
(evidence)."""
