"""Contains the estimator that determines the amplitudes of catalogue effects, and the parts of this estimator."""
