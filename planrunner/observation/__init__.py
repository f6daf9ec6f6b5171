"""Converts a recording to data for fits: samples, still spans, means with their covariance, and temperatures. Each recording is
combined with the planned states."""
