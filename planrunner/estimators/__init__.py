"""Estimators: one file an estimator; each turns a recording into coefficients with covariance."""
