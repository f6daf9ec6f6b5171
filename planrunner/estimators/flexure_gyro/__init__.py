"""Static coefficients of a flexure gyro, and the residuals after compensation."""
