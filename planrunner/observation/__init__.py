"""Converts a recording to data for fits: samples, still spans, means with their covariance, and temperatures, together with the
planned states."""
