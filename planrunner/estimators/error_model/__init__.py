"""The estimator that determines the amplitudes of catalogue effects, and its parts."""
