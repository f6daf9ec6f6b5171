"""Evidence: whitens a recording by its noise, and evaluates how much better it is explained with certain amplitudes than without."""
