"""Review of plans, benches and runs: computes the meaning of each, and the difference between two of them."""
