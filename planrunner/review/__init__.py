"""Review of plans, benches and runs: the meaning of each, and the difference between two of them."""
