"""Converts a recording to data for fits: samples, still spans, means with their covariance, and temperatures. Each comes with the
planned states."""
