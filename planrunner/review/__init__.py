"""Review of plans, benches and runs: what they mean, and how two of them differ."""
