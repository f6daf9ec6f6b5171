"""From a recording to what may be fitted: samples, means and temperatures beside the state that was planned for them."""
