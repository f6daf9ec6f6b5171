"""Evidence: a recording whitened by its noise, and how much better certain amplitudes explain it."""
