"""Whitens a recording with its noise, and evaluates the evidence for an effect: how much better the recording is explained with the
effect than without it."""
