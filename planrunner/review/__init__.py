"""Review of plans, benches and runs: their meaning, and the difference between two of them."""
