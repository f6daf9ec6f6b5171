"""Estimators: one file per estimator, or a folder if it has several parts. Each estimator turns a recording into coefficients with
their covariance.

Common parts are in this folder. A subfolder is named after its subject and contains one or two estimators with their parts."""
