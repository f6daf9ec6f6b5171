"""Many runs on many devices and benches: what happened to an archive of runs over time."""
