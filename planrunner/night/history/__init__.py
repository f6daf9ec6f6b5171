"""History of devices: an index over run folders, and the statistics of coefficients over time."""
