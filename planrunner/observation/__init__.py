"""From a recording to what may be fitted: samples, still spans, means with their covariance, and temperatures, beside the planned state."""
