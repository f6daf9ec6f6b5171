"""What a diagnosis answers: the posterior, the verdict, the place of the gap, the closure, and what to measure next."""
