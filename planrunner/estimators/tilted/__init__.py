"""Estimators of the scale factors of several axes in one tilted mounting, and of the fixture angles on which they depend."""
