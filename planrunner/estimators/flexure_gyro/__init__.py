"""Static coefficients of a flexure gyro, and what is left after compensating with them."""
