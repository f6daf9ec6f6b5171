"""Benchmarks. Each one compares planrunner with another program or with a lower limit of the time, both measured in the same run.
`python -m benchmarks` runs all of them."""
