"""Estimators that compare navigations with and without rotation cycles."""
