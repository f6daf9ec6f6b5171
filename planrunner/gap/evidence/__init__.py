"""Evidence: a recording whitened by its noise, and how much better some amplitudes explain it."""
