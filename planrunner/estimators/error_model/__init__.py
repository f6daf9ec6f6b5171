"""The estimator of amplitudes of catalogue effects, and its parts."""
