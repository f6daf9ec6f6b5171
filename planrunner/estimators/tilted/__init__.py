"""Estimators for several axes in one tilted mounting: they determine the scale factors of the axes, and the fixture angles on which
the scale factors depend."""
