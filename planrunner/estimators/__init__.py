"""Estimators: one file an estimator, with a folder around it where it has parts; each turns a recording into coefficients with covariance.

What several share lies here; a folder is named for what it estimates and holds one or two estimators and their parts."""
