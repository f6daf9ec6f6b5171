"""Contains the estimators, with one file per estimator, or a folder if the estimator has several parts. Each estimator turns a
recording into coefficients with their covariance.

Parts that several estimators use are directly in this folder. A subfolder is named after its subject and contains one or two
estimators with their parts."""
